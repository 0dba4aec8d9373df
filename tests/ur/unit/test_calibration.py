"""Kinematics of an arm with its own calibration."""

import math

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from crtk_driver_ur.calibration import CalibratedKinematics, Calibration, displacements
from crtk_driver_ur.frames import Transform, compose
from crtk_driver_ur.kinematics import ArmKinematics, InverseKinematicsError
from crtk_driver_ur.models import MODELS, RobotModel
from crtk_drivers.samples import vector
from rigs.examples import examples

TOOL = Transform.from_pose_vector((0.01, -0.02, 0.15, 0.1, -0.2, 0.3))
TWISTS = (math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0)
angles = st.tuples(*[st.floats(-3.0, 3.0)] * 6)


def calibration(model: RobotModel, spread: float = 0.0) -> Calibration:
    """The model's lengths and angles, each off by up to `spread` m or rad, the same each time."""
    off = iter(np.random.default_rng(1).uniform(-spread, spread, 24).tolist())
    a = (0.0, model.a2, model.a3, 0.0, 0.0, 0.0)
    d = (model.d1, 0.0, 0.0, model.d4, model.d5, model.d6)
    columns = [tuple(value + next(off) for value in row) for row in ((0.0,) * 6, a, d, TWISTS)]
    return Calibration(
        checksum=(1,) * 6, theta=columns[0], a=columns[1], d=columns[2], alpha=columns[3]
    )


@pytest.mark.parametrize("name", MODELS)
def test_without_a_difference_it_is_the_model(name):
    model = MODELS[name]
    nominal = ArmKinematics(model, TOOL)
    own = CalibratedKinematics(model, calibration(model), TOOL)
    q = (0.3, -1.2, 1.4, -0.8, 1.1, 0.5)
    np.testing.assert_allclose(own.place(q), nominal.place(q), atol=1e-12)
    np.testing.assert_allclose(own.jacobian(vector(q)), nominal.jacobian(vector(q)), atol=1e-12)
    assert max(displacements(model, calibration(model))) < 1e-12


@given(angles)
@settings(max_examples=examples(60), deadline=None)
def test_jacobian_is_the_derivative(q):
    model = MODELS["ur5e"]
    arm, step = CalibratedKinematics(model, calibration(model, 0.003), TOOL), 1e-6
    jacobian = arm.jacobian(vector(q))
    for i in range(6):
        ahead, behind = list(q), list(q)
        ahead[i] += step
        behind[i] -= step
        moved = np.subtract(arm.place(ahead).position, arm.place(behind).position)
        np.testing.assert_allclose(jacobian[:3, i], moved / (2.0 * step), atol=1e-7)


@given(angles)
@example((0.0, 1.0, 0.15625, 0.0, 2.5, 0.0))  # the nominal arm does not reach it by this branch
@settings(max_examples=examples(150), deadline=None)
def test_inverse_reaches_the_pose_from_nearby(q):
    model = MODELS["ur10e"]
    arm = CalibratedKinematics(model, calibration(model, 0.002), TOOL)
    assume(abs(math.sin(q[4])) > 0.15 and abs(math.sin(q[2])) > 0.15)
    assume(np.linalg.cond(arm.jacobian(vector(q))) < 100.0)
    found = arm.solve(arm.place(q), q)
    np.testing.assert_allclose(found, q, atol=1e-7)


@pytest.mark.parametrize("axis", range(3))
def test_a_half_turn_of_the_tool_is_no_pose_that_is_there_already(axis):
    model = MODELS["ur5e"]
    arm = CalibratedKinematics(model, calibration(model, 0.002), TOOL)
    q = (0.3, -1.2, 1.4, -0.8, 1.1, 0.5)
    turn = [0.0] * 6
    turn[3 + axis] = math.pi
    pose = compose(arm.place(q), Transform.from_pose_vector(turn))
    try:
        found = arm.solve(pose, q)
    except InverseKinematicsError:
        return  # out of reach is an answer, too
    np.testing.assert_allclose(arm.place(found), pose, atol=1e-8)


def test_a_pose_out_of_reach_is_refused():
    model = MODELS["ur5e"]
    arm = CalibratedKinematics(model, calibration(model, 0.002))
    far = Transform.from_pose_vector((2.0, 0.0, 0.3, 0.0, 0.0, 0.0))
    with pytest.raises(InverseKinematicsError):
        arm.solve(far, (0.0,) * 6)


def test_the_difference_is_told_in_metres():
    model = MODELS["ur5e"]
    assert 1e-4 < np.mean(displacements(model, calibration(model, 0.001))) < 5e-3
