"""servo_cf and interpolate_cf: the tool pushes as it is told, through the joints if need be."""

import numpy as np
import pytest

from crtk_drivers.device import CartesianLimits, JointLimits, Mode
from crtk_drivers.engine import EngineOptions
from crtk_drivers.errors import Reason
from crtk_drivers.geometry.frames import wrench_in_base
from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from crtk_drivers.samples import Vector, Wrench, vector
from rigs.scripted_arm import ARM, BENT, PERIOD, TOOL, ArmRig, wrench
from rigs.scripted_engine import jf

PUSH = (6.0, -5.0, 9.0, 0.6, -0.8, 0.4)
FRAMES = ("", "body", "spatial")
EFFORTS = (Mode.JOINT_EFFORT, Mode.CARTESIAN_EFFORT)
RISE = 0.1
"""Seconds in which a force may go from zero to its limit."""


def named(frame: str, name: str) -> str:
    return f"{frame}/{name}" if frame else name


def in_base(frame: str, values: Vector, joints: Vector = BENT) -> Vector:
    return wrench_in_base(vector(values), frame, ARM.forward(vector(joints)))


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("name", ["servo_cf", "interpolate_cf"])
def test_joint_efforts_do_the_work_of_the_wrench(name: str, frame: str) -> None:
    rig = ArmRig(Mode.JOINT_EFFORT).enabled()
    rig.stream(named(frame, name), wrench(*PUSH), 80)
    effort = rig.written[-1].values
    push = in_base(frame, vector(PUSH))
    short = 1e-6
    for joint in range(6):
        after = ARM.forward(vector(BENT + short * np.eye(6)[joint]))
        before = ARM.forward(vector(BENT - short * np.eye(6)[joint]))
        moved = (after.position - before.position) / (2.0 * short)
        turned = ARM.jacobian(BENT)[3:, joint]
        assert effort[joint] == pytest.approx(push[:3] @ moved + push[3:] @ turned, abs=1e-6)
    assert {setpoint.mode for setpoint in rig.written} == {Mode.JOINT_EFFORT}
    assert rig.setpoint() == {
        "position": [],
        "velocity": [],
        "effort": effort.tolist(),
    }
    value, stamp = rig.value("setpoint_cf")
    assert stamp != 0
    assert value.vector == pytest.approx(push)


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("name", ["servo_cf", "interpolate_cf"])
def test_hardware_that_takes_wrenches_gets_them_in_base_axes(name: str, frame: str) -> None:
    rig = ArmRig(Mode.CARTESIAN_EFFORT).enabled()
    rig.stream(named(frame, name), wrench(*PUSH), 80)
    assert {setpoint.mode for setpoint in rig.written} == {Mode.CARTESIAN_EFFORT}
    assert rig.written[-1].values == pytest.approx(in_base(frame, vector(PUSH)))


@pytest.mark.parametrize("mode", EFFORTS)
def test_a_wrench_that_is_held_in_the_tool_turns_with_the_arm(mode: Mode) -> None:
    rig = ArmRig(mode).enabled()
    rig.stream("body/servo_cf", wrench(0, 0, 10.0, 0, 0, 0), 2)
    rig.device.position = BENT + np.array((0.5, 0.2, 0, 0, 0.4, 0))  # somebody turns it
    rig.cycle(2)
    there = vector(rig.device.position)
    push = in_base("body", vector((0, 0, 10.0, 0, 0, 0)), there)
    expected = push if mode is Mode.CARTESIAN_EFFORT else ARM.jacobian(there).T @ push
    assert rig.written[-1].values == pytest.approx(expected)
    z_axis = matrix_from_quaternion(ARM.forward(there).orientation)[:, 2]
    assert push[:3] == pytest.approx(10.0 * z_axis)


@pytest.mark.parametrize("mode", EFFORTS)
def test_a_slow_stream_of_wrenches_changes_steadily(mode: Mode) -> None:
    rig = ArmRig(mode).enabled()
    pushes = []
    for value in (wrench(*PUSH), wrench(-20.0, 0, 0, 0, 5.0, 0)):
        for _ in range(6):
            rig.engine.submit("interpolate_cf", value)
            for _ in range(12):
                rig.cycle()
                pushes.append(rig.value("setpoint_cf")[0].vector)
    assert pushes[-1] == pytest.approx([-20.0, 0, 0, 0, 5.0, 0])
    change = np.abs(np.diff(np.vstack((np.zeros(6), pushes)), axis=0))
    assert change[:, :3].max() <= TOOL.force / RISE * PERIOD + 1e-9
    assert change[:, 3:].max() <= TOOL.torque / RISE * PERIOD + 1e-9


@pytest.mark.parametrize("mode", EFFORTS)
def test_a_smoothed_wrench_begins_with_the_one_in_force(mode: Mode) -> None:
    rig = ArmRig(mode, options=EngineOptions(mode_switch_dwell=0.0)).enabled()
    rig.stream("body/servo_cf", wrench(10.0, 0, 0, 0, 0, 0), 3)
    before = rig.value("setpoint_cf")[0].vector
    rig.engine.submit("interpolate_cf", wrench(0, 0, 0, 0, 0, 0))
    rig.cycle()
    after = rig.value("setpoint_cf")[0].vector
    assert np.abs(after - before).max() <= TOOL.force / RISE * PERIOD + 1e-9


@pytest.mark.parametrize("mode", EFFORTS)
@pytest.mark.parametrize("name", ["servo_cf", "body/servo_cf", "interpolate_cf"])
def test_a_silent_stream_lets_go(name: str, mode: Mode) -> None:
    rig = ArmRig(mode).enabled()
    rig.stream(name, wrench(*PUSH), 40)
    assert rig.written[-1].values.any()
    assert "stop" not in rig.device.calls
    goes_on = 0.5 if name.startswith("interpolate") else 0.1
    rig.cycle(int(goes_on / PERIOD) - 2)
    assert "stop" not in rig.device.calls
    rig.cycle(int(0.5 / PERIOD))
    assert rig.device.calls[-1] == "stop"
    if "servo" not in name:
        assert rig.written[-1].values == pytest.approx(np.zeros(6), abs=1e-9)
    assert rig.value("setpoint_cf")[1] == 0
    assert rig.setpoint()["effort"] == []
    health = rig.engine.health()
    assert (health.stream, health.stream_timeouts) == ("", 1)


def test_efforts_beyond_those_of_the_joints_are_scaled_as_a_whole_and_so_is_what_is_told() -> None:
    weak = JointLimits(-6.0, 6.0, velocity=2.0, acceleration=20.0, jerk=400.0, effort=2.0)
    rig = ArmRig(Mode.JOINT_EFFORT, limits=(weak,) * 6).enabled()
    rig.stream("servo_cf", wrench(*PUSH), 2)
    effort, wanted = rig.written[-1].values, ARM.jacobian(BENT).T @ np.array(PUSH)
    assert np.abs(wanted).max() > 2.0
    assert np.abs(effort).max() == pytest.approx(2.0)
    assert effort / np.linalg.norm(effort) == pytest.approx(wanted / np.linalg.norm(wanted))
    value, stamp = rig.value("setpoint_cf")
    assert stamp != 0
    assert ARM.jacobian(BENT).T @ value.vector == pytest.approx(effort)


@pytest.mark.parametrize("mode", EFFORTS)
def test_the_limits_of_the_tool_hold_at_the_tool_wherever_the_wrench_is_given(mode: Mode) -> None:
    rig = ArmRig(mode).enabled()
    rig.stream("spatial/servo_cf", wrench(0, 0, 39.0, 0, 0, 0), 2)  # through the origin
    told = rig.value("setpoint_cf")[0]
    assert isinstance(told, Wrench)
    assert np.linalg.norm(told.torque) == pytest.approx(TOOL.torque)
    assert np.linalg.norm(told.force) < 39.0
    direction = in_base("spatial", vector((0, 0, 39.0, 0, 0, 0)))
    assert told.vector / np.linalg.norm(told.vector) == pytest.approx(
        direction / np.linalg.norm(direction)
    )
    if mode is Mode.JOINT_EFFORT:
        assert rig.written[-1].values == pytest.approx(ARM.jacobian(BENT).T @ told.vector)


@pytest.mark.parametrize("name", ["servo_cf", "interpolate_cf", "body/servo_cf"])
def test_too_much_is_refused(name: str) -> None:
    rig = ArmRig(Mode.JOINT_EFFORT).enabled()
    assert rig.refused(name, wrench(0, 41.0, 0, 0, 0, 0)).reason is Reason.OUT_OF_RANGE
    assert rig.refused(name, wrench(0, 0, 0, 0, 0, 11.0)).reason is Reason.OUT_OF_RANGE
    assert rig.refused(name, wrench(0, np.nan, 0, 0, 0, 0)).reason is Reason.NOT_FINITE


def test_without_limits_of_force_there_are_no_wrenches_and_without_kinematics_none_by_joints() -> (
    None
):
    unlimited = CartesianLimits(0.5, 1.5, 5.0, 10.0)
    for changes in ({"cartesian_limits": unlimited}, {"has_kinematics": False}):
        rig = ArmRig(Mode.JOINT_EFFORT, **changes).enabled()
        assert not {"servo_cf", "interpolate_cf", "setpoint_cf", "body/servo_cf"} & set(
            rig.engine.commands
        )
        assert rig.refused("servo_cf", wrench(*PUSH)).reason is Reason.UNSUPPORTED


def test_an_effort_of_the_joints_is_no_wrench() -> None:
    rig = ArmRig(Mode.JOINT_EFFORT).enabled()
    rig.stream("servo_jf", jf(*[1.0] * 6), 2)
    assert rig.value("setpoint_cf")[1] == 0
    assert rig.setpoint()["effort"] == [1.0] * 6
