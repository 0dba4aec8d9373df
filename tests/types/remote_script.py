"""What a user of a device on ROS 2 writes, for mypy: see `local_script`."""

from typing import assert_type

import crtk_drivers
from crtk_drivers import client
from crtk_drivers.motion.move import Move


def a_device_of_any_kind() -> None:
    with client.connect("/ur5", features=["measured_js"]) as arm:
        assert_type(arm, client.RemoteDevice)
        arm.enable()
        assert_type(arm.move_jp([0.0] * 6), Move)
        assert_type(arm.measured_cp(extra=True), tuple[crtk_drivers.Pose, float])
        arm.body.servo_cv([0.0] * 6)
        arm.jaw.servo_jp([0.1])
        arm.child("probe").measured_cp()
        arm.call("zero_force_sensor")
        stop = arm.on("measured_js", lambda value, stamp: None)
        stop()
        arm.mov_jp([0.0] * 6)  # type: ignore[attr-defined]
        arm.zero_force_sensor()  # type: ignore[attr-defined]


def close(gripper: crtk_drivers.Gripper) -> None:
    gripper.move_jp([0.0]).wait()


def an_arm(namespace: str) -> crtk_drivers.Arm:
    """It is here or there: the program is the same."""
    return client.connect(namespace) if namespace else crtk_drivers.connect("ur", sim=True)


def a_gripper() -> crtk_drivers.Gripper:
    return client.connect("/gripper")


def a_kind_is_said_by_an_annotation() -> None:
    gripper = a_gripper()
    gripper.move_jp([0.0]).wait()
    gripper.move_cp([0.0] * 7)  # type: ignore[attr-defined]
    close(client.connect("/gripper"))
    with an_arm("") as arm:
        arm.move_jp([0.0] * 6).wait()
        arm.bias()  # type: ignore[attr-defined]


def the_devices_of_a_lab() -> None:
    with crtk_drivers.lab("lab.toml") as lab:
        assert_type(lab.arm, client.RemoteDevice)
        lab["arm"].move_jp([0.0] * 6)
