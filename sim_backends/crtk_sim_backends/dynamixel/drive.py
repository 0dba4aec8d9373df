"""What the firmware of a servo makes of its goals: the torque of its motor, in every operating mode.

The inner loops are ideal ones (no sag under gravity), limited by what the motor can do: its straight
line from stall to no-load speed, at the present supply voltage and PWM limit, and the current that it
may draw.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final

from crtk_sim_backends.dynamixel.models import Model
from crtk_sim_backends.dynamixel.plant import Joint
from crtk_sim_backends.dynamixel.profile import Profile, rest


class Mode(IntEnum):
    """Operating Mode (11)."""

    CURRENT = 0
    VELOCITY = 1
    POSITION = 3
    EXTENDED_POSITION = 4
    CURRENT_BASED_POSITION = 5
    PWM = 16


POSITION_MODES: Final = frozenset(
    {Mode.POSITION, Mode.EXTENDED_POSITION, Mode.CURRENT_BASED_POSITION}
)
CURRENT_MODES: Final = frozenset({Mode.CURRENT, Mode.CURRENT_BASED_POSITION})

STRAIN_LIMIT: Final = 2.0  # s at full output before it counts as overload

_BANDWIDTH: Final = 60.0  # rad/s of the position and velocity loops
_STRAIN: Final = 0.9  # of what the motor can give
_DRAG: Final = 0.3  # of the motor's line, while torque is off


@dataclass(eq=False)
class Drive:
    """The motor of one servo at a joint; angles and torques are those of its own horn.

    Attributes:
        mount: -1 if it looks at the joint from the other side.
        mode: see `Mode`; None while torque is off.
        profile: for position modes, which began at `since`.
        goal: rad/s, N·m or a fraction of full PWM, by mode.
        torque_limit: N·m by current; pwm_limit: fraction.
        supply: fraction of the recommended voltage.
        stiffness: of the position loop, 1 with the factory's P gain.
        applied: N·m at present; output: fraction of PWM.
        alarm: plant time of the bus watchdog's end; infinity if it is off.
    """

    model: Model
    joint: Joint
    mount: int = 1
    mode: Mode | None = None
    profile: Profile = field(default_factory=lambda: rest(0.0))
    since: float = 0.0
    goal: float = 0.0
    slope: float = 0.0
    torque_limit: float = math.inf
    pwm_limit: float = 1.0
    supply: float = 1.0
    stiffness: float = 1.0
    applied: float = 0.0
    output: float = 0.0
    alarm: float = math.inf
    alarms: int = 0
    overloads: int = 0

    def __post_init__(self) -> None:
        self.joint.actuators.append(self)
        self._ramp_from = 0.0
        self._strained_since: float | None = None
        self.damping = self.model.torque / self.model.speed  # slope of the line, N·m·s/rad
        self.positions = False  # in one of the position modes
        self.deadline = math.inf

    @property
    def angle(self) -> float:
        """Of the horn, rad."""
        return self.mount * self.joint.angle

    @property
    def velocity(self) -> float:
        """Of the horn, rad/s."""
        return self.mount * self.joint.velocity

    def trajectory(self, time: float) -> tuple[float, float, float]:
        """Where the firmware wants to be: rad, rad/s, rad/s²."""
        if self.mode is Mode.VELOCITY:
            velocity, acceleration = self._ramp(time)
            return self.angle, velocity, acceleration
        if self.positions:
            return self.profile.at(time - self.since)
        return self.angle, 0.0, 0.0

    def follow(self, profile: Profile, time: float) -> None:
        """Begin a profile now."""
        self.profile, self.since = profile, time
        self.joint.wake()

    def turn(self, velocity: float, acceleration: float, time: float) -> None:
        """Go over to a velocity with an acceleration (0: at once)."""
        self._ramp_from = self.trajectory(time)[1] if self.mode is Mode.VELOCITY else self.velocity
        self.goal, self.slope, self.since = velocity, acceleration, time
        self.joint.wake()

    def push(self, goal: float) -> None:
        """Take a torque (N·m) or a fraction of PWM as the goal."""
        self.goal = goal
        self.joint.wake()

    def switch(self, mode: Mode | None, time: float) -> None:
        """Go over to a mode, or to no torque (None), at rest where it is."""
        self.mode = mode
        self.positions = mode in POSITION_MODES
        self.goal = self.slope = self._ramp_from = 0.0
        if mode is None:
            self.applied = self.output = 0.0
        self.profile, self.since = rest(self.angle), time
        self._strain(None)
        self.joint.wake()

    def set_alarm(self, time: float) -> None:
        """Set the end of the bus watchdog; infinity turns it off."""
        self.alarm = time
        self._strain(self._strained_since)

    def _strain(self, since: float | None) -> None:
        self._strained_since = since
        end = math.inf if since is None else since + STRAIN_LIMIT
        self.deadline = min(self.alarm, end)

    def _ramp(self, time: float) -> tuple[float, float]:
        change = self.goal - self._ramp_from
        passed = self.slope * (time - self.since)
        if self.slope <= 0.0 or passed >= abs(change):
            return self.goal, 0.0
        return self._ramp_from + math.copysign(passed, change), math.copysign(self.slope, change)

    def reach(self, time: float) -> None:
        """See `Actuator`: counts what the servo then acts upon."""
        if time >= self.alarm:
            self.set_alarm(math.inf)
            self.alarms += 1
            self.stand(time)
        strained = self._strained_since
        if strained is not None and time >= strained + STRAIN_LIMIT:
            self._strain(None)
            self.overloads += 1

    def stand(self, time: float) -> None:
        """Stop at once where it is, with torque."""
        if self.positions:
            self.follow(rest(self.angle), time)
        else:
            self.turn(0.0, 0.0, time)

    @property
    def settled(self) -> bool:
        """See `Actuator`."""
        time = self.joint.time
        if self.positions:
            return time >= self.since + self.profile.duration
        return self.mode is not Mode.VELOCITY or self._ramp(time)[1] == 0.0

    def torque(self, angle: float, velocity: float, load: float, time: float) -> float:
        """See `Actuator`."""
        mode, mount = self.mode, self.mount
        if mode is None:
            self.applied = self.output = 0.0
            return -_DRAG * self.damping * velocity
        velocity *= mount
        stall = self.model.torque * self.supply
        drop = self.damping * velocity
        if mode is Mode.PWM:
            wanted = self.goal * stall - drop
        elif mode is Mode.CURRENT:
            wanted = self.goal
        else:
            wanted = self._wanted(mount * angle, velocity, mount * load, time)
        limit = self.pwm_limit * stall
        allowed = max(
            min(wanted, self.torque_limit, limit - drop), -self.torque_limit, -limit - drop
        )
        self.applied = allowed
        self.output = (allowed + drop) / stall if stall > 0.0 else 0.0
        if abs(allowed) < _STRAIN * stall:
            if self._strained_since is not None:
                self._strain(None)
        elif self._strained_since is None:
            self._strain(time)
        return mount * allowed

    def _wanted(self, angle: float, velocity: float, load: float, time: float) -> float:
        """Torque of the velocity and position loops; motors of one joint share the work."""
        share = self.model.torque / self.joint.stall
        if self.mode is Mode.VELOCITY:
            aim, acceleration = self._ramp(time)
            wanted = acceleration + _BANDWIDTH * (aim - velocity)
            if aim:  # what the integral gain comes to
                wanted += math.copysign(self.joint.friction / self.joint.inertia, aim)
        else:
            position, aim, acceleration = self.profile.at(time - self.since)
            error = position - angle
            wanted = acceleration + self.stiffness * (
                _BANDWIDTH * _BANDWIDTH * error + 2.0 * _BANDWIDTH * (aim - velocity)
            )
        return share * (self.joint.inertia * wanted - load)
