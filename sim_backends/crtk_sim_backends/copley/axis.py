"""One axis of a drive: trajectory, motor, switches. In counts and seconds; no wire and no clock."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final, NamedTuple

from crtk_sim_backends.kit.profile import cubic, over_the_end, ramp_velocity, toward

STEP: Final = 0.001
"""Seconds of a step."""

_GAIN: Final = 1.0 - math.exp(-STEP / 0.004)
"""Share of its error that the motor makes up for in a step: it is 4 ms behind its trajectory."""
_COAST: Final = math.exp(-STEP / 0.02)
"""What is left in a step of the velocity of a motor without power."""
_AMPERE: Final = 2e-3  # A for a count of error
_MOST: Final = 10.0  # A

_CREEP: Final = 500.0
"""Counts/s up to which a limit switch ends no motion: a count more or less while it stands there."""

FOLLOWING: Final = 1 << 9  # of the latching faults
HERE, POSITIVE_INDEX, NEGATIVE_INDEX = 512, 544, 560
SEARCHES: Final = {513: 1, 529: -1, 544: 1, 560: -1, 514: 1, 530: -1, 516: 1, 532: -1}
"""Homing methods that search, and their first direction."""


class Point(NamedTuple):
    """A point of PVT: seconds to the next one, counts, counts/s."""

    seconds: float
    position: float
    velocity: float


@dataclass
class Axis:
    """One axis.

    Attributes:
        travel, home_at, index_every: of its switches and its encoder, see `SimConfig`.
        position: of the motor.
        mode: what the trajectory does; empty: nothing.
        places: in the buffer of points.
        fastest: that the motor turns, in counts/s.
        latched: latching faults (0xa4).
    """

    travel: float
    home_at: float
    index_every: float
    position: float = 0.0
    on: bool = False
    mode: str = ""
    profile: int = 0
    goal: float = 0.0
    speed: float = 25_000.0
    acceleration: float = 250_000.0
    deceleration: float = 250_000.0
    abort_deceleration: float = 250_000.0
    following_limit: float = 16_000.0
    latched: int = 0
    places: int = 32
    fastest: float = 80_000.0
    stuck: bool = False
    home_method: int = HERE
    home_fast: float = 10_000.0
    home_slow: float = 2_000.0
    home_acceleration: float = 100_000.0

    def __post_init__(self) -> None:
        self.reference = self.position
        self.rate = 0.0  # of the reference
        self.velocity = 0.0  # of the motor
        self.zero = 0.0  # motor position at which it counts 0
        self.aborted = self.referenced = self.home_error = False
        self.points: deque[Point] = deque()
        self.told: list[float] = []  # positions of all points since the buffer was cleared
        self._point: tuple[Point, float] | None = None  # that is carried out, and for how long
        self._found: float | None = None  # where what homing looks for is, in counts of the motor
        self._before = self.position
        self._wrap()

    # What others see

    @property
    def counts(self) -> int:
        """What the encoder counts."""
        return round(self.position - self.zero)

    @property
    def homing(self) -> bool:
        """Whether it homes."""
        return self.mode == "home"

    @property
    def positive_limit(self) -> bool:
        """Whether the switch is active."""
        return self.position >= self.travel

    @property
    def negative_limit(self) -> bool:
        """Whether the switch is active."""
        return self.position <= -self.travel

    @property
    def home_switch(self) -> bool:
        """Whether the switch is active."""
        return self.position >= self.home_at

    @property
    def current(self) -> float:
        """A."""
        if not self.on:
            return 0.0
        return max(-_MOST, min(_MOST, _AMPERE * (self.reference - self.counts)))

    # Commands

    def power(self, *, on: bool) -> None:
        """Enable or disable it: it is where it stands."""
        self.on = on and not self.latched
        self.mode = ""
        self._point = None
        self.points.clear()
        self.reference, self.rate = float(self.counts), 0.0

    def fail(self, fault: int) -> None:
        """A fault is latched."""
        self.latched |= fault
        self.power(on=False)

    def add(self, point: Point) -> bool:
        """Put a point in the buffer; False: it is full."""
        if len(self.points) >= self.places:
            return False
        self.points.append(point)
        self.told.append(point.position)
        return True

    def clear(self) -> None:
        """Empty the buffer."""
        self.points.clear()
        self.told.clear()

    def update(self) -> int:
        """Begin a motion or give it a new goal (t 1); the code of an error."""
        if self.mode in ("home", "stop"):
            return 18
        if self.profile == 3:
            if self.mode == "go":
                return 18
            if self.mode != "pvt":
                if len(self.points) < 2:
                    return 4
                self.mode = "pvt"
        elif self.profile == 2:
            self.mode = "velocity"
        elif self.profile in (0, 256):
            if self.mode == "pvt":
                return 18
            self.mode = "go"
            self._target = self.goal + (self.reference if self.profile == 256 else 0.0)
        else:
            return 25
        self.aborted = False
        return 0

    def abort(self) -> None:
        """Slow down with the abort deceleration (t 0)."""
        if self.mode:
            self.mode = "stop"
        self.aborted = True
        self._point = None

    def home(self) -> int:
        """Begin homing (t 2); the code of an error."""
        if self.mode:
            return 18
        self.referenced = self.home_error = False
        if self.home_method == HERE:
            self._is_home(self.position)
            return 0
        if self.home_method not in SEARCHES:
            return 10
        self.mode, self._found, self.aborted = "home", None, False
        self._before = self.position
        return 0

    # Time

    def step(self) -> None:
        """One step."""
        before = self.position
        if self.on:
            self._trajectory()
            if not self.stuck:
                way = (self.reference + self.zero - self.position) * _GAIN
                self.position += max(-self.fastest * STEP, min(self.fastest * STEP, way))
            self.velocity = (self.position - before) / STEP
            if abs(self.reference - self.counts) > self.following_limit:
                self.fail(FOLLOWING)
        else:
            self.velocity = 0.0 if self.stuck else self.velocity * _COAST
            self.position += self.velocity * STEP
            self.reference = float(self.counts)
        self._wrap()

    def _wrap(self) -> None:
        """Count on at the other end of 32 bits, as the counter does; where it was sent stays what it is."""
        left_out = over_the_end(self.position - self.zero)
        self.zero += left_out
        self.reference -= left_out

    def _trajectory(self) -> None:
        if self.mode == "go":
            self._go(self._target, self.speed, self.acceleration, self.deceleration)
            if self.reference == self._target and not self.rate:
                self.mode = ""
        elif self.mode == "stop":
            self._ramp(0.0, self.abort_deceleration)
            if not self.rate:
                self.mode = ""
        elif self.mode == "velocity":
            self._ramp(math.copysign(self.speed, self.goal), self.acceleration)
        elif self.mode == "pvt":
            self._pvt()
        elif self.mode == "home":
            self._home()
        if self.mode in ("go", "velocity", "pvt") and (
            (self.rate > _CREEP and self.positive_limit)
            or (self.rate < -_CREEP and self.negative_limit)
        ):
            self.abort()

    def _go(self, target: float, speed: float, up: float, down: float) -> None:
        self.reference, self.rate = toward(self.reference, self.rate, target, speed, up, down, STEP)

    def _ramp(self, wanted: float, change: float) -> None:
        self.rate = ramp_velocity(self.rate, wanted, change, change, STEP)
        self.reference += self.rate * STEP

    def _pvt(self) -> None:
        """A point is left for the next one, which must be there; else it is an underflow, and a stop."""
        if self._point is None:
            self._point = self.points.popleft(), 0.0
        point, passed = self._point
        if point.seconds == 0.0:  # the end of the motion
            self.mode, self.rate, self._point = "", 0.0, None
            return
        if not self.points:
            self.abort()
            return
        following = self.points[0]
        passed += STEP
        share = min(1.0, passed / point.seconds)
        before = self.reference
        self.reference = cubic(
            share,
            point.position,
            following.position,
            point.velocity,
            following.velocity,
            point.seconds,
        )
        self.rate = (self.reference - before) / STEP
        self._point = point, passed
        if passed > point.seconds - 0.5 * STEP:
            self._point = self.points.popleft(), 0.0

    def _home(self) -> None:
        if self._found is not None:
            place = self._found - self.zero
            self._go(place, self.home_slow, self.home_acceleration, self.home_acceleration)
            if self.reference == place and not self.rate and abs(self.position - self._found) < 2.0:
                self._is_home(self._found)
            return
        way = SEARCHES[self.home_method]
        kind = self.home_method - (16 if way < 0 else 0)
        if kind == 514 and self.home_switch:
            way = -1
        self._ramp(way * self.home_fast, self.home_acceleration)
        here, before = self.position, self._before
        self._before = here
        limit = self.positive_limit if way > 0 else self.negative_limit
        if kind in (513, 516) and limit:
            self._found = way * self.travel
        elif kind == 544 and here // self.index_every != before // self.index_every:
            self._found = max(here // self.index_every, before // self.index_every)
            self._found *= self.index_every
        elif kind == 514 and (here >= self.home_at) != (before >= self.home_at):
            self._found = self.home_at
        elif limit:
            self.home_error = True
            self.mode = "stop"

    def _is_home(self, place: float) -> None:
        self.zero = place
        self.reference, self.rate, self.mode = float(self.counts), 0.0, ""
        self.referenced = True
