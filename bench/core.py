"""What the core and the node cost per command and per message, without hardware and without subscribers."""

from __future__ import annotations

import time

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState as JointStateMessage

import crtk_drivers
from bench.report import options, show_calls
from crtk_drivers.recording import cdr
from crtk_drivers.ros.unlocked import UnlockedNode
from crtk_drivers.samples import JointState, Pose, vector

FIELDS = ("position", "velocity", "effort")


def main() -> None:
    """Measure and print."""
    given = options(__doc__ or "", calls=(2000, "in each round"))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    locked, unlocked = Node("bench_locked"), UnlockedNode("bench_unlocked")
    joints = vector([0.1, 0.1, 0.1, 0.1])
    state = JointState(joints, joints, joints, ("x", "y", "z", "yaw"))
    pose = Pose(vector([0.1, 0.2, 0.3]), vector([0.0, 0.0, 0.0, 1.0]), "base")
    joints_type = cdr.TYPE_NAMES[JointState]
    command = cdr.encode(JointState(joints), 1)
    message = JointStateMessage(name=list(state.name), **dict.fromkeys(FIELDS, joints.tolist()))
    with crtk_drivers.connect("loopback") as device:
        device.enable()
        engine = device.engine
        command_value = JointState(position=device.measured_js().position)
        time.sleep(engine.options.mode_switch_dwell)
        plain = locked.create_publisher(JointStateMessage, "plain", 10)
        ours = unlocked.create_publisher(JointStateMessage, "ours", 10)
        show_calls(
            "Core and node",
            {
                "engine: submit servo_jp": lambda: engine.submit("servo_jp", command_value),
                "engine: read measured_js": lambda: engine.feedback("measured_js"),
                "engine: read setpoint_cp": lambda: engine.feedback("setpoint_cp"),
                "engine: health": engine.health,
                "message to value, JointState": lambda: cdr.decode(joints_type, command),
                "value to message, JointState": lambda: cdr.encode(state, 1, "base"),
                "value to message, PoseStamped": lambda: cdr.encode(pose, 1, "base"),
                "publish JointState, rclpy": lambda: plain.publish(message),
                "publish JointState, lock released": lambda: ours.publish(
                    cdr.encode(state, 1, "base")
                ),
            },
            given.calls,
        )
    locked.destroy_node()
    unlocked.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
