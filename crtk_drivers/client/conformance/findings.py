"""What became of a clause: a verdict, and what was seen."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from crtk_drivers.client.conformance.clause_rows import Level
from crtk_drivers.client.conformance.clauses import CLAUSES, Clause

MOST_EVIDENCE: Final = 5
"""Lines of evidence that a finding keeps."""


class Verdict(StrEnum):
    """Of a clause. The worst of several is the one that counts."""

    CONFORMS = "CONFORMS"
    DIVERGES = "DIVERGES"
    UNDETERMINED = "UNDETERMINED"
    NOT_OFFERED = "NOT OFFERED"


@dataclass(frozen=True, slots=True)
class Finding:
    """A verdict, what was seen in one line, and the messages that show it."""

    verdict: Verdict
    text: str
    evidence: tuple[str, ...] = ()


def conforms(text: str) -> Finding:
    """It is as CRTK asks."""
    return Finding(Verdict.CONFORMS, text)


def diverges(text: str, evidence: Iterable[str] = ()) -> Finding:
    """It is not."""
    lines = tuple(evidence)
    left = len(lines) - MOST_EVIDENCE
    more = (f"and {left} more",) if left > 0 else ()
    return Finding(Verdict.DIVERGES, text, (*lines[:MOST_EVIDENCE], *more))


def undetermined(why: str) -> Finding:
    """It could not be found out."""
    return Finding(Verdict.UNDETERMINED, why)


def not_offered(what: str) -> Finding:
    """The device does not have what the clause is about."""
    return Finding(Verdict.NOT_OFFERED, what)


@dataclass(frozen=True, slots=True)
class Judged:
    """A clause with its finding."""

    clause: Clause
    finding: Finding

    @property
    def is_violated(self) -> bool:
        """Whether something is not as it must be."""
        return self.finding.verdict is Verdict.DIVERGES and self.clause.level is Level.MUST


_ORDER: Final = (
    Verdict.DIVERGES,
    Verdict.CONFORMS,
    Verdict.UNDETERMINED,
    Verdict.NOT_OFFERED,
)


def together(findings: Sequence[Finding]) -> Finding:
    """Return what several trials of one clause say: one that diverges counts, whatever others say."""
    worst = min(findings, key=lambda each: _ORDER.index(each.verdict)).verdict
    same = [each for each in findings if each.verdict is worst]
    texts = dict.fromkeys(each.text for each in same)
    return Finding(worst, "; ".join(texts), tuple(line for each in same for line in each.evidence))


def judged(findings: Mapping[str, Sequence[Finding]], ids: Iterable[str]) -> tuple[Judged, ...]:
    """Return the clauses `ids` with what was found of them."""
    return tuple(Judged(CLAUSES[each], together(findings[each])) for each in ids)


def exit_code(results: Iterable[Judged]) -> int:
    """Return 1 if a MUST diverges, 3 if nothing could be judged, otherwise 0."""
    found = tuple(results)
    if any(each.is_violated for each in found):
        return 1
    said = {each.finding.verdict for each in found}
    return 0 if said & {Verdict.CONFORMS, Verdict.DIVERGES} else 3
