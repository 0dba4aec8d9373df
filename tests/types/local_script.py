"""What a user of a device in the own process writes, for mypy: it is checked, and never run.

A line with ``type: ignore`` holds a mistake that mypy must find: one that it does not find is an error, too.
"""

from typing import assert_type

import numpy as np

import crtk_drivers
from crtk_drivers.front import local_devices
from crtk_drivers.motion.move import Move
from crtk_drivers.samples import JointState, Joy, Matrix, Poses, Vector


def an_arm() -> None:
    with crtk_drivers.connect("ur", sim=True, model="ur5e") as arm:
        assert_type(arm, local_devices.Ur)
        arm.enable(timeout=20.0)
        assert_type(arm.move_jp([0.0] * 6), Move)
        assert_type(arm.move_jp(np.zeros(6)).wait(timeout=3.0), bool)
        assert_type(arm.measured_js(), JointState)
        assert_type(arm.measured_jp() + 0.1, Vector)
        assert_type(arm.setpoint_cp(age=0.0), crtk_drivers.Pose)
        assert_type(arm.measured_cf(extra=True), tuple[crtk_drivers.Wrench, float])
        assert_type(arm.measured_cp().position, Vector)
        assert_type(arm.jacobian(), Matrix)
        assert_type(arm.inverse_kinematics(arm.measured_cp()), Vector)
        arm.move_cp(crtk_drivers.Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])))
        arm.move_cp(np.eye(4)).wait()
        arm.servo_jp(arm.setpoint_js())
        assert_type(arm.hold(), None)
        arm.mov_jp([0.0] * 6)  # type: ignore[attr-defined]
        arm.move_jp(None)  # type: ignore[arg-type]
        arm.move_jp(arm.measured_cp())  # type: ignore[arg-type]
        arm.move_jp()  # type: ignore[call-arg]
        arm.move_jp([0.0] * 6).wait_for_it()  # type: ignore[attr-defined]


def names_below_an_arm() -> None:
    with crtk_drivers.connect("ur", sim=True) as arm:
        arm.body.servo_cv([0.0, 0.0, 0.01, 0.0, 0.0, 0.0])
        arm.body.set_cf_orientation_absolute(True)
        assert_type(arm.local.measured_cp(), crtk_drivers.Pose)
        assert_type(arm.spatial.jacobian(), Matrix)
        arm.trajectory_j.set_ratio(0.5)
        assert_type(arm.trajectory_j.ratio(), float)
        arm.gripper.move_jp([0.02]).wait()
        arm.child("wrist").servo_jp([0.0])
        arm.body.measured_js()  # type: ignore[attr-defined]
        arm.trajectory_j.set_ration(0.5)  # type: ignore[attr-defined]


def what_is_beyond_crtk() -> None:
    with crtk_drivers.connect("ur", sim=True) as arm:
        arm.tool_voltage(24.0)
        arm.digital_out_0(True)
        assert_type(arm.state.digital_in_0(), bool)
        assert_type(arm.zero_force_sensor(), str)
        arm.extras["record_start"]()
        assert arm.sim is not None
        arm.sim.control.inject("emergency_stop")
        arm.digital_out_0("on")  # type: ignore[arg-type]
        arm.digital_out_99(True)  # type: ignore[attr-defined]


def other_kinds() -> None:
    sensor = crtk_drivers.connect("ati-netft", sim=True)
    assert_type(sensor.measured_cf(), crtk_drivers.Wrench)
    assert_type(sensor.raw.measured_cf(), crtk_drivers.Wrench)
    assert_type(sensor.bias(), str)
    sensor.move_jp([0.0])  # type: ignore[attr-defined]
    gripper = crtk_drivers.connect("robotiq", sim=True)
    gripper.move_jp([0.0]).wait()
    gripper.force(50.0)
    assert_type(gripper.state.holds(), bool)
    gripper.move_cp(np.eye(4))  # type: ignore[attr-defined]
    tracker = crtk_drivers.connect("ndi", sim=True)
    assert_type(tracker.measured_cp_array(), Poses)
    assert_type(tracker.child("probe").measured_cp(), crtk_drivers.Pose)
    tracker.servo_cp(np.eye(4))  # type: ignore[attr-defined]
    haptic = crtk_drivers.connect("force-dimension", sim=True)
    haptic.servo_cf([0.0] * 6)
    haptic.use_gravity_compensation(True)
    haptic.gripper.servo_jf([0.1])
    haptic.move_jp([0.0])  # type: ignore[attr-defined]
    pedals = crtk_drivers.connect("inputs", sim=True)
    assert_type(pedals.joy(), Joy)
    pedals.move_jp([0.0])  # type: ignore[attr-defined]


def a_plugin_of_somebody_else(name: str) -> None:
    device = crtk_drivers.connect(name)
    assert_type(device, crtk_drivers.LocalDevice)
    device.move_jp([0.0]).wait()
    assert_type(device.measured_cp_array(), Poses)
    device.extras["tare"]()
    device.mov_jp([0.0])  # type: ignore[attr-defined]


def turn(arm: crtk_drivers.Arm) -> None:
    arm.move_jp(arm.setpoint_jp() + 0.1).wait()


def close(gripper: crtk_drivers.Gripper) -> None:
    gripper.move_jp([0.0]).wait()


def a_function_takes_a_kind() -> None:
    turn(crtk_drivers.connect("ur", sim=True))
    turn(crtk_drivers.connect("of-somebody-else"))
    close(crtk_drivers.connect("weiss-wsg", sim=True))
    close(crtk_drivers.connect("ur", sim=True).gripper)
    turn(crtk_drivers.connect("weiss-wsg", sim=True))  # type: ignore[arg-type]
