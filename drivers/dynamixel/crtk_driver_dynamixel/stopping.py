"""A stop of servos that is believed only when it was read back: the goal, and that nothing turns any more.

What is written in a cycle nobody answers, and any packet may be lost: so it is written again, as long as that
takes.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final

from crtk_driver_dynamixel.chain_link import ChainLink
from crtk_driver_dynamixel.joints import ChainServo
from crtk_driver_dynamixel.models import GOALS
from crtk_driver_dynamixel.modes import Modes
from crtk_driver_dynamixel.servo_state import Values

EAGER: Final = 5
"""Cycles in each of which servos are read back; then in every other one, as that takes the line's time."""
STOP_TIME: Final = 0.5
"""Seconds in which servos without a profile stand after a stop; past it that is told."""


class Stopping:
    """Stops some servos of a chain.

    Args:
        link: to the chain.
        modes: which each servo is in.
        places: of the servos.

    Attributes:
        time: seconds in which they stand, at the latest.
        unconfirmed: places of those that were told to stop, and are not known to have.
    """

    def __init__(self, link: ChainLink, modes: Modes, places: Sequence[int]) -> None:
        self._link = link
        self._modes = modes
        self._places = tuple(places)
        self.unconfirmed: tuple[int, ...] = ()
        self.time = STOP_TIME + max(_ramp(link.chain.servos[place]) for place in places)

    def write(self, places: Sequence[int], held: Mapping[int, int | None] | None = None) -> None:
        """Tell servos once to stop; nobody answers.

        Args:
            held: goals by the place of servos in a mode for positions; others of them are told nothing. None:
                a servo keeps the goal that it has, and is not known to have stopped.
        """
        wanted = self._wanted(places, held or {})
        taking = {place: goals for place, goals in wanted.items() if self._link.takes_goals(place)}
        self._link.write_values(taking)

    def write_from_outside(self) -> None:
        """Tell servos with velocities or efforts to stop, from another thread than the I/O thread."""
        self._link.write_from_outside(self._wanted(self._places, {}))

    def until_confirmed(
        self,
        places: Callable[[], Sequence[int]],
        held: Mapping[int, int | None] | None = None,
        *,
        at_once: bool,
    ) -> Iterator[str]:
        """Tell servos to stop until each is read to have: by its goal, without torque, or by its watchdog.

        Args:
            places: of those to be stopped, asked anew in each cycle.
            held: see `write`; may change from cycle to cycle.
            at_once: write before the first reading, and to those that do not answer: a goal may switch the
                torque on of a servo that was not enabled.

        Yields:
            what is the matter, once `time` is over; empty before.
        """
        goals = {} if held is None else held
        end = time.monotonic() + self.time
        if at_once:
            self.write(places(), goals)
        stopped: set[int] = set()
        for turn in itertools.count():
            if turn >= EAGER and turn % 2:
                yield self._told() if time.monotonic() > end else ""
                continue
            here = [place for place in places() if place not in stopped]
            # Who is silent would cost the others the time of its answer, cycle by cycle.
            read = self._link.read_values([p for p in here if self._link.answers(p)], _READ)
            wanted = self._wanted(here, goals)
            moving = [
                place
                for place in here
                if not self._stands(
                    place, read.get(place), wanted, is_open=goals.get(place, 0) is None
                )
            ]
            stopped |= {*here} - {*moving}
            self.unconfirmed = tuple(moving)
            if not moving:
                return
            yield self._told() if time.monotonic() > end else ""
            self.write(
                [p for p in moving if (at_once if p not in read else _has_torque(read[p]))], goals
            )

    def _told(self) -> str:
        names = ", ".join(self._link.chain.servos[place].place for place in self.unconfirmed)
        return f"{names}: told to stop, and not seen to have stopped in {self.time:g} s"

    def _wanted(self, places: Sequence[int], held: Mapping[int, int | None]) -> dict[int, Values]:
        """Return the goals at which servos stop, in the mode that each is in."""
        wanted: dict[int, Values] = {}
        for place in places:
            register = self._modes.stop_register(place)
            if self._link.chain.servos[place].follow == "cable":
                continue  # it has no goals
            if register is not None:
                wanted[place] = {register: 0}
            elif (goal := held.get(place)) is not None:
                wanted[place] = {"goal_position": goal}
        return wanted

    def _stands(
        self, place: int, read: Values | None, wanted: Mapping[int, Values], *, is_open: bool
    ) -> bool:
        """Whether what was read of a servo says that it has stopped.

        Args:
            read: None: it did not answer.
            is_open: where it is to be held is not known yet.
        """
        if read is None:
            return False
        if not _has_torque(read):
            return True
        goals = wanted.get(place, {})
        has_goal = not is_open and all(read.get(name) == value for name, value in goals.items())
        if not has_goal and read.get("bus_watchdog", 0) >= 0:
            return False
        return self._modes.stop_register(place) not in _TURNING or self._link.rests(place)


_TURNING: Final = ("goal_velocity", "moving_speed", "goal_torque")
"""Registers that stop a servo some time after they hold 0."""

_READ: Final = (
    *("torque_enable", "bus_watchdog", "goal_position"),
    *dict.fromkeys((*GOALS.values(), *_TURNING)),
)


def _has_torque(read: Values) -> bool:
    return bool(read.get("torque_enable", 1))


def _ramp(servo: ChainServo) -> float:
    """Return the seconds in which the profile of a servo brings it to rest from its greatest speed."""
    speed, acceleration = servo.units.model.no_load_speed, servo.config.profile_acceleration
    known = 10.0 if math.isnan(speed) else speed
    return known / servo.units.gear / acceleration if acceleration else 0.0
