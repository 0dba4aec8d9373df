"""What a lab's own test measures: figures with bounds, judged by their intervals as those of the bench."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Final, Literal

import numpy as np

from crtk_drivers.errors import ConfigError
from crtk_drivers.labs.bench.bounds import OWN_GROUP, bound_trouble, bounded
from crtk_drivers.labs.lab_file import BoundEntry
from crtk_drivers.labs.verdicts.estimates import Estimate, exact, mean
from crtk_drivers.labs.verdicts.judging import (
    Bound,
    Comparison,
    Findings,
    Measurement,
    Quantity,
    Worse,
)

__all__ = ["Figures"]

_ID: Final = re.compile(rf"{OWN_GROUP}(\.[a-z][a-z0-9_]*)+")


class Figures:
    """The fixture ``measure``: called with what was measured; the verdict is made when the test has ended.

    Args:
        bounds: of the lab file, by id.
        places: where each was written.
    """

    def __init__(self, bounds: Mapping[str, BoundEntry], places: Mapping[str, str]) -> None:
        self._bounds = bounds
        self._places = places
        self._measured: list[Measurement] = []
        self._doubts: list[str] = []

    def __call__(
        self,
        name: str,
        value: float | Sequence[float] | Estimate | None,
        unit: str = "",
        *,
        at_most: float | None = None,
        at_least: float | None = None,
        within: tuple[float, float] | None = None,
        because: str = "the test",
        worse: Literal["higher", "lower", "either"] | None = None,
        guard: float = 0.0,
        part: str = "",
        title: str = "",
        why: str = "",
    ) -> Measurement:
        """Keep a figure and judge it; without a bound it is told, and compared with earlier runs.

        Args:
            name: its id, ``lab.<what>.<quantity>``, the same for ever: a figure that is measured in another
                way has another one.
            value: a number; repeated trials (n,), whose mean counts; an `Estimate`; None: it could not be
                measured, and nothing is decided.
            unit: of it.
            at_most, at_least, within: the bound, one of them or none. One of the lab file takes its place.
            because: where the bound comes from.
            worse: which way a change is for the worse; as the bound says if None, higher without one.
            guard: the least change against earlier runs that counts, in `unit`.
            part: of what, where one figure is measured of several things.
            title: for people; the last part of the id if empty.
            why: it could not be measured, or what is to be added.

        Raises:
            ValueError: the id, the value or the bound is none, or it was measured in this test already.
            ConfigError: the bound of the lab file does not suit it.
        """
        if not _ID.fullmatch(name):
            raise ValueError(
                f"{name!r} is no id: lower case, with dots, beginning with {OWN_GROUP!r}, such as "
                f"'{OWN_GROUP}.press.depth'"
            )
        if any((one.quantity.id, one.part) == (name, part) for one in self._measured):
            raise ValueError(f"{name} is measured twice in this test: give each a `part`")
        comparison, bound = _bound(name, at_most, at_least, within, because)
        direction = Worse(worse) if worse is not None else _WORSE[comparison]
        quantity = Quantity(
            name, title or name.rpartition(".")[2], unit, comparison, direction, guard
        )
        entry = self._bounds.get(name)
        if entry is not None:
            trouble = bound_trouble(quantity, entry)
            if trouble:
                raise ConfigError(f"bounds.{name}: {trouble}", where=self._places.get(name, ""))
            quantity, bound = bounded(quantity, entry, bound)
        found = Measurement(quantity, _estimate(name, value), bound, why, part)
        self._measured.append(found)
        return found

    def doubt(self, why: str) -> None:
        """Say why nothing can be decided: too few samples, an amplitude that is below the resolution."""
        self._doubts.append(why)

    def findings(self, violations: Sequence[str] = (), doubts: Sequence[str] = ()) -> Findings:
        """Return all that was found.

        Args:
            violations: what failed beside the figures.
            doubts: why nothing can be said, beside what the test says.
        """
        return Findings(tuple(self._measured), tuple(violations), (*self._doubts, *doubts))


_WORSE: Final = {
    Comparison.AT_MOST: Worse.HIGHER,
    Comparison.AT_LEAST: Worse.LOWER,
    Comparison.WITHIN: Worse.EITHER,
    Comparison.TOLD: Worse.HIGHER,
}


def _bound(
    name: str,
    at_most: float | None,
    at_least: float | None,
    within: tuple[float, float] | None,
    because: str,
) -> tuple[Comparison, Bound | None]:
    given = [value for value in (at_most, at_least, within) if value is not None]
    if len(given) > 1:
        raise ValueError(f"{name}: at_most, at_least, within: one of them")
    if not given:
        return Comparison.TOLD, None
    if within is not None:
        lower, upper = within
        if not lower <= upper:
            raise ValueError(f"{name}: within {lower} to {upper} is nothing")
        return Comparison.WITHIN, Bound(upper, because, lower)
    (value,) = given
    assert isinstance(value, int | float)
    if math.isnan(value):
        raise ValueError(f"{name}: the bound is no number")
    return (Comparison.AT_LEAST if at_most is None else Comparison.AT_MOST), Bound(value, because)


def _estimate(name: str, value: float | Sequence[float] | Estimate | None) -> Estimate | None:
    if value is None or isinstance(value, Estimate):
        return value
    values = np.asarray(value, dtype=np.float64)
    if not np.isfinite(values).all():
        raise ValueError(f"{name}: {value} is not finite; give None for what could not be measured")
    return exact(float(values)) if values.ndim == 0 else mean(values)
