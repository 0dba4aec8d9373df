"""Where joints are to be by a stream of positions, or of velocities that are added up.

For hardware that is sent positions only: a velocity that it carried out by itself would go on when this
process is gone.
"""

from __future__ import annotations

import numpy as np

from crtk_drivers.device import Mode, Setpoint
from crtk_drivers.samples import Vector

__all__ = ["StreamGoal"]


class StreamGoal:
    """The newest goal of one stream. No clock but that of the caller.

    Args:
        lower, upper: range of the joints (n,), in rad (m).
        longest: seconds between two setpoints for which a velocity counts at most.
    """

    def __init__(self, lower: Vector, upper: Vector, longest: float) -> None:
        self._lower = lower
        self._upper = upper
        self._longest = longest
        self._goal: Vector | None = None
        self._since = 0.0

    def forget(self) -> None:
        """The stream has ended."""
        self._goal = None

    def lead(self, setpoint: Setpoint, here: Vector, now: float) -> Vector:
        """Return where a setpoint leads to, (n,) in rad (m).

        Args:
            setpoint: positions, or velocities, which do not leave the range, nor bring back at once a joint
                that is outside.
            here: where the joints are told to be when a stream begins, (n,).
            now: monotonic seconds.
        """
        if setpoint.mode is Mode.JOINT_VELOCITY:
            start = here if self._goal is None else self._goal
            seconds = 0.0 if self._goal is None else min(now - self._since, self._longest)
            lower, upper = np.minimum(self._lower, start), np.maximum(self._upper, start)
            self._goal = np.clip(start + setpoint.values * seconds, lower, upper)
        else:
            self._goal = np.array(setpoint.values)
        self._since = now
        return self._goal
