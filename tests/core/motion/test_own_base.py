"""What dVRK's scripts expect: poses in ``local/``, and wrenches of ``body/`` along the base's axes."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from crtk_drivers.device import Mode
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.geometry.frames import product
from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from crtk_drivers.samples import Flag, Pose, vector
from rigs.scripted_arm import BENT, ArmRig, apart, step, wrench
from rigs.scripted_engine import jp

ABSOLUTE = "body/set_cf_orientation_absolute"
BASE = step(0.2, -0.1, 0.3, 0.0, 0.5, np.pi / 2.0)
PUSH = (3.0, -1.0, 2.0, 0.1, 0.2, -0.3)


def test_local_is_the_same_where_the_base_is_its_own() -> None:
    rig = ArmRig().enabled()
    rig.engine.submit("move_jp", jp(*BENT + 0.1))
    rig.cycle(30)
    for name in ("measured_cp", "setpoint_cp"):
        own, plain = rig.value(f"local/{name}"), rig.value(name)
        assert own[1] == plain[1] != 0
        assert own[0].frame_id == plain[0].frame_id
        assert own[0].position.tolist() == plain[0].position.tolist()
        assert own[0].orientation.tolist() == plain[0].orientation.tolist()
    joints = vector(BENT)
    assert rig.engine.forward_kinematics(joints, "local/forward_kinematics").position == (
        pytest.approx(rig.engine.forward_kinematics(joints).position)
    )
    assert "local/servo_cp" not in rig.engine.commands, "no second way to command one frame"


def test_local_is_without_the_pose_of_the_base() -> None:
    rig = ArmRig(base_pose=BASE).enabled()
    for name in ("measured_cp", "setpoint_cp"):
        own, plain = rig.value(f"local/{name}"), rig.value(name)
        assert own[1] == plain[1] != 0
        assert own[0].frame_id == "local"
        assert apart(product(BASE, own[0]), plain[0]) < 1e-9
        assert apart(own[0], plain[0]) > 0.1
    joints = vector(BENT)
    own_pose = rig.engine.forward_kinematics(joints, "local/forward_kinematics")
    assert own_pose.frame_id == "local"
    assert apart(product(BASE, own_pose), rig.engine.forward_kinematics(joints)) < 1e-9


def test_a_setpoint_that_is_not_valid_is_not_valid_in_local() -> None:
    rig = ArmRig()
    rig.cycle()
    assert rig.value("setpoint_cp")[1] == rig.value("local/setpoint_cp")[1] == 0, "not enabled"


@pytest.mark.sweep(3)
@pytest.mark.parametrize("mode", [Mode.CARTESIAN_EFFORT, Mode.JOINT_EFFORT])
@pytest.mark.parametrize("name", ["servo_cf", "interpolate_cf"])
def test_a_wrench_of_body_is_along_the_axes_that_were_asked_for(mode: Mode, name: str) -> None:
    rig = ArmRig(mode).enabled()
    turned = np.kron(np.eye(2), matrix_from_quaternion(rig.device.pose.orientation))

    def sent() -> np.ndarray:
        rig.stream(f"body/{name}", wrench(*PUSH), 200)
        written = rig.written[-1].values
        if mode is Mode.CARTESIAN_EFFORT:
            return written
        return np.linalg.solve(rig.device.solver.jacobian(vector(rig.device.position)).T, written)

    assert sent() == pytest.approx(turned @ PUSH, abs=1e-6)
    rig.engine.submit(ABSOLUTE, Flag(True))
    assert sent() == pytest.approx(np.array(PUSH), abs=1e-6)
    told = rig.value("body/setpoint_cf")[0]
    assert told.frame_id == "base"
    assert told.vector == pytest.approx(np.array(PUSH), abs=1e-6)
    rig.engine.submit(ABSOLUTE, Flag(False))
    assert sent() == pytest.approx(turned @ PUSH, abs=1e-6)
    assert rig.value("body/setpoint_cf")[0].frame_id == "tool"


def test_it_changes_nothing_but_wrenches_of_body() -> None:
    rig = ArmRig(Mode.JOINT_POSITION, Mode.CARTESIAN_EFFORT).enabled()
    rig.engine.submit(ABSOLUTE, Flag(True))
    rig.stream("spatial/servo_cf", wrench(*PUSH), 3)
    spatial = rig.written[-1].values
    assert spatial[:3] == pytest.approx(PUSH[:3])
    assert spatial[3:] != pytest.approx(PUSH[3:]), "at the tool point, not at the origin"
    start = rig.device.pose
    rig.engine.submit("hold")
    rig.cycle(2)
    rig.engine.submit("body/move_cr", step(0.02, 0.0, 0.0, 0.0, 0.0, 0.0))
    rig.cycle(300)
    forwards = matrix_from_quaternion(start.orientation)[:, 0]
    assert rig.device.pose.position - start.position == pytest.approx(0.02 * forwards, abs=1e-6)


@pytest.mark.parametrize("told_in", ["base", "tool"])
def test_what_is_measured_in_body_follows(told_in: str) -> None:
    rig = ArmRig(
        Mode.CARTESIAN_EFFORT, measured=("measured_js", "measured_cp", "measured_cf")
    ).enabled()
    turned = np.kron(np.eye(2), matrix_from_quaternion(rig.device.pose.orientation))
    own = turned.T if told_in == "tool" else np.eye(6)
    rig.device.extra = {"measured_cf": wrench(*(own @ PUSH), frame=told_in)}
    rig.cycle()
    assert rig.value("body/measured_cf")[0].vector == pytest.approx(turned.T @ PUSH)
    rig.engine.submit(ABSOLUTE, Flag(True))
    value, stamp = rig.value("body/measured_cf")
    assert (value.frame_id, stamp) == ("base", rig.value("measured_cf")[1])
    assert value.vector == pytest.approx(np.array(PUSH))


def test_the_frame_id_of_a_wrench_is_that_of_the_axes() -> None:
    rig = ArmRig(Mode.CARTESIAN_EFFORT).enabled()
    for absolute, right, wrong in ((True, "base", "tool"), (False, "tool", "base")):
        rig.engine.submit(ABSOLUTE, Flag(absolute))
        rig.engine.submit("body/servo_cf", wrench(*PUSH, frame=right))
        with pytest.raises(CommandRefused) as caught:
            rig.engine.submit("body/servo_cf", wrench(*PUSH, frame=wrong))
        assert caught.value.reason is Reason.WRONG_FRAME


def test_without_forces_there_is_no_such_setting() -> None:
    assert ABSOLUTE not in ArmRig().engine.commands
    assert ABSOLUTE in ArmRig(Mode.CARTESIAN_EFFORT).engine.commands


def test_the_pose_of_a_placed_arm_as_pinocchio_has_it() -> None:
    rig = ArmRig(base_pose=BASE).enabled()
    own, plain = rig.value("local/measured_cp")[0], rig.value("measured_cp")[0]

    def se3(pose: Pose) -> pin.SE3:
        return pin.SE3(matrix_from_quaternion(pose.orientation), np.array(pose.position))

    assert (se3(BASE).inverse() * se3(plain)).isApprox(se3(own), 1e-9)
