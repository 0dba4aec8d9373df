"""Dynamics of the simulated UR against pinocchio, and motion by torque."""

from __future__ import annotations

from math import cos, sin
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crtk_sim_backends.ur.messages import RuntimeExceptionMessage, TextMessage
from crtk_sim_backends.ur.models import ALPHA, MODELS, RobotModel
from crtk_sim_backends.ur.motion.dynamics import Dynamics, solve
from crtk_sim_backends.ur.motion.kinematics import IDENTITY, Kinematics, to_transform
from crtk_sim_backends.ur.safety.modes import SafetyMode
from rigs.ur_controller import Bench

pin = pytest.importorskip("pinocchio")

angles = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6)
PAYLOAD = 2.0
COG = (0.02, -0.01, 0.08)
INERTIA = (0.02, 0.03, 0.04, 0.001, -0.002, 0.003)  # Ixx Iyy Izz Ixy Ixz Iyz


def reference(model: RobotModel) -> Any:
    """A pinocchio model from the same DH table and masses."""
    arm = pin.Model()
    placement = pin.SE3.Identity()
    kinematics = Kinematics(model)
    for i in range(6):
        joint = arm.addJoint(i, pin.JointModelRZ(), placement, f"joint{i}")
        c, s = cos(ALPHA[i]), sin(ALPHA[i])
        rotation = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        link = pin.SE3(rotation, np.array([model.a[i], 0.0, model.d[i]]))
        inertia = pin.Inertia(model.mass[i], np.array(model.cog[i]), np.zeros((3, 3)))
        arm.appendBodyToJoint(joint, inertia, link)
        placement = link
    xx, yy, zz, xy, xz, yz = INERTIA
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    arm.appendBodyToJoint(6, pin.Inertia(PAYLOAD, np.array(COG), tensor), placement)
    arm.addFrame(pin.Frame("flange", 6, placement, pin.FrameType.OP_FRAME))
    arm.armature = np.array([0.01 * limit for limit in model.torque])
    assert kinematics.model is model
    return arm


ARMS = {name: (reference(model), Kinematics(model)) for name, model in MODELS.items()}


@pytest.mark.parametrize("name", MODELS)
@settings(max_examples=10, deadline=None)
@given(q=angles)
def test_mass_matrix(name: str, q: list[float]) -> None:
    arm, kinematics = ARMS[name]
    ours = Dynamics(kinematics).mass_matrix(q, PAYLOAD, COG, INERTIA)
    theirs = pin.crba(arm, arm.createData(), np.array(q))
    theirs = np.triu(theirs) + np.triu(theirs, 1).T
    np.testing.assert_allclose(ours, theirs, atol=1e-9)


@pytest.mark.sweep(3)
@pytest.mark.parametrize("name", MODELS)
@settings(max_examples=10, deadline=None)
@given(q=angles, qd=angles)
def test_coriolis_and_centrifugal_torques(name: str, q: list[float], qd: list[float]) -> None:
    arm, kinematics = ARMS[name]
    ours = Dynamics(kinematics).coriolis(q, qd, PAYLOAD, COG, INERTIA)
    data = arm.createData()
    full = pin.rnea(arm, data, np.array(q), np.array(qd), np.zeros(6))
    gravity = pin.computeGeneralizedGravity(arm, data, np.array(q))
    np.testing.assert_allclose(ours, full - gravity, atol=1e-8)


@pytest.mark.parametrize("name", MODELS)
@settings(max_examples=10, deadline=None)
@given(q=angles)
def test_gravity_torques(name: str, q: list[float]) -> None:
    arm, kinematics = ARMS[name]
    ours = Dynamics(kinematics).torques(q, (0.0,) * 6, PAYLOAD, COG, (0.0, 0.0, 9.81))
    theirs = pin.computeGeneralizedGravity(arm, arm.createData(), np.array(q))
    np.testing.assert_allclose(ours, theirs, atol=1e-8)


@pytest.mark.sweep(3)
@pytest.mark.parametrize("name", MODELS)
@settings(max_examples=10, deadline=None)
@given(q=angles, qd=angles)
def test_jacobian_and_its_time_derivative(name: str, q: list[float], qd: list[float]) -> None:
    arm, kinematics = ARMS[name]
    data = arm.createData()
    frame = arm.getFrameId("flange")
    world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    theirs = pin.computeFrameJacobian(arm, data, np.array(q), frame, world)
    np.testing.assert_allclose(kinematics.jacobian(q, IDENTITY), theirs, atol=1e-9)
    if MODELS[name].is_cb3:  # whose software has no such built-in
        return
    pin.computeJointJacobiansTimeVariation(arm, data, np.array(q), np.array(qd))
    pin.updateFramePlacements(arm, data)
    change = pin.getFrameJacobianTimeVariation(arm, data, frame, world)
    bench = Bench(name)
    bench.start(f"textmsg(get_jacobian_time_derivative({q}, {qd})[2, 3])")
    bench.seconds(0.1)
    assert float(bench.of_type(TextMessage)[0].text) == pytest.approx(change[2, 3], abs=1e-4)


@given(st.lists(st.floats(-1.0, 1.0), min_size=36, max_size=36), angles)
def test_solve(entries: list[float], vector: list[float]) -> None:
    root = np.array(entries).reshape(6, 6)
    matrix = root @ root.T + np.eye(6)
    np.testing.assert_allclose(solve(matrix.tolist(), vector), np.linalg.solve(matrix, vector))


@pytest.mark.parametrize("rotors", [True, False])
def test_the_mass_matrix_of_a_program_has_payload_and_rotors(rotors: bool) -> None:
    bench = Bench()
    q = [0.1, -1.2, 1.3, -0.9, 0.7, 0.4]
    bench.start(
        f"set_target_payload({PAYLOAD}, {list(COG)}, {list(INERTIA)})\n"
        f"m = get_mass_matrix({q}, {rotors})\ntextmsg(m[0, 0])\ntextmsg(m[5, 5])"
    )
    bench.seconds(0.1)
    arm, _ = ARMS["ur5e"]
    theirs = pin.crba(arm, arm.createData(), np.array(q))
    if not rotors:
        theirs = theirs - np.diag(arm.armature)
    ours = [float(m.text) for m in bench.of_type(TextMessage)]
    assert ours == pytest.approx([theirs[0, 0], theirs[5, 5]], abs=1e-5)


# Motion by torque.


def torque(bench: Bench, body: str, seconds: float) -> None:
    bench.start(f"while True:\n {body}\nend")
    bench.seconds(seconds)
    assert not bench.of_type(RuntimeExceptionMessage)


def test_no_torque_holds_the_arm_against_gravity() -> None:
    bench = Bench()
    before = bench["actual_q"]
    torque(bench, "direct_torque([0, 0, 0, 0, 0, 0])", 0.5)
    assert bench["actual_q"] == before


@pytest.mark.parametrize("slider", [1.0, 0.5])
def test_a_torque_accelerates_as_the_mass_matrix_says(slider: float) -> None:
    bench = Bench()
    bench.write(speed_slider_mask=1, speed_slider_fraction=slider)
    bench.seconds(0.5)
    scales = "viscous_scale=[1,1,1,1,1,1], coulomb_scale=[1,1,1,1,1,1]"
    inertia = np.array(bench.controller.plant.mass_matrix(bench["actual_q"]))
    load = np.array([8.0, -5.0, 3.0, 1.0, -0.5, 0.3])
    torque(bench, f"direct_torque({load.tolist()}, {scales})", 0.02)
    expected = np.linalg.solve(inertia, load) * 0.02
    np.testing.assert_allclose(bench["target_qd"], expected, rtol=0.02, atol=1e-3)


def test_motion_without_friction_keeps_its_energy() -> None:
    """Coriolis torques do no work: without them the energy would drift."""
    bench = Bench()
    scales = "viscous_scale=[1,1,1,1,1,1], coulomb_scale=[1,1,1,1,1,1]"
    bench.start(
        "t = 0\nwhile t < 150:\n direct_torque([20, -12, 6, 2, 1, 0.5], "
        f"{scales})\n t = t + 1\nend\nwhile True:\n direct_torque([0,0,0,0,0,0], {scales})\nend"
    )

    def energy() -> float:
        qd = np.array(bench["target_qd"])
        return float(
            0.5 * qd @ np.array(bench.controller.plant.mass_matrix(bench["target_q"])) @ qd
        )

    bench.seconds(0.31)
    first = energy()
    assert first > 1.0
    bench.seconds(0.4)
    assert energy() == pytest.approx(first, rel=0.03)


def test_friction_slows_down_what_is_not_compensated() -> None:
    final = {}
    for scale in (0.0, 1.0):
        bench = Bench()
        scales = f"viscous_scale={[scale] * 6}, coulomb_scale={[scale] * 6}"
        torque(bench, f"direct_torque([10, 0, 0, 0, 0, 0], {scales})", 0.3)
        final[scale] = bench["target_qd"][0]
    assert 0.05 < final[0.0] < 0.8 * final[1.0]


def test_a_push_moves_an_arm_without_torque() -> None:
    bench = Bench()
    bench.controller.external_force([0, 30, 0, 0, 0, 0])
    torque(bench, "direct_torque([0, 0, 0, 0, 0, 0])", 0.3)
    assert bench["actual_TCP_speed"][1] > 0.02


def test_the_arm_ramps_down_when_the_torques_stop() -> None:
    bench = Bench()
    bench.start(
        "t = 0\nwhile t < 100:\n direct_torque([15, 0, 0, 0, 0, 0])\n t = t + 1\nend\nsleep(1)"
    )
    bench.seconds(0.2)
    assert bench["target_qd"][0] > 0.1
    bench.seconds(0.3)
    assert bench["target_qd"] == (0.0,) * 6


def test_a_torque_that_makes_a_joint_too_fast_stops_protectively() -> None:
    bench = Bench()
    bench.start("while True:\n direct_torque([0, 0, 0, 0, 0, 5])\nend")
    bench.until(lambda: bench.controller.safety_mode == SafetyMode.PROTECTIVE_STOP)


def test_the_tool_of_the_jacobian() -> None:
    tool = to_transform((0.1, -0.05, 0.2, 0.3, 0.2, 0.1))
    q = [0.1, -1.2, 1.3, -0.9, 0.7, 0.4]
    kinematics = Kinematics(MODELS["ur5e"])
    ours = np.array(kinematics.jacobian(q, tool))
    flange = kinematics.flange(q)
    rotation = np.array(flange[:9]).reshape(3, 3)
    x, y, z = rotation @ np.array(tool[9:])
    shift = np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]])
    plain = np.array(kinematics.jacobian(q))
    np.testing.assert_allclose(ours[:3], plain[:3] + shift @ plain[3:], atol=1e-9)
