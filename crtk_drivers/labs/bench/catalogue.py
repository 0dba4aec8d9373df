"""All tests of the bench, in the order of their safety."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from crtk_drivers.errors import ConfigError
from crtk_drivers.labs.bench import (
    forces,
    losses,
    motions,
    sampling,
    staying,
    stops,
    together,
    weighing,
)
from crtk_drivers.labs.bench.declared import BenchTest, Suite

__all__ = ["ACQUISITIONS", "TESTS", "chosen"]

TESTS: Final[tuple[BenchTest, ...]] = tuple(
    sorted(
        (
            *sampling.TESTS,
            *staying.TESTS,
            *stops.TESTS,
            *motions.TESTS,
            *weighing.TESTS,
            *together.TESTS,
            *forces.TESTS,
            *losses.TESTS,
        ),
        key=lambda test: test.acquisition.safety,
    )
)
"""Sorting keeps the order within a class."""

ACQUISITIONS: Final = {test.acquisition.name: test.acquisition for test in TESTS}
"""By name."""


def chosen(suite: Suite, only: Iterable[str] = ()) -> tuple[BenchTest, ...]:
    """Return the tests of a suite, or those that are named, whatever their suite.

    Raises:
        ConfigError: there is no such test.
    """
    wanted = tuple(only)
    known = {test.id: test for test in TESTS}
    for name in wanted:
        if name not in known:
            raise ConfigError(
                f"there is no test {name!r}", remedy="crtk-driver bench list has all of them."
            )
    if wanted:
        return tuple(test for test in TESTS if test.id in wanted)
    return tuple(test for test in TESTS if suite.holds(test.acquisition.suite))
