"""All tests of the bench, in the order of their safety."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

from crtk_drivers.errors import ConfigError
from crtk_drivers.errors.near_names import near_names
from crtk_drivers.labs.bench import (
    efforts,
    endurance,
    forces,
    grips,
    homings,
    limits,
    lines,
    links,
    losses,
    marked,
    motions,
    operated,
    ranges,
    reaction,
    sampling,
    staying,
    stops,
    together,
    tracking,
    weighing,
)
from crtk_drivers.labs.bench.acquisition import BenchTest, Suite
from crtk_drivers.labs.verdicts.judging import Quantity

TESTS: Final[tuple[BenchTest, ...]] = tuple(
    sorted(
        (
            test
            for part in (
                *(sampling, staying, stops, motions, efforts, reaction, endurance),
                *(
                    ranges,
                    homings,
                    lines,
                    grips,
                    tracking,
                    marked,
                    weighing,
                    together,
                    limits,
                    forces,
                    losses,
                    links,
                ),
                *(operated,),
            )
            for test in part.TESTS
        ),
        key=lambda test: test.acquisition.safety,
    )
)
"""Sorting keeps the order within a class."""

ACQUISITIONS: Final = {test.acquisition.name: test.acquisition for test in TESTS}
"""By name."""

QUANTITIES: Final[Mapping[str, Quantity]] = {
    quantity.id: quantity for test in TESTS for quantity in test.quantities
}
"""All that is measured, by id."""


def chosen(suite: Suite, only: Iterable[str] = ()) -> tuple[BenchTest, ...]:
    """Return the tests of a suite, or those that are named, whatever their suite.

    Raises:
        ConfigError: there is no such test.
    """
    wanted = tuple(only)
    known = {test.id: test for test in TESTS}
    for name in wanted:
        if name not in known:
            meant = near_names(name, known)
            hint = f"Did you mean {meant[0]!r}? " if meant else ""
            raise ConfigError(
                f"there is no test {name!r}",
                remedy=f"{hint}crtk-driver bench list has all of them.",
            )
    if wanted:
        return tuple(test for test in TESTS if test.id in wanted)
    return tuple(test for test in TESTS if suite.holds(test.acquisition.suite))
