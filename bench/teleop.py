"""From a leader's measurement to what the follower is sent, and what that costs.

A leader that tells measured_cp at 500 Hz and a follower that takes servo_cp are bare rclpy in this process;
between them is, as a process of its own,

crtk-driver teleop   at 200 Hz, as a user starts it
a polling loop       as the community's scripts: measured_cp, servo_cp, sleep, at 200 Hz, by the same client
and nothing          the same message from publish to callback, once

Times are from before the leader's publish to the follower's callback. Each pose carries its number.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
import time
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import rclpy
from crtk_msgs.msg import OperatingState
from geometry_msgs.msg import PoseStamped
from rclpy.context import Context
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Joy
from std_msgs.msg import Empty

from bench.report import options, ratio, show, spread
from crtk_drivers.ros.spinning import make_executor

LEADER, FOLLOWER, PEDAL = "/bench_hand", "/bench_arm", "/bench_pedal"
STEP: Final = 1e-7
"""Metres between two poses of the leader: a minute of them is a few millimetres."""
LEADER_RATE: Final = 500.0

LAB = f"""
[teleop]
leader = "{LEADER}"
follower = "{FOLLOWER}"
timeout = 1.0
[teleop.engage]
topic = "{PEDAL}"
"""
POLLING = f"""
import time
from crtk_drivers.client import connect

with connect("{LEADER}") as leader, connect("{FOLLOWER}") as follower:
    start, at = follower.measured_cp(wait=10.0), leader.measured_cp(wait=10.0)
    while True:
        here = leader.measured_cp()
        follower.servo_cp([*(start.position + here.position - at.position), 0.0, 0.0, 0.0, 1.0])
        time.sleep(0.005)
"""


class Both:
    """The leader and the follower."""

    def __init__(self) -> None:
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node("bench_teleop", context=self._context)
        make = self.node.create_publisher
        self.hand = make(PoseStamped, f"{LEADER}/measured_cp", 10)
        self._arm = make(PoseStamped, f"{FOLLOWER}/measured_cp", 10)
        self._pedal = make(Joy, PEDAL, 10)
        self._states = [
            make(OperatingState, f"{each}/operating_state", 10) for each in (LEADER, FOLLOWER)
        ]
        self.node.create_subscription(
            PoseStamped, f"{FOLLOWER}/servo_cp", self._moved, QoSProfile(depth=10)
        )
        self.node.create_subscription(
            PoseStamped, f"{LEADER}/measured_cp", self._heard, QoSProfile(depth=10)
        )
        for each in (LEADER, FOLLOWER):
            self.node.create_subscription(Empty, f"{each}/hold", lambda message: None, 10)
        self.sent: list[int] = []
        self.through: dict[int, int] = {}
        self.direct: dict[int, int] = {}
        self.moves = False
        self.pressed = False
        self.is_followed = False
        self._x = 0.0
        self._stop = threading.Event()
        self._executor = make_executor(self._context)
        self._executor.add_node(self.node)
        self._threads = [threading.Thread(target=each) for each in (self._spin, self._tell)]
        for thread in self._threads:
            thread.start()

    def _spin(self) -> None:
        while not self._stop.is_set():
            self._executor.spin_once(timeout_sec=0.05)

    def _stamped(self, kind: Any) -> Any:
        message = kind()
        message.header.stamp = self.node.get_clock().now().to_msg()
        return message

    def _pose(self, x: float) -> Any:
        message = self._stamped(PoseStamped)
        message.pose.position.x, message.pose.orientation.w = x, 1.0
        return message

    def _tell(self) -> None:
        due, count = time.monotonic(), 0
        while not self._stop.is_set():
            due += 1.0 / LEADER_RATE
            time.sleep(max(0.0, due - time.monotonic()))
            if self.moves:
                message = self._pose(STEP * len(self.sent))
                self.sent.append(time.monotonic_ns())
                self.hand.publish(message)
            else:
                self.hand.publish(self._pose(0.0))
            if count % 5 == 0:
                self._arm.publish(self._pose(self._x))
            if count % 50 == 0:
                joy = self._stamped(Joy)
                joy.buttons = array("i", [int(self.pressed)])
                self._pedal.publish(joy)
                for each in self._states:
                    state = self._stamped(OperatingState)
                    state.state, state.is_homed = "ENABLED", True
                    each.publish(state)
            count += 1

    def _moved(self, message: Any) -> None:
        now, self.is_followed = time.monotonic_ns(), True
        self._x = message.pose.position.x
        self.through.setdefault(round(self._x / STEP), now)

    def _heard(self, message: Any) -> None:
        self.direct.setdefault(round(message.pose.position.x / STEP), time.monotonic_ns())

    def delays(self, arrived: dict[int, int]) -> np.ndarray:
        """Return the delays (ns) of those poses that arrived first; 0 was sent before."""
        return np.array(
            [at - self.sent[n] for n, at in dict(arrived).items() if 0 < n < len(self.sent)]
        )

    def close(self) -> None:
        """End all."""
        self._stop.set()
        for thread in self._threads:
            thread.join()
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()


def cpu_of(pid: int) -> float:
    """Return the CPU time (s) that a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def until(condition: Callable[[], bool]) -> None:
    """Wait for it."""
    end = time.monotonic() + 60.0
    while not condition():
        if time.monotonic() > end:
            raise SystemExit("they were not coupled within a minute")
        time.sleep(0.01)


def measured(command: list[str], seconds: float) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Return delays through it and direct ones (ns), setpoints a second, and CPU in percent."""
    both = Both()
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    try:
        if "teleop" in command:
            for line in process.stderr:
                if "RELEASED" in line:
                    break
        both.pressed = True
        until(lambda: both.is_followed)
        before, both.moves = cpu_of(process.pid), True
        time.sleep(seconds)
        used = (cpu_of(process.pid) - before) / seconds
        return (
            both.delays(both.through),
            both.delays(both.direct),
            len(both.through) / seconds,
            used,
        )
    finally:
        process.kill()
        process.communicate()
        both.close()


def main() -> None:
    """Measure and print."""
    given = options(__doc__ or "", seconds=(20.0, "of each"))
    with tempfile.TemporaryDirectory() as folder:
        lab = Path(folder) / "lab.toml"
        lab.write_text(LAB)
        ways = {
            "crtk-driver teleop": [sys.executable, "-m", "crtk_drivers.cli", "teleop", str(lab)],
            "a polling loop": [sys.executable, "-c", POLLING],
        }
        found = {name: measured(command, given.seconds) for name, command in ways.items()}
    direct = np.concatenate([each[1] for each in found.values()])
    polled = float(np.median(found["a polling loop"][0]))
    rows = [
        [
            name,
            *spread(through, 1e-3),
            ratio(float(np.median(through)), polled),
            f"{rate:.0f}",
            f"{100 * cpu:.0f}",
        ]
        for name, (through, _, rate, cpu) in found.items()
    ]
    rows.append(["publish to callback, nothing between", *spread(direct, 1e-3), "", "", ""])
    show(
        "Leader to follower, µs",
        ["", "p50", "p99", "max", "of polling", "setpoints/s", "CPU %"],
        rows,
    )


if __name__ == "__main__":
    main()
