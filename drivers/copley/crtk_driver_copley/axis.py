"""What one axis has told, and whether that can be believed. No I/O.

Answers have no check sum. What cannot be, or is a fault, is believed when the next answer tells the same.
"""

from __future__ import annotations

from typing import Final

from crtk_driver_copley.config import JointConfig
from crtk_driver_copley.tables import (
    CONDITIONS,
    CURRENT_UNIT,
    LIMITS,
    VELOCITY_UNIT,
    Meaning,
    Status,
    Trajectory,
    fault_texts,
)
from crtk_drivers.kit.axes import AxisTold, can_have_gone

__all__ = ["Axis"]


class Axis:
    """One axis.

    Args:
        name: of the joint.
        joint: its configuration.

    Attributes:
        status, trajectory, latched: registers 0xa0, 0xc9 and 0xa4 as they were told last.
        position: counts.
        velocity: counts/s.
        current: A.
        powered: it was enabled by us, and what it tells is judged.
        homing: it searches, and may meet a limit switch.
    """

    def __init__(self, name: str, joint: JointConfig) -> None:
        self.name = name
        self.joint = joint
        self.to = joint.to
        self.scale = joint.sign / joint.counts
        self.powered = self.homing = False
        self.forget()

    def forget(self) -> None:
        """A connection begins."""
        self.status = Status(0)
        self.trajectory = Trajectory(0)
        self.latched = 0
        self.velocity = self.current = 0.0
        self.limits = Status(0)
        self._position: int | None = None
        self._heard = 0.0
        self._doubted: int | None = None
        self._suspected: frozenset[str] = frozenset()

    @property
    def position(self) -> int:
        """Counts; 0 before it was told."""
        return self._position or 0

    @property
    def is_known(self) -> bool:
        """Whether its position was told."""
        return self._position is not None

    @property
    def has_power(self) -> bool:
        """Whether its motor has power."""
        return not self.status & (Status.SOFTWARE_OFF | Status.PWM_OFF | Status.INPUT_OFF)

    @property
    def is_running(self) -> bool:
        """Whether its profile runs, or it homes."""
        return bool(self.trajectory & (Trajectory.RUNNING | Trajectory.HOMING))

    @property
    def told(self) -> AxisTold:
        """What it has told, as the kit wants it."""
        at = [meaning.text for bit, meaning in LIMITS.items() if self.status & bit]
        return AxisTold(
            self.name,
            self.has_power,
            bool(self.status & Status.SOFTWARE_OFF),
            self.is_running,
            f"it is at its {' and '.join(at)}" if at else "",
        )

    def take_position(self, counts: int, now: float) -> bool:
        """Take a position; False if it cannot be there, and the one before it was not there either."""
        near = self._position is None or self._can_come_from(self._position, counts, now)
        again = self._doubted is not None and self._can_come_from(self._doubted, counts, now)
        if not near and not again:
            self._doubted = counts
            return False
        self._position, self._heard, self._doubted = counts, now, None
        return True

    def _can_come_from(self, before: int, counts: int, now: float) -> bool:
        way = (counts - before) / self.joint.counts
        return can_have_gone(way, self.joint, now - self._heard)

    def take_trajectory(self, raw: int) -> Trajectory:
        """Take and return what 0xc9 tells."""
        self.trajectory = Trajectory(raw & 0xFFFF)
        return self.trajectory

    def take_velocity(self, raw: int) -> None:
        """Take what 0x18 tells."""
        self.velocity = raw * VELOCITY_UNIT

    def take_current(self, raw: int) -> None:
        """Take what 0x0c tells."""
        self.current = raw * CURRENT_UNIT

    def judged(self) -> tuple[list[str], bool]:
        """Return what is wrong with an axis with power, and whether it was told twice."""
        if self.homing or not self.powered:
            self.limits = self.status & _ALL_LIMITS
        if not self.powered:
            return [], True
        wrong = [meaning for bit, meaning in CONDITIONS.items() if self.status & bit]
        if self.status & Status.LATCHED:
            wrong = fault_texts(self.latched) or wrong
        new = self.status & _ALL_LIMITS & ~self.limits
        wrong += [
            Meaning(f"it has met its {meaning.text}", meaning.remedy)
            for bit, meaning in LIMITS.items()
            if new & bit
        ]
        self.limits &= self.status
        told = frozenset(meaning.text for meaning in wrong)
        is_sure = not told or bool(told & self._suspected)
        self._suspected = told
        return [f"{self.name}: {meaning.text}. {meaning.remedy}" for meaning in wrong], is_sure


_ALL_LIMITS: Final = (
    Status.POSITIVE_LIMIT | Status.NEGATIVE_LIMIT | Status.POSITIVE_SOFT | Status.NEGATIVE_SOFT
)
