"""What came of a world: findings, and the story that led to them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any, Final, NamedTuple, Self

_WHO: Final = 28
_INDENT: Final = 9 + 4 + _WHO + 1


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
    """One event of the story: when (s), whose process and thread, what."""

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
        struck: how many took effect, by kind; bad weather of one kind counts once.
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
    struck: dict[str, int]
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

    @property
    def kept(self) -> list[int]:
        """Numbers of the troubles that were not left out."""
        return [number for number in range(self.troubles) if number not in self.without]

    def told(self, last: int = 60) -> str:
        """Return the story for people: its last lines, and the findings.

        Args:
            last: how many lines of it.
        """
        skipped = max(0, len(self.story) - last)
        head = [
            f"seed {self.seed}: {self.over} after {self.virtual:.3f} s in the world, "
            f"{len(self.kept)} of {self.troubles} troubles, hash {self.hash}"
        ]
        if self.without:
            head.append(f"without the troubles {ranges(self.without)}")
        if skipped:
            head.append(f"({skipped} lines before)")
        lines = [_row(line.at, line.who, line.text) for line in self.story[skipped:]]
        found = [_row(each.at, "FOUND", f"{each.kind}: {each.text}") for each in self.findings]
        return "\n".join([*head, *lines, *found])

    def check(self) -> None:
        """Let a test fail, with the story, if something was found.

        Raises:
            AssertionError: something was.
        """
        if self.findings:
            raise AssertionError(self.told())


def ranges(numbers: Iterable[int]) -> str:
    """Return numbers as text, neighbours together: ``0-3,7``."""
    found: list[list[int]] = []
    for number in sorted(set(numbers)):
        if found and found[-1][-1] == number - 1:
            found[-1][1:] = [number]
        else:
            found.append([number])
    return ",".join("-".join(map(str, each)) for each in found)


def numbers(text: str) -> list[int]:
    """Return what `ranges` has written.

    Raises:
        ValueError: it is something else.
    """
    found: list[int] = []
    for part in filter(None, text.split(",")):
        first, _, last = part.partition("-")
        found.extend(range(int(first), int(last or first) + 1))
    return found


def _row(at: float, who: str, text: str) -> str:
    first, *more = text.rstrip().splitlines() or [""]
    who = who if len(who) <= _WHO else f"{who[: _WHO - 3]}..."
    return "\n".join(
        [f"{at:9.4f} s  {who:<{_WHO}} {first}", *(f"{'':{_INDENT}}{each}" for each in more)]
    )
