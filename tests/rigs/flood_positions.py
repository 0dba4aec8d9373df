"""A process that sends one joint position on servo_jp in a tight loop until it is killed.

It says "ready" when somebody listens, and begins then.

Usage: flood_positions.py NAMESPACE NODE VALUES...
"""

from __future__ import annotations

import sys
import time

import rclpy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState


def main() -> None:
    namespace, name, *values = sys.argv[1:]
    rclpy.init()
    node = rclpy.create_node(name, enable_rosout=False, start_parameter_services=False)
    publisher = node.create_publisher(JointState, f"{namespace}/servo_jp", 10)
    data = serialize_message(JointState(position=[float(value) for value in values]))
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    while True:
        publisher.publish(data)


if __name__ == "__main__":
    main()
