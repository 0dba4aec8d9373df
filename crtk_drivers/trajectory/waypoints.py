"""Trajectories through given points: what is between the points, and how a motion joins one.

Between two points it is linear where one of them has a position only, cubic where both have velocities, and
quintic where both have accelerations as well, as ros2_controllers' joint_trajectory_controller has it
(trajectory.cpp, ``interpolate_between_points``). At the last point it comes to rest.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crtk_drivers.device import JointLimits
from crtk_drivers.samples import Array, Vector, vector

_PROBES = 9
"""Instants of each piece, a polynomial of degree 5, at which it is looked how fast and how far it goes."""

_AT_ONCE = 4096
"""Pieces that are looked at together: what that takes of memory."""

_PULL = 5.7735
"""Peak acceleration of the smooth way of a distance of 1 in 1 s, from rest to rest."""

_BRAKE = 4.0
"""Peak acceleration, nearly, of smoothly coming from a speed of 1 to rest where it began, in 1 s."""

_SPEED = 1.875
"""Peak speed of the smooth way of a distance of 1 in 1 s."""

_SHARE = 0.25
"""Share of its velocity limit that a joint has for coming onto a trajectory, beside the trajectory's own."""


SHORTEST_LEAD = 0.05
"""Seconds to the first point below which it is as if that were now."""
HARDER = 0.01
"""By how much the way to the first point may exceed an acceleration limit: what plans it rounds."""
SHORTEST_JOINING = 1e-6
"""Seconds below which a motion counts as on the trajectory: it is off by less than 1e-11 rad or m."""


class Spline:
    """A trajectory of n joints through m points.

    Args:
        times: (m,) s, increasing.
        positions: (m, n).
        velocities: (m, n); a row of NaN where a point has none.
        accelerations: (m, n); the same.

    Attributes:
        first: position, velocity and acceleration (n,) of the first point, as they were given.
    """

    def __init__(
        self, times: Vector, positions: Array, velocities: Array, accelerations: Array
    ) -> None:
        self._times = times
        self.first = positions[0], velocities[0], accelerations[0]
        self._start, self._last = vector(positions[0]), vector(positions[-1])
        self._zero = vector(np.zeros(positions.shape[1]))
        self._pieces = _pieces(times, positions, velocities, accelerations)

    @property
    def end(self) -> float:
        """Seconds at which it ends."""
        return float(self._times[-1])

    @property
    def begin(self) -> float:
        """Seconds at which it begins."""
        return float(self._times[0])

    def state(self, time: float) -> tuple[Vector, Vector, Vector]:
        """Return position, velocity and acceleration (n,) at a time; before and after it, it rests."""
        piece = int(np.searchsorted(self._times, time, side="right")) - 1
        if piece < 0:
            return self._start, self._zero, self._zero
        if piece >= len(self._pieces):
            return self._last, self._zero, self._zero
        return _read(self._pieces[piece], time - float(self._times[piece]))

    def hardest(self) -> Array:
        """Return the greatest accelerations (n,); between its pieces, where it may be a jump, none is."""
        greatest: Array = self._zero
        for begin in range(0, len(self._pieces), _AT_ONCE):
            pieces = self._pieces[begin : begin + _AT_ONCE]
            spans = np.diff(self._times[begin : begin + len(pieces) + 1])
            for share in np.linspace(0.0, 1.0, _PROBES):
                pulls = _accelerations(pieces, (spans * share)[:, None])
                greatest = np.maximum(greatest, np.abs(pulls).max(axis=0))
        return greatest

    def extremes(self) -> tuple[Array, Array, Array]:
        """Return the least and greatest positions and the greatest speeds (n,)."""
        lower = upper = self._last
        fastest: Array = self._zero
        for begin in range(0, len(self._pieces), _AT_ONCE):
            pieces = self._pieces[begin : begin + _AT_ONCE]
            spans = np.diff(self._times[begin : begin + len(pieces) + 1])
            for share in np.linspace(0.0, 1.0, _PROBES):
                at = (spans * share)[:, None]
                position, velocity = _polynomials(pieces, at)
                lower = np.minimum(lower, position.min(axis=0))
                upper = np.maximum(upper, position.max(axis=0))
                fastest = np.maximum(fastest, np.abs(velocity).max(axis=0))
        return lower, upper, fastest


class JoinedPath:
    """A trajectory as it is gone along from a motion that is not quite on it.

    Before its first point that motion goes there, and comes to rest where that point has no velocity. On the
    way already, or where the time to the first point is so short that a joint would exceed its limit of
    acceleration, it comes onto the trajectory smoothly, in a time that the limits allow, and the trajectory's
    own time goes on meanwhile.

    Args:
        spline: the trajectory.
        begin: its time at which it is joined; before the first point's, the rest is to get there.
        motion: position, velocity and acceleration (n,) that it is joined from.
        limits: of the joints.

    Attributes:
        lead: the way to the first point; None if that is now, or past, or asks for too much acceleration.
        pull: (n,) the greatest accelerations of the way to the first point, whether it is gone or not.
        off: (n,) how far the joints are from where the trajectory is at that time.
        duration: seconds until the end.
    """

    def __init__(
        self,
        spline: Spline,
        begin: float,
        motion: tuple[Vector, Vector, Vector],
        limits: Sequence[JointLimits],
    ) -> None:
        self._spline = spline
        self._begin = begin
        self.lead: Spline | None = None
        self.pull: Array = np.zeros_like(motion[0])
        if spline.begin - begin >= SHORTEST_LEAD:
            position, velocity, acceleration = spline.first
            first = position, np.nan_to_num(velocity), acceleration
            ends = (np.vstack(both) for both in zip(motion, first, strict=True))
            lead = Spline(vector([begin, spline.begin]), *ends)
            self.pull = lead.hardest()
            strongest = np.array([limit.acceleration for limit in limits])
            if (self.pull <= strongest * (1.0 + HARDER)).all():
                self.lead = lead
        there = self._on_it(begin)
        position, velocity, acceleration = (
            vector(mine - its) for mine, its in zip(motion, there, strict=True)
        )
        self.off = position
        self._joins = _joining_time(position, velocity, limits)
        still = np.zeros_like(position)
        self._joining: Array | None = None
        if self._joins:
            self._joining = _quintic(
                self._joins, position, velocity, acceleration, still, still, still
            )
        self.duration = max(spline.end - begin, self._joins)

    def state(self, time: float) -> tuple[Vector, Vector, Vector]:
        """Return position, velocity and acceleration (n,) `time` seconds after it is joined."""
        on_it = self._on_it(self._begin + time)
        if self._joining is None or time >= self._joins:
            return on_it
        position, velocity, acceleration = (
            vector(its + mine) for its, mine in zip(on_it, _read(self._joining, time), strict=True)
        )
        return position, velocity, acceleration

    def _on_it(self, time: float) -> tuple[Vector, Vector, Vector]:
        is_led = self.lead is not None and time < self._spline.begin
        return (self.lead if is_led and self.lead else self._spline).state(time)


def _joining_time(distance: Array, speed: Array, limits: Sequence[JointLimits]) -> float:
    longest = 0.0
    for way, rate, limit in zip(np.abs(distance), np.abs(speed), limits, strict=True):
        pulls = float(np.sqrt(_PULL * way / limit.acceleration))
        goes = _SPEED * float(way) / (_SHARE * limit.velocity)
        longest = max(longest, pulls, goes, _BRAKE * float(rate) / limit.acceleration)
    return longest if longest >= SHORTEST_JOINING else 0.0


def _pieces(times: Vector, p: Array, v: Array, a: Array) -> Array:
    """Return the coefficients (m - 1, 6, n) of the pieces, from the constant up."""
    span: Array = np.diff(times)[:, None]
    has_v = np.atleast_1d(np.isfinite(v).all(axis=1))
    has_a = np.atleast_1d(has_v & np.isfinite(a).all(axis=1))
    cubic, quintic = has_v[:-1] & has_v[1:], has_a[:-1] & has_a[1:]
    pieces = np.zeros((len(times) - 1, 6, p.shape[1]))
    pieces[:, 0] = p[:-1]
    pieces[:, 1] = np.diff(p, axis=0) / span
    for rows, make in ((cubic & ~quintic, _cubic), (quintic, _quintic)):
        if rows.any():
            ends = (
                each[side][rows] for side in (slice(None, -1), slice(1, None)) for each in (p, v, a)
            )
            pieces[rows] = make(span[rows], *ends)
    return pieces


def _cubic(
    h: Array | float, p0: Array, v0: Array, _a0: Array, p1: Array, v1: Array, _a1: Array
) -> Array:
    way = p1 - p0
    c2 = (3.0 * way / h - 2.0 * v0 - v1) / h
    c3 = (-2.0 * way / h + v0 + v1) / h**2
    none = np.zeros_like(c2)
    return np.stack([p0, v0, c2, c3, none, none], axis=-2)


def _quintic(
    h: Array | float, p0: Array, v0: Array, a0: Array, p1: Array, v1: Array, a1: Array
) -> Array:
    way = p1 - p0 - v0 * h - 0.5 * a0 * h**2
    speed = (v1 - v0 - a0 * h) * h
    pull = (a1 - a0) * h**2
    c3 = (10.0 * way - 4.0 * speed + 0.5 * pull) / h**3
    c4 = (-15.0 * way + 7.0 * speed - pull) / h**4
    c5 = (6.0 * way - 3.0 * speed + 0.5 * pull) / h**5
    return np.stack([p0, v0, 0.5 * a0, c3, c4, c5], axis=-2)


def _polynomials(pieces: Array, t: Array) -> tuple[Array, Array]:
    """Return positions and velocities (m, n) of pieces (m, 6, n), each at its time (m, 1)."""
    c0, c1, c2, c3, c4, c5 = (pieces[:, power] for power in range(6))
    position = c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5))))
    velocity = c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5)))
    return position, velocity


def _accelerations(pieces: Array, t: Array) -> Array:
    """Return accelerations (m, n) of pieces (m, 6, n), each at its time (m, 1)."""
    _, _, c2, c3, c4, c5 = (pieces[:, power] for power in range(6))
    pulls: Array = 2.0 * c2 + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5))
    return pulls


def _read(piece: Array, t: float) -> tuple[Vector, Vector, Vector]:
    """Return position, velocity and acceleration (n,) of one piece (6, n)."""
    powers = np.array(
        [
            [1.0, t, t**2, t**3, t**4, t**5],
            [0.0, 1.0, 2.0 * t, 3.0 * t**2, 4.0 * t**3, 5.0 * t**4],
            [0.0, 0.0, 2.0, 6.0 * t, 12.0 * t**2, 20.0 * t**3],
        ]
    )
    position, velocity, acceleration = powers @ piece
    return vector(position), vector(velocity), vector(acceleration)
