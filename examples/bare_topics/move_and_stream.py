"""Enable a CRTK arm, move one joint a little, then stream to it: rclpy and topics alone.

Start a device in one terminal, and this script in another one:

crtk-driver ur --ns /ur5 --sim --set space.speed=0.1
python examples/bare_topics/move_and_stream.py /ur5
"""

import json
import math
import sys
import time

import rclpy
from crtk_msgs.msg import OperatingState, StringStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, String

STEP = 0.05
"""How far the last joint moves, in rad."""

PERIOD = 0.01
"""Between two setpoints of the stream, in s. The device holds when 0.1 s pass without one."""

ABSOLUTE = QoSProfile(depth=1)  # reliable and volatile, as rclpy has it: the newest setpoint counts
EVENTS = QoSProfile(depth=10)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Arm(Node):
    """The far side of one CRTK device."""

    def __init__(self, namespace):
        super().__init__("bare_topics", namespace=namespace)
        self.state = self.setpoint = self.measured = None
        self.was_busy = False
        self.create_subscription(OperatingState, "operating_state", self.take_state, LATCHED)
        self.create_subscription(JointState, "measured_js", self.take_measured, EVENTS)
        self.create_subscription(JointState, "setpoint_js", self.take_setpoint, EVENTS)
        # The topic is latched. This subscription is volatile, so older refusals stay out.
        self.create_subscription(String, "refusals", self.take_refusal, EVENTS)
        self.state_command = self.create_publisher(StringStamped, "state_command", EVENTS)
        self.move_jp = self.create_publisher(JointState, "move_jp", ABSOLUTE)
        self.servo_jp = self.create_publisher(JointState, "servo_jp", ABSOLUTE)
        self.hold = self.create_publisher(Empty, "hold", EVENTS)

    def take_state(self, message):
        """Keep the operating state, and whether the device was busy since that was forgotten."""
        self.state = message
        self.was_busy = self.was_busy or message.is_busy

    def take_measured(self, message):
        """Keep where the joints are."""
        if is_valid(message):
            self.measured = message

    def take_setpoint(self, message):
        """Keep where the joints are to be."""
        if is_valid(message):
            self.setpoint = message

    def take_refusal(self, message):
        """End with the reason for which a command was refused."""
        refusal = json.loads(message.data)
        sys.exit(f"{refusal['command']} refused: {refusal['message']}. {refusal['remedy']}")

    def wait(self, condition, what, seconds=10.0):
        """Handle messages until the condition holds."""
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                sys.exit(f"{self.get_namespace()}: {what} did not happen within {seconds:g} s")
            rclpy.spin_once(self, timeout_sec=0.1)

    def is_found(self):
        """Return whether both directions are connected: a message to nobody is lost."""
        publishers = (self.state_command, self.move_jp, self.servo_jp, self.hold)
        return self.state and self.measured and all(p.get_subscription_count() for p in publishers)

    def reach(self, command, state):
        """Send a state command, and wait for the state."""
        self.state_command.publish(StringStamped(string=command))
        self.wait(lambda: self.state.state == state, state)

    def move_last_joint(self, way):
        """Move to a goal, and wait until the device has been busy and is not any more."""
        self.wait(lambda: self.setpoint, "a valid setpoint")
        goal = list(self.setpoint.position)
        goal[-1] += way
        self.was_busy = False
        self.move_jp.publish(JointState(position=goal))
        self.wait(lambda: self.was_busy and not self.state.is_busy, "the end of the move", 30.0)

    def stream(self, amplitude, seconds):
        """Let the last joint swing once, by setpoints at a steady rate."""
        start = list(self.setpoint.position)
        begin = time.monotonic()
        for step in range(1, round(seconds / PERIOD) + 1):
            share = (1.0 - math.cos(2.0 * math.pi * step * PERIOD / seconds)) / 2.0
            self.servo_jp.publish(JointState(position=[*start[:-1], start[-1] + amplitude * share]))
            rclpy.spin_once(self, timeout_sec=0.0)
            time.sleep(max(0.0, begin + step * PERIOD - time.monotonic()))
        self.hold.publish(Empty())


def is_valid(message):
    """Return whether feedback counts: stamp 0 means that the value is not valid now."""
    return message.header.stamp.sec != 0


def main():
    """Run the example."""
    if len(sys.argv) != 2:
        sys.exit("say the namespace of the device: /ur5")
    rclpy.init()
    arm = Arm(sys.argv[1])
    try:
        arm.wait(arm.is_found, "finding a CRTK device")
        arm.reach("enable", "ENABLED")
        before = arm.measured.position[-1]
        arm.move_last_joint(STEP)
        arm.measured = None
        arm.wait(lambda: arm.measured, "a sample after the move")
        print(f"the last joint moved by {arm.measured.position[-1] - before:.3f} rad")
        arm.stream(STEP, 2.0)
        arm.reach("disable", "DISABLED")
        print("it is DISABLED again")
    finally:
        if rclpy.ok():
            arm.hold.publish(Empty())
        arm.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
