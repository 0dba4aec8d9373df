"""Homing (CiA 402-2, section 12): every method as a list of phases.

A method searches its switch, then crosses one edge of it in one direction, which makes the home
position independent of where the search began; some then go on to the index pulse of the encoder.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto
from typing import Final, Protocol

from typing_extensions import override

from crtk_sim_backends.canopen.modes import (
    BIT_12,
    BIT_13,
    NEW_SETPOINT,
    TARGET_REACHED,
    AxisView,
    Control,
    Mode,
)
from crtk_sim_backends.kit.profile import ramp_velocity, toward


class Switch(Enum):
    """A switch of the axis; the value is its bit in the digital inputs 60FD."""

    NEGATIVE = 0
    POSITIVE = 1
    HOME = 2


class Until(Enum):
    """What ends a phase."""

    ACTIVE = auto()  # the switch is active
    RISES = auto()  # the switch becomes active while the axis moves in the direction
    FALLS = auto()
    INDEX = auto()  # the index pulse passes
    STALL = auto()  # the axis pushes against a stop


@dataclass(frozen=True)
class Phase:
    """One phase: `direction` 1 or -1, how fast, what ends it."""

    direction: int
    fast: bool
    until: Until
    switch: Switch = Switch.HOME
    turns: bool = False  # a limit switch turns it round, once; otherwise it is an error


def _edge(direction: int, until: Until, switch: Switch = Switch.HOME) -> tuple[Phase, ...]:
    """Cross an edge slowly; before a rising one leave the switch on that side."""
    final = Phase(direction, False, until, switch)
    if until is Until.FALLS:
        return (final,)
    return (Phase(-direction, True, Until.FALLS, switch), final)


def _index(direction: int) -> Phase:
    return Phase(direction, False, Until.INDEX)


def _search(direction: int) -> Phase:
    return Phase(direction, True, Until.ACTIVE, Switch.HOME, turns=True)


_LEFT_OUT = _edge(-1, Until.FALLS)  # of the left edge, outside of the switch
_LEFT_IN = _edge(+1, Until.RISES)
_RIGHT_IN = _edge(-1, Until.RISES)
_RIGHT_OUT = _edge(+1, Until.FALLS)

_TO_NEGATIVE = (
    Phase(-1, True, Until.ACTIVE, Switch.NEGATIVE),
    *_edge(+1, Until.FALLS, Switch.NEGATIVE),
)
_TO_POSITIVE = (
    Phase(+1, True, Until.ACTIVE, Switch.POSITIVE),
    *_edge(-1, Until.FALLS, Switch.POSITIVE),
)

# Method without index pulse: its phases. The same with index pulse is 16 less.
_BY_SWITCH: Final[dict[int, tuple[Phase, ...]]] = {
    17: _TO_NEGATIVE,
    18: _TO_POSITIVE,
    19: (_search(+1), *_LEFT_OUT),
    20: (_search(+1), *_LEFT_IN),
    21: (_search(-1), *_RIGHT_OUT),
    22: (_search(-1), *_RIGHT_IN),
    23: (_search(+1), *_LEFT_OUT),
    24: (_search(+1), *_LEFT_IN),
    25: (_search(+1), *_RIGHT_IN),
    26: (_search(+1), *_RIGHT_OUT),
    27: (_search(-1), *_RIGHT_OUT),
    28: (_search(-1), *_RIGHT_IN),
    29: (_search(-1), *_LEFT_IN),
    30: (_search(-1), *_LEFT_OUT),
}

METHODS: Final[dict[int, tuple[Phase, ...]]] = {
    **_BY_SWITCH,
    **{n - 16: (*phases, _index(phases[-1].direction)) for n, phases in _BY_SWITCH.items()},
    33: (_index(-1),),
    34: (_index(+1),),
    35: (),
    37: (),
    -1: (Phase(+1, False, Until.STALL), _index(-1)),
    -2: (Phase(-1, False, Until.STALL), _index(+1)),
    -3: (Phase(+1, False, Until.STALL),),
    -4: (Phase(-1, False, Until.STALL),),
}

_STALL_TIME: Final = 0.05  # s at the torque limit without motion that is a stop


class HomingAxis(AxisView, Protocol):
    """What homing sees of its axis besides."""

    @property
    def saturated(self) -> bool:
        """Whether the torque is at its limit."""

    @property
    def revolutions(self) -> float:
        """Position of the motor, revolutions."""

    @property
    def forward(self) -> int:
        """1, or -1 when the polarity turns the motor round."""

    @property
    def per_revolution(self) -> float:
        """Position units in one revolution of the motor."""

    @property
    def home_move(self) -> int:
        """How far it goes after homing, position units."""

    def switch(self, switch: Switch) -> bool:
        """Whether a switch is active."""

    def edge_between(self, switch: Switch, first: float, last: float) -> float:
        """Where between two positions (revolutions) a switch has its edge."""

    def set_home(self, revolutions: float) -> None:
        """Let the position of the axis be 607C where the motor stood at `revolutions`."""


class Homing(Mode):
    """HM: bit 4 of the controlword starts the method 6098."""

    number = 6
    halts = True

    def __init__(self, axis: HomingAxis) -> None:
        super().__init__(axis)
        self._homing = axis
        self._phases: list[Phase] = []
        self._direction = 0
        self._turned = False
        self._before = 0.0  # revolutions at the last step
        self._active = False  # the switch at the last step
        self._stalled = 0.0  # s
        self._running = self._attained = self._failed = False
        self._goal: float | None = None  # position to which it goes after homing

    @override
    def enter(self) -> None:
        """Begin where the axis stands."""
        self._stop()
        self._attained = self._failed = False

    @property
    def searches_stop(self) -> bool:
        """Whether it is meant to push against a stop, and so errors of following are none."""
        return bool(self._running and self._phases and self._phases[0].until is Until.STALL)

    @property
    def running(self) -> bool:
        """Whether a method is under way."""
        return self._running

    def _stop(self) -> None:
        self._phases = []
        self._running = False
        self._goal = None

    @override
    def control(self, word: int, before: int) -> None:
        """Follow the bits of the mode."""
        if not word & NEW_SETPOINT:
            self._stop()
        elif not before & NEW_SETPOINT and not self._running:
            self._attained = self._failed = False
            phases = METHODS.get(self.axis.value(0x6098))
            self._failed = phases is None  # of a method that only the file of a real drive allows
            self._running = phases is not None
            if phases is not None:
                self._begin(list(phases))

    def halt(self) -> None:
        """Be interrupted by bit 8 of the controlword."""
        self._stop()

    def _begin(self, phases: list[Phase]) -> None:
        self._phases = phases
        self._turned = False
        self._before = self._homing.revolutions
        self._stalled = 0.0
        if phases:
            self._direction = phases[0].direction
            self._active = self._homing.switch(phases[0].switch)
        else:
            self._finish(self._homing.revolutions)

    def _finish(self, revolutions: float) -> None:
        moved = bool(self._phases)
        self._homing.set_home(revolutions)
        self._stop()
        if moved and self._homing.home_move:
            home = (revolutions - self._homing.revolutions) * self._homing.forward
            turn = abs(self._homing.per_revolution)
            self._goal = self.axis.position + home * turn + self._homing.home_move
            self._running = True
        else:
            self._attained = True

    @override
    def step(self, dt: float) -> None:
        """Advance the setpoint."""
        axis, setpoint = self._homing, self.axis.setpoint
        setpoint.control = Control.POSITION
        acceleration = min(axis.acceleration(0x609A), axis.acceleration(0x60C5))
        if self._phases:
            self._check(self._phases[0], dt)
        if self._goal is not None:
            speed = axis.speed(0x6099, 1)
            place = setpoint.position, setpoint.velocity, self._goal, speed
            setpoint.position, setpoint.velocity = toward(*place, acceleration, acceleration, dt)
            if setpoint.position == self._goal and not setpoint.velocity:
                self._stop()
                self._attained = True
            return
        speed = 0.0
        if self._phases:
            fast = self._phases[0].fast
            speed = self._direction * axis.speed(0x6099, 1 if fast else 2)
        velocity = ramp_velocity(setpoint.velocity, speed, acceleration, acceleration, dt)
        setpoint.position += velocity * dt
        setpoint.velocity = velocity

    def _check(self, phase: Phase, dt: float) -> None:
        """End the phase when its time has come, or turn round at a limit switch."""
        axis = self._homing
        before, now = self._before, axis.revolutions
        self._before = now
        active = axis.switch(phase.switch)
        was_active, self._active = self._active, active
        forward = (now - before) * axis.forward * self._direction > 0
        home: float | None = None
        match phase.until:
            case Until.ACTIVE if active:
                home = now
            case Until.RISES if active and not was_active and forward:
                home = axis.edge_between(phase.switch, before, now)
            case Until.FALLS if was_active and not active and forward:
                home = axis.edge_between(phase.switch, before, now)
            case Until.INDEX if forward and math.floor(before) != math.floor(now):
                home = float(max(math.floor(before), math.floor(now)))
            case Until.STALL:
                pushes = axis.saturated and abs(axis.velocity) < 1e-3 * axis.speed(0x6099, 2)
                self._stalled = self._stalled + dt if pushes else 0.0
                home = now if self._stalled >= _STALL_TIME else None
        if home is not None:
            if phase.until is Until.STALL:
                axis.setpoint.position, axis.setpoint.velocity = axis.position, 0.0
            rest = self._phases[1:]
            if rest:
                self._begin(rest)
            else:
                self._finish(home)
            return
        limit = Switch.POSITIVE if self._direction > 0 else Switch.NEGATIVE
        blocked = axis.switch(limit) and phase.switch is not limit
        if blocked and phase.until is not Until.STALL:
            if phase.turns and not self._turned:
                self._turned = True
                self._direction = -self._direction
            elif (now - before) * axis.forward * self._direction >= 0:
                self._stop()
                self._failed = True

    @override
    def status(self, halted: bool) -> int:
        """Bits 10, 12 and 13."""
        moving = self.axis.setpoint.velocity != 0.0
        if self._failed:
            return BIT_13 | (0 if moving else TARGET_REACHED)
        if self._running:
            return 0
        if self._attained:
            return BIT_12 | (0 if moving else TARGET_REACHED)
        return 0 if moving else TARGET_REACHED
