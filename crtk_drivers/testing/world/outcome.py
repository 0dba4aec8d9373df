"""What came of a world: findings, and the story that led to them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, NamedTuple, Self


class Finding(NamedTuple):
    """Something that must not be.

    Attributes:
        kind: what kind of thing, the same in each run that finds it.
        at: s from the beginning of the world.
        text: for people.
    """

    kind: str
    at: float
    text: str


class Line(NamedTuple):
    """One event of the story: when (s), who, what."""

    at: float
    who: str
    text: str


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of one seed.

    Attributes:
        seed: of all that happened.
        over: why the world ended: ``done``, or the kind of its finding.
        hash: of every decision and every byte. The same seed gives the same one.
        findings: empty if all was well.
        story: what happened, in order.
        troubles: how many troubles were drawn.
        without: numbers of those that were left out.
        virtual, cpu: s that passed in the world, and of the processor.
        switches, packets: how often another thread went on, and what was sent.
        result: what the scenario returned, as JSON has it; None if it did not come to its end.
    """

    seed: int
    over: str
    hash: str
    findings: tuple[Finding, ...]
    story: tuple[Line, ...]
    troubles: int
    without: tuple[int, ...]
    virtual: float
    cpu: float
    switches: int
    packets: int
    result: Any = None

    @classmethod
    def of_json(cls, found: dict[str, Any]) -> Self:
        """Return the outcome that a host has sent."""
        lists = {
            "findings": tuple(Finding(*each) for each in found["findings"]),
            "story": tuple(Line(*each) for each in found["story"]),
            "without": tuple(found["without"]),
        }
        return cls(**found | lists)

    def to_json(self) -> dict[str, Any]:
        """Return what `of_json` takes."""
        return asdict(self)

    @property
    def kinds(self) -> frozenset[str]:
        """Of the findings."""
        return frozenset(finding.kind for finding in self.findings)

    def told(self, last: int = 60) -> str:
        """Return the story for people: its last lines, and the findings.

        Args:
            last: how many lines of it.
        """
        skipped = max(0, len(self.story) - last)
        head = [f"seed {self.seed}, {self.virtual:.3f} s in the world, hash {self.hash}"]
        if self.without:
            head.append(f"without the troubles {', '.join(map(str, self.without))}")
        if skipped:
            head.append(f"({skipped} lines before)")
        lines = [f"{line.at:10.4f} s  {line.who:<16} {line.text}" for line in self.story[skipped:]]
        found = [
            f"{finding.at:10.4f} s  FOUND {finding.kind}: {finding.text}"
            for finding in self.findings
        ]
        return "\n".join([*head, *lines, *found])

    def check(self) -> None:
        """Let a test fail, with the story, if something was found.

        Raises:
            AssertionError: something was.
        """
        if self.findings:
            raise AssertionError(self.told())
