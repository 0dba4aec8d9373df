"""The rest of a move when the next one begins, and how fast the two go then."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import Final

from crtk_sim_backends.ur.motion.kinematics import Transform, compose, invert
from crtk_sim_backends.ur.motion.paths import Path
from crtk_sim_backends.ur.motion.profiles import Piece, ramps, timed

NOWHERE: Final = 1e-9  # rad or m


@dataclass(frozen=True)
class Tail:
    """What is left of a move when the next one begins: `speed` along `path` from `begin` on."""

    path: Path
    begin: float
    speed: float
    radius: float  # m, of the blend
    constant: bool  # speed, through blends, too
    tick: int  # in which the next move must begin
    end: float  # along the path, where the waypoint is
    waypoint: list[float]  # joint positions there

    @property
    def duration(self) -> float:
        """Seconds in which it comes to rest at the waypoint, with constant deceleration."""
        return 2.0 * (self.end - self.begin) / self.speed

    def at(self, t: float) -> float:
        """Distance along its path after `t` seconds."""
        duration = self.duration
        if t >= duration:
            return self.end
        return self.begin + self.speed * t * (1.0 - 0.5 * t / duration)


@dataclass(frozen=True)
class Pace:
    """How fast a move goes: `speed` and `acceleration` along its path, or `seconds` in all."""

    speed: float
    acceleration: float
    seconds: float = 0.0
    constant: bool = False  # through blends, too
    abortable: bool = False  # by `abort`


def added(a: Transform, corner: Transform, b: Transform) -> Transform:
    """Where the ways from `a` to `corner` and from `corner` to `b` lead together."""
    x, y, z = (p + q - c for p, q, c in zip(a[9:], b[9:], corner[9:], strict=True))
    turn = compose((*a[:9], 0.0, 0.0, 0.0), invert((*corner[:9], 0.0, 0.0, 0.0)))
    rotation = compose(turn, (*b[:9], 0.0, 0.0, 0.0))
    return (*rotation[:9], x, y, z)


def exit_speed(pace: Pace, entry: float) -> float:
    """Speed at which a blend begins, `entry` before the waypoint; 0 for no blend.

    No corner then takes more than the acceleration of the move.
    """
    if not entry or pace.constant:
        return pace.speed if entry else 0.0
    return min(pace.speed, sqrt(pace.acceleration * entry))


def pieces(length: float, pace: Pace, tail: Tail | None, lead: float, entry: float) -> list[Piece]:
    """Profile from the start of a path to `entry` before its end.

    Out of a blend the move speeds up for as long as the tail lasts, within `lead` of its path.
    """
    if length < NOWHERE:
        return [(tail.duration, 0.0)] if tail is not None else []
    if pace.seconds:
        return timed(length, pace.seconds, tail.duration if tail is not None else 0.0, entry)
    v, a = pace.speed, pace.acceleration
    way = length - entry
    end = exit_speed(pace, entry)
    if tail is None:
        return ramps(way, v, a, 0.0, end)
    seconds = tail.duration
    speed = min(v, 2.0 * lead / seconds)
    if not pace.constant:
        speed = min(speed, 0.5 * a * seconds)
    b = 0.5 * a * seconds
    speed = min(speed, sqrt(b * b + 2.0 * a * way + end * end) - b)  # or it could not slow down
    return [
        (seconds, speed / seconds),
        *ramps(way - 0.5 * speed * seconds, v, a, speed, end),
    ]
