"""Cartesian streams on joints: inverse, damping, limits together."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from crtk_drivers.device import CartesianLimits, JointLimits
from crtk_drivers.gates.resolved_rate import Damping, ResolvedRate
from crtk_drivers.geometry.quaternions import quaternion_from_rotvec, quaternion_product
from crtk_drivers.geometry.rates import turn
from crtk_drivers.samples import Array, Pose, Vector, vector
from rigs.examples import examples

CYCLE = 0.002
LIMIT = JointLimits(-2.0, 2.0, velocity=1.5, acceleration=10.0, jerk=100.0, effort=1.0)
WIDE = JointLimits(-1e6, 1e6, velocity=1e6, acceleration=1e9, jerk=1e9, effort=1.0)
T = 0.05

numbers = st.floats(-1.0, 1.0)
three = arrays(float, 3, elements=numbers).map(vector)
six = arrays(float, 6, elements=numbers).map(vector)
matrices = arrays(float, (6, 6), elements=numbers)
rotations = st.tuples(*[st.floats(-2.0, 2.0)] * 3).map(lambda r: quaternion_from_rotvec(vector(r)))


def poses() -> st.SearchStrategy[Pose]:
    return st.builds(Pose, three, rotations)


def diagonal(*values: float) -> Array:
    return np.diag(np.array(values, dtype=float))


def rates(limit: JointLimits = WIDE, count: int = 6) -> ResolvedRate:
    return ResolvedRate([limit] * count, None, CYCLE, Damping(T))


# ------------------------------------------------------------------------------------- inverse and damping


@given(matrices, six)
def test_far_from_singularities_the_twist_is_met_exactly(matrix: Array, twist: Vector) -> None:
    jacobian = matrix + 8.0 * np.eye(6)
    rate = rates().follow_twist(vector(np.zeros(6)), jacobian, twist)
    assert jacobian @ rate.velocity == pytest.approx(twist, abs=1e-9)
    assert not rate.is_damped
    assert rate.scale == 1.0


@given(matrices, six)
def test_seven_joints_meet_the_twist_with_the_least_velocity(matrix: Array, twist: Vector) -> None:
    jacobian = np.hstack((matrix + 8.0 * np.eye(6), np.ones((6, 1))))
    rate = rates(count=7).follow_twist(vector(np.zeros(7)), jacobian, twist)
    assert rate.velocity == pytest.approx(np.linalg.pinv(jacobian) @ twist, abs=1e-9)


def test_fewer_joints_do_what_they_can() -> None:
    jacobian = np.eye(6)[:, :4]
    twist = vector((0.1, 0.2, 0.3, 0.4, 0.5, 0.6))
    rate = rates(count=4).follow_twist(vector(np.zeros(4)), jacobian, twist)
    assert rate.velocity == pytest.approx([0.1, 0.2, 0.3, 0.4])


def test_only_the_singular_direction_is_damped() -> None:
    rate = rates().follow_twist(
        vector(np.zeros(6)), diagonal(1, 1, 0.01, 0.5, 1, 1), vector((0.1,) * 6)
    )
    assert rate.is_damped
    d_squared = (T / 2) ** 2 * (1 - (0.01 / T) ** 2)
    known = 0.1 * 0.01 / (0.01**2 + d_squared)
    assert rate.velocity == pytest.approx([0.1, 0.1, known, 0.2, 0.1, 0.1])


def test_at_the_singularity_its_direction_is_given_up() -> None:
    rate = rates().follow_twist(vector(np.zeros(6)), diagonal(1, 1, 0, 1, 1, 1), vector((0.1,) * 6))
    assert rate.velocity == pytest.approx([0.1, 0.1, 0.0, 0.1, 0.1, 0.1])


def test_damping_has_no_jump_and_a_bound() -> None:
    values = np.linspace(0.0, 2 * T, 20_001)
    gains = Damping(T).gains(values)
    assert gains.max() <= 1.16 / T
    assert gains.max() > 1.0 / T
    assert np.abs(np.diff(gains)).max() < 0.001 / T
    assert gains[values >= T] == pytest.approx(1.0 / values[values >= T])


@pytest.mark.parametrize("threshold", [0.0, -1.0, math.nan, math.inf])
def test_a_threshold_is_above_zero(threshold: float) -> None:
    with pytest.raises(ValueError, match="threshold"):
        Damping(threshold)


@pytest.mark.parametrize(
    ("jacobian", "twist"),
    [
        (np.eye(6), (0.0,) * 5),
        (np.eye(5), (0.0,) * 6),
        (np.eye(6), (math.nan,) + (0.0,) * 5),
        (np.full((6, 6), math.inf), (0.0,) * 6),
    ],
)
def test_what_cannot_be_inverted_is_refused(jacobian: Array, twist: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="Jacobian"):
        rates().follow_twist(vector(np.zeros(6)), jacobian, vector(twist))


# -------------------------------------------------------------------------------------------------- limits


@given(six.map(lambda v: vector(v * 20.0)))
def test_too_fast_is_scaled_as_a_whole(twist: Vector) -> None:
    rate = rates(LIMIT).follow_twist(vector(np.zeros(6)), np.eye(6), twist)
    assert np.abs(rate.velocity).max() <= LIMIT.velocity + 1e-12
    assert rate.velocity == pytest.approx(twist * rate.scale, abs=1e-9)
    if np.abs(twist).max() > LIMIT.velocity:
        assert np.abs(rate.velocity).max() == pytest.approx(LIMIT.velocity), (
            "no slower than it must"
        )


def test_a_twist_beyond_the_tools_limits_is_scaled_as_a_whole() -> None:
    tool = CartesianLimits(0.5, 1.0, 1.0, 1.0)
    resolver = ResolvedRate([WIDE] * 6, tool, CYCLE)
    rate = resolver.follow_twist(
        vector(np.zeros(6)), np.eye(6), vector((3.0, 4.0, 0.0, 0.0, 1.0, 0.0))
    )
    assert rate.velocity == pytest.approx([0.3, 0.4, 0.0, 0.0, 0.1, 0.0])


def test_a_joint_at_its_limit_stops_all_outwards_and_frees_all_inwards() -> None:
    joints = vector((2.0, 0.0, 0.0, 0.0, 0.0, -2.0))
    outwards = vector((0.1, 0.5, 0.0, 0.0, 0.0, 0.1))
    inwards = vector((-0.1, 0.5, 0.0, 0.0, 0.0, 0.1))
    resolver = rates(LIMIT)
    assert resolver.follow_twist(joints, np.eye(6), outwards).velocity.tolist() == [0.0] * 6
    assert resolver.follow_twist(joints, np.eye(6), inwards).velocity == pytest.approx(inwards)


@settings(max_examples=examples(40))
@given(
    st.lists(six.map(lambda v: vector(v * 3.0)), min_size=1, max_size=6),
    arrays(float, 6, elements=st.floats(-1.95, 1.95)),
    st.booleans(),
)
def test_joints_never_pass_their_limits_nor_their_velocity(
    twists: list[Vector], start: Array, slews: bool
) -> None:
    resolver = rates(LIMIT)
    joints, before = start, np.zeros(6)
    for twist in twists:
        for _ in range(150):
            rate = resolver.follow_twist(
                vector(joints), np.eye(6), twist, vector(before) if slews else None
            )
            if slews and (np.abs(joints) < 1.8).all():
                change = np.abs(rate.velocity - before).max()
                assert change <= LIMIT.acceleration * CYCLE + 1e-9
            before = rate.velocity
            joints = joints + before * CYCLE
            assert np.abs(joints).max() <= 2.0 + 1e-12
            assert np.abs(before).max() <= LIMIT.velocity + 1e-12


def test_towards_a_limit_the_braking_keeps_the_acceleration() -> None:
    resolver = rates(LIMIT, 6)
    joints, before, changes = np.zeros(6), np.zeros(6), []
    twist = vector((1.5, 0.0, 0.0, 0.0, 0.0, 0.0))
    for _ in range(2000):
        rate = resolver.follow_twist(vector(joints), np.eye(6), twist, vector(before))
        changes.append(float(np.abs(rate.velocity - before).max()))
        before = rate.velocity
        joints = joints + before * CYCLE
    assert joints[0] == pytest.approx(2.0, abs=1e-4)
    assert max(changes) <= LIMIT.acceleration * CYCLE + 1e-9


# ---------------------------------------------------------------------------------------------------- poses


@given(poses(), poses())
def test_a_pose_is_approached_by_the_twist_that_leads_there(here: Pose, goal: Pose) -> None:
    rate = rates().follow_pose(vector(np.zeros(6)), here, np.eye(6), goal, 0.5)
    assert here.position + rate.velocity[:3] * 0.5 == pytest.approx(goal.position, abs=1e-9)
    spun = quaternion_from_rotvec(vector(rate.velocity[3:] * 0.5))
    reached = quaternion_product(spun, here.orientation)
    assert np.abs(turn(reached, goal.orientation)).max() < 1e-7


@pytest.mark.parametrize("outward", [1e-17, 1e-9])
def test_a_joint_at_the_end_of_its_range_stops_no_motion_that_needs_it_only_by_rounding(
    outward: float,
) -> None:
    jacobian = np.linalg.inv(np.eye(6) + outward * np.eye(6)[:, [1, 0, 2, 3, 4, 5]])
    at = vector((LIMIT.upper, 0.0, 0.0, 0.0, 0.0, 0.0))
    rate = rates(LIMIT).follow_twist(at, jacobian, vector((0.0, 0.5, 0.0, 0.0, 0.0, 0.0)))
    assert rate.velocity[0] == 0.0
    assert rate.velocity[1] == pytest.approx(0.5)
    rate = rates(LIMIT).follow_twist(at, jacobian, vector((1e-3, 0.5, 0.0, 0.0, 0.0, 0.0)))
    assert rate.velocity.tolist() == [0.0] * 6, "it would leave the way"
