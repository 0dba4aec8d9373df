"""The servo of one joint: follows positions and velocities, and holds. Pure, one substep at a time.

It says which acceleration the joint is to have; whether the motor can give it is the plant's affair.
"""

from __future__ import annotations

import math
from typing import Final

from crtk_drivers.device import JointLimits

FOLLOWING: Final = 0.05
"""rad (m) by which the reference of a velocity may run ahead of a joint that is held fast."""
BRAKING: Final = 3.0
"""Times the joint's acceleration limit with which it slows down from a large error."""
AT_REST: Final = 1e-4
"""rad/s (m/s) of a reference that stands."""


class JointServo:
    """Follows a reference with a critically damped response; a velocity of the reference is fed forward.

    Args:
        limit: of the joint.
        bandwidth: in Hz.
        substep: in s.

    Attributes:
        reference: position that is followed, in rad (m).
        velocity: of the reference.
    """

    __slots__ = (
        "_braking",
        "_fastest",
        "_gain",
        "_goal",
        "_linear",
        "_lower",
        "_steps_left",
        "_substep",
        "_upper",
        "reference",
        "velocity",
    )

    def __init__(self, limit: JointLimits, bandwidth: float, substep: float) -> None:
        self._gain = 2.0 * math.pi * bandwidth
        self._braking = BRAKING * limit.acceleration
        self._linear = 4.0 * self._braking / self._gain**2
        self._fastest = limit.velocity
        self._lower, self._upper = limit.lower, limit.upper
        self._substep = substep
        self._goal = 0.0
        self._steps_left = 0
        self.reference = self.velocity = 0.0

    @property
    def is_at_rest(self) -> bool:
        """Whether the reference stands."""
        return abs(self.velocity) <= AT_REST

    def start(self, position: float, velocity: float) -> None:
        """Begin from where the joint is, as it moves."""
        self.reference, self.velocity = position, velocity

    def leave_ramp(self, position: float, velocity: float) -> None:
        """Go on from following positions: what is not needed for the motion carries a load, and is kept."""
        bent = self.velocity + self._pull(self.reference - position) - velocity
        ahead = min(max(2.0 * bent / self._gain, -FOLLOWING), FOLLOWING)
        self.start(position + ahead, velocity)

    def time_to(self, goal: float) -> float:
        """Return how many seconds the reference needs at least to a position."""
        return abs(goal - self.reference) / self._fastest

    def ramp_to(self, goal: float, duration: float) -> None:
        """Take the reference to a position, in a straight line of some seconds."""
        self._steps_left = max(1, round(duration / self._substep))
        self.velocity = (goal - self.reference) / (self._steps_left * self._substep)
        self._goal = goal

    def follow_ramp(self, position: float, velocity: float) -> float:
        """Return the acceleration on the way to a position, and move the reference on."""
        wanted = self.velocity + self._pull(self.reference - position)
        wanted = min(max(wanted, -self._fastest), self._fastest)
        if self._steps_left > 1:
            self._steps_left -= 1
            self.reference += self._substep * self.velocity
        elif self._steps_left == 1:
            self._steps_left = 0
            self.reference = self._goal
        else:
            self.velocity = 0.0
        return 2.0 * self._gain * (wanted - velocity)

    def follow_velocity(self, goal: float, position: float, velocity: float) -> float:
        """Return the acceleration towards a velocity, and move the reference on."""
        wanted = self.velocity + self._pull(self.reference - position)
        change = self._gain * (goal - self.velocity)
        change = min(max(change, -self._braking), self._braking)
        self.velocity += self._substep * change
        aim = self.reference + self._substep * self.velocity
        # Not further ahead of a joint that is held fast, and not beyond its stops.
        least = max(position - FOLLOWING, self._lower)
        most = min(position + FOLLOWING, self._upper)
        self.reference = min(max(aim, least), most)
        if (self.reference - aim) * self.velocity < 0.0:
            self.velocity = 0.0
        return change + 2.0 * self._gain * (wanted - velocity)

    def _pull(self, error: float) -> float:
        """Return the velocity that makes up for an error: in proportion, but never too fast to stop."""
        size = abs(error)
        if size <= self._linear:
            return 0.5 * self._gain * error
        return math.copysign(math.sqrt(self._braking * (2.0 * size - self._linear)), error)
