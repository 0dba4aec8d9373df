"""Boot, power and brakes: the way up and down through the robot modes, which takes time."""

from __future__ import annotations

from crtk_sim_backends.ur.safety.modes import (
    BOOT_STEPS,
    POWER_OFF_SECONDS,
    POWER_SECONDS,
    POWER_UP,
    RobotMode,
)


class ArmPower:
    """Where the arm is between POWER_OFF and RUNNING, and where it goes.

    Args:
        boot_seconds: time to POWER_OFF; 0.0: it has been on for long.
        power_seconds: time from there to RUNNING.
    """

    def __init__(self, boot_seconds: float = 0.0, power_seconds: float = POWER_SECONDS) -> None:
        self._boot_step = boot_seconds / BOOT_STEPS
        self._power_seconds = power_seconds
        self.mode: RobotMode = RobotMode.DISCONNECTED if boot_seconds else RobotMode.POWER_OFF
        self._goal: RobotMode = RobotMode.POWER_OFF
        self._due = self._boot_step

    def up(self, goal: RobotMode, time: float) -> bool:
        """Go up to `goal`, step by step; False during boot and while the power is being cut."""
        if self.mode < RobotMode.POWER_OFF:
            return False
        if self.mode >= goal:
            return self._goal >= goal
        if self._goal <= self.mode:  # at rest, or on the way down
            self._due = time + self._step
        self._goal = max(goal, self._goal)
        return True

    def off(self, time: float) -> None:
        """Cut the power after the time that a controlled stop takes, and go up no further."""
        self._goal = RobotMode.POWER_OFF
        if self.mode > RobotMode.POWER_OFF:
            self._due = time + POWER_OFF_SECONDS

    def set(self, mode: RobotMode) -> None:
        """Be in `mode` at once and stay there."""
        self.mode = self._goal = mode

    def start(self, goal: RobotMode) -> None:
        """Be in `goal` at once, or go there behind the boot."""
        if self.mode < RobotMode.POWER_OFF:
            self._goal = goal
        else:
            self.set(goal)

    def advance(self, time: float) -> bool:
        """Take the step that is due; whether there was one."""
        if self.mode == self._goal or time < self._due:
            return False
        if self._goal < self.mode:
            self.mode = self._goal
            return True
        self.mode = POWER_UP[self.mode][1]
        if self.mode < RobotMode.POWER_OFF:
            self._due = time + self._boot_step
        elif self.mode != self._goal:
            self._due = time + self._step
        return True

    @property
    def _step(self) -> float:
        return self._power_seconds * POWER_UP[self.mode][0]
