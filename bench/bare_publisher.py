"""The peer of `bench.latency` and `bench.publishing`: plain rclpy, the same six messages.

They are stamped and sent at once, by UDP as the driver's.
"""

from __future__ import annotations

import argparse
import signal
import threading
import time

from crtk_drivers.ros.environment import share_no_memory

share_no_memory()

import rclpy  # noqa: E402 - the transport is chosen before
from rclpy.node import Node  # noqa: E402
from rclpy.signals import SignalHandlerOptions  # noqa: E402

from bench.ros_client import TOPICS  # noqa: E402


def main() -> None:
    """Publish until SIGTERM."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--namespace", required=True)
    parser.add_argument("--rate", type=float, required=True)
    options = parser.parse_args()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("bench_bare_publisher", namespace=options.namespace)
    stopped = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stopped.set())
    pairs = [(node.create_publisher(kind, name, 10), kind()) for name, kind in TOPICS.items()]
    for (_, message), name in zip(pairs, TOPICS, strict=True):
        if name.endswith("_js"):
            message.name = [f"joint_{index}" for index in range(6)]
            message.position = message.velocity = message.effort = [0.5] * 6
    due = time.monotonic()
    while not stopped.is_set():
        seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
        for publisher, message in pairs:
            message.header.stamp.sec = seconds
            message.header.stamp.nanosec = nanoseconds
            publisher.publish(message)
        due += 1.0 / options.rate
        time.sleep(max(0.0, due - time.monotonic()))
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
