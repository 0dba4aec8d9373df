"""How long an arm takes to stand after a stop while other clients flood the driver, beside a quiet one.

A client streams positions, so that the first joint goes to and fro at a constant speed. Others send valid
messages to one topic as fast as they can, or at a rate. Then a third client sends ``hold`` or ``disable``.
What counts is the stamp of the first sample of which the joint stands, less the time at which the stop was
sent. The flooders' processors are those of this machine: on two cores they take most of both.
"""

from __future__ import annotations

import math
import os
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from bench import processes
from bench.report import options, show
from crtk_drivers.ros import environment

SPEED = 0.3
"""rad/s of the first joint."""
SWEEP = 0.6
"""rad from which it turns back."""
STEP_RATE = 200.0
"""Hz of the stream that moves it."""
STANDS = 1e-3
"""rad/s below which it stands."""
FLOODED = 1.0
"""Seconds of the flood before the stop."""
PATIENCE = 20.0
DRIVER = ("virtual", "--ns", processes.NAMESPACE, "--log-level", "error")
STOPS = ("hold", "disable")
CASES: Sequence[tuple[str, str, int, float]] = (
    ("quiet: 200 a second", "", 0, 0.0),
    ("servo_jp, 2500 a second", "servo_jp", 1, 2500.0),
    ("servo_jp, 10 000 a second", "servo_jp", 1, 10_000.0),
    ("servo_jp, 40 000 a second", "servo_jp", 1, 40_000.0),
    ("servo_jp, one tight loop", "servo_jp", 1, 0.0),
    ("servo_jp, two tight loops", "servo_jp", 2, 0.0),
    ("servo_jr, one tight loop", "servo_jr", 1, 0.0),
    ("state_command, one tight loop", "state_command", 1, 0.0),
)
"""What is flooded: topic, clients, messages a second of each (0: a tight loop)."""


def _joint_state(position: Sequence[float]) -> Any:
    from sensor_msgs.msg import JointState

    return JointState(position=[float(each) for each in position])


def _node(name: str) -> Any:
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    from crtk_drivers.ros.unlocked import UnlockedNode

    environment.share_no_memory()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    return UnlockedNode(f"{name}_{os.getpid()}", namespace=processes.NAMESPACE, enable_rosout=False)


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def _measured(node: Any) -> Sequence[float]:
    """Return where the joints are."""
    from rclpy.executors import SingleThreadedExecutor
    from sensor_msgs.msg import JointState

    heard: list[Sequence[float]] = []
    node.create_subscription(JointState, "measured_js", lambda m: heard.append(m.position), 1)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not heard:
        executor.spin_once()
    executor.remove_node(node)
    return heard[-1]


def sender(topic: str, rate: float) -> None:
    """Send valid messages; on ``servo_jp`` those that move the joint. Say how many went out until now."""
    from crtk_msgs.msg import StringStamped
    from rclpy.serialization import serialize_message

    node = _node("sender")
    mark = 0.0123
    joints = _measured(node)
    way = -SWEEP if joints[0] > 0.0 else SWEEP
    message = StringStamped(string="enable")
    if topic == "servo_jp":
        message = _joint_state([mark, *joints[1:]])
    elif topic != "state_command":
        message = _joint_state([0.0] * len(joints) if topic.endswith("r") else joints)
    publisher = node.create_publisher(type(message), topic, 10)
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    data = serialize_message(message)
    before, _, after = data.partition(struct.pack("<d", mark))
    at_once = max(1, int(rate / 1000.0)) if rate else 50
    begin, sent, told = time.monotonic(), 0, 0
    _say(f"ready {begin}")
    while True:
        elapsed = time.monotonic() - begin
        if topic == "servo_jp":
            turn = (SPEED * elapsed / SWEEP) % 2.0
            data = before + struct.pack("<d", joints[0] + way * min(turn, 2.0 - turn)) + after
        for _ in range(at_once):
            publisher.publish(data)
        sent += at_once
        if rate:
            time.sleep(max(0.0, sent / rate - (time.monotonic() - begin)))
        if elapsed > 0.25 * (told + 1):
            told += 1
            _say(f"{sent} {elapsed}")


class Commander:
    """Enables the arm, sends stops, and hears when the joint stands."""

    def __init__(self) -> None:
        from crtk_msgs.msg import OperatingState, StringStamped
        from rclpy.experimental import EventsExecutor
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Empty

        self._node = _node("commander")
        self._kinds = {"hold": Empty, "state_command": StringStamped}
        self._publishers = {
            name: self._node.create_publisher(kind, name, 10) for name, kind in self._kinds.items()
        }
        self._node.create_subscription(OperatingState, "operating_state", self._take_state, 10)
        self._node.create_subscription(JointState, "measured_js", self._take_joints, 100)
        self._executor = EventsExecutor()
        self._executor.add_node(self._node)
        self._state = ""
        self._heard: list[tuple[float, float]] = []

    def _take_state(self, message: Any) -> None:
        self._state = message.state

    def _take_joints(self, message: Any) -> None:
        if not message.velocity:
            return  # nothing was measured yet
        stamp = message.header.stamp
        self._heard.append((stamp.sec + 1e-9 * stamp.nanosec, abs(message.velocity[0])))

    def _wait(self, done: Callable[[], bool], what: str) -> None:
        end = time.monotonic() + PATIENCE
        while not done():
            if time.monotonic() > end:
                raise TimeoutError(f"{what}: not in {PATIENCE:g} s")
            self._executor.spin_once(timeout_sec=0.05)

    def send(self, word: str) -> float:
        """Send a stop or a state command; return when (s since the epoch) that was."""
        name = "hold" if word == "hold" else "state_command"
        message = self._kinds[name]()
        if name == "state_command":
            message.string = word
        sent = time.time()
        self._publishers[name].publish(message)
        return sent

    def reach(self, word: str, state: str) -> None:
        """Send a state command until its state is told."""
        asked = 0.0

        def reached() -> bool:
            nonlocal asked
            if self._state != state and time.monotonic() - asked > 2.0:
                asked = time.monotonic()
                self.send(word)
            return self._state == state

        self._wait(reached, word)

    def wait_to_move(self) -> None:
        """Wait until the joint has moved in all samples of a fifth of a second."""
        self._heard.clear()

        def moves() -> bool:
            newest = [speed for _, speed in self._heard[-40:]]
            return len(newest) == 40 and min(newest) > 0.2 * SPEED

        self._wait(moves, "the joint moves")

    def stop(self, word: str) -> float:
        """Send a stop; return after how many seconds the joint stood, for good."""
        self._heard.clear()
        sent = self.send(word)

        def stands() -> bool:
            return len(self._heard) > 40 and max(speed for _, speed in self._heard[-40:]) < STANDS

        self._wait(stands, f"standing after {word}")
        return max(stamp for stamp, speed in self._heard if speed >= STANDS) - sent

    def listen(self, seconds: float) -> None:
        """Go on hearing."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.05)


COMMAND = [sys.executable, "-m", "bench.flood"]


def _rate(process: subprocess.Popen[str]) -> float:
    """Return how many messages a second are sent, by what the sender said last."""
    assert process.stdout is not None
    os.set_blocking(process.stdout.fileno(), False)
    said = os.read(process.stdout.fileno(), 1 << 16).decode().splitlines()
    count, elapsed = map(float, said[-1].split())
    return count / elapsed


def play(
    commander: Commander, records: Path, stop: str, case: tuple[str, str, int, float]
) -> tuple[float, float]:
    """Return after how many seconds the joint stood, and how many messages a second were sent."""
    _, topic, clients, rate = case
    commander.reach("disable", "DISABLED")
    commander.reach("enable", "ENABLED")
    with ExitStack() as stack:

        def start(topic: str, rate: float) -> subprocess.Popen[str]:
            command = [*COMMAND, "sender", topic, str(rate)]
            process: subprocess.Popen[str] = stack.enter_context(
                processes.running(command, records)
            )
            processes.wait_ready(process)
            return process

        if topic != "servo_jp":
            start("servo_jp", STEP_RATE)
            commander.wait_to_move()
        senders = [start(topic, rate) for _ in range(clients)]
        commander.listen(FLOODED)
        commander.wait_to_move()
        stood = commander.stop(stop)
        return stood, sum(map(_rate, senders))


def main() -> None:
    """Play each case, and print after how long the joint stood."""
    arguments = options(
        __doc__ or "", rounds=(5, "stops of each kind and case"), case=(-1, "only this one")
    )
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        records = Path(folder)
        with processes.running([*processes.CRTK_DRIVER, *DRIVER], records) as driver:
            commander = Commander()
            chosen = CASES if arguments.case < 0 else [CASES[arguments.case]]
            for case in chosen:
                rates, cells = [], []
                before = processes.usage(driver.pid)
                for stop in STOPS:
                    stood = []
                    for _ in range(int(arguments.rounds)):
                        try:
                            seconds, rate = play(commander, records, stop, case)
                        except TimeoutError as error:
                            seconds, rate = math.inf, math.nan
                            sys.stderr.write(f"{case[0]}: {error}\n")
                        stood.append(seconds)
                        rates.append(rate)
                    cells += [f"{np.median(stood):.3f}", f"{max(stood):.3f}"]
                busy = processes.usage(driver.pid).share_since(before)
                rows.append((case[0], f"{np.nanmedian(rates):.0f}", *cells, f"{busy:.0f} %"))
                sys.stderr.write(f"{rows[-1]}\n")
    columns = [f"{stop}: {what}" for stop in STOPS for what in ("p50", "max")]
    show(
        "Seconds from a stop to standing",
        ("flood", "sent/s", *columns, "CPU of the driver"),
        rows,
    )


if __name__ == "__main__":
    if sys.argv[1:2] == ["sender"]:
        sender(sys.argv[2], float(sys.argv[3]))
    else:
        main()
