"""The servo of one joint: follows positions and velocities, and holds. Pure, one substep at a time.

It says which acceleration the joint is to have; whether the motor can give it is the plant's affair.
"""

from __future__ import annotations

import math
from typing import Final

from crtk_drivers.device import JointLimits

FOLLOWING: Final = 0.05
"""rad (m) by which a reference may be away from its joint."""
BRAKING: Final = 3.0
"""Times the joint's acceleration limit that its reference slows down with."""
RESERVE: Final = 1.5
"""Times that acceleration that a reference may have on its way to a position."""
UNEVEN: Final = 2.0
"""Times the velocity limit that a step of a stream may need, because setpoints come unevenly."""
AT_REST: Final = 1e-4
"""rad/s (m/s) of a reference that stands."""


class JointServo:
    """Follows a reference with a critically damped response, its velocity and acceleration fed forward.

    The reference is always a motion that the joint can do: it approaches a position, or a velocity, with
    limited velocity and acceleration. Positions come as a ramp, a straight line for each setpoint.

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
        "_ramp",
        "_ramp_velocity",
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
        self._goal = self._ramp = self._ramp_velocity = 0.0
        self._steps_left = 0
        self.reference = self.velocity = 0.0

    @property
    def is_at_rest(self) -> bool:
        """Whether the reference stands."""
        return abs(self.velocity) <= AT_REST

    @property
    def goal(self) -> float:
        """The position setpoint that was taken last, in rad (m)."""
        return self._goal if self._steps_left else self._ramp

    def start(self, position: float, velocity: float) -> None:
        """Begin from where the joint is, as it moves."""
        self.reference = self._ramp = position
        self.velocity = velocity

    def can_reach(self, goal: float, duration: float) -> bool:
        """Whether a ramp to a position within some seconds keeps the velocity limit, nearly."""
        return abs(goal - self._ramp) <= UNEVEN * self._fastest * duration

    def ramp_to(self, goal: float, duration: float) -> None:
        """Go on to a position, in a straight line of some seconds."""
        self._steps_left = max(1, round(duration / self._substep))
        self._ramp_velocity = (goal - self._ramp) / (self._steps_left * self._substep)
        self._goal = goal

    def jump_to(self, goal: float) -> None:
        """Go to a position that is no part of a stream."""
        self._steps_left = 0
        self._ramp_velocity = 0.0
        self._ramp = goal

    def follow_ramp(self, position: float, velocity: float) -> float:
        """Return the acceleration on the way to a position, and move the reference on."""
        wanted = self._ramp_velocity + self._pull(self._ramp - self.reference)
        wanted = min(max(wanted, -self._fastest), self._fastest)
        most = RESERVE * self._braking
        change = min(max(2.0 * self._gain * (wanted - self.velocity), -most), most)
        if self._steps_left > 1:
            self._steps_left -= 1
            self._ramp += self._substep * self._ramp_velocity
        elif self._steps_left == 1:
            self._steps_left = 0
            self._ramp = self._goal
        else:
            self._ramp_velocity = 0.0
        return self._follow(change, position, velocity)

    def follow_velocity(self, goal: float, position: float, velocity: float) -> float:
        """Return the acceleration towards a velocity, and move the reference on."""
        change = self._gain * (goal - self.velocity)
        change = min(max(change, -self._braking), self._braking)
        acceleration = self._follow(change, position, velocity)
        within = min(max(self.reference, self._lower), self._upper)
        if within != self.reference:
            self.reference, self.velocity = within, 0.0
        self._ramp = self.reference
        return acceleration

    def _follow(self, change: float, position: float, velocity: float) -> float:
        """Return the acceleration of the joint for that of the reference, and move the reference on."""
        wanted = self.velocity + self._pull(self.reference - position)
        acceleration = change + 2.0 * self._gain * (wanted - velocity)
        self.velocity += self._substep * change
        self.reference += self._substep * self.velocity
        ahead = self.reference - position
        if abs(ahead) > FOLLOWING:  # it waits for a joint that is held fast, or too weak
            self.reference = position + math.copysign(FOLLOWING, ahead)
            self.velocity = velocity
        return acceleration

    def _pull(self, error: float) -> float:
        """Return the velocity that makes up for an error: in proportion, but never too fast to stop."""
        size = abs(error)
        if size <= self._linear:
            return 0.5 * self._gain * error
        return math.copysign(math.sqrt(self._braking * (2.0 * size - self._linear)), error)
