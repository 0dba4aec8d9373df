"""interpolate_*: any stream becomes motion that is continuous, within limits, and late by what is said."""

import math
from collections.abc import Callable, Iterable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from crtk_drivers.commands import Kind
from crtk_drivers.device import CartesianLimits, JointLimits
from crtk_drivers.geometry.frames import moved
from crtk_drivers.geometry.quaternions import (
    quaternion_from_rotvec,
    quaternion_product,
    rotvec_from_quaternion,
)
from crtk_drivers.geometry.rates import turn
from crtk_drivers.samples import Pose, vector
from crtk_drivers.trajectory.interpolators import (
    JointInterpolator,
    PoseInterpolator,
    TwistInterpolator,
    VectorInterpolator,
    WrenchInterpolator,
)
from crtk_drivers.trajectory.smoothing import FIRST_PERIOD, StreamClock
from rigs.examples import examples

CYCLE = 0.002
TIMEOUT = 0.3
SOFT = JointLimits(-1.0, 1.0, velocity=1.0, acceleration=5.0, jerk=50.0, effort=10.0)
HARD = JointLimits(-6.3, 6.3, velocity=3.0, acceleration=40.0, jerk=1000.0, effort=150.0)
TOOL = CartesianLimits(0.5, 1.5, 3.0, 10.0, 50.0, 5.0)
UPRIGHT = vector((0.0, 0.0, 0.0, 1.0))

Stream = list[tuple[float, np.ndarray]]


def stopping_distance(
    velocity: float, acceleration: float, jerk: float, present: float = 0.0
) -> float:
    """Return a bound of the distance in which one axis can be stopped.

    Args:
        velocity: its speed.
        acceleration, jerk: its limits.
        present: its acceleration now, positive if it gets faster.
    """
    ending = max(0.0, present) / jerk
    fastest = velocity + present * ending / 2.0
    return fastest * (ending + (fastest / acceleration + acceleration / jerk) / 2.0)


class Track:
    """What an interpolator made of a stream, one row a cycle."""

    def __init__(self, motion: VectorInterpolator, stream: Stream, duration: float) -> None:
        rows, lags, self.over = [], [], []
        waiting = list(stream)
        for index in range(round(duration / CYCLE)):
            now = index * CYCLE
            while waiting and waiting[0][0] <= now:
                arrival, goal = waiting.pop(0)
                motion.command(goal, arrival)
            value, rate = motion.step(now)
            rows.append((value, rate, motion.acceleration))
            lags.append(motion.lag)
            self.over.append(motion.is_over)
        self.time = np.arange(len(rows)) * CYCLE
        self.value, self.rate, self.acceleration = (
            np.array(part) for part in zip(*rows, strict=True)
        )
        self.lag = np.array(lags)


def assert_smooth(track: Track, limit: JointLimits, seed_rate: float = 0.0) -> None:
    """Position, velocity and acceleration have no jump and keep the limits."""
    for part in (track.value, track.rate, track.acceleration, track.lag):
        assert np.isfinite(part).all()
    assert np.abs(track.rate).max() <= max(limit.velocity, seed_rate) + 1e-6
    assert np.abs(track.acceleration).max() <= limit.acceleration + 1e-6
    assert np.abs(np.diff(track.acceleration, axis=0)).max() <= limit.jerk * CYCLE + 1e-6
    mean = (track.rate[1:] + track.rate[:-1]) / 2.0
    moved = np.diff(track.value, axis=0)
    assert moved == pytest.approx(mean * CYCLE, abs=limit.jerk * CYCLE**3)
    assert track.value.min() >= limit.lower
    assert track.value.max() <= limit.upper


def sampled(
    signal: Callable[[float], np.ndarray], rate: float, end: float, late: Iterable[float] = ()
) -> Stream:
    """Return a signal's goals, each late by a share of the period."""
    times = np.arange(round(end * rate)) / rate
    delays = dict(enumerate(late))
    stream = [(t + delays.get(i, 0.0) / rate, signal(t)) for i, t in enumerate(times)]
    return sorted(stream, key=lambda item: item[0])


def joints(
    limit: JointLimits = SOFT, count: int = 2, kind: Kind = Kind.POSITION
) -> JointInterpolator:
    return JointInterpolator([limit] * count, CYCLE, TIMEOUT, kind)


any_goal = st.tuples(*[st.floats(-1.2, 1.2)] * 2).map(np.array)
any_stream = st.lists(
    st.tuples(st.sampled_from([0.0, 5e-5, 0.003, 0.01, 0.05, 0.06, 0.1, 0.4]), any_goal),
    min_size=1,
    max_size=12,
)


# A distance at which ruckig's answer crawls for minutes.
@example([(0.0, np.array([-1.0, 0.0])), (0.003, np.array([0.0, 0.0]))], SOFT)
@settings(max_examples=examples(40))
@given(any_stream, st.sampled_from([SOFT, HARD]))
def test_any_stream_becomes_smooth_motion_within_the_limits(
    steps: list[tuple[float, np.ndarray]], limit: JointLimits
) -> None:
    arrivals = np.cumsum([step for step, _ in steps])
    stream = [(float(t), goal) for t, (_, goal) in zip(arrivals, steps, strict=True)]
    motion = joints(limit)
    motion.start((0.1, -0.2), 0.0)
    track = Track(motion, stream, float(arrivals[-1]) + TIMEOUT + 3.0)
    assert_smooth(track, limit)
    goal = np.clip(stream[-1][1], limit.lower, limit.upper)
    assert track.value[-1] == pytest.approx(goal, abs=1e-6)
    assert track.rate[-1] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert track.over[-1]
    assert not track.over[0]


@settings(max_examples=examples(25))
@given(
    st.sampled_from([5, 10, 20, 50, 100]),
    st.floats(0.05, 0.9),
    st.lists(st.floats(0.0, 0.4), min_size=20, max_size=20),
    st.sampled_from([SOFT, HARD]),
)
@example(20, 0.5, [0.0] * 20, SOFT)
@example(100, 0.9, [0.0] * 20, HARD)
def test_a_stream_that_stops_is_overshot_by_no_more_than_the_documented_bound(
    rate: int, speed: float, late: list[float], limit: JointLimits
) -> None:
    motion = joints(limit, 1)
    motion.start((-0.95,), 0.0)
    stream = sampled(lambda t: np.array((-0.95 + speed * t,)), rate, 1.0, late)
    track = Track(motion, stream, 4.0)
    goal = stream[-1][1]
    beyond = track.value[:, 0] - goal
    # What it had when the next goal was missing is at most what it had when it came to its last goal.
    last = int(np.argmax(beyond > 0.0)) if (beyond > 0.0).any() else len(beyond) - 1
    had = stopping_distance(
        float(np.abs(track.rate[last:]).max()),
        limit.acceleration,
        limit.jerk,
        float(max(0.0, track.acceleration[last:, 0].max())),
    )
    assert beyond.max() <= had + 1e-9
    if not any(late):
        bound = speed / 2 * (speed / limit.acceleration + limit.acceleration / limit.jerk)
        assert beyond.max() <= bound + 1e-6
    assert track.value[-1] == pytest.approx(goal, abs=1e-7)


@pytest.mark.parametrize("rate", [10, 20, 50, 100])
def test_a_ramp_is_followed_exactly_and_late_by_the_latency_that_is_said(rate: int) -> None:
    motion = joints(HARD, 1)
    motion.start((0.0,), 0.0)
    track = Track(motion, sampled(lambda t: np.array((0.4 * t,)), rate, 2.0), 1.9)
    assert motion.period == pytest.approx(1 / rate)
    assert motion.latency == pytest.approx(1 / rate + CYCLE)
    settled = track.time > 1.0
    late = track.time[settled] - track.value[settled, 0] / 0.4
    assert late == pytest.approx(np.full(late.size, motion.latency), abs=1e-6)
    assert np.abs(track.lag[settled]).max() < 1e-9


def test_jitter_does_not_reach_the_velocity() -> None:
    rng = np.random.default_rng(4)
    motion = joints(HARD, 1)
    motion.start((0.0,), 0.0)
    late = rng.uniform(0.0, 0.4, 200)
    track = Track(motion, sampled(lambda t: np.array((0.4 * t,)), 50, 4.0, late), 3.9)
    settled = track.rate[track.time > 1.0, 0]
    assert settled.mean() == pytest.approx(0.4, rel=0.01)
    assert settled.std() < 0.03, "differences of the goals as they arrive have 0.065"
    assert 0.02 + CYCLE + 0.002 < motion.latency < 0.04, "room for the late ones"


def test_a_sine_is_followed_closely() -> None:
    motion = joints(HARD, 1)
    motion.start((0.0,), 0.0)
    stream = sampled(lambda t: np.array((0.3 * math.sin(math.pi * t),)), 20, 4.0)
    track = Track(motion, stream, 3.9)
    settled = track.time > 1.0
    should = 0.3 * np.sin(math.pi * (track.time[settled] - motion.latency))
    assert np.abs(track.value[settled, 0] - should).max() < 0.002


def test_a_clean_ramp_is_not_disturbed_by_second_copies() -> None:
    once, twice = joints(HARD, 1), joints(HARD, 1)
    stream = sampled(lambda t: np.array((0.4 * t,)), 20, 1.0)
    copies = [(t + delay, goal) for t, goal in stream for delay in (0.0, 0.003)]
    for motion in (once, twice):
        motion.start((0.0,), 0.0)
    assert Track(twice, copies, 0.9).value.tolist() == Track(once, stream, 0.9).value.tolist()


def test_a_stream_faster_than_a_joint_is_followed_at_its_limit_and_the_lag_shows() -> None:
    motion = joints(SOFT, 1)
    motion.start((-1.0,), 0.0)
    track = Track(motion, sampled(lambda t: np.array((-1.0 + 4.0 * t,)), 50, 0.5), 4.0)
    assert_smooth(track, SOFT)
    assert track.rate.max() == pytest.approx(SOFT.velocity, rel=0.05)
    assert track.lag.max() > 0.3
    assert track.value[-1] == pytest.approx([0.92], abs=1e-6)


@pytest.mark.parametrize("rate", [10, 20, 50, 100])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_ramp_to_the_end_of_the_range_stops_there_without_a_jump(rate: int, sign: float) -> None:
    motion = joints(SOFT, 1)
    motion.start((0.0,), 0.0)
    stream = sampled(lambda t: np.array((sign * 0.5 * t,)), rate, 2.0 + 1.0 / rate)
    track = Track(motion, stream, 4.0)
    assert_smooth(track, SOFT)
    assert track.value[-1] == pytest.approx([sign], abs=1e-6)


@pytest.mark.parametrize("start", [0.66, 0.68, 0.70])
@pytest.mark.parametrize("slope", [0.1, 0.2])
def test_catching_up_at_the_end_of_the_range_can_be_stopped(start: float, slope: float) -> None:
    motion = joints(SOFT, 1)
    motion.start((start,), 0.0, (1.0,))
    stream = [(0.0, np.array((0.98 - slope * 0.1,))), (0.1, np.array((0.98,)))]
    assert_smooth(Track(motion, stream, 1.5), SOFT)


def test_a_flood_is_followed() -> None:
    motion = joints(HARD, 1)
    motion.start((0.0,), 0.0)
    stream = sampled(lambda t: np.array((0.4 * t,)), 20_000, 0.5)
    track = Track(motion, stream, 0.49)
    assert_smooth(track, HARD)
    settled = track.time > 0.3
    assert track.value[settled, 0] == pytest.approx(0.4 * track.time[settled], abs=0.4 * 0.006)


@settings(max_examples=examples(25))
@given(st.lists(st.tuples(st.floats(-2.0, 2.0), any_goal), min_size=1, max_size=30), st.booleans())
def test_a_clock_that_goes_back_makes_no_jump(
    moments: list[tuple[float, np.ndarray]], commands: bool
) -> None:
    motion = joints()
    motion.start((0.0, 0.0), 0.0)
    before = np.zeros(2)
    for moment, goal in moments:
        if commands:
            motion.command(goal, moment)
        value, rate = motion.step(moment)
        assert np.isfinite(value).all()
        assert np.isfinite(rate).all()
        assert np.abs(value - before).max() <= SOFT.velocity * 2 * CYCLE + 1e-9
        assert np.isfinite(motion.latency)
        before = value


@settings(max_examples=examples(25))
@given(st.floats(-0.9, 0.9), st.floats(-4.0, 4.0), st.floats(-0.5, 0.5))
def test_it_begins_with_the_motion_that_there_is(
    rate: float, acceleration: float, goal: float
) -> None:
    motion = joints(SOFT, 1)
    motion.start((0.0,), 0.0, (rate,), (acceleration,))
    track = Track(motion, [(0.0, np.array((goal,)))], 4.0)
    assert track.value[0] == pytest.approx([0.0])
    assert track.rate[0] == pytest.approx([rate])
    assert track.acceleration[0] == pytest.approx([acceleration])
    assert np.abs(np.diff(track.rate, axis=0)).max() <= SOFT.acceleration * CYCLE + 1e-6
    assert track.value[-1] == pytest.approx([goal], abs=1e-6)


def test_start_forgets_the_stream_before() -> None:
    motion = joints(SOFT, 1)
    motion.start((0.0,), 0.0)
    Track(motion, sampled(lambda t: np.array((0.4 * t,)), 100, 1.0), 1.0)
    motion.start((0.5,), 1.0)
    assert motion.step(1.0)[0].tolist() == [0.5]
    assert motion.goal.tolist() == [0.5]
    assert motion.period == FIRST_PERIOD
    motion.command(motion.goal + np.array((0.1,)), 1.0)
    assert motion.goal == pytest.approx([0.6])


def test_increments_add_up_from_where_the_stream_began() -> None:
    motion = joints(SOFT, 2)
    motion.start((0.1, 0.2), 0.0)
    for index in range(5):
        motion.command(motion.goal + np.array((0.1, -0.05)), 0.05 * index)
    assert motion.goal == pytest.approx([0.6, -0.05])


def test_a_late_cycle_makes_no_jump() -> None:
    motion = joints(HARD, 1)
    motion.start((0.0,), 0.0)
    for index in range(20):
        motion.command((0.02 * index,), 0.05 * index)
    before, _ = motion.step(1.0)
    after, _ = motion.step(1.5)
    assert abs(after - before)[0] <= HARD.velocity * 2 * CYCLE


@pytest.mark.parametrize(
    "goal", [(math.nan, 0.0), (math.inf, 0.0), (0.0,), (0.0, 0.0, 0.0), ((0, 0),)]
)
def test_what_is_not_a_goal_is_refused_and_changes_nothing(goal: ArrayLike) -> None:
    motion = joints()
    motion.start((0.0, 0.0), 0.0)
    motion.command((0.1, 0.1), 0.0)
    with pytest.raises(ValueError, match="expected"):
        motion.command(goal, 0.01)
    assert motion.goal.tolist() == [0.1, 0.1]


# -------------------------------------------------------------------------------- velocities and efforts


@settings(max_examples=examples(25))
@given(st.lists(st.floats(-1.2, 1.2), min_size=1, max_size=20), st.sampled_from([0.01, 0.05, 0.2]))
def test_velocities_change_within_acceleration_and_jerk_and_end_at_zero(
    goals: list[float], period: float
) -> None:
    motion = joints(SOFT, 1, Kind.VELOCITY)
    motion.start((0.0,), 0.0)
    stream = [(index * period, np.array((goal,))) for index, goal in enumerate(goals)]
    track = Track(motion, stream, len(goals) * period + TIMEOUT + 2.0)
    assert np.abs(track.value).max() <= SOFT.velocity
    assert np.abs(track.rate).max() <= SOFT.acceleration + 1e-6
    assert np.abs(np.diff(track.rate, axis=0)).max() <= SOFT.jerk * CYCLE + 1e-6
    assert track.value[-1] == pytest.approx([0.0], abs=1e-9)
    assert track.over[-1]


@pytest.mark.parametrize("rate", [20, 50, 100, 250])
def test_a_velocity_that_was_said_again_and_again_stops_at_once(rate: int) -> None:
    """A stream above 40 Hz that had said the same for a minute took a minute to stop."""
    motion = joints(SOFT, 1, Kind.VELOCITY)
    motion.start((0.0,), 0.0)
    stream = sampled(lambda t: np.array((0.5 if t < 2.0 else 0.0,)), rate, 3.0)
    track = Track(motion, stream, 3.0)
    ideal = 0.5 / SOFT.acceleration + SOFT.acceleration / SOFT.jerk
    stands = np.flatnonzero(np.abs(track.value[:, 0]) > 1e-3)[-1] * CYCLE
    assert stands - 2.0 <= ideal + 3.0 / rate
    assert track.rate.min() == pytest.approx(-SOFT.acceleration, rel=0.01), "as hard as is allowed"


def test_a_position_that_was_said_again_and_again_is_left_at_once() -> None:
    motion = joints(HARD, 1)
    motion.start((0.0,), 0.0)
    track = Track(motion, sampled(lambda t: np.array((0.0 if t < 2.0 else 0.2,)), 100, 3.0), 2.5)
    assert_smooth(track, HARD)
    assert track.value[-1] == pytest.approx([0.2], abs=1e-3)


def test_a_value_that_something_else_held_back_goes_on_from_there() -> None:
    motion = joints(SOFT, 2, Kind.VELOCITY)
    motion.start((0.0, 0.0), 0.0)
    for index in range(500):
        now = index * CYCLE
        if index % 25 == 0:
            motion.command((0.8, 0.8), now)
        value, _ = motion.step(now)
        motion.held_at(vector((min(value[0], 0.1), value[1])))
    assert motion.step(1.0)[0] == pytest.approx([0.1, 0.8], abs=1e-3)
    motion.command((-0.8, -0.8), 1.0)
    values = np.array([motion.step(1.0 + index * CYCLE)[0] for index in range(1, 145)])
    assert np.abs(np.diff(values, axis=0)).max() <= SOFT.acceleration * CYCLE + 1e-9
    first, other = (np.flatnonzero(column < 0.0)[0] for column in values.T)
    assert first * CYCLE < 0.1 < other * CYCLE


def test_each_kind_fills_its_own_field() -> None:
    for kind, fields in (
        (Kind.POSITION, ("position", "velocity")),
        (Kind.VELOCITY, ("velocity",)),
        (Kind.EFFORT, ("effort",)),
    ):
        motion = joints(SOFT, 2, kind)
        motion.start((0.0, 0.0), 0.0)
        motion.command((0.5, 0.5), 0.0)
        motion.step(0.002)
        state = motion.point(0.1)
        filled = tuple(n for n in ("position", "velocity", "effort") if getattr(state, n).size)
        assert filled == fields


def test_efforts_and_wrenches_reach_their_goal_hold_it_and_go_to_zero() -> None:
    effort = joints(SOFT, 1, Kind.EFFORT)
    effort.start((0.0,), 0.0)
    track = Track(effort, [(0.05 * i, np.array((12.0,))) for i in range(20)], 2.0)
    assert track.value.max() == 10.0, "the limit"
    assert track.value[round(0.9 / CYCLE)] == pytest.approx([10.0])
    assert track.value[-1] == pytest.approx([0.0], abs=1e-9)
    wrench = WrenchInterpolator(TOOL, CYCLE, TIMEOUT)
    wrench.start(np.zeros(6), 0.0)
    wrench.command((10.0, 0, 0, 0, 0, 1.0), 0.0)
    for index in range(100):
        value = wrench.point(index * CYCLE)
    assert value.force.tolist() == pytest.approx([10.0, 0, 0])
    assert value.torque.tolist() == pytest.approx([0, 0, 1.0])


def test_a_twist_keeps_the_accelerations_and_ends_at_zero() -> None:
    motion = TwistInterpolator(TOOL, CYCLE, TIMEOUT)
    motion.start(np.zeros(6), 0.0)
    goal = np.array((0.2, 0.2, 0.2, 0.5, -0.5, 0.5))
    track = Track(motion, [(0.05 * i, goal) for i in range(20)], 2.5)
    assert np.linalg.norm(track.rate[:, :3], axis=1).max() <= TOOL.linear_acceleration + 1e-6
    assert np.linalg.norm(track.rate[:, 3:], axis=1).max() <= TOOL.angular_acceleration + 1e-6
    assert track.value[round(0.9 / CYCLE)] == pytest.approx(goal)
    assert track.value[-1] == pytest.approx(np.zeros(6), abs=1e-9)


# ------------------------------------------------------------------------------------------------- poses


def poses(
    motion: PoseInterpolator, stream: list[tuple[float, Pose]], duration: float
) -> tuple[np.ndarray, ...]:
    waiting, rows = list(stream), []
    for index in range(round(duration / CYCLE)):
        now = index * CYCLE
        while waiting and waiting[0][0] <= now:
            motion.command(waiting[0][1], waiting.pop(0)[0])
        pose, twist = motion.step(now)
        rows.append((pose.position, pose.orientation, twist.vector, motion.acceleration))
    return tuple(np.array(part) for part in zip(*rows, strict=True))


three = st.tuples(*[st.floats(-0.3, 0.3)] * 3)


@settings(max_examples=examples(20))
@given(
    st.lists(st.tuples(three, three), min_size=1, max_size=8),
    st.sampled_from([0.01, 0.05, 0.1]),
    three,
)
def test_any_stream_of_poses_becomes_smooth_motion_within_the_limits(
    goals: list[tuple[tuple[float, ...], tuple[float, ...]]],
    period: float,
    begin: tuple[float, ...],
) -> None:
    stream = [
        (i * period, Pose(vector(place), quaternion_from_rotvec(vector(way))))
        for i, (place, way) in enumerate(goals)
    ]
    motion = PoseInterpolator(TOOL, CYCLE, TIMEOUT)
    motion.start(Pose(vector(begin), UPRIGHT, "base"), 0.0)
    place, facing, twist, acceleration = poses(motion, stream, len(goals) * period + 4.0)
    assert np.linalg.norm(facing, axis=1) == pytest.approx(np.ones(len(facing)), abs=1e-12)
    assert np.linalg.norm(twist[:, :3], axis=1).max() <= TOOL.linear_velocity + 1e-6
    assert np.linalg.norm(twist[:, 3:], axis=1).max() <= TOOL.angular_velocity * 1.1
    mean = (twist[1:] + twist[:-1]) / 2.0 * CYCLE
    assert np.diff(place, axis=0) == pytest.approx(mean[:, :3], abs=2e-6)
    turned = np.array([turn(vector(b), vector(a)) for a, b in pairwise(facing)])
    assert turned == pytest.approx(mean[:, 3:], abs=5e-6), "the twist is the orientation's own"
    steps = np.diff(twist, axis=0) / CYCLE
    assert np.linalg.norm(steps[:, :3], axis=1).max() <= TOOL.linear_acceleration + 1e-6
    assert np.linalg.norm(steps[:, 3:], axis=1).max() <= TOOL.angular_acceleration * 1.3
    jumps = np.abs(np.diff(acceleration, axis=0)).max()
    assert jumps <= 2.0 * TOOL.angular_acceleration / 0.1 * CYCLE, "of acceleration: none"
    assert place[-1] == pytest.approx(goals[-1][0], abs=1e-6)
    rest = turn(vector(facing[-1]), quaternion_from_rotvec(vector(goals[-1][1])))
    assert np.abs(rest).max() < 1e-6


def test_a_diagonal_step_keeps_the_norms() -> None:
    motion = PoseInterpolator(TOOL, CYCLE, TIMEOUT)
    motion.start(Pose(vector((0.0, 0.0, 0.0)), UPRIGHT), 0.0)
    goal = Pose(vector((0.5, 0.5, 0.5)), quaternion_from_rotvec(vector((1.0, 1.0, 1.0))))
    _, _, twist, acceleration = poses(motion, [(0.0, goal)], 3.0)
    for part, limit in (
        (twist[:, :3], TOOL.linear_velocity),
        (twist[:, 3:], TOOL.angular_velocity),
        (acceleration[:, :3], TOOL.linear_acceleration),
        (acceleration[:, 3:], TOOL.angular_acceleration),
    ):
        assert np.linalg.norm(part, axis=1).max() <= limit + 1e-6
    assert np.linalg.norm(twist[:, :3], axis=1).max() > 0.99 * TOOL.linear_velocity


def test_one_goal_is_reached_in_a_straight_line_and_on_a_geodesic() -> None:
    way, axis = np.array((0.3, -0.2, 0.1)), np.array((0.5, 1.0, -0.7))
    start = Pose(vector((0.1, 0.2, 0.3)), quaternion_from_rotvec(vector((0.3, 0.1, 0.0))), "base")
    goal = Pose(
        vector(start.position + way),
        quaternion_product(quaternion_from_rotvec(vector(axis)), start.orientation),
    )
    motion = PoseInterpolator(TOOL, CYCLE, TIMEOUT)
    motion.start(start, 0.0)
    place, facing, _, _ = poses(motion, [(0.0, goal)], 3.0)
    moved = place - start.position
    assert np.cross(moved, way) == pytest.approx(np.zeros(moved.shape), abs=1e-9)
    turned = np.array([turn(vector(q), start.orientation) for q in facing])
    assert np.cross(turned, axis) == pytest.approx(np.zeros(turned.shape), abs=1e-9)
    assert np.linalg.norm(turned, axis=1).max() <= np.linalg.norm(axis) + 1e-9


def test_relative_poses_move_along_base_axes_and_turn_about_them() -> None:
    quarter = quaternion_from_rotvec(vector((0.0, 0.0, math.pi / 2)))
    motion = PoseInterpolator(TOOL, CYCLE, TIMEOUT)
    motion.start(Pose(vector((0.0, 0.0, 0.0)), quarter, "base"), 0.0)
    step = Pose(vector((0.01, 0.0, 0.0)), quaternion_from_rotvec(vector((0.1, 0.0, 0.0))))
    for index in range(3):
        motion.command(moved(motion.goal, step), 0.05 * index)
    assert motion.goal.position == pytest.approx([0.03, 0.0, 0.0])
    should = quaternion_product(quaternion_from_rotvec(vector((0.3, 0.0, 0.0))), quarter)
    assert np.abs(turn(motion.goal.orientation, should)).max() < 1e-12


def test_a_turning_stream_is_followed_past_half_a_turn_and_late_by_the_latency() -> None:
    motion = PoseInterpolator(TOOL, CYCLE, TIMEOUT)
    motion.start(Pose(vector((0.0, 0.0, 0.0)), UPRIGHT), 0.0)
    stream = [
        (i * 0.05, Pose(vector((0.0, 0.0, 0.0)), quaternion_from_rotvec(vector((0, 0, 0.04 * i)))))
        for i in range(120)
    ]
    _, facing, twist, _ = poses(motion, stream, 5.9)
    angle = rotvec_from_quaternion(vector(facing[-1]))[2]
    should = 0.8 * (5.898 - motion.latency)
    assert (angle - should + math.pi) % (2 * math.pi) - math.pi == pytest.approx(0.0, abs=1e-6)
    assert twist[-1] == pytest.approx([0, 0, 0, 0, 0, 0.8], abs=1e-6)


@pytest.mark.parametrize(
    "pose",
    [
        Pose(vector((math.nan, 0, 0)), UPRIGHT),
        Pose(vector((0, 0, 0)), vector((0, 0, 0, 0))),
        Pose(vector((0, 0)), UPRIGHT),
    ],
)
def test_what_is_not_a_pose_is_refused(pose: Pose) -> None:
    motion = PoseInterpolator(TOOL, CYCLE, TIMEOUT)
    motion.start(Pose(vector((0.0, 0.0, 0.0)), UPRIGHT), 0.0)
    with pytest.raises(ValueError, match=r"expected|zero"):
        motion.command(pose, 0.0)


# ---------------------------------------------------------------------------------------- the stream clock


def test_a_lost_goal_does_not_change_the_period_and_a_new_rate_does_within_four() -> None:
    clock = StreamClock(CYCLE)
    arrivals = [0.1 * i for i in range(20) if i != 11]
    times = [clock.tick(arrival) for arrival in arrivals]
    assert clock.period == pytest.approx(0.1)
    assert times == pytest.approx(arrivals)
    for index in range(4):
        clock.tick(1.9 + 0.02 * (index + 1))
    assert clock.period == pytest.approx(0.02)


@given(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=50))
def test_the_clock_is_sound_whatever_it_is_told(steps: list[float]) -> None:
    clock = StreamClock(CYCLE)
    arrival, before = 0.0, -math.inf
    for step in steps:
        arrival += step
        time = clock.tick(arrival)
        assert math.isfinite(time)
        assert step < 0.0 or time > before
        assert CYCLE <= clock.period <= 1.0
        assert 0.0 <= clock.lateness <= clock.period
        before = time


def test_stopping_distance_of_known_motions() -> None:
    # 1 m/s at 5 m/s² with 50 m/s³: 0.3 s, symmetric about half the speed.
    assert stopping_distance(1.0, 5.0, 50.0) == pytest.approx(0.15)
    assert stopping_distance(1.0, 5.0, math.inf) == pytest.approx(0.1)
    assert stopping_distance(0.0, 5.0, 50.0) == 0.0
