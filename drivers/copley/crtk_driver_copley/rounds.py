"""Questions to all axes: in each round what changes fast, in turn what does not."""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from functools import partial
from typing import Final

from crtk_driver_copley.axis import Axis
from crtk_driver_copley.codec import Reply, get
from crtk_driver_copley.halting import Halting
from crtk_driver_copley.line import Line
from crtk_driver_copley.tables import Parameter, Status, error_text
from crtk_driver_copley.tracking import Tracking
from crtk_drivers.errors import ConnectionLost
from crtk_drivers.samples import Stamp

__all__ = ["Rounds"]

ERRORS: Final = 3
"""Rounds in a row in which a drive refuses to tell something."""


class Rounds:
    """Rounds of questions on one line.

    Args:
        line, axes: of the arm.
        tracking: gets what drives tell of their buffers and profiles.
        halting: gets what profiles do.
        period: seconds from one round to the next, at least.

    Attributes:
        lost: what went wrong, counted.
        stamp: of the first position of a round; None: none was told.
        is_whole: the round has told all, and nothing that cannot be.
    """

    def __init__(
        self,
        line: Line,
        axes: Sequence[Axis],
        tracking: Tracking,
        halting: Halting,
        period: float,
    ) -> None:
        self._line = line
        self._axes = axes
        self._tracking = tracking
        self._halting = halting
        self._period = period
        self.lost = dict.fromkeys(("implausible answers", "refused questions"), 0)
        self.forget()

    def forget(self) -> None:
        """A connection begins."""
        self._is_under_way = self.is_whole = False
        self._left = self._errors = 0
        self._turns = itertools.count()
        self._due = 0.0
        self.stamp: Stamp | None = None

    def go_on(self, deadline: float) -> bool:
        """Ask, and take answers until the monotonic `deadline`; return whether a round has ended.

        Raises:
            ConnectionLost: the line is gone, or a drive tells something no more.
        """
        if not self._is_under_way:
            due = min(self._due, deadline)
            self._line.pump(due)
            self._line.listen(due)
            if time.monotonic() < self._due:
                return False
            self._begin()
        self._line.pump(deadline)
        if self._left:
            return False
        self._is_under_way = False
        if self.is_whole:
            self._errors = 0
        return True

    def _begin(self) -> None:
        now = time.monotonic()
        self._due = max(self._due + self._period, now)
        self.stamp = None
        self._is_under_way = self.is_whole = True
        self._left = 0
        turn = next(self._turns)
        for index, axis in enumerate(self._axes):
            asked = [Parameter.STATUS, Parameter.POSITION, Parameter.VELOCITY]
            in_turn = self._asked_in_turn
            asked.append(in_turn[(turn + index) % len(in_turn)])
            if axis.joint.torque_per_ampere is not None:
                asked.append(Parameter.CURRENT)
            if axis.status & Status.LATCHED:
                asked.append(Parameter.FAULTS)
            for parameter in asked:
                self._left += 1
                take = partial(self._heard_of, axis, parameter, now)
                self._line.ask(get(axis.to, parameter), take)

    @property
    def _asked_in_turn(self) -> Sequence[Parameter]:
        if not self._halting.is_seen:
            return (Parameter.TRAJECTORY,)
        if self._tracking.wants_free:
            return (Parameter.PVT, Parameter.TRAJECTORY, Parameter.PVT)
        return (Parameter.TRAJECTORY,)

    def _heard_of(
        self, axis: Axis, parameter: Parameter, asked: float, reply: Reply | None
    ) -> None:
        self._left -= 1
        assert reply is not None  # questions are asked again, until the line counts as lost
        if reply.error:
            self.is_whole = False
            self.lost["refused questions"] += 1
            self._errors += 1
            if self._errors > ERRORS:
                text, remedy = error_text(reply.error)
                raise ConnectionLost(
                    f"{axis.name}: it does not tell 0x{parameter:02x} any more: e {reply.error} {text}",
                    where=self._line.where,
                    remedy=remedy,
                )
        elif not self.take(axis, parameter, reply, asked):
            self.is_whole = False
            self.lost["implausible answers"] += 1
            self._line.distrust()

    def take(self, axis: Axis, parameter: Parameter, reply: Reply, asked: float = 0.0) -> bool:
        """Take what an axis has told; False: it cannot be.

        Args:
            axis: that has.
            parameter: of what.
            reply: with it.
            asked: monotonic s, not later than the question.
        """
        value, sent = reply.values[0], self._line.sent
        if parameter is Parameter.POSITION:
            self.stamp = self.stamp or sent
            return axis.take_position(value, sent.monotonic)
        if parameter is Parameter.STATUS:
            axis.status = Status(value & 0x7FFF_FFFF)
        elif parameter is Parameter.VELOCITY:
            axis.take_velocity(value)
        elif parameter is Parameter.CURRENT:
            axis.take_current(value)
        elif parameter is Parameter.FAULTS:
            axis.latched = value
        elif parameter is Parameter.PVT:
            self._tracking.take_free(self._axes.index(axis), value, sent.monotonic)
        elif parameter is Parameter.TRAJECTORY:
            axis.take_trajectory(value)
            self._tracking.take_trajectory(self._axes.index(axis), asked)
            self._halting.look(axis)
        return True
