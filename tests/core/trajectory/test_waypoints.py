"""Trajectories through given points: what is between them, and how a motion joins one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from crtk_drivers.device import JointLimits
from crtk_drivers.samples import vector
from crtk_drivers.trajectory.waypoints import JoinedPath, Spline

NONE = [np.nan, np.nan]
LIMIT = JointLimits(-6.0, 6.0, velocity=2.0, acceleration=20.0, jerk=400.0, effort=50.0)


def spline(times: list[float], p: object, v: object = None, a: object = None) -> Spline:
    at = np.array(p, dtype=float)
    none = np.full(at.shape, np.nan)
    rows = [none if values is None else np.array(values, dtype=float) for values in (v, a)]
    return Spline(vector(times), at, *rows)


WAYS = [
    # time, position, velocity, acceleration in the middle of one piece of 2 s from 0 to 1; by hand
    ("positions only: linear", None, None, (1.0, 0.5, 0.5, 0.0)),
    ("velocities too: cubic", [[0.0], [0.0]], None, (1.0, 0.5, 0.75, 0.0)),
    ("cubic, moving at the ends", [[1.0], [1.0]], None, (1.0, 0.5, 0.25, 0.0)),
    ("accelerations too: quintic", [[0.0], [0.0]], [[0.0], [0.0]], (1.0, 0.5, 0.9375, 0.0)),
    ("quintic with accelerations", [[0.0], [0.0]], [[1.0], [1.0]], (1.0, 0.625, 0.9375, -0.5)),
    ("one point without velocity: linear", [[0.0], [np.nan]], None, (1.0, 0.5, 0.5, 0.0)),
    ("accelerations alone count for nothing", None, [[3.0], [3.0]], (1.0, 0.5, 0.5, 0.0)),
]


@pytest.mark.parametrize(("v", "a", "expected"), [w[1:] for w in WAYS], ids=[w[0] for w in WAYS])
def test_what_is_between_two_points_follows_from_what_they_give(
    v: object, a: object, expected: tuple[float, ...]
) -> None:
    state = spline([0.0, 2.0], [[0.0], [1.0]], v, a).state(expected[0])
    assert np.concatenate(state) == pytest.approx(expected[1:])


def test_each_piece_has_its_own_degree() -> None:
    way = spline(
        [0.0, 1.0, 2.0],
        [[0.0], [1.0], [2.0]],
        [[np.nan], [0.0], [0.0]],
        [[np.nan], [np.nan], [0.0]],
    )
    assert way.state(0.25)[0] == pytest.approx([0.25])
    assert way.state(1.25)[0] == pytest.approx([1.0 + 3 * 0.25**2 - 2 * 0.25**3])


@pytest.mark.parametrize("begin", [0.0, 0.99, 1.0, 3.0])
def test_a_single_point_is_gone_to_from_wherever_it_is_joined(begin: float) -> None:
    """Just before it too, where there is no time for a way of its own to it."""
    way = spline([1.0], [[0.2, 0.0]])
    rest = vector([0.0, 0.0])
    joined = JoinedPath(way, begin, (rest, rest, rest), [LIMIT] * 2)
    assert joined.state(0.0)[0] == pytest.approx([0.0, 0.0])
    assert joined.state(joined.duration)[0] == pytest.approx([0.2, 0.0])


def test_before_and_after_it_the_trajectory_rests() -> None:
    way = spline([1.0, 2.0], [[0.5], [1.0]], [[0.3], [0.0]])
    for time, position in ((0.0, 0.5), (2.0, 1.0), (9.0, 1.0)):
        assert np.concatenate(way.state(time)).tolist() == [position, 0.0, 0.0]


numbers = st.floats(-3.0, 3.0)
points = st.lists(
    st.tuples(st.floats(0.05, 2.0), *(st.tuples(numbers, numbers) for _ in range(3))),
    min_size=2,
    max_size=6,
)


@given(points, st.sampled_from(["p", "pv", "pva"]))
def test_it_passes_each_point_as_given_and_its_rates_are_derivatives(
    rows: list[tuple[float, tuple[float, ...], tuple[float, ...], tuple[float, ...]]], given_: str
) -> None:
    times = np.cumsum([row[0] for row in rows]).tolist()
    p, v, a = ([row[1 + which] for row in rows] for which in range(3))
    way = spline(times, p, v if "v" in given_ else None, a if "a" in given_ else None)
    for time, at, rate in list(zip(times, p, v, strict=True))[:-1]:
        position, velocity, acceleration = way.state(time)
        assert position == pytest.approx(at)
        if "v" in given_:
            assert velocity == pytest.approx(rate)
        step = 1e-6
        later = way.state(time + step)
        assert (later[0] - position) / step == pytest.approx(velocity, abs=1e-2)
        assert (later[1] - velocity) / step == pytest.approx(acceleration, abs=2.0)
    lower, upper, fastest = way.extremes()
    for time in np.linspace(times[0], times[-1] - 1e-9, 40):
        position, velocity, _ = way.state(float(time))
        reach = 0.05 * (upper - lower) + 1e-9  # it looks at a few instants of each piece
        assert (position >= lower - reach).all()
        assert (position <= upper + reach).all()
        assert (np.abs(velocity) <= 1.15 * fastest + 1e-9).all()


FIRST = 1.0
"""Time of the first point of the trajectory that is joined, s."""


def joined(begin: float, motion: object, way: Spline | None = None) -> JoinedPath:
    way = way or spline([FIRST, 3.0], [[0.0, 0.0], [1.0, -1.0]], [[0.0, 0.0], [0.0, 0.0]])
    position, velocity, acceleration = (vector(row) for row in motion)  # type: ignore[attr-defined]
    return JoinedPath(way, begin, (position, velocity, acceleration), (LIMIT, LIMIT))


REST = ([0.0, 0.0], [0.0, 0.0], [0.0, 0.0])


def test_before_the_first_point_it_goes_there_from_where_the_joints_are() -> None:
    path = joined(0.0, ([0.2, 0.0], [0.0, 0.0], [0.0, 0.0]))
    assert path.lead is not None
    assert path.state(0.0)[0] == pytest.approx([0.2, 0.0])
    assert path.state(0.5)[0] == pytest.approx([0.1, 0.0])
    assert path.state(1.0)[0] == pytest.approx([0.0, 0.0])
    assert path.duration == 3.0


def test_a_start_in_the_past_is_joined_where_it_is_by_now() -> None:
    path = joined(2.0, ([0.5, -0.5], [0.75, -0.75], [0.0, 0.0]))
    assert path.lead is None
    assert path.duration == pytest.approx(1.0)
    assert path.state(0.0)[0] == pytest.approx([0.5, -0.5])
    assert path.state(1.0)[0].tolist() == [1.0, -1.0]


@example(9.179632522502434e-216, 0.0, 1.0)
@example(0.0, 9.179632522502434e-216, 1.0)
@example(1e-13, 1e-13, 1.0)
@example(0.0, 1.0, 0.9375)
@given(st.floats(-0.05, 0.05), st.floats(-1.0, 1.0), st.floats(0.0, 3.5))
def test_what_is_off_it_comes_onto_it_smoothly_within_the_limits(
    off: float, speed: float, begin: float
) -> None:
    path = joined(begin, ([off, 0.0], [speed, 0.0], [0.0, 0.0]))
    position, velocity, _ = path.state(0.0)
    assert position == pytest.approx([off, 0.0], abs=1e-9)
    assert velocity == pytest.approx([speed, 0.0], abs=1e-9) or path.lead is not None
    end, still, _ = path.state(path.duration)
    assert end == pytest.approx([1.0, -1.0])
    assert still == pytest.approx([0.0, 0.0])
    times = np.linspace(0.0, path.duration, 400)
    step = float(times[1] - times[0])
    for time in times[1:].tolist():
        before, after = path.state(time - step), path.state(time)
        assert (np.abs(after[0] - before[0]) <= step * 6.0 + 1e-9).all(), "a jump"
        # The way to the first point takes the time that there is: `Orders` refuses one that is too fast.
        is_led = path.lead is not None and begin + time - step < FIRST
        assert is_led or (np.abs(after[1] - before[1]) <= step * 60.0 + 1e-6).all(), "a jerk"


def test_from_on_it_nothing_is_added() -> None:
    path = joined(1.0, REST)
    for time in (0.0, 0.5, 1.9):
        assert path.state(time)[0] == pytest.approx(
            [3 * (time / 2) ** 2 - 2 * (time / 2) ** 3, -3 * (time / 2) ** 2 + 2 * (time / 2) ** 3]
        )
