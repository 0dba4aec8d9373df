"""Hears topics as bytes: the six of `bench.ros_client`, or joint states; ``ready`` when it has heard each.

On SIGTERM it prints how many messages it has heard since the last SIGUSR1: ``heard N``.
"""

from __future__ import annotations

import argparse
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable

from crtk_drivers.ros.environment import share_no_memory

share_no_memory()

import rclpy  # noqa: E402 - the transport is chosen before
from rclpy.experimental import EventsExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.signals import SignalHandlerOptions  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402

from bench.ros_client import TOPICS  # noqa: E402


def main() -> None:
    """Hear until SIGTERM."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--namespace", required=True)
    parser.add_argument("--joints", nargs="*", metavar="TOPIC", help="of joint states")
    given = parser.parse_args()
    topics = dict.fromkeys(given.joints, JointState) if given.joints else TOPICS
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node, executor = Node("bench_raw", namespace=given.namespace), EventsExecutor()
    executor.add_node(node)
    heard: Counter[str] = Counter()
    stopped = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stopped.set())
    signal.signal(signal.SIGUSR1, lambda *_: heard.clear())

    def counter(topic: str) -> Callable[[bytes], None]:
        def receive(data: bytes) -> None:
            heard[topic] += 1

        return receive

    for topic, kind in topics.items():
        node.create_subscription(kind, topic, counter(topic), 10, raw=True)
    while len(heard) < len(topics) and not stopped.is_set():
        executor.spin_once(timeout_sec=0.05)
    print(f"ready {time.monotonic()}", flush=True)
    while not stopped.is_set():
        executor.spin_once(timeout_sec=0.05)
    print(f"heard {heard.total()}", flush=True)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
