"""What another program latched before the driver started is not carried out."""

from __future__ import annotations

import subprocess
import sys

from rigs.loopback_client import far_device

NAMESPACE = "/latched_before"

LATCHING = """
import sys, time, rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from crtk_msgs.msg import StringStamped
from sensor_msgs.msg import JointState
rclpy.init()
node = rclpy.create_node("latching")
kept = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)
made = []
for name, kind, message in (
    ("state_command", StringStamped, StringStamped(string="enable")),
    ("servo_jp", JointState, JointState(position=[0.02, 0.0, 0.0, 0.0])),
    ("move_jp", JointState, JointState(position=[0.5, 0.0, 0.0, 0.0])),
    ("servo_jr", JointState, JointState(position=[0.02, 0.0, 0.0, 0.0])),
):
    made.append(node.create_publisher(kind, f"{sys.argv[1]}/{name}", kept))
    made[-1].publish(message)
print("ready", flush=True)
while not all(each.get_subscription_count() for each in made):
    time.sleep(0.01)
print("met", flush=True)
time.sleep(3600)
"""


def test_commands_latched_before_the_start_are_not_heard() -> None:
    command = [sys.executable, "-c", LATCHING, NAMESPACE]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        try:
            assert child.stdout is not None
            assert child.stdout.readline() == "ready\n"
            heard: list[str] = []
            with far_device(NAMESPACE) as far:
                far.engine.hearers = (lambda name, *_: heard.append(name),)
                assert child.stdout.readline() == "met\n"
                far.arm.enable()
                far.arm.hold()
                assert heard == ["state_command", "hold"]
                assert not far.engine.health().refusals
                assert far.arm.operating_state().state == "ENABLED"
                assert not far.arm.measured_jp().any()
                assert not far.arm.is_busy()
        finally:
            child.kill()
