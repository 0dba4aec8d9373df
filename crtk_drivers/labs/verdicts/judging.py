"""Measurements against bounds: what is judged, how, and the verdict of a test.

A verdict is an interval against a bound: PASS when the whole of it is within, FAIL when it is beyond, and
INCONCLUSIVE when it holds the bound. What may not happen at all (a joint moves while it is DISABLED) is a
violation, and fails whatever was measured; what makes a measurement worthless (a machine that is too slow, a
motion below the resolution) is a doubt, and leaves it open.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from crtk_drivers.labs.verdicts.estimates import Estimate

MARGIN: Final = 0.1
"""Share of a bound: a value that passes, but is that near to it, is told as marginal."""


class Verdict(StrEnum):
    """What became of a test or a measurement."""

    PASS = "PASS"
    FAIL = "FAIL"
    INCONCLUSIVE = "INCONCLUSIVE"
    SKIPPED = "SKIPPED"


class Comparison(StrEnum):
    """How a value is held against its bound, in words."""

    AT_MOST = "at most"
    AT_LEAST = "at least"
    WITHIN = "within"
    """Two bounds."""
    TOLD = "told"
    """No bound: it is compared with earlier runs only."""


class Worse(StrEnum):
    """Which direction of a change is for the worse."""

    HIGHER = "higher"
    LOWER = "lower"
    EITHER = "either"


@dataclass(frozen=True, slots=True)
class Quantity:
    """Something that a test measures, declared before it is.

    Attributes:
        id: ``group.test.quantity``, the same for ever; a changed method has a new one.
        title: for people.
        unit: SI, or ms, mm, %, where people expect these; empty: a number.
        comparison: with its bound.
        worse: which direction is.
        guard: the least change against earlier runs that counts, in `unit`: how well it repeats.
    """

    id: str
    title: str
    unit: str
    comparison: Comparison
    worse: Worse = Worse.HIGHER
    guard: float = 0.0

    @classmethod
    def at_most(cls, id_: str, title: str, unit: str, guard: float = 0.0) -> Quantity:
        """Return one of which less is better."""
        return cls(id_, title, unit, Comparison.AT_MOST, Worse.HIGHER, guard)

    @classmethod
    def at_least(cls, id_: str, title: str, unit: str, guard: float = 0.0) -> Quantity:
        """Return one of which more is better."""
        return cls(id_, title, unit, Comparison.AT_LEAST, Worse.LOWER, guard)

    @classmethod
    def within(cls, id_: str, title: str, unit: str, guard: float = 0.0) -> Quantity:
        """Return one that has one value that is right."""
        return cls(id_, title, unit, Comparison.WITHIN, Worse.EITHER, guard)

    @classmethod
    def told(cls, id_: str, title: str, unit: str, guard: float = 0.0) -> Quantity:
        """Return one without a bound, of which less is better."""
        return cls(id_, title, unit, Comparison.TOLD, Worse.HIGHER, guard)


@dataclass(frozen=True, slots=True)
class Bound:
    """What a value is held against.

    Attributes:
        value: of `Comparison.AT_MOST` and `AT_LEAST`; the upper one of `WITHIN`.
        source: where it comes from, in words: "default", "datasheet", "the lab file", "declared lag + 3
            periods".
        lower: of `WITHIN`.
    """

    value: float
    source: str
    lower: float = -math.inf


@dataclass(frozen=True, slots=True)
class Measurement:
    """A quantity as it was measured.

    Attributes:
        quantity: what it is.
        estimate: None if it could not be measured.
        bound: None if it is only told.
        why: why it could not be measured, or what is to be added.
        part: of what, where a test measures one quantity of several things: the name of a joint.
    """

    quantity: Quantity
    estimate: Estimate | None
    bound: Bound | None = None
    why: str = ""
    part: str = ""

    @property
    def verdict(self) -> Verdict:
        """The interval against the bound."""
        if self.estimate is None:
            return Verdict.INCONCLUSIVE
        if self.bound is None or self.quantity.comparison is Comparison.TOLD:
            return Verdict.PASS
        lower, upper = self._allowed
        if lower <= self.estimate.lower and self.estimate.upper <= upper:
            return Verdict.PASS
        if self.estimate.upper < lower or self.estimate.lower > upper:
            return Verdict.FAIL
        return Verdict.INCONCLUSIVE

    @property
    def is_marginal(self) -> bool:
        """Whether it passes, but nearer to its bound than `MARGIN` of it."""
        if self.verdict is not Verdict.PASS or self.bound is None or self.estimate is None:
            return False
        lower, upper = self._allowed
        width = upper - lower if math.isfinite(upper - lower) else abs(self.bound.value)
        room = min(upper - self.estimate.upper, self.estimate.lower - lower)
        # Of a count that may be 0 and is 0 there is nothing to be near to.
        return room < MARGIN * width and width > 0.0

    @property
    def told(self) -> str:
        """In words: ``stop time 0.310 s (0.300 to 0.320), at most 0.200 s``."""
        quantity, estimate = self.quantity, self.estimate
        name = f"{quantity.title} of {self.part}" if self.part else quantity.title
        if estimate is None:
            return f"{name}: not measured: {self.why}"
        value = with_unit(estimate.value, quantity.unit)
        spread = ""
        if estimate.lower < estimate.value or estimate.upper > estimate.value:
            spread = f" ({number(estimate.lower)} to {number(estimate.upper)})"
        return f"{name} {value}{spread}{self.bound_told}{self.why and f' ({self.why})'}"

    @property
    def bound_told(self) -> str:
        """In words, with a comma before it: ``, at most 0.2 s``; empty if it is only told."""
        quantity, bound = self.quantity, self.bound
        if bound is None or quantity.comparison is Comparison.TOLD:
            return ""
        value = with_unit(bound.value, quantity.unit)
        if quantity.comparison is Comparison.WITHIN:
            return f", within {number(bound.lower)} to {value}"
        return f", {quantity.comparison} {value}"

    @property
    def _allowed(self) -> tuple[float, float]:
        assert self.bound is not None
        match self.quantity.comparison:
            case Comparison.AT_MOST:
                return -math.inf, self.bound.value
            case Comparison.AT_LEAST:
                return self.bound.value, math.inf
            case _:
                return self.bound.lower, self.bound.value


@dataclass(frozen=True, slots=True)
class Series:
    """A line of a plot: `x` and `y` of one size."""

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Plot:
    """What is drawn beside the figures of a test."""

    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]

    @classmethod
    def of(
        cls,
        title: str,
        x_label: str,
        y_label: str,
        *lines: tuple[str, Iterable[float], Iterable[float]],
    ) -> Plot:
        """Return the plot of lines, of each its name, `x` and `y`."""
        series = tuple(Series(name, tuple(x), tuple(y)) for name, x, y in lines)
        return cls(title, x_label, y_label, series)


@dataclass(frozen=True, slots=True)
class Findings:
    """All that was found by one test.

    Attributes:
        measurements: in the order in which they are told.
        violations: what may not happen, and did.
        doubts: why nothing can be said.
        plots: for the report.
    """

    measurements: tuple[Measurement, ...] = ()
    violations: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    plots: tuple[Plot, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """The worst of it; see the module."""
        if self.violations:
            return Verdict.FAIL
        if self.doubts or not self.measurements:
            return Verdict.INCONCLUSIVE
        return verdict_of(measurement.verdict for measurement in self.measurements)

    @property
    def reason(self) -> str:
        """Why it is not PASS; empty if it is."""
        verdict = self.verdict
        if verdict is Verdict.PASS:
            return ""
        if self.violations:
            return "; ".join(self.violations)
        if self.doubts:
            return _joined(self.doubts)
        return "; ".join(one.told for one in self.measurements if one.verdict is verdict)


def _joined(doubts: Iterable[str]) -> str:
    """Return doubts in a row, each once; those that begin alike, up to a colon, share that beginning."""
    groups: dict[str, dict[str, None]] = {}
    for doubt in doubts:
        head, colon, rest = doubt.partition(": ")
        groups.setdefault(head + colon, {})[rest] = None
    return "; ".join(head + "; ".join(rests) for head, rests in groups.items())


def verdict_of(verdicts: Iterable[Verdict]) -> Verdict:
    """Return what several verdicts amount to: one FAIL fails; nothing that was judged is SKIPPED."""
    found = set(verdicts)
    for verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE, Verdict.PASS):
        if verdict in found:
            return verdict
    return Verdict.SKIPPED


def number(value: float) -> str:
    """Return a number with three or four digits that count."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"


def with_unit(value: float, unit: str) -> str:
    """Return a number with its unit."""
    return f"{number(value)} {unit}".rstrip()
