"""Point-to-point profiles: limits, blends, straight lines, and what is refused before it begins."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crtk_drivers.device import CartesianLimits, JointLimits, Ratios
from crtk_drivers.errors import KinematicsError, MotionAborted
from crtk_drivers.geometry.quaternions import quaternion_from_rotvec, quaternion_product
from crtk_drivers.geometry.rates import angular_acceleration, angular_velocity, turn
from crtk_drivers.samples import Pose, Vector, vector
from crtk_drivers.trajectory.profiles import JointProfile, LineProfile, check_line
from rigs.examples import examples

LIMIT = JointLimits(-2.0, 2.0, velocity=1.0, acceleration=5.0, jerk=50.0, effort=1.0)
TOOL = CartesianLimits(0.5, 1.0, 2.0, 4.0)
REST = vector((0.0, 0.0))
STEP = 0.005

two = st.tuples(*[st.floats(-2.0, 2.0)] * 2).map(vector)
three = st.tuples(*[st.floats(-0.6, 0.6)] * 3).map(vector)
share = st.floats(0.1, 1.0)


def pose(
    position: tuple[float, ...] | Vector, rotvec: tuple[float, ...] | Vector = (0, 0, 0)
) -> Pose:
    return Pose(vector(position), quaternion_from_rotvec(vector(rotvec)), "base")


@settings(max_examples=examples(40))
@given(two, two, share, share)
def test_a_profile_from_rest_keeps_its_ratios_of_the_limits_and_ends_exactly(
    start: Vector, goal: Vector, velocity: float, acceleration: float
) -> None:
    ratios = Ratios(velocity, acceleration)
    profile = JointProfile(start, REST, REST, goal, (LIMIT, LIMIT), ratios)
    assert profile.at(0.0)[0] == pytest.approx(start, abs=1e-9)
    for time in np.linspace(0.0, profile.duration, 60):
        _, speed, change = profile.state(float(time))
        assert np.abs(speed).max() <= LIMIT.velocity * velocity + 1e-6
        assert np.abs(change).max() <= LIMIT.acceleration * acceleration + 1e-6
    for time in (profile.duration, profile.duration + 10.0):
        position, speed = profile.at(time)
        assert position.tolist() == goal.tolist(), "exactly: it may lie on a limit"
        assert speed.tolist() == [0.0, 0.0]


@settings(max_examples=examples(40))
@given(two, two, two, st.floats(0.0, 1.0))
def test_a_new_goal_while_moving_goes_on_without_a_jump(
    start: Vector, goal: Vector, other: Vector, when: float
) -> None:
    limits = (LIMIT, LIMIT)
    first = JointProfile(start, REST, REST, goal, limits)
    time = when * first.duration
    before = first.state(time)
    second = JointProfile(*before, other, limits)
    for old, new in zip(before, second.state(0.0), strict=True):
        assert new == pytest.approx(old, abs=1e-9)
    assert second.at(second.duration)[0].tolist() == other.tolist()
    for time in np.linspace(0.0, second.duration, 40):
        _, speed, change = second.state(float(time))
        assert np.abs(speed).max() <= LIMIT.velocity + 1e-6
        assert np.abs(change).max() <= LIMIT.acceleration + 1e-6


def test_the_duration_of_a_known_profile() -> None:
    # 1 rad at 1 rad/s, 5 rad/s², 50 rad/s³: one second of cruising, plus v/a + a/j.
    profile = JointProfile(vector((0.0,)), vector((0.0,)), vector((0.0,)), vector((1.0,)), (LIMIT,))
    assert profile.duration == pytest.approx(1.0 + 0.2 + 0.1)
    slow = JointProfile(
        vector((0.0,)), vector((0.0,)), vector((0.0,)), vector((1.0,)), (LIMIT,), Ratios(0.5, 1.0)
    )
    assert slow.duration == pytest.approx(2.0 + 0.1 + 0.1)


def test_distances_at_which_ruckig_gives_up_are_solved() -> None:
    # Exactly 2 a³/j²; see crtk_drivers.trajectory.solver.
    one = vector((0.0,))
    profile = JointProfile(vector((-1.0,)), one, one, vector((-1.1,)), (LIMIT,))
    assert profile.duration == pytest.approx(0.4, rel=1e-5)
    assert profile.at(profile.duration)[0].tolist() == [-1.1]


@pytest.mark.parametrize("ratio", [0.0, -0.1, 1.1, math.nan])
def test_a_ratio_is_above_zero_and_at_most_one(ratio: float) -> None:
    with pytest.raises(ValueError, match="ratio is"):
        Ratios(ratio, ratio)


@pytest.mark.parametrize(
    ("position", "goal"), [((0.0,), (0.0, 0.0)), ((0.0, 0.0), (0.0,)), ((), ())]
)
def test_sizes_that_differ_are_refused(position: tuple[float], goal: tuple[float]) -> None:
    rest = vector(np.zeros(len(position)))
    with pytest.raises(MotionAborted, match="no trajectory from"):
        JointProfile(vector(position), rest, rest, vector(goal), (LIMIT,) * len(goal))


def test_what_is_not_a_number_is_refused() -> None:
    with pytest.raises(MotionAborted, match="no trajectory to"):
        JointProfile(vector((math.nan, 0.0)), REST, REST, REST, (LIMIT, LIMIT))


# -------------------------------------------------------------------------------------------------- lines


@settings(max_examples=examples(30))
@given(three, three, three, three, share, share)
def test_a_line_from_rest_is_straight_turns_on_a_geodesic_and_keeps_the_limits(
    start: Vector,
    goal: Vector,
    facing: Vector,
    turned: Vector,
    velocity: float,
    acceleration: float,
) -> None:
    begin = pose(start, facing)
    end = Pose(goal, quaternion_product(quaternion_from_rotvec(turned), begin.orientation))
    line = LineProfile(begin, end, TOOL, Ratios(velocity, acceleration))
    assert line.at(0.0)[0].position == pytest.approx(start, abs=1e-12)
    for time in np.linspace(0.0, line.duration, 30):
        here, twist, change = line.state(float(time))
        moved, spun = here.position - start, turn(here.orientation, begin.orientation)
        assert np.cross(moved, goal - start) == pytest.approx(np.zeros(3), abs=1e-9)
        assert np.cross(spun, turned) == pytest.approx(np.zeros(3), abs=1e-9)
        if line.length > 1e-3 and line.angle > 1e-3:  # together
            done = np.linalg.norm(spun) / line.angle
            assert np.linalg.norm(moved) / line.length == pytest.approx(done, abs=1e-6)
        assert np.linalg.norm(twist[:3]) <= TOOL.linear_velocity * velocity + 1e-6
        assert np.linalg.norm(twist[3:]) <= TOOL.angular_velocity * velocity + 1e-6
        assert np.linalg.norm(change[:3]) <= TOOL.linear_acceleration * acceleration + 1e-6
        assert np.linalg.norm(change[3:]) <= TOOL.angular_acceleration * acceleration + 1e-6
    here, twist = line.at(line.duration)
    assert here is end
    assert twist.tolist() == [0.0] * 6


@settings(max_examples=examples(30))
@given(three, three, three, st.floats(0.05, 0.95), three, three)
def test_a_new_line_while_moving_goes_on_without_a_jump_and_keeps_the_limits(
    goal: Vector, turned: Vector, other: Vector, when: float, facing: Vector, third: Vector
) -> None:
    first = LineProfile(pose((0.1, 0.2, 0.3)), pose(goal, turned), TOOL)
    here, twist, change = first.state(when * first.duration)
    second = LineProfile(here, pose(other, facing), TOOL, Ratios(), twist, change)
    # And a third one from within the blend of the second.
    here, twist, change = second.state(0.1 * second.duration)
    last = LineProfile(here, pose(third, facing), TOOL, Ratios(), twist, change)
    for line, old in ((second, first.state(when * first.duration)), (last, (here, twist, change))):
        new = line.state(0.0)
        assert new[0].position == pytest.approx(old[0].position, abs=1e-9)
        assert np.abs(turn(new[0].orientation, old[0].orientation)).max() < 1e-9
        assert new[1] == pytest.approx(old[1], abs=1e-9)
        assert new[2] == pytest.approx(old[2], abs=1e-6)
        times = np.arange(0.0, line.duration + 2 * STEP, STEP)
        states = [line.state(float(time)) for time in times]
        twists, changes = (np.array([s[i] for s in states]) for i in (1, 2))
        places = np.array([s[0].position for s in states])
        faces = [s[0].orientation for s in states]
        spins = np.array([turn(b, a) for a, b in pairwise(faces)])
        mean = (twists[1:] + twists[:-1]) / 2.0 * STEP
        assert np.diff(places, axis=0) == pytest.approx(mean[:, :3], abs=3e-6)
        assert spins == pytest.approx(mean[:, 3:], abs=1e-5), "the twist is the orientation's own"
        grown = (changes[1:] + changes[:-1]) / 2.0 * STEP
        assert np.diff(twists, axis=0) == pytest.approx(grown, abs=2e-3)
        assert np.linalg.norm(twists[:, :3], axis=1).max() <= TOOL.linear_velocity * 1.01
        assert np.linalg.norm(twists[:, 3:], axis=1).max() <= TOOL.angular_velocity * 1.01
        assert np.linalg.norm(changes[:, :3], axis=1).max() <= TOOL.linear_acceleration * 1.02
        assert np.linalg.norm(changes[:, 3:], axis=1).max() <= TOOL.angular_acceleration * 1.1


def test_the_angular_acceleration_of_a_blend_is_the_derivative() -> None:
    twist = vector((0.0, 0.0, 0.0, 0.9, 0.0, 0.0))
    line = LineProfile(pose((0, 0, 0)), pose((0, 0, 0), (0.0, 1.5, 0.0)), TOOL, Ratios(), twist)
    for time in np.arange(0.05, line.duration - 0.01, 0.01):
        (_, before), (_, after) = (line.at(float(time) + dt) for dt in (-1e-5, 1e-5))
        change = line.state(float(time))[2]
        assert change == pytest.approx((after - before) / 2e-5, abs=2e-3)


def test_a_line_to_where_it_is_takes_no_time() -> None:
    line = LineProfile(pose((0.1, 0, 0)), pose((0.1, 0, 0)), TOOL)
    assert line.duration == 0.0
    assert line.at(0.0)[0].position.tolist() == [0.1, 0.0, 0.0]
    assert line.fraction(0.0) == 1.0


def test_a_pure_turn_takes_the_time_of_the_angle() -> None:
    line = LineProfile(pose((0, 0, 0)), pose((0, 0, 0), (0, 0, 1.0)), TOOL)
    # 1 rad at 1 rad/s, 4 rad/s², reached in 0.1 s.
    assert line.duration == pytest.approx(1.0 + 0.25 + 0.1)


# ---------------------------------------------------------------------------------- lines and joint limits

SHORT = JointLimits(-3.0, 3.0, velocity=2.0, acceleration=10.0, jerk=100.0, effort=1.0)

WHIRL = JointLimits(-3.0, 3.0, velocity=50.0, acceleration=10.0, jerk=100.0, effort=1.0)


def elbow(goal: Pose, reference: Vector) -> Vector:
    """Inverse kinematics of two links of 0.5 m in a plane, elbow up."""
    x, y, _ = goal.position.tolist()
    cosine = (x * x + y * y - 0.5) / 0.5
    if cosine > 1.0:
        raise KinematicsError(f"({x:.3f}, {y:.3f}) is out of reach", remedy="Come nearer.")
    bend = math.acos(cosine)
    first = math.atan2(y, x) - math.atan2(0.5 * math.sin(bend), 0.5 + 0.5 * math.cos(bend))
    nearest = first + 2 * math.pi * round((reference[0] - first) / (2 * math.pi))
    return vector((nearest, bend))


def checked(start: Pose, goal: Pose, ratio: float = 0.5, limit: JointLimits = SHORT) -> Vector:
    line = LineProfile(start, goal, TOOL, Ratios(ratio, ratio))
    begin = elbow(start, vector((0.0, 0.0)))
    return check_line(line, elbow, begin, ("shoulder", "elbow"), (limit, limit))


def test_a_line_within_reach_is_accepted_with_the_joints_at_its_end() -> None:
    goal = pose((0.5, 0.4, 0.0))
    assert checked(pose((0.5, -0.4, 0.0)), goal) == pytest.approx(elbow(goal, vector((0.0, 0.0))))


def test_a_line_out_of_reach_says_how_far_it_comes() -> None:
    with pytest.raises(KinematicsError, match=r"breaks off after 8\d %: .* is out of reach") as e:
        checked(pose((0.2, 0.0, 0.0)), pose((1.2, 0.0, 0.0)), limit=WHIRL)
    assert e.value.remedy == "Come nearer."


def test_a_line_past_the_base_makes_a_joint_too_fast_unless_it_is_slow() -> None:
    start, goal = pose((0.5, 0.1, 0.0)), pose((-0.5, 0.1, 0.0))
    with pytest.raises(KinematicsError, match=r"after 4\d %: (shoulder|elbow) would need .* ratio"):
        checked(start, goal)
    assert checked(start, goal, 0.15) == pytest.approx(elbow(goal, vector((2.0, 2.0))))


def test_a_tool_as_fast_as_its_joints_gets_up_to_its_speed() -> None:
    """What the speed would grow to, if it grew on, is above the limit where the tool has got up to it."""
    tool = CartesianLimits(1.0, 2.0, 5.0, 10.0)
    gantry = JointLimits(-1.0, 1.0, velocity=1.0, acceleration=20.0, jerk=200.0, effort=1.0)

    def inverse(goal: Pose, near: Vector) -> Vector:
        return vector(goal.position)

    names, limits = ("x", "y", "z"), (gantry,) * 3
    for far in (0.5, 0.8, 0.99):
        line = LineProfile(pose((0.0, 0.0, 0.0)), pose((far, 0.0, 0.0)), tool, Ratios(1.0, 1.0))
        end = check_line(line, inverse, vector(np.zeros(3)), names, limits)
        assert end.tolist() == [far, 0.0, 0.0]
        slow = (replace(gantry, velocity=0.99), gantry, gantry)
        with pytest.raises(KinematicsError, match=r"x would need .* more than its 0\.990"):
            check_line(line, inverse, vector(np.zeros(3)), names, slow)


def test_a_line_that_takes_minutes_is_judged_as_soon_as_one_of_seconds() -> None:
    """What comes next from the same thread, as a stop, waits for that."""
    asked = 0

    def inverse(goal: Pose, near: Vector) -> Vector:
        nonlocal asked
        asked += 1
        return elbow(goal, near)

    start, goal = pose((0.5, -0.4, 0.0)), pose((0.5, 0.4, 0.0))
    line = LineProfile(start, goal, TOOL, Ratios(0.001, 0.001))
    assert line.duration > 100.0
    begin = elbow(start, vector((0.0, 0.0)))
    check_line(line, inverse, begin, ("shoulder", "elbow"), (SHORT, SHORT))
    assert asked <= 300


def test_a_line_beyond_a_joint_limit_is_refused() -> None:
    narrow = JointLimits(-3.0, 2.0, velocity=2.0, acceleration=10.0, jerk=100.0, effort=1.0)
    with pytest.raises(KinematicsError, match="elbow would be at"):
        checked(pose((0.9, 0.0, 0.0)), pose((0.2, 0.0, 0.0)), limit=narrow)


# ---------------------------------------------------------------------------------------------- rotations


@settings(max_examples=examples(60))
@given(
    st.tuples(*[st.floats(-2.0, 2.0)] * 3).map(vector),
    three,
    three,
    st.sampled_from([1.0, 1e-2, 4e-3, 1e-6, 0.0]),
)
def test_angular_velocity_and_acceleration_are_the_derivatives(
    rotvec: Vector, rate: Vector, change: Vector, size: float
) -> None:
    centre, dt = vector(rotvec * size), 1e-4

    def at(time: float) -> tuple[Vector, Vector]:
        away = vector(centre + rate * time + change * time**2 / 2)
        return quaternion_from_rotvec(away), angular_velocity(away, vector(rate + change * time))

    (before, slower), (after, faster) = at(-dt), at(dt)
    assert angular_velocity(centre, rate) == pytest.approx(turn(after, before) / (2 * dt), abs=1e-6)
    should = (faster - slower) / (2 * dt)
    assert angular_acceleration(centre, rate, change) == pytest.approx(should, abs=1e-6)
