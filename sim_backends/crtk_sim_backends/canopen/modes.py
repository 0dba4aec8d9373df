"""The modes of operation of an axis (CiA 402-2, sections 10 to 16), without homing.

A mode turns targets and controlword into the setpoint of the controller, one control period after
the other. Positions are in position units, velocities in position units a second.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from typing import Final, Protocol

from typing_extensions import override

from crtk_sim_backends.kit.profile import approach, ramp_velocity, toward

NEW_SETPOINT: Final = 1 << 4
CHANGE_AT_ONCE: Final = 1 << 5
RELATIVE: Final = 1 << 6
HALT: Final = 1 << 8
CHANGE_ON_SETPOINT: Final = 1 << 9

TARGET_REACHED: Final = 1 << 10
BIT_12: Final = 1 << 12
BIT_13: Final = 1 << 13

ALWAYS_REACHED: Final = 0xFFFF_FFFF  # of a position window


class Control(Enum):
    """Which loop of the controller is closed."""

    POSITION = auto()
    VELOCITY = auto()
    TORQUE = auto()


@dataclass
class Setpoint:
    """What the controller follows."""

    control: Control = Control.POSITION
    position: float = 0.0
    velocity: float = 0.0
    torque: float = 0.0  # 1/1000 of the rated torque; feed-forward but in Control.TORQUE


class Window:
    """A condition that has to hold for a while."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def hold(self, inside: bool, dt: float) -> None:
        """Note for how long the condition holds."""
        self.seconds = self.seconds + dt if inside else 0.0

    def lasted(self, milliseconds: int) -> bool:
        """Whether it has held for so long."""
        return self.seconds > 0.0 and self.seconds * 1000 >= milliseconds - 1e-6


class AxisView(Protocol):
    """What a mode sees of its axis."""

    setpoint: Setpoint
    position: float
    velocity: float
    limited: bool

    def value(self, index: int, sub: int = 0) -> int:
        """Value of an object of the axis."""

    def speed(self, index: int, sub: int = 0) -> float:
        """Value of a velocity object in position units a second."""

    def acceleration(self, index: int) -> float:
        """Value of an acceleration object in position units a second squared."""

    def within_limits(self, position: float) -> float:
        """Bring a position within the software limits; sets `limited` when it was not."""

    @property
    def period(self) -> float:
        """Interpolation time period, s."""

    @property
    def following_error(self) -> bool:
        """Whether the position is out of the following error window."""


class Mode:
    """Base of the modes; alone it is the mode in which nothing is done: the axis holds."""

    number = 0
    halts = False  # whether bit 8 of the controlword stops the axis

    def __init__(self, axis: AxisView) -> None:
        self.axis = axis

    def enter(self) -> None:
        """Begin, with a setpoint that stands where the axis is."""

    def control(self, word: int, before: int) -> None:
        """Follow the bits of the mode in a controlword."""

    def targets(self) -> None:
        """Targets were received; or SYNC says that those in the dictionary are valid now."""

    def step(self, dt: float) -> None:
        """Advance the setpoint."""
        self.axis.setpoint.control = Control.POSITION
        self.axis.setpoint.velocity = 0.0

    def status(self, halted: bool) -> int:
        """Bits 10, 12 and 13 of the statusword."""
        return 0

    def _limited_speed(self, index: int) -> float:
        return min(self.axis.speed(index), self.axis.speed(0x607F))

    def _limited(self, index: int, limit: int) -> float:
        return min(self.axis.acceleration(index), self.axis.acceleration(limit))


@dataclass(frozen=True)
class Target:
    """One set-point of profile position."""

    position: float
    blend: bool  # go on through the one before without stopping


class ProfilePosition(Mode):
    """PP: the handshake of new set-points, one that runs and one that waits."""

    number = 1
    halts = True

    def __init__(self, axis: AxisView) -> None:
        super().__init__(axis)
        self._running: Target | None = None
        self._waiting: Target | None = None
        self._acknowledged = False
        self._goal = 0.0
        self._reached = Window()

    @override
    def enter(self) -> None:
        """Begin where the axis stands."""
        self._running = self._waiting = None
        self._acknowledged = False
        self._goal = self.axis.setpoint.position
        self._reached = Window()

    @override
    def control(self, word: int, before: int) -> None:
        """Follow the bits of the mode."""
        if not word & NEW_SETPOINT:
            if self._waiting is None:
                self._acknowledged = False
            return
        if before & NEW_SETPOINT or self._acknowledged:
            return
        target = Target(self._requested(word), bool(word & CHANGE_ON_SETPOINT))
        if self._running is None or word & CHANGE_AT_ONCE:
            self._running, self._waiting = target, None
            self._goal = target.position
        else:
            self._waiting = target
        self._acknowledged = True

    def _requested(self, word: int) -> float:
        axis = self.axis
        position = float(axis.value(0x607A))
        if word & RELATIVE:
            last = self._waiting.position if self._waiting else self._goal
            position += (last, axis.setpoint.position, axis.position)[axis.value(0x60F2) & 3]
        return axis.within_limits(position)

    @override
    def step(self, dt: float) -> None:
        """Advance the setpoint."""
        axis, setpoint = self.axis, self.axis.setpoint
        setpoint.control = Control.POSITION
        speed = self._limited_speed(0x6081)
        up, down = self._limited(0x6083, 0x60C5), self._limited(0x6084, 0x60C6)
        if self._running:
            goal = self._running.position
            passes = self._passes_on()
            distance = goal - setpoint.position
            setpoint.position, setpoint.velocity = toward(
                setpoint.position, setpoint.velocity, goal, speed, up, down, dt, stop=not passes
            )
            passed = passes and distance * (goal - setpoint.position) <= 0
            if passed or (setpoint.position == goal and setpoint.velocity == 0.0):
                self._running, self._waiting = self._waiting, None
                if self._running:
                    self._goal = self._running.position
                    self._reached = Window()
                if not axis.value(0x6040) & NEW_SETPOINT:
                    self._acknowledged = False
        else:
            setpoint.velocity = 0.0
        near = axis.value(0x6067)
        inside = near == ALWAYS_REACHED or abs(axis.position - self._goal) <= near
        self._reached.hold(inside and self._running is None, dt)

    def _passes_on(self) -> bool:
        """Whether the running target is passed without stopping, toward the one that waits."""
        if self._running is None or self._waiting is None or not self._waiting.blend:
            return False
        here, goal = self.axis.setpoint.position, self._running.position
        return (goal - here) * (self._waiting.position - goal) > 0

    @override
    def status(self, halted: bool) -> int:
        """Bits 10, 12 and 13."""
        if halted:
            reached = self.axis.setpoint.velocity == 0.0
        else:
            reached = self._running is None and self._reached.lasted(self.axis.value(0x6068))
        return (
            (TARGET_REACHED if reached else 0)
            | (BIT_12 if self._acknowledged else 0)
            | (BIT_13 if self.axis.following_error else 0)
        )


class ProfileVelocity(Mode):
    """PV: ramps to the target velocity."""

    number = 3
    halts = True

    def __init__(self, axis: AxisView) -> None:
        super().__init__(axis)
        self._reached, self._moving, self._slipping = Window(), Window(), Window()

    @override
    def enter(self) -> None:
        """Begin where the axis stands."""
        self._reached, self._moving, self._slipping = Window(), Window(), Window()

    @override
    def step(self, dt: float) -> None:
        """Advance the setpoint."""
        axis, setpoint = self.axis, self.axis.setpoint
        setpoint.control = Control.VELOCITY
        fastest = axis.speed(0x607F)
        target = min(max(axis.speed(0x60FF), -fastest), fastest)
        up, down = self._limited(0x6083, 0x60C5), self._limited(0x6084, 0x60C6)
        setpoint.velocity = ramp_velocity(setpoint.velocity, target, up, down, dt)
        self._reached.hold(abs(axis.velocity - target) <= axis.speed(0x606D), dt)
        self._moving.hold(abs(axis.velocity) > axis.speed(0x606F), dt)
        slip = abs(axis.velocity - setpoint.velocity) > axis.speed(0x60F8)
        self._slipping.hold(slip, dt)

    @override
    def status(self, halted: bool) -> int:
        """Bits 10, 12 and 13."""
        axis = self.axis
        if halted:
            rests = abs(axis.velocity) <= axis.speed(0x606F)
            return TARGET_REACHED | BIT_12 if rests else 0
        moving = self._moving.lasted(axis.value(0x6070))
        reached = self._reached.lasted(axis.value(0x606E))
        return (
            (TARGET_REACHED if reached else 0)
            | (0 if moving else BIT_12)
            | (BIT_13 if self._slipping.lasted(20) else 0)
        )


class ProfileTorque(Mode):
    """TQ: ramps to the target torque."""

    number = 4
    halts = True

    @override
    def enter(self) -> None:
        """Begin where the axis stands."""
        self.axis.setpoint.torque = 0.0

    @override
    def step(self, dt: float) -> None:
        """Advance the setpoint."""
        axis, setpoint = self.axis, self.axis.setpoint
        setpoint.control = Control.TORQUE
        most = min(axis.value(0x6072), axis.value(0x6073))
        target = min(max(axis.value(0x6071), -most), most)
        setpoint.torque = approach(setpoint.torque, target, axis.value(0x6087) * dt)

    @override
    def status(self, halted: bool) -> int:
        """Bits 10, 12 and 13."""
        if halted:
            return TARGET_REACHED if abs(self.axis.velocity) <= self.axis.speed(0x606F) else 0
        reached = self.axis.setpoint.torque == self.axis.value(0x6071)
        return TARGET_REACHED if reached else 0


class Interpolated(Mode):
    """Positions that come with SYNC and are interpolated over the period 60C2."""

    target = (0x60C1, 1)

    def __init__(self, axis: AxisView) -> None:
        super().__init__(axis)
        self._goal = 0.0
        self._rest = 0.0  # s until the goal
        self._fresh = False  # a target has come since the mode was entered

    @override
    def enter(self) -> None:
        """Begin where the axis stands."""
        self._goal = self.axis.setpoint.position
        self._rest = 0.0
        self._fresh = False

    def _wanted(self) -> float:
        return float(self.axis.value(*self.target))

    @override
    def targets(self) -> None:
        """Take the targets."""
        goal = self.axis.within_limits(self._wanted())
        if goal == self._goal and self._fresh:
            return
        self._goal, self._rest, self._fresh = goal, self.axis.period, True

    @override
    def step(self, dt: float) -> None:
        """Advance the setpoint."""
        setpoint = self.axis.setpoint
        setpoint.control = Control.POSITION
        if self._rest <= 1e-9:
            setpoint.position, setpoint.velocity = self._goal, 0.0
            return
        setpoint.velocity = (self._goal - setpoint.position) / self._rest
        setpoint.position += setpoint.velocity * min(dt, self._rest)
        self._rest -= dt

    @override
    def status(self, halted: bool) -> int:
        """Bits 10, 12 and 13."""
        return BIT_12 | (BIT_13 if self.axis.following_error else 0)


class InterpolatedPosition(Interpolated):
    """IP: interpolates while bit 4 of the controlword is set."""

    number = 7
    halts = True

    def __init__(self, axis: AxisView) -> None:
        super().__init__(axis)
        self._active = False

    @override
    def enter(self) -> None:
        """Begin where the axis stands."""
        super().enter()
        self._active = False

    @override
    def control(self, word: int, before: int) -> None:
        """Follow the bits of the mode."""
        active = bool(word & NEW_SETPOINT)
        if active and not self._active:
            super().enter()
        self._active = active

    @override
    def targets(self) -> None:
        """Take the targets."""
        if self._active:
            super().targets()

    @override
    def status(self, halted: bool) -> int:
        """Bits 10, 12 and 13."""
        axis = self.axis
        reached = abs(axis.position - self._goal) <= axis.value(0x6067)
        return (BIT_12 if self._active and not halted else 0) | (TARGET_REACHED if reached else 0)


class CyclicPosition(Interpolated):
    """CSP: target position and its offset, with velocity and torque as feed-forward."""

    number = 8
    target = (0x607A, 0)

    @override
    def _wanted(self) -> float:
        return float(self.axis.value(0x607A) + self.axis.value(0x60B0))

    @override
    def step(self, dt: float) -> None:
        """Advance the setpoint."""
        super().step(dt)
        self.axis.setpoint.torque = float(self.axis.value(0x60B2))


class CyclicVelocity(Mode):
    """CSV: target velocity and its offset, followed at once."""

    number = 9

    @override
    def enter(self) -> None:
        """Begin where the axis stands."""
        self._wanted = 0.0

    _wanted = 0.0

    @override
    def targets(self) -> None:
        """Take the targets."""
        axis = self.axis
        fastest = axis.speed(0x607F)
        wanted = axis.speed(0x60FF) + axis.speed(0x60B1)
        self._wanted = min(max(wanted, -fastest), fastest)
        axis.limited = self._wanted != wanted

    @override
    def step(self, dt: float) -> None:
        """Advance the setpoint."""
        setpoint = self.axis.setpoint
        setpoint.control = Control.VELOCITY
        setpoint.velocity = approach(
            setpoint.velocity, self._wanted, self.axis.acceleration(0x60C5) * dt
        )
        setpoint.torque = float(self.axis.value(0x60B2))

    @override
    def status(self, halted: bool) -> int:
        """Bits 10, 12 and 13."""
        return BIT_12


class CyclicTorque(Mode):
    """CST: target torque and its offset, followed at once."""

    number = 10

    @override
    def enter(self) -> None:
        """Begin where the axis stands."""
        self.axis.setpoint.torque = self._wanted = 0.0

    _wanted = 0.0

    @override
    def targets(self) -> None:
        """Take the targets."""
        self._wanted = float(self.axis.value(0x6071) + self.axis.value(0x60B2))

    @override
    def step(self, dt: float) -> None:
        """Advance the setpoint."""
        self.axis.setpoint.control = Control.TORQUE
        self.axis.setpoint.torque = self._wanted

    @override
    def status(self, halted: bool) -> int:
        """Bits 10, 12 and 13."""
        return BIT_12
