"""Kinematics of the UR arms: against an independent chain of DH matrices, and round trips."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_ur.frames import IDENTITY, Transform, compose, inverse
from crtk_driver_ur.kinematics import ArmKinematics, IkFailure, InverseKinematicsError
from crtk_driver_ur.models import MODELS, model_named
from crtk_drivers.errors import KinematicsError
from crtk_drivers.samples import vector

ACCURACY = 1e-9
TOOL = Transform.from_pose_vector((0.01, -0.02, 0.15, 0.3, -0.2, 0.5))
UR5E = MODELS["ur5e"]

models = st.sampled_from(sorted(MODELS)).map(MODELS.__getitem__)
tools = st.sampled_from([IDENTITY, TOOL])
angles = st.lists(st.floats(-2 * math.pi, 2 * math.pi), min_size=6, max_size=6)
rotation_vectors = st.tuples(*[st.floats(-3.0, 3.0)] * 3).filter(lambda r: math.hypot(*r) < 3.1)


def difference(a: Transform, b: Transform) -> float:
    return max(abs(x - y) for x, y in zip(a, b, strict=True))


def matrix(t: Transform) -> np.ndarray:
    return np.array([[*t[0:3], t.x], [*t[3:6], t.y], [*t[6:9], t.z], [0, 0, 0, 1]])


def dh_chain(model, q):
    """Textbook product of Denavit-Hartenberg matrices, as the manufacturer publishes it."""
    d = (model.d1, 0, 0, model.d4, model.d5, model.d6)
    a = (0, model.a2, model.a3, 0, 0, 0)
    alpha = (math.pi / 2, 0, 0, math.pi / 2, -math.pi / 2, 0)
    result = np.eye(4)
    for i in range(6):
        c, s, ca, sa = math.cos(q[i]), math.sin(q[i]), math.cos(alpha[i]), math.sin(alpha[i])
        result = result @ np.array(
            [
                [c, -s * ca, s * sa, a[i] * c],
                [s, c * ca, -c * sa, a[i] * s],
                [0, sa, ca, d[i]],
                [0, 0, 0, 1],
            ]
        )
    return result


def regular(q) -> bool:
    """Neither wrist nor elbow nearly (but not exactly) singular, so that q can be found again."""
    return abs(math.sin(q[4])) > 1e-3 and abs(math.sin(q[2])) > 1e-3


@given(models, angles)
def test_forward_equals_the_dh_chain(model, q):
    found = matrix(ArmKinematics(model).place(q))
    assert np.abs(found - dh_chain(model, q)).max() < 1e-12


def test_forward_known_answer():
    # The zero position follows from the DH table by hand: arm stretched along -x, flange to -y.
    pose = ArmKinematics(UR5E).place((0.0,) * 6)
    assert pose.position == pytest.approx((-0.425 - 0.3922, -0.1333 - 0.0996, 0.1625 - 0.0997))
    assert pose[:9] == pytest.approx((1, 0, 0, 0, 0, -1, 0, 1, 0))


def test_tool_is_applied_in_flange_axes():
    pose = ArmKinematics(UR5E, Transform.from_pose_vector((0, 0, 0.1, 0, 0, 0))).place((0.0,) * 6)
    assert pose.y == pytest.approx(-0.1333 - 0.0996 - 0.1)


@given(models, tools, angles)
def test_every_inverse_solution_reaches_the_pose(model, tool, q):
    arm = ArmKinematics(model, tool)
    pose = arm.place(q)
    for solution in arm.inverse_all(pose, wrist_3=q[5]):
        assert difference(arm.place(solution), pose) < ACCURACY


@given(models, tools, angles)
def test_inverse_is_nearest_to_its_reference(model, tool, q):
    arm = ArmKinematics(model, tool)
    pose = arm.place(q)
    try:
        found = arm.solve(pose, q)
    except KinematicsError:
        assert not regular(q)
        return
    assert difference(arm.place(found), pose) < ACCURACY
    if regular(q):
        assert math.dist(found, q) < 1e-6


def test_regular_pose_has_eight_different_solutions():
    arm = ArmKinematics(UR5E, TOOL)
    solutions = arm.inverse_all(arm.place((0.1, -1.2, 1.3, -0.7, 0.9, 0.4)))
    assert len({tuple(round(angle, 6) for angle in s) for s in solutions}) == 8


@pytest.mark.parametrize("wrist", [0.0, math.pi, -math.pi])
@pytest.mark.parametrize("name", sorted(MODELS))
def test_wrist_singularity_keeps_joint_6_of_the_reference(name, wrist):
    arm = ArmKinematics(MODELS[name])
    q = (0.3, -1.1, 0.9, -0.6, wrist, 1.234)
    found = arm.solve(arm.place(q), q)
    assert found[5] == pytest.approx(1.234, abs=1e-12)
    assert found == pytest.approx(q, abs=1e-9)


@pytest.mark.parametrize("name", sorted(MODELS))
def test_upright_pose_is_found_although_doubly_singular(name):
    arm = ArmKinematics(MODELS[name])
    q = (0.0, -math.pi / 2, 0.0, -math.pi / 2, 0.0, 0.0)
    assert difference(arm.place(arm.solve(arm.place(q), q)), arm.place(q)) < ACCURACY


def test_path_through_the_wrist_singularity_does_not_jump():
    arm = ArmKinematics(UR5E)
    q = (0.3, -1.1, 0.9, -0.6, 0.05, 1.0)
    for step in range(101):
        target = (0.3, -1.1, 0.9, -0.6, 0.05 - 0.001 * step, 1.0)
        found = arm.solve(arm.place(target), q)
        assert max(abs(a - b) for a, b in zip(found, q, strict=True)) < 0.01
        q = found


def test_inverse_takes_the_turn_of_the_reference():
    arm = ArmKinematics(UR5E)
    q = (0.4, -1.2, 1.1, -0.8, 1.0, 0.5)
    reference = (0.4 - 2 * math.pi, -1.2, 1.1, -0.8, 1.0, 0.5 - 2 * math.pi)
    found = arm.solve(arm.place(q), reference)
    assert found[0] == pytest.approx(0.4 - 2 * math.pi)
    assert found[5] == pytest.approx(0.5 - 2 * math.pi)


@given(angles, st.lists(st.floats(-7.0, 7.0), min_size=6, max_size=6))
def test_inverse_stays_within_the_limits(q, reference):
    arm = ArmKinematics(UR5E)
    limits = UR5E.position_limits
    try:
        found = arm.solve(arm.place(q), reference)
    except KinematicsError:
        return
    assert all(a <= x <= b for a, x, b in zip(limits.lower, found, limits.upper, strict=True))


@pytest.mark.parametrize("limit", [-2 * math.pi, 2 * math.pi])
@pytest.mark.parametrize("joint", [0, 1, 3, 5])
def test_joint_on_its_limit_is_found(joint, limit):
    arm = ArmKinematics(MODELS["ur10e"])
    q = [0.3, -1.2, 1.1, -0.8, 1.0, 0.5]
    q[joint] = limit
    assert arm.solve(arm.place(q), q) == pytest.approx(q, abs=1e-9)


def test_endless_wrist_follows_any_turn():
    arm = ArmKinematics(MODELS["ur3e"])
    q = (0.4, -1.2, 1.1, -0.8, 1.0, 50.0)
    assert arm.solve(arm.place(q), q)[5] == pytest.approx(50.0)


@pytest.mark.parametrize(
    ("position", "reason"),
    [
        ((2.0, 0.0, 0.3), IkFailure.OUT_OF_REACH),
        ((0.0, 0.05, 0.5), IkFailure.TOO_CLOSE_TO_BASE),
    ],
)
def test_impossible_pose_is_refused_with_reason_and_remedy(position, reason):
    pose = Transform.from_pose_vector((*position, 0.0, 0.0, 0.0))
    with pytest.raises(InverseKinematicsError) as caught:
        ArmKinematics(UR5E).solve(pose, (0.0,) * 6)
    assert caught.value.reason is reason
    assert caught.value.remedy
    assert "ur5e" in str(caught.value)


@given(models, tools, angles)
def test_jacobian_is_the_derivative_of_forward(model, tool, q):
    arm, h = ArmKinematics(model, tool), 1e-6
    jacobian = arm.jacobian(vector(q))
    for joint in range(6):
        plus, minus = list(q), list(q)
        plus[joint] += h
        minus[joint] -= h
        a, b = matrix(arm.place(plus)), matrix(arm.place(minus))
        turn = a[:3, :3] @ b[:3, :3].T
        axis = [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
        column = np.array([*(a[:3, 3] - b[:3, 3]), *(0.5 * x for x in axis)]) / (2 * h)
        assert np.abs(column - jacobian[:, joint]).max() < 1e-7


@given(rotation_vectors)
def test_pose_vector_and_quaternion_round_trip(rotation):
    pose = Transform.from_pose_vector((0.1, -0.2, 0.3, *rotation))
    assert pose.pose_vector() == pytest.approx((0.1, -0.2, 0.3, *rotation), abs=1e-9)
    again = Transform.from_quaternion(pose.position, pose.quaternion())
    assert difference(pose, again) < 1e-12
    assert difference(compose(pose, inverse(pose)), IDENTITY) < 1e-12


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, 0.8, 0), (0, -0.6, 0.8)])
@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-6, math.pi - 1e-9, math.pi])
def test_rotation_vector_at_its_ends(axis, angle):
    pose = Transform.from_pose_vector((0, 0, 0, *(angle * x for x in axis)))
    assert difference(pose, Transform.from_pose_vector(pose.pose_vector())) < 1e-12
    assert math.hypot(*pose.pose_vector()[3:]) == pytest.approx(angle, abs=1e-12)


def test_zero_quaternion_is_refused():
    with pytest.raises(ValueError, match="length zero"):
        Transform.from_quaternion((0, 0, 0), (0, 0, 0, 0))


def test_models_are_complete():
    assert set(MODELS) == {
        *("ur3", "ur5", "ur10"),
        *("ur3e", "ur5e", "ur10e", "ur16e", "ur20", "ur30"),
    }
    assert {name for name, model in MODELS.items() if model.frequency == 125.0} == {
        "ur3",
        "ur5",
        "ur10",
    }
    assert model_named("UR5e") is UR5E
    with pytest.raises(ValueError, match=r"choose one of .*ur10e"):
        model_named("ur6")
