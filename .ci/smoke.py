"""In an environment of any Python: every plugin loads, and simulated hardware is driven, in a world too.

Needs the extras `drivers` and `kinematics`. With `ros`, a node uses the messages that are there.
"""

import platform
from importlib.util import find_spec

import numpy as np

import crtk_drivers
from crtk_drivers import plugins
from crtk_drivers.errors import MissingExtra
from crtk_drivers.testing.world import run


def load_all() -> None:
    """Load what is registered; what an extra is missing for is no failure."""
    for kind, found in (("device", plugins.devices()), ("simulator", plugins.sims())):
        broken = [plugin.name for plugin in found.values() if plugin.error and not plugin.missing]
        assert not broken, f"a {kind} cannot be loaded: {broken}"


def move() -> None:
    """Let two simulated devices move, and a simulated sensor measure."""
    for device in ("ur", "dynamixel"):
        with crtk_drivers.connect(device, sim=True) as arm:
            arm.enable()
            goal = arm.setpoint_js().position + 0.02
            arm.move_jp(goal).wait()
            assert np.allclose(arm.measured_js().position, goal, atol=0.01), device
    with crtk_drivers.connect("ati-netft", sim=True) as sensor:
        assert np.isfinite(sensor.measured_cf().force).all()


def close_gripper(_: object) -> None:
    """Let a gripper move: the scenario of a simulated machine, which imports this file."""
    with crtk_drivers.connect("robotiq", sim=True, config={"link": "modbus"}) as gripper:
        gripper.enable()
        gripper.move_jp(gripper.setpoint_js().position + 0.01).wait()


def run_world() -> None:
    """Run a gripper and its simulator on a simulated machine: one seed gives one run."""
    outcomes = [run(close_gripper, 1) for _ in range(2)]
    for outcome in outcomes:
        outcome.check()
    assert outcomes[0].hash == outcomes[1].hash


def ask_for_ur_rtde() -> str:
    """Return what became of `control: ur_rtde`, which not every Python can have."""
    try:
        crtk_drivers.connect("ur", sim=True, control="ur_rtde").close()
    except MissingExtra as error:
        if find_spec("rtde_control") is not None or "control: native" not in error.remedy:
            raise
        return "left out"
    return "connected"


def import_ros() -> str:
    """Return whether ROS 2 is there; a node uses the messages then."""
    if find_spec("rclpy") is None:
        return "not installed"
    import crtk_msgs.msg
    import rclpy
    import tf2_msgs.msg

    rclpy.init()
    crtk_msgs.msg.OperatingState()
    tf2_msgs.msg.TFMessage()
    # Publishers and clients load the libraries of the types, which do without those of C++.
    node = rclpy.create_node("smoke")
    node.create_publisher(crtk_msgs.msg.OperatingState, "state", 1)
    node.create_publisher(tf2_msgs.msg.TFMessage, "tf", 1)
    if find_spec("control_msgs") is not None:
        import control_msgs.action
        from rclpy.action import ActionClient

        ActionClient(node, control_msgs.action.FollowJointTrajectory, "trajectory")
    if find_spec("controller_manager_msgs") is not None:
        import controller_manager_msgs.srv

        node.create_client(controller_manager_msgs.srv.ListControllers, "controllers")
    node.destroy_node()
    rclpy.shutdown()
    return "has its messages"


if __name__ == "__main__":
    load_all()
    move()
    run_world()
    print(
        f"Python {platform.python_version()}: plugins load, simulators are driven; "
        f"ur-rtde {ask_for_ur_rtde()}; ROS 2 {import_ros()}"
    )
