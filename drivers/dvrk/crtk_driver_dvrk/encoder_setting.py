"""Where encoders are to be set by the potentiometers of an arm that rests. Steps of a procedure, no I/O."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Final

import numpy as np

from crtk_driver_dvrk.arm import Joints, States
from crtk_driver_dvrk.registers import MIDDLE
from crtk_drivers.errors import TransitionFailed
from crtk_drivers.kit.waiting_steps import until

_SAMPLES: Final = 25
_TIME: Final = 3.0
"""Readings of which potentiometers are averaged, and seconds within which they must come."""

_RESTS: Final = 20
"""Counts by which an encoder of an arm that rests may move meanwhile."""

_HIGHEST: Final = 0xFFFFFF


def preloads(
    joints: Joints, states: Callable[[], States], where: str
) -> Generator[None, None, list[int]]:
    """Return from what each encoder must count on, so that it tells what its potentiometer does.

    Args:
        joints: of the arm.
        states: returns those of the newest reading; what it raises ends the procedure.
        where: the controller, for errors.

    Raises:
        TransitionFailed: the arm moves, is not read, or is where an encoder cannot be.
    """
    taken = [states()]

    def is_enough() -> bool:
        newest = states()
        if newest is not taken[-1]:
            taken.append(newest)
        return len(taken) >= _SAMPLES

    if not (yield from until(is_enough, _TIME)):
        raise TransitionFailed("boards do not tell their state", where=where)
    told = [joints.of_actuators(each) for each in taken]
    counts = np.array([joints.counts(encoders) for encoders, _ in told])
    if np.ptp(counts, axis=0).max() > _RESTS:
        raise TransitionFailed(
            "the arm moves", where=where, remedy="Let it rest, then ask again for set_encoders."
        )
    found = [MIDDLE + count for count in joints.counts(np.mean([pots for _, pots in told], axis=0))]
    # One that has never been set counts from the middle: one count beside it says that it was.
    found = [value + 1 if value == MIDDLE else value for value in found]
    if not all(0 <= value <= _HIGHEST for value in found):
        raise TransitionFailed(
            f"potentiometers say that encoders are at {found}, of which one is beyond its range",
            where=where,
            remedy="Look at the potentiometers, and at their conversions in `io`.",
        )
    return found
