"""The opening of every dVRK script, again and again, on every device, over ROS 2.

    arm.enable(10)
    arm.home(10)
    arm.move_jp(goal).wait()

by the rules of the official CRTK Python client 1.4: `enable` waits for ENABLED, `home` does not wait where
is_homed is true already, and a move has ended once is_busy has been true since it was sent and is not any
more. What it takes for a move that ended must have ended where it was sent to. Each second round begins
DISABLED, and not homed where a device can be that.

    python -m bench.opening --rounds 100 --only ur
"""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple, Self

import numpy as np
import rclpy
from crtk_msgs.msg import OperatingState, StringStamped
from rclpy.context import Context
from rclpy.experimental import EventsExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from bench.report import show
from crtk_drivers import plugins
from crtk_drivers.config import DeviceConfig, NodeConfig
from crtk_drivers.engine import Engine
from crtk_drivers.ros.serving import Serving
from crtk_drivers.samples import JointState as Joints
from crtk_drivers.session import open_session

CONNECT = 40.0
"""Seconds in which a simulator is up, and the two ends have met."""

PATIENCE = 30.0
"""Seconds that each call of the opening may take."""

STEP = 0.05
"""rad (m) that each joint is moved, to and fro."""


class Candidate(NamedTuple):
    """A device in the bench: its plugin, its configuration, and how far from its goal a joint may rest."""

    plugin: str
    values: Mapping[str, Any]
    sim: bool
    tolerance: float = 0.005


PATIENT = {"sample_timeout": 3.0}
"""Configuration in which a busy machine is no fault."""

DEVICES: Mapping[str, Candidate] = {
    "loopback": Candidate(
        "loopback", {"needs_homing": True, "transition_time": 0.05, **PATIENT}, sim=False
    ),
    "virtual": Candidate("virtual", {"needs_homing": True, **PATIENT}, sim=False),
    "ur": Candidate("ur", {"watchdog_frequency": 2.0, **PATIENT}, sim=True),
    "dynamixel": Candidate(
        "dynamixel", {**PATIENT, "silent_timeout": 2.0, "watchdog": 2.5}, sim=True, tolerance=0.02
    ),
    "canopen": Candidate(
        "canopen",
        {
            **PATIENT,
            "period": 0.01,
            "missed_cycles": 100,
            "heartbeat": {"ours_timeout": 5.0, "drives_timeout": 5.0},
        },
        sim=True,
    ),
}


class Arm:
    """A client of one namespace, by the rules of the official one. A context manager."""

    def __init__(self, namespace: str) -> None:
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node("opening", context=self._context)
        self._latest = OperatingState()
        self._last_busy = 0
        self._event = threading.Condition()
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        topic = f"{namespace}/operating_state"
        self._subscription = self._node.create_subscription(
            OperatingState, topic, self._receive, 10
        )
        self._commands = self._node.create_publisher(
            StringStamped, f"{namespace}/state_command", latched
        )
        self._moves = self._node.create_publisher(JointState, f"{namespace}/move_jp", 10)
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._spin, name="opening")
        self._thread.start()

    def _spin(self) -> None:
        while not self._stop.is_set():
            self._executor.spin_once(timeout_sec=0.05)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *details: object) -> None:
        self._stop.set()
        self._thread.join()
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _receive(self, message: OperatingState) -> None:
        with self._event:
            if message.is_busy:
                self._last_busy = max(self._last_busy, _nanoseconds(message))
            if _nanoseconds(message) > _nanoseconds(self._latest):
                self._latest = message
            self._event.notify_all()

    def _wait(self, test: Callable[[], bool], timeout: float) -> bool:
        with self._event:
            return self._event.wait_for(test, timeout)

    def connect(self) -> None:
        """Wait until every topic has its other end, and the device is connected.

        Raises:
            TimeoutError: it is not in time.
        """
        end = time.monotonic() + CONNECT
        publishers = (self._commands, self._moves)
        while not all(each.get_subscription_count() for each in publishers):
            if time.monotonic() > end:
                raise TimeoutError("nobody listens")
            time.sleep(0.01)
        if not self._wait(lambda: self._latest.state in ("DISABLED", "ENABLED"), CONNECT):
            raise TimeoutError(f"the device is {self._latest.state!r}")

    def state_command(self, text: str) -> None:
        """Send a state command."""
        self._commands.publish(StringStamped(string=text))

    def disable(self, timeout: float) -> bool:
        """Return whether it is DISABLED in time."""
        return self._reach("disable", "DISABLED", timeout)

    def enable(self, timeout: float) -> bool:
        """Return whether it is ENABLED in time."""
        return self._reach("enable", "ENABLED", timeout)

    def _reach(self, command: str, state: str, timeout: float) -> bool:
        known = self._latest.state == state
        self.state_command(command)
        return known or self._wait(lambda: self._latest.state == state, timeout)

    def home(self, timeout: float) -> bool:
        """Return whether it is homed in time."""
        return self._home("home", True, timeout)

    def unhome(self, timeout: float) -> bool:
        """Return whether it is not homed any more in time."""
        return self._home("unhome", False, timeout)

    def _home(self, command: str, homed: bool, timeout: float) -> bool:
        known = self._latest.is_homed is homed
        self.state_command(command)
        return known or self._wait(
            lambda: self._latest.is_homed is homed and not self._latest.is_busy, timeout
        )

    def move_jp(self, goal: np.ndarray, timeout: float) -> bool:
        """Send a move, and return whether it seems to have ended in time."""
        start = time.time_ns()
        self._moves.publish(JointState(position=goal.tolist()))
        return self._wait(lambda: self._last_busy > start and not self._latest.is_busy, timeout)


def _nanoseconds(message: OperatingState) -> int:
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


@contextmanager
def opened(name: str, config: DeviceConfig | None = None) -> Iterator[tuple[Engine, Arm]]:
    """Serve a device of `DEVICES` from this process, and connect a client to it.

    Args:
        name: of the device.
        config: of it; that of `DEVICES` if None.
    """
    candidate, namespace = DEVICES[name], f"/opening_{name}"
    config = config or plugins.device(candidate.plugin).load_config(None, candidate.values)
    session = open_session(candidate.plugin, config, sim=candidate.sim)
    stop = threading.Event()
    with (
        Serving(session.engine, namespace, (), NodeConfig(), session.children) as serving,
        session,
    ):
        thread = threading.Thread(target=serving.spin, args=(stop,), name="serving")
        thread.start()
        try:
            with Arm(namespace) as arm:
                arm.connect()
                yield session.engine, arm
        finally:
            stop.set()
            thread.join()


def measured(engine: Engine) -> np.ndarray:
    """Return where the joints are."""
    found = engine.feedback("measured_js")
    assert found is not None
    assert isinstance(found[0], Joints)
    return np.array(found[0].position)


def rounds(engine: Engine, arm: Arm, count: int, tolerance: float) -> list[str]:
    """Open so many times; return what went wrong."""
    failures: list[str] = []
    for number in range(count):
        begun = True
        if number % 2 == 0:
            begun = not engine.capabilities.needs_homing or arm.unhome(PATIENCE)
            begun = arm.disable(PATIENCE) and begun
        enabled = arm.enable(PATIENCE)
        homed = arm.home(PATIENCE)
        goal = measured(engine) + (STEP if number % 4 < 2 else -STEP)
        moved = arm.move_jp(goal, PATIENCE)
        off = float(np.abs(measured(engine) - goal).max())
        refusal = engine.health().last_refusal
        if not (begun and enabled and homed and moved and off <= tolerance):
            failures.append(
                f"round {number}: unhome and disable {begun}, enable {enabled}, home {homed}, "
                f"move_jp().wait() {moved}, {off:.3f} from its goal; {engine.status}; {refusal}"
            )
    return failures


def main(arguments: Sequence[str] = sys.argv[1:]) -> int:
    """Run it, and print how many moves were carried out of how many."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=100, help="a device (default: 100)")
    parser.add_argument("--only", choices=DEVICES, nargs="+", default=list(DEVICES))
    chosen = parser.parse_args(arguments)
    rows, failed = [], False
    for name in chosen.only:
        begin = time.monotonic()
        with opened(name) as (engine, arm):
            failures = rounds(engine, arm, chosen.rounds, DEVICES[name].tolerance)
        for failure in failures:
            print(f"{name}: {failure}", file=sys.stderr)
        failed = failed or bool(failures)
        well = chosen.rounds - len(failures)
        rows.append([name, str(chosen.rounds), str(well), f"{time.monotonic() - begin:.0f}"])
    show("the opening of dVRK scripts", ["device", "rounds", "carried out", "seconds"], rows)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
