"""A process that streams one joint position on servo_jp at 100 Hz until it is killed.

It says "ready" when somebody listens, and begins when it is told to by a line.

Usage: stream_positions.py NAMESPACE NODE VALUES...
"""

from __future__ import annotations

import sys
import time

import rclpy
from sensor_msgs.msg import JointState


def main() -> None:
    namespace, name, *values = sys.argv[1:]
    rclpy.init()
    node = rclpy.create_node(name, enable_rosout=False, start_parameter_services=False)
    publisher = node.create_publisher(JointState, f"{namespace}/servo_jp", 10)
    message = JointState(position=[float(value) for value in values])
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    sys.stdin.readline()
    while True:
        publisher.publish(message)
        time.sleep(0.01)


if __name__ == "__main__":
    main()
