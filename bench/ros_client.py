"""A ROS client in a process of its own: enables the device, listens, and streams servo commands.

    heard     for each message: number of the topic, its stamp (ns), wall time (ns) in the callback
    sent      for each command: its last joint's position, monotonic time (ns) before publishing

Prints ``up`` when its node exists, ``ready`` when every topic has been heard; runs until SIGTERM.
"""

from __future__ import annotations

import argparse
import math
import signal
import threading
import time
from typing import Any

import rclpy
from crtk_msgs.msg import OperatingState, StringStamped
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from bench.recording import Recording
from crtk_drivers.ros import environment

TOPICS = {
    "measured_js": JointState,
    "setpoint_js": JointState,
    "measured_cp": PoseStamped,
    "setpoint_cp": PoseStamped,
    "measured_cv": TwistStamped,
    "measured_cf": WrenchStamped,
}
ENABLE_PERIOD = 5.0
"""Seconds after which enable is tried again: on a busy machine it may fail."""
SERVO_STEP = 1e-6
"""rad by which each servo command differs from the one before, so that it can be recognised."""


class Client:
    """Node, subscriptions and recordings."""

    def __init__(
        self, namespace: str, name: str, topics: list[str], quiet: bool, patience: float
    ) -> None:
        self.node = Node("bench_" + name, namespace=namespace)
        self.executor = EventsExecutor()
        self.executor.add_node(self.node)
        self.stopped = threading.Event()
        self._heard = Recording(f"{name}_heard", 3)
        self._sent = Recording(f"{name}_sent", 2)
        self._quiet = quiet
        self._patience = patience
        self._state = ""
        self._joints: list[float] = []
        self._unheard = set(topics)
        for topic in topics:
            self.node.create_subscription(TOPICS[topic], topic, self._listener(topic), 10)
        self.node.create_subscription(OperatingState, "operating_state", self._take_state, 10)
        self._state_command = self.node.create_publisher(StringStamped, "state_command", 10)
        self._servo = self.node.create_publisher(JointState, "servo_jp", 10)

    def _listener(self, topic: str) -> Any:
        number, add = list(TOPICS).index(topic), self._heard.add
        joints = topic == "measured_js"

        def heard(message: Any) -> None:
            now, stamp = time.time_ns(), message.header.stamp
            if not self._quiet:
                add((number, stamp.sec * 1_000_000_000 + stamp.nanosec, now))
            if stamp.sec:  # else it is marked as invalid: the device is not connected yet
                self._unheard.discard(topic)
            if joints:
                self._joints = message.position

        return heard

    def _take_state(self, message: OperatingState) -> None:
        self._state = message.state

    def spin_until(self, done: Any, what: str) -> None:
        """Serve callbacks until `done()`; give up after `patience` s."""
        deadline = time.monotonic() + self._patience
        while not done():
            if time.monotonic() > deadline or self.stopped.is_set():
                raise SystemExit(f"{what} did not come in {self._patience:g} s")
            self.executor.spin_once(timeout_sec=0.05)

    def hear_all(self) -> None:
        """Wait until each topic was heard."""
        self.spin_until(lambda: not self._unheard, "the first messages")

    def enable(self) -> None:
        """Enable the device."""
        self.spin_until(lambda: self._state == "DISABLED", "DISABLED")
        asked = -math.inf

        def enabled() -> bool:
            nonlocal asked
            if self._state != "ENABLED" and time.monotonic() - asked > ENABLE_PERIOD:
                asked = time.monotonic()
                self._state_command.publish(StringStamped(string="enable"))
            return self._state == "ENABLED"

        self.spin_until(enabled, "ENABLED")

    def stream(self, rate: float) -> None:
        """Send servo commands, each a little beside where the arm is, until stopped."""
        self.spin_until(lambda: len(self._joints) > 0, "measured_js")
        command = JointState(position=list(self._joints))
        last, step, due = command.position[-1], 0, time.monotonic()
        while not self.stopped.is_set():
            step += 1
            command.position[-1] = last + SERVO_STEP * (step % 10_000)
            self._sent.add((command.position[-1], time.monotonic_ns()))
            self._servo.publish(command)
            due += 1.0 / rate
            time.sleep(max(0.0, due - time.monotonic()))

    def spin(self) -> None:
        """Serve callbacks until stopped."""
        while not self.stopped.is_set():
            self.executor.spin_once(timeout_sec=0.05)


def main() -> None:
    """Do what the options say."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--namespace", default="/bench")
    parser.add_argument("--name", default="client")
    parser.add_argument("--topics", nargs="*", choices=list(TOPICS), default=list(TOPICS))
    parser.add_argument("--enable", action="store_true")
    parser.add_argument("--quiet", action="store_true", help="record nothing")
    parser.add_argument("--servo", type=float, default=0.0, metavar="HZ")
    parser.add_argument("--patience", type=float, default=30.0, metavar="S")
    options = parser.parse_args()
    environment.share_no_memory()  # as our own clients do
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    client = Client(
        options.namespace, options.name, options.topics, options.quiet, options.patience
    )
    signal.signal(signal.SIGTERM, lambda *_: client.stopped.set())
    print("up", flush=True)
    if options.enable:
        client.enable()
    client.hear_all()
    print("ready", time.monotonic(), flush=True)
    if options.servo:
        streaming = threading.Thread(target=client.stream, args=(options.servo,))
        streaming.start()
    client.spin()
    if options.servo:
        streaming.join()
    client.node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
