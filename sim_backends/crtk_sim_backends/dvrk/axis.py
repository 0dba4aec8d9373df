"""One motor of a board: amplifier, current, what it moves, encoder and potentiometer. No sockets, no clock.

Source: MotorChannelQLA.v and SafetyCheck.v of mechatronics-firmware. Positions are in counts of the encoder.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

CLOCK: Final = 49.152e6
"""Hz."""

MIDDLE: Final = 0x800000
"""From which an encoder counts."""

NO_CURRENT: Final = 0x8000
AMPERE: Final = 32768.0 / 6.25
"""Of the converters of currents."""

DRAG: Final = 4.0
"""1/s in which a motor that nothing drives comes to rest."""
PUSH: Final = 60_000.0
"""Counts/s² of one ampere: what it moves has this inertia."""

POTENTIOMETER: Final = 10.0
"""Counts of the encoder for one of the converter."""

_LONGEST: Final = 0x03FFFFFF
_DELAY: Final = 0.0025
"""Seconds from the enable to the amplifier."""
_CHECKED: Final = 0x0900
_SMALL: Final = 0x0300
_CHECK_TIME: Final = 0.05
"""The board's own check: current beyond what was asked for by so much, for so long, if it is not small."""


@dataclass(frozen=True)
class Load:
    """What motors move.

    Attributes:
        gravity: A that hold it against its weight; it falls towards lower counts, and lies at 0.
        friction: A that it takes to move it at all.
    """

    gravity: float = 0.0
    friction: float = 0.0


WEIGHTLESS: Final = Load()


class Axis:
    """One motor with its sensors.

    Args:
        load: what it moves.
    """

    def __init__(self, load: Load) -> None:
        self._load = load
        self.position = 0.0
        self.velocity = 0.0
        self.hand: float | None = None  # counts/s at which somebody moves it
        self.command = NO_CURRENT
        self.preload = MIDDLE
        self.origin = 0.0  # position at which the encoder has its preload
        self.asked = False  # amplifier
        self.tripped = self.overheated = False
        self.overflow = self.jumped = self.runs_wild = self.sticks = self.dead = False
        self.current_error = 0.0  # A that are measured beside what flows
        self.sensor_error = 0.0  # counts by which the potentiometer is elsewhere
        self.is_on = False
        self._since = math.inf  # it was asked for and had voltage
        self._wrong_since = math.inf  # its current is not what was asked for

    # Time

    def advance(self, now: float, seconds: float, *, powered: bool) -> None:
        """Let time pass until `now`.

        Args:
            now: monotonic s.
            seconds: since it was called last.
            powered: motors have had their voltage for long enough.
        """
        self._since = min(self._since, now) if self.asked and powered else math.inf
        is_on = now - self._since >= _DELAY and not self.dead
        self.is_on = is_on or self.sticks
        self._check(now)
        if self.hand is not None:
            self.velocity = self.hand
            self.position += self.hand * seconds
        else:
            self._move(seconds)

    def _move(self, seconds: float) -> None:
        amperes = self._flowing - self._load.gravity
        friction = self._load.friction
        if self.velocity == 0.0 and abs(amperes) <= friction:
            return
        opposes = math.copysign(friction, self.velocity or amperes)
        final = PUSH * (amperes - opposes) / DRAG
        decay = math.exp(-DRAG * seconds)
        after = final + (self.velocity - final) * decay
        self.position += final * seconds + (self.velocity - final) * (1.0 - decay) / DRAG
        # Friction brings it to rest, and no further.
        turns = friction > 0.0 and self.velocity * after < 0.0
        self.velocity = 0.0 if turns else after
        if self._load.gravity > 0.0 and self.position <= 0.0:
            self.position, self.velocity = 0.0, max(self.velocity, 0.0)

    def _check(self, now: float) -> None:
        """Switch the amplifier off where its current is beyond what was asked for."""
        asked, found = abs(self.command - NO_CURRENT), abs(self.measured - NO_CURRENT)
        is_wrong = self.is_on and found > _SMALL and found > asked + _CHECKED
        self._wrong_since = min(self._wrong_since, now) if is_wrong else math.inf
        if now - self._wrong_since > _CHECK_TIME:
            self.tripped = True

    # What is told

    @property
    def _flowing(self) -> float:
        return (self.command - NO_CURRENT) / AMPERE if self.is_on else 0.0

    @property
    def measured(self) -> int:
        """The current, of the converter."""
        bits = NO_CURRENT + round((self._flowing + self.current_error) * AMPERE)
        return min(max(bits, 0), 0xFFFF)

    def set_encoder(self, value: int) -> None:
        """Let the encoder count from a value."""
        self.preload, self.origin, self.overflow = value & 0xFFFFFF, self.position, False

    @property
    def encoder(self) -> int:
        """The quadlet of its position: 24 bits, overflow, and the signals A and B."""
        counts = self.preload + round(self.position - self.origin)
        overflow = self.overflow or not 0 <= counts <= 0xFFFFFF
        phase = (0, 1, 3, 2)[counts & 3]
        return (counts & 0xFFFFFF) | overflow << 24 | phase << 28

    @property
    def period(self) -> int:
        """The quadlet of its period: 26 bits, direction, too long, signals that changed at once."""
        speed = 1e6 if self.runs_wild else abs(self.velocity)
        ticks = 4.0 * CLOCK / speed if speed > 0.0 else math.inf
        forwards = (self.velocity > 0.0) << 30
        told = 1 << 31 | _LONGEST if ticks > _LONGEST else round(ticks)
        return told | forwards | self.jumped << 28

    @property
    def analog(self) -> int:
        """The quadlet of potentiometer and current."""
        sensed = NO_CURRENT + round((self.position + self.sensor_error) / POTENTIOMETER)
        return min(max(sensed, 0), 0xFFFF) << 16 | self.measured

    @property
    def status(self) -> int:
        """The quadlet of the motor: amplifier on, asked for, current control, faults, last command."""
        return (
            self.is_on << 29
            | self.asked << 28
            | 1 << 20
            | self.tripped << 17
            | self.overheated << 16
            | self.command
        )
