"""The goals that servos were sent: whether they have taken them, and are on their way to them."""

from __future__ import annotations

import math
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from crtk_driver_dynamixel.chain_link import ChainLink
from crtk_driver_dynamixel.config import JointConfig
from crtk_driver_dynamixel.joints import ChainServo
from crtk_driver_dynamixel.modes import Modes
from crtk_driver_dynamixel.units import Counts
from crtk_drivers.commands import Kind

MOST_REFUSED: Final = 3
"""Times in a row that a servo may be found with another goal than it was sent."""
STUCK_TIME: Final = 1.0
"""Seconds for which a servo may stand far from its goal."""


@dataclass(frozen=True, slots=True, eq=False)
class _Sent:
    """One goal register: the servos of a part that have it, and their counts."""

    register: str
    index: NDArray[np.int64]
    counts: Counts


class SentGoals:
    """What some servos of a chain were sent last.

    Args:
        link: to the chain.
        modes: which they have.
        places: of the servos.

    Attributes:
        positions: (servos,) counts, None if it is not known where they are sent to.
    """

    def __init__(self, link: ChainLink, modes: Modes, places: Sequence[int]) -> None:
        self._link = link
        self._modes = modes
        self._places = tuple(places)
        servos = [link.chain.servos[place] for place in places]
        self._commanded = np.array([servo.follow == "goals" for servo in servos])
        self._reach = np.array([_reach(servo) for servo in servos])
        yields = np.array([servo.config.yields for servo in servos])
        self._watched = np.where(yields, math.inf, self._reach)
        self._registers: dict[Kind, list[tuple[str, NDArray[np.int64]]]] = {}
        self._sent: list[_Sent] = []
        self._read = [0] * len(servos)
        self._refused = [0] * len(servos)
        self._far_since = math.inf
        self._undecided = np.zeros(len(servos), dtype=np.bool_)
        self.positions: Counts | None = None

    def forget(self) -> None:
        """They have other goals now."""
        self._sent = []
        self._refused = [0] * len(self._places)
        self.positions = None

    def send(self, kind: Kind, counts: Counts) -> None:
        """Send goals (servos,)."""
        self._remember(kind, counts)
        self._send()

    def _remember(self, kind: Kind, counts: Counts) -> None:
        self.positions = counts if kind is Kind.POSITION else None
        self._sent = [_Sent(name, index, counts[index]) for name, index in self._of_kind(kind)]

    def _send(self) -> None:
        for sent in self._sent:
            self._link.send(sent.register, [self._places[i] for i in sent.index], sent.counts)

    def _of_kind(self, kind: Kind) -> list[tuple[str, NDArray[np.int64]]]:
        """Return the registers that setpoints of a kind go to, each with the servos that are sent them."""
        found = self._registers.get(kind)
        if found is None:
            by_name: dict[str, list[int]] = defaultdict(list)
            for i in np.flatnonzero(self._commanded).tolist():
                by_name[self._modes.goal_register(self._places[i], kind)].append(i)
            found = [(name, np.array(index)) for name, index in by_name.items()]
            self._registers[kind] = found
        return found

    def held(self, here: Counts, *, where_they_are: bool) -> dict[int, int | None]:
        """Return goals, by place, that hold servos in position mode: where they are, or where they were sent.

        Where they were sent holds only those that are there: one that is blocked, or did not hear it, would
        jump. So these goals are None until `decide` knows where a servo is.

        Args:
            here: (servos,) positions that were seen last.
            where_they_are: all of them, as servos with a profile are on their way.
        """
        if self.positions is None:
            return {}
        self._undecided[:] = not where_they_are
        if where_they_are:
            self._remember(Kind.POSITION, here)
        return {
            self._places[i]: int(self.positions[i]) if where_they_are else None
            for i in np.flatnonzero(self._commanded).tolist()
        }

    def decide(self, held: dict[int, int | None], here: Counts, heard: NDArray[np.bool_]) -> None:
        """Put the goals into `held` of servos that are heard now: one that is far from its goal stays here.

        A position that is older says nothing of that: setpoints have gone on, and a servo with them.

        Args:
            held: what the method of this name returned.
            here: (servos,) present positions.
            heard: (servos,) whose positions were read in this cycle.
        """
        ready = self._undecided & heard
        if self.positions is None or not ready.any():
            return
        self._undecided &= ~heard
        is_far = np.abs(self.positions - here) > self._reach
        self._remember(Kind.POSITION, np.where(ready & is_far, here, self.positions))
        for i in np.flatnonzero(ready & self._commanded).tolist():
            held[self._places[i]] = int(self.positions[i])

    def refused(self) -> str:
        """Compare what servos hold, read now and then, with what was sent, and send it again if it differs.

        Returns:
            which servo does not take its goals, in words; empty while all do.
        """
        lost = False
        for sent in self._sent:
            register = sent.register
            for i, count in zip(sent.index.tolist(), sent.counts.tolist(), strict=True):
                health = self._link.health[self._places[i]]
                if health.goals_read == self._read[i]:
                    continue
                self._read[i] = health.goals_read
                held = health.goals.get(register, count)
                self._refused[i] = 0 if held == count else self._refused[i] + 1
                lost = lost or held != count
                if self._refused[i] == MOST_REFUSED:
                    name = self._link.chain.servos[self._places[i]].place
                    return f"{name} does not take its goals: {register} is {held}, and {count} was sent"
        if lost:
            self._send()
        return ""

    def stuck(self, here: Counts) -> str:
        """Return which servos have stood far from their goals for a while, in words; empty if none.

        Args:
            here: (servos,) present positions.
        """
        far: list[int] = []
        if self.positions is not None:
            off = (np.abs(self.positions - here) > self._watched) & self._commanded
            far = [self._places[i] for i in np.flatnonzero(off).tolist()]
        far = [place for place in far if self._link.rests(place)]
        now = time.monotonic()
        self._far_since = min(self._far_since, now) if far else math.inf
        if now - self._far_since <= STUCK_TIME:
            return ""
        names = ", ".join(self._link.chain.servos[place].place for place in far)
        return f"{names} does not follow: it stands far from where it was sent"


def _reach(servo: ChainServo) -> float:
    """Return how far a servo may be from its goal, in counts; inf where that is its task: a gripper."""
    own, unit = servo.config, servo.units.model.family.position_unit
    return own.following_error * own.gear / unit if isinstance(own, JointConfig) else math.inf
