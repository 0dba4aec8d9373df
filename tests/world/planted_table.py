"""The table of mistakes that are planted: in whose driver each is looked for, and what finds it.

The mistakes are in `planted.py` and in the files that it imports. None of these imports pytest: they are
imported in patched Python.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from types import SimpleNamespace
from typing import Final, NamedTuple

from world.subjects import SUBJECTS

from crtk_drivers.testing.world import far_user, user

USE, CALM, FAREWELL, DIE, STILL, FAR = "use", "calm", "farewell", "die", "still", "far"

SCENARIOS: Final = SimpleNamespace(
    **{
        f"{name}_{way}": functools.partial(scenario, subject=subject)
        for name, subject in SUBJECTS.items()
        for way, scenario in {
            USE: user.use,
            CALM: user.use,
            FAREWELL: user.farewell,
            DIE: user.die,
            STILL: user.still,
            FAR: far_user.far,
        }.items()
    }
)
"""Each device by each way of using it."""


class Planted(NamedTuple):
    """A mistake.

    Attributes:
        plant: makes it.
        text: what is wrong.
        device: in whose driver it is looked for.
        way: how that is used; all but `CALM` in bad weather.
        kinds: of findings that count as finding it.
        seeds: that may be needed at most, from 1 on.
    """

    plant: Callable[[], None]
    text: str
    device: str
    way: str
    kinds: frozenset[str]
    seeds: int

    @property
    def scenario(self) -> str:
        """Its name in this file."""
        return f"SCENARIOS.{self.device}_{self.way}"


PLANTED: Final[dict[str, Planted]] = {}
"""All of them, by name."""


def planted(
    device: str, way: str, *kinds: str, seeds: int
) -> Callable[[Callable[[], None]], Callable[[], None]]:
    """Enter a function into the table."""

    def enter(plant: Callable[[], None]) -> Callable[[], None]:
        text = (plant.__doc__ or "").strip()
        PLANTED[plant.__name__] = Planted(plant, text, device, way, frozenset(kinds), seeds)
        return plant

    return enter


MOVES = "moves though nobody asks"
NOT_ENABLED = "moves when not enabled"
BELIEVED = "a stop is believed too early"
STAMP = "a stamp is wrong"
OLD = "enabled with an old sample"
HORIZON = "not done at the horizon"
LEFT = "close leaves something behind"
REASONLESS = "refused without a reason"
UNASKED = "moves unasked"
FAST = "beyond its limits"
AFTER_DEATH = "moves after its driver died"
AFTER_CLOSE = "moves after close"
TOO_EARLY = "reached too early"
CONTRADICTS = "wait contradicts the outcome"
NONSENSE = "nonsense is accepted"
WAITS = "a stop waits"
FAILS = "it fails though nothing is wrong"
DEADLOCK = "deadlock"
FOR_EVER = "all wait for ever"
STUCK = "a stuck thread is no fault"
DIED = "a thread died"
REFUSED = "a stop is refused"
MIXED = "two clients are mixed"
