"""What a call of `crtk_drivers.client` costs beside the same thing in bare rclpy, in one thread.

send     servo_jp of six joints, against filling a message and publishing it
read     measured_js that has arrived as bytes, against a message object and converting that to numpy by hand
receive  what a message costs when it arrives, against the shortest callback
"""

from __future__ import annotations

import threading
import time
from array import array

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from bench.report import options, show_calls
from crtk_drivers.client import connect
from crtk_drivers.client.inbox import Inbox
from crtk_drivers.ros.spinning import make_executor

NAMESPACE = "/bench_client"


def main() -> None:
    """Measure and print."""
    given = options(__doc__ or "", calls=(2000, "in each round"))
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("bench_device", context=context)
    feedback = node.create_publisher(JointState, f"{NAMESPACE}/measured_js", 10)
    node.create_subscription(JointState, f"{NAMESPACE}/servo_jp", lambda message: None, 10)
    stopped = threading.Event()
    executor = make_executor(context)
    executor.add_node(node)

    def spin() -> None:
        while not stopped.is_set():
            executor.spin_once(timeout_sec=0.05)

    thread = threading.Thread(target=spin, name="bench device")
    thread.start()
    sample = JointState(position=array("d", [0.5] * 6), velocity=array("d", [0.1] * 6))
    data = serialize_message(sample)
    try:
        with connect(NAMESPACE, features=["measured_js", "servo_jp"]) as arm:
            goal = np.full(6, 0.5)
            newest = [data]
            bare = node.create_publisher(JointState, f"{NAMESPACE}/servo_jp", 10)
            inbox = Inbox(f"{NAMESPACE}/measured_js", JointState)

            def publish_bare() -> None:
                message = JointState()
                message.header.stamp = node.get_clock().now().to_msg()
                message.position = goal.tolist()
                bare.publish(message)

            def read_bare() -> None:
                message = deserialize_message(newest[0], JointState)
                np.array(message.position), np.array(message.velocity), np.array(message.effort)

            def read_new() -> None:
                inbox.receive(data)
                assert inbox.latest is not None
                inbox.latest.value  # noqa: B018 - it is made when it is asked for

            feedback.publish(sample)
            arm.measured_js(age=0, wait=5.0)
            arm.servo_jp(goal)
            time.sleep(0.2)
            show_calls(
                "ROS 2 client: calls beside bare rclpy, six joints",
                {
                    "send: client": lambda: arm.servo_jp(goal),
                    "send: bare rclpy": publish_bare,
                    "read again: client": lambda: arm.measured_js(age=0),
                    "receive and read: client": read_new,
                    "receive and read: bare rclpy": read_bare,
                    "receive: client": lambda: inbox.receive(data),
                    "receive: bare callback": lambda: newest.__setitem__(0, data),
                },
                given.calls,
            )
    finally:
        stopped.set()
        thread.join()
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()


if __name__ == "__main__":
    main()
