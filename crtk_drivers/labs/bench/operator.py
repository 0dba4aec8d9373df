"""Who stands beside a device and does what a test needs, or does it to its simulator."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final, Protocol

from crtk_drivers.labs.bench.conducting import Asked

STOP_LOOK_PERIOD: Final = 0.002
"""Seconds between two looks where it is measured how soon a button is noticed."""

PERSON_TAKES: Final = 60.0
"""Seconds in which a person presses an emergency stop, once asked."""

PERSON_RELEASES: Final = 20.0
"""Seconds in which a person pulls it out again: nothing that every device tells shows that."""

UNNOTICED: Final = 2.0
"""Seconds after which a simulator's emergency stop has not been noticed."""


class Operator(Protocol):
    """Who stands beside a device, or does what he would to its simulator."""

    @property
    def is_person(self) -> bool:
        """Whether somebody has to read what is asked, and to walk to it."""

    def press_stop(self) -> None:
        """Press the emergency stop, or ask for that."""

    def release_stop(self) -> None:
        """Pull it out again, or ask for that."""


@dataclass(frozen=True)
class Pressed:
    """How an emergency stop was noticed.

    Attributes:
        noticed: seconds after it was pressed, or asked for; None if it was not.
        look: seconds by which that may be late: between two looks.
        by_operator: nobody knows when it was pressed.
    """

    noticed: float | None
    look: float
    by_operator: bool


@contextmanager
def pressed(operator: Operator) -> Iterator[None]:
    """Within, an emergency stop is pressed, or asked for; after that a person has time to release it."""
    operator.press_stop()
    try:
        yield
    finally:
        operator.release_stop()
    if operator.is_person:
        time.sleep(PERSON_RELEASES)


class Person:
    """The operator, who reads what `tell` tells the parent of a conductor."""

    is_person: Final = True

    def __init__(self, tell: Callable[[object], None], device: str) -> None:
        self._tell = tell
        self._device = device

    def press_stop(self) -> None:
        """Ask for it."""
        what = f"press the emergency stop of {self._device}, within {PERSON_TAKES:g} s"
        self._tell(Asked(what))

    def release_stop(self) -> None:
        """Ask for it."""
        what = f"release the emergency stop of {self._device}, within {PERSON_RELEASES:g} s"
        self._tell(Asked(what))
