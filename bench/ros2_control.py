"""A robot behind ros2_control: from a command to its controller, and from its joint state to a callback.

The robot is the simulated one, in a process of its own. A node in this process subscribes to the command
topic of its forward controller, as the controller does, and to its joint states. The peer is rclpy without a
driver: a message published on the same topic, and the callback of a plain subscription. All over UDP on this
machine; the stamp of a joint state is from when the robot took it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from bench.report import options, ratio, show, spread
from crtk_driver_ros2_control import PLUGIN
from crtk_driver_ros2_control.config import Ros2ControlConfig
from crtk_drivers.front import LocalDevice
from crtk_drivers.ros import environment

environment.share_no_memory()

import rclpy  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.signals import SignalHandlerOptions  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Float64MultiArray  # noqa: E402

from crtk_drivers.ros.spinning import make_executor, spin  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_sim_backends.ros2_control import SIM  # noqa: E402

CONTROLLER = "forward_position_controller"
PATIENCE = 5.0
GAP = 0.023
"""Seconds between two commands, at the least: a driver sends one for each joint state, at once or with it."""


class Plain:
    """A node without a driver."""

    def __init__(self, namespace: str, context: Context) -> None:
        self.node = rclpy.create_node("plain", context=context)
        topic = f"{namespace}/{CONTROLLER}/commands"
        self.arrived = threading.Event()
        self.at = 0.0
        self.ages: list[float] = []
        self.publisher = self.node.create_publisher(Float64MultiArray, topic, 1)
        self.node.create_subscription(Float64MultiArray, topic, self._command, 1)
        self.node.create_subscription(JointState, f"{namespace}/joint_states", self._state, 1)

    def _command(self, message: Float64MultiArray) -> None:
        self.at = time.perf_counter()
        self.arrived.set()

    def _state(self, message: JointState) -> None:
        stamp = message.header.stamp
        self.ages.append(1e-9 * (time.time_ns() - stamp.sec * 1_000_000_000 - stamp.nanosec))


@contextmanager
def plain(namespace: str) -> Iterator[Plain]:
    """Spin one in a thread."""
    context, stop = Context(), threading.Event()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    found = Plain(namespace, context)
    executor = make_executor(context)
    executor.add_node(found.node)
    thread = threading.Thread(target=spin, args=(executor, stop))
    thread.start()
    try:
        yield found
    finally:
        stop.set()
        thread.join()
        found.node.destroy_node()
        context.try_shutdown()


def commands(send: Any, node: Plain, count: int) -> list[float]:
    """Return how long each of so many commands took to the callback, s."""
    took = []
    for tick in range(count):
        node.arrived.clear()
        began = time.perf_counter()
        send(1e-4 * (tick % 2))
        if node.arrived.wait(PATIENCE):
            took.append(node.at - began)
        time.sleep(GAP + 0.0011 * (tick % 10))  # anywhere between two joint states
    return took


def main() -> None:
    """Measure both and print them."""
    given = options(__doc__ or "", count=(500, "commands"), rate=(100.0, "of joint states, Hz"))
    with SIM.spawn(rate=given.rate) as sim:
        config = PLUGIN.sim_config(Ros2ControlConfig(rate=given.rate, sample_timeout=3.0), sim)
        session = Session(PLUGIN, config)
        arm: Any = LocalDevice(session)
        ages: list[float] = []

        def sample() -> None:
            found = session.engine.feedback("measured_js")
            if found is not None and found[1].wall_ns:
                ages.append(time.monotonic() - found[1].monotonic)

        with session, plain(sim.control.status()["namespace"]) as node:
            while not session.engine.has_sample:
                time.sleep(0.01)
            arm.enable()
            time.sleep(0.5)
            start = np.array(arm.setpoint_jp())

            def publish(offset: float) -> None:
                node.publisher.publish(Float64MultiArray(data=(start + offset).tolist()))

            bare = commands(publish, node, given.count)
            arm.hold()
            time.sleep(0.5)
            ours = commands(lambda offset: arm.servo_jp(start + offset), node, given.count)
            arm.hold()
            node.ages.clear()
            session.engine.on_sample = sample
            before = time.process_time()
            began = time.monotonic()
            time.sleep(given.count / given.rate)
            used = (time.process_time() - before) / (time.monotonic() - began)
            session.engine.on_sample = None
            plain_ages = list(node.ages)
    rows = [
        (
            "command to controller, driver",
            *spread(ours, 1e3, 2),
            ratio(*map(_median, (ours, bare))),
        ),
        ("command to controller, bare rclpy", *spread(bare, 1e3, 2), ""),
        ("joint state to on_sample, driver", *spread(ages, 1e3, 2), ""),
        ("joint state to callback, bare rclpy", *spread(plain_ages, 1e3, 2), ""),
    ]
    show(
        f"ros2_control: {given.count} commands, joint states at {given.rate:g} Hz",
        ("", "p50 ms", "p99 ms", "max ms", "to bare"),
        rows,
        (
            "The driver's age is from the earliest arrival of the last 10 s: what the network takes at the "
            "least is not in it. bare rclpy's is from the stamp, on one clock.",
            f"{100.0 * used:.1f} % of a core by driver and plain node together, no command.",
        ),
    )


def _median(values: list[float]) -> float:
    return float(np.median(values)) if values else 0.0


if __name__ == "__main__":
    main()
