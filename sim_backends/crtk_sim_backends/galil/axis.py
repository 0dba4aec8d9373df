"""One axis: profile, servo, switches, and why it stopped. In counts and seconds; no wire and no clock."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final, NamedTuple

from crtk_sim_backends.kit.profile import cubic, over_the_end, ramp_velocity, toward

STEP: Final = 0.001
"""Seconds of a sample (TM 1000)."""

_GAIN: Final = 1.0 - math.exp(-STEP / 0.004)
"""Share of its error that the motor makes up for in a sample: it is 4 ms behind its profile."""

_STIFF: Final = 2e-3  # V for a count of error
_MOST: Final = 9.9982  # V
_LONGEST: Final = 255  # pieces in the buffer of PVT

FORWARD, REVERSE, ST, ABORT, OFF_ON_ERROR, FOUND_EDGE, HOMED, ENCODER = 2, 3, 4, 7, 8, 9, 10, 12
PVT, PVT_END, PVT_EMPTY = 30, 31, 32


class Piece(NamedTuple):
    """One piece of PVT: way in counts, velocity at its end, samples."""

    way: float
    velocity: float
    samples: int


@dataclass
class Axis:
    """One axis.

    Attributes:
        travel, home_at, index_every: of its switches and its encoder, see `SimConfig`.
        position: of the motor.
        reference: of its profile.
        mode: what the profile does; empty: nothing.
    """

    travel: float
    home_at: float
    index_every: float
    position: float = 0.0
    on: bool = False
    stop_code: int = 1
    mode: str = ""
    speed: float = 25_000.0
    acceleration: float = 256_000.0
    deceleration: float = 256_000.0
    jog: float = 25_000.0
    goal: float = 0.0
    error_limit: float = 16384.0
    off_on_error: int = 0
    limits_off: int = 0
    stuck: bool = False

    def __post_init__(self) -> None:
        self.reference = self.position
        self.rate = 0.0  # of the reference
        self.velocity = 0.0  # of the motor
        self.zero = 0.0  # motor position at which it counts 0
        self.next = ""  # what BG begins
        self.tracks = False
        self.pieces: deque[Piece] = deque()
        self._piece: tuple[Piece, float, float, int] | None = None
        self._searches = False  # HM and FI: the switch or the index has not been found yet
        self._found = 0.0  # where it is, in counts of the motor
        self._switch: bool | None = None  # the home switch at the last step

    # What others see

    @property
    def counts(self) -> int:
        """What the encoder counts."""
        return round(self.position - self.zero)

    @property
    def moving(self) -> bool:
        """Whether the profile runs."""
        return bool(self.mode)

    @property
    def homing(self) -> bool:
        """Whether HM runs."""
        return self.mode == "home"

    @property
    def finding(self) -> bool:
        """Whether FE or FI runs."""
        return self.mode == "index"

    @property
    def forward_limit(self) -> bool:
        """Whether the switch is active."""
        return self.position >= self.travel

    @property
    def reverse_limit(self) -> bool:
        """Whether the switch is active."""
        return self.position <= -self.travel

    @property
    def home_switch(self) -> bool:
        """Whether the switch is active."""
        return self.position >= self.home_at

    @property
    def volts(self) -> float:
        """Output of the controller."""
        if not self.on:
            return 0.0
        return max(-_MOST, min(_MOST, _STIFF * (self.reference - self.counts)))

    # Commands

    def power(self, *, on: bool) -> None:
        """SH, MO. Position tracking is left by ST and PT 0 only: what firmware does there is not known."""
        self.on = on
        self.mode = "track" if on and self.tracks else ""
        self.pieces.clear()
        self._piece = None
        self.reference, self.rate = float(self.counts), 0.0

    def define(self, counts: float) -> None:
        """DP."""
        self.zero = self.position - counts
        self.reference = counts
        self._wrap()

    def begin(self) -> int:
        """BG; the error code, 0 if it begins."""
        if not self.on:
            return 20
        if self.moving:
            return 21
        kind = self.next or "go"
        way = self.jog if kind in ("jog", "index") else self.goal - self.reference
        if kind == "home":
            way = -1.0 if self.home_switch else 1.0
        if (way > 0 and self._stops(1)) or (way < 0 and self._stops(-1)):
            return 22
        self.mode, self.stop_code, self._searches, self._switch = kind, 0, True, None
        self.next = "jog" if kind == "jog" else ""
        return 0

    def begin_pvt(self) -> int:
        """BT; the error code."""
        if not self.on:
            return 20
        if self.moving or not self.pieces:
            return 21 if self.moving else 24
        self.mode, self.stop_code = "pvt", PVT
        return 0

    def add(self, piece: Piece) -> int:
        """PV; the error code."""
        if len(self.pieces) >= _LONGEST:
            return 5
        self.pieces.append(piece)
        return 0

    def track(self, *, on: bool) -> int:
        """PT; the error code."""
        if on and not self.on:
            return 20
        if on and self.moving:
            return 7
        self.tracks = on
        self.mode, self.stop_code = ("track", 0) if on else ("", 1)
        return 0

    def stop(self, code: int = ST) -> None:
        """ST, AB and what limit switches do: slow down."""
        if self.moving:
            self.mode, self.stop_code = "stop", code
        self.tracks = False
        self.pieces.clear()
        self._piece = None
        self.next = ""

    # Time

    def step(self) -> None:
        """One sample."""
        before = self.position
        if self.mode:
            self._profile()
        if self.on and not self.stuck:
            self.position += (self.reference + self.zero - self.position) * _GAIN
        self.velocity = (self.position - before) / STEP
        self._wrap()
        if self.on:
            self._supervise()

    def _wrap(self) -> None:
        """Count on at the other end of 32 bits, as the counter does; where it was sent stays what it is."""
        left_out = over_the_end(self.position - self.zero)
        self.zero += left_out
        self.reference -= left_out

    def _profile(self) -> None:
        kind = self.mode
        if kind in ("go", "track"):
            speed, up, down = self.speed, self.acceleration, self.deceleration
            self.reference, self.rate = toward(
                self.reference, self.rate, self.goal, speed, up, down, STEP
            )
            if kind == "go" and self.reference == self.goal and not self.rate:
                self._end(1)
        elif kind == "stop":
            self._ramp(0.0)
            if not self.rate:
                self.mode = ""
        elif kind == "jog":
            self._ramp(self.jog)
        elif kind == "pvt":
            self._pvt()
        elif kind == "index":
            self._index()
        elif kind == "home":
            self._home()

    def _ramp(self, wanted: float) -> None:
        self.rate = ramp_velocity(self.rate, wanted, self.acceleration, self.deceleration, STEP)
        self.reference += self.rate * STEP

    def _pvt(self) -> None:
        if self._piece is None:
            if not self.pieces:
                self.mode, self.rate = "", 0.0
                self.stop_code = PVT_EMPTY
                return
            piece = self.pieces.popleft()
            if piece.samples == 0:
                self.rate = 0.0
                self._end(PVT_END)
                return
            self._piece = piece, self.reference, self.rate, 0
        piece, begin, rate, done = self._piece
        done += 1
        end = begin + piece.way
        seconds = piece.samples * STEP
        share = done / piece.samples
        self.reference = cubic(share, begin, end, rate, piece.velocity, seconds)
        self._piece = piece, begin, rate, done
        if done >= piece.samples:
            self.reference, self.rate = end, piece.velocity
            self._piece = None

    def _index(self) -> None:
        if not self._searches:
            self._return_to(self._found)
            return
        before = math.floor((self.reference + self.zero) / self.index_every)
        self._ramp(self.jog)
        after = math.floor((self.reference + self.zero) / self.index_every)
        if before != after:
            self._searches, self._found = False, max(before, after) * self.index_every

    def _home(self) -> None:
        if not self._searches:
            self._return_to(self._found)
            return
        active = self.home_switch
        self._ramp(-self.speed if active else self.speed)
        if self._switch is not None and active != self._switch:
            self._searches, self._found = False, self.home_at
        self._switch = active

    def _return_to(self, place: float) -> None:
        """Slow down, go back to where the switch or the index was, and count 0 there."""
        self.reference, self.rate = toward(
            self.reference,
            self.rate,
            place - self.zero,
            abs(self.speed) / 4,
            self.acceleration,
            self.deceleration,
            STEP,
        )
        if self.reference == place - self.zero and not self.rate:
            if abs(self.position - place) > 2.0:
                return
            self.define(self.position - place)
            self.reference = 0.0
            self._end(HOMED)

    def _end(self, code: int) -> None:
        self.mode, self.stop_code, self.rate = "", code, 0.0

    def _stops(self, way: int) -> bool:
        if self.limits_off in (3, 1 if way > 0 else 2):
            return False
        return self.forward_limit if way > 0 else self.reverse_limit

    def _supervise(self) -> None:
        if self.mode not in ("", "stop"):
            if self.rate > 0 and self._stops(1):
                self.stop(FORWARD)
            elif self.rate < 0 and self._stops(-1):
                self.stop(REVERSE)
        if abs(self.reference - self.counts) > self.error_limit and self.off_on_error & 1:
            code = OFF_ON_ERROR
            self.power(on=False)
            self.stop_code = code
