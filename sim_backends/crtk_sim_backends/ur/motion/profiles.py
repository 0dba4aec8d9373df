"""Distance over time: the profiles of moves."""

from __future__ import annotations

from collections.abc import Iterable
from math import sqrt

TIME_TOLERANCE = 1e-9  # s

Piece = tuple[float, float]  # duration, s, and acceleration


class Profile:
    """Distance over time, in pieces of constant acceleration, from a speed at the start."""

    def __init__(self, pieces: Iterable[Piece], speed: float = 0.0) -> None:
        self.duration = 0.0
        self.distance = 0.0
        self.speed = speed
        self._pieces: list[tuple[float, float, float, float, float]] = []
        for duration, acceleration in pieces:
            if duration <= 0.0:
                continue
            start = self.duration
            self.duration += duration
            self._pieces.append((self.duration, start, self.distance, self.speed, acceleration))
            self.distance += (self.speed + 0.5 * acceleration * duration) * duration
            self.speed += acceleration * duration

    def braked(self, t: float, deceleration: float) -> Profile:
        """The same up to `t` seconds, then slowing down to rest."""
        pieces = [
            (min(end, t) - start, acceleration) for end, start, _, _, acceleration in self._pieces
        ]
        _, speed = self.at(t)
        begin = self._pieces[0][3] if self._pieces else speed
        return Profile([*pieces, (speed / deceleration, -deceleration)], begin)

    def at(self, t: float) -> tuple[float, float]:
        """Distance covered and speed after `t` seconds."""
        if t < self.duration - TIME_TOLERANCE:
            for end, start, distance, speed, acceleration in self._pieces:
                if t < end:
                    t -= start
                    return distance + (speed + 0.5 * acceleration * t) * t, speed + acceleration * t
        return self.distance, self.speed


def ramps(
    distance: float, speed: float, acceleration: float, start: float = 0.0, end: float = 0.0
) -> list[Piece]:
    """Pieces that cover `distance` with at most `speed`, from speed `start` to speed `end`.

    `end` is lowered to what can be reached; from `start` it must be possible to slow down to it.
    """
    end = min(end, speed, sqrt(start * start + 2.0 * acceleration * distance))
    peak = min(speed, sqrt(0.5 * (start * start + end * end) + acceleration * distance))
    slowing = abs(start * start - peak * peak) + peak * peak - end * end
    left = distance - slowing / (2.0 * acceleration)
    up = acceleration if peak > start else -acceleration
    return [
        ((peak - start) / up, up),
        (max(0.0, left) / peak if peak > 0.0 else 0.0, 0.0),
        ((peak - end) / acceleration, -acceleration),
    ]


def timed(length: float, seconds: float, blend: float, entry: float) -> list[Piece]:
    """Profile that takes `seconds` from waypoint to waypoint, the blends up to their middle.

    Without blends it has three equal parts. A blend that takes longer than the move makes it later.
    """
    seconds = max(seconds, 0.5 * blend * length / (length - entry) if entry else blend)
    share = entry / length
    rise = 0.0 if blend else min(seconds / 3.0, seconds * (1.0 - share) / (1.0 - 0.5 * share))
    fall = 0.0 if entry else min(seconds / 3.0, seconds - 0.5 * blend)
    speed = length / (seconds - 0.5 * (rise + fall))
    up = blend or rise
    cruise = seconds + 0.5 * blend - entry / speed - up - fall
    return [(up, speed / up), (cruise, 0.0), (fall, -speed / fall if fall else 0.0)]
