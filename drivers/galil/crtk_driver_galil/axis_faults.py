"""What has gone wrong with axes that should have power: stop codes, motors, amplifiers. No I/O."""

from __future__ import annotations

from collections.abc import Mapping

from crtk_driver_galil import codes
from crtk_driver_galil.config import JointConfig
from crtk_driver_galil.record import AXES, Record

__all__ = ["AxisFaults"]


class AxisFaults:
    """Of the axes of one arm.

    Args:
        joints: by name.

    Attributes:
        watched: the axes should have power.
        streams: they follow what we send, so that a stop that is not ours is foreign.
        searching: letter of the axis that is being homed, whose search may end in any way.
    """

    def __init__(self, joints: Mapping[str, JointConfig]) -> None:
        self._joints = joints
        self.begin()

    def begin(self) -> None:
        """A connection begins."""
        self.watched = self.streams = False
        self.searching = ""
        self._codes: dict[str, int] = {}

    def take(self, record: Record) -> None:
        """What a record tells is not news any more."""
        self._codes = {
            joint.axis: record.axes[joint.axis].stop_code for joint in self._joints.values()
        }

    def of(self, record: Record) -> list[str]:
        """Return what a record tells that was not so before, in words."""
        if not self.watched:
            return []
        found = []
        for name, joint in self._joints.items():
            letter, axis = joint.axis, record.axes[joint.axis]
            stopped = axis.stop_code if axis.stop_code != self._codes.get(letter) else 0
            amplifier = codes.amplifier_text(record.amplifier, AXES.index(letter))
            if stopped in codes.FAULTS and letter != self.searching:
                found.append(f"{name}: {codes.stop_text(stopped)} (stop code {stopped})")
            elif stopped == codes.STOPPED and self.streams:
                found.append(
                    f"{name}: stopped by ST, which was not ours: another client or a program"
                )
            elif axis.motor_off:
                why = codes.stop_text(axis.stop_code) if axis.stop_code in codes.FAULTS else "by MO"
                found.append(f"{name}: its motor is off ({why})")
            if amplifier:
                found.append(f"{name}: the amplifier tells {amplifier}")
        return found
