"""Which data records are believed: newer ones that can be. No I/O."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final

from crtk_driver_galil.config import JointConfig
from crtk_driver_galil.record import AXES, LAYOUTS, Layout, Record, parse
from crtk_driver_galil.tracking import since
from crtk_drivers.kit.axes import can_have_gone
from crtk_drivers.kit.lateness import Lateness

__all__ = ["BelievedRecords"]

REORDERED: Final = 1000
"""Samples by which a record may be older than the one before it without being that of a restart."""
HELD_UP: Final = 0.25
"""Seconds by which a record may be later than the next one, as it seems by the controller's clock."""
LONGEST: Final = 1.0
"""Seconds between two records; more is doubted."""
UNWRAPPED: Final = 30.0
"""Seconds between two records whose sample numbers, of 16 bits, tell how many passed."""


class BelievedRecords:
    """The records of one controller.

    One that tells what cannot be, or a fault, is believed when a later one tells the same.

    Args:
        joints: whose axes it must have.
        period: seconds from one record to the next.
        faults: what a record tells of axes that have power, in words.

    Attributes:
        newest: the last one that was believed.
        heard: monotonic s at which it was made, by the controller's clock and the records that came soonest;
            -inf before.
        lost: what went wrong, counted.
    """

    def __init__(
        self,
        joints: Sequence[JointConfig],
        period: float,
        faults: Callable[[Record], list[str]],
    ) -> None:
        self._joints = joints
        self._period = period
        self._faults = faults
        self.lost = dict.fromkeys(("bad records", "doubted records", "lost records"), 0)
        self.begin(LAYOUTS["4000"], len(AXES))

    def begin(self, layout: Layout, count: int) -> None:
        """A connection begins.

        Args:
            layout: of its records.
            count: of its axes.
        """
        self._layout = layout
        self._count = count
        self.forget()

    def forget(self) -> None:
        """What came before is not what comes next."""
        self._doubted: Record | None = None
        self.newest: Record | None = None
        self.heard = -math.inf
        self._lateness = Lateness()

    def take(self, data: bytes, now: float) -> Record | None:
        """Take and return a record that is newer than the last one, and can be believed.

        Args:
            data: a datagram.
            now: monotonic seconds at which it was read.
        """
        if data in (b":", b"?"):
            return None  # the answer to DR
        try:
            record = parse(data, self._layout, self._count)
            if any(joint.axis not in record.axes for joint in self._joints):
                raise ValueError("an axis is missing")
        except ValueError:
            self.lost["bad records"] += 1
            return None
        before, doubted, passed = self.newest, self._doubted, 0
        if before is not None:
            passed = since(before.sample, record.sample)
            is_known = doubted is not None and doubted.sample == record.sample
            if -REORDERED < passed <= 0 or is_known:
                return None  # it was overtaken, or came twice
            late = passed / 1000.0 > now - self.heard + HELD_UP
            if (late or self._is_strange(record, before)) and not self._is_confirmed(record):
                self._doubted = record
                self.lost["doubted records"] += 1
                return None
            due = passed / (1000 * self._period)
            self.lost["lost records"] += max(0, round(due) - 1)
            if now - self.heard > UNWRAPPED:
                self._lateness.reset()
        self.newest, self._doubted = record, None
        self.heard = now - self._lateness.of(passed / 1000.0, now)
        return record

    def _is_strange(self, record: Record, before: Record) -> bool:
        return not self._can_follow(record, before) or bool(self._faults(record))

    def _is_confirmed(self, record: Record) -> bool:
        """Whether a record tells the same as the one before it, which was doubted."""
        doubted = self._doubted
        if doubted is None or not self._can_follow(record, doubted):
            return False
        faults = self._faults(record)
        return not faults or bool(set(faults) & set(self._faults(doubted)))

    def _can_follow(self, record: Record, before: Record) -> bool:
        """Whether the joints can have come from one record to the other."""
        seconds = since(before.sample, record.sample) / 1000.0
        if not 0.0 < seconds < LONGEST:
            return False
        for joint in self._joints:
            way = record.axes[joint.axis].position - before.axes[joint.axis].position
            if not can_have_gone(way * joint.scale, joint, seconds):
                return False
        return True
