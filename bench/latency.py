"""How long a command and a sample take, across processes, with a plain rclpy pair as the yardstick.

Command: from before `publish` of servo_jp in a client process (or before the call of `servo_jp` in plain
Python) until the simulated controller has read the bytes of the servoJ that results.
Sample: from the controller's package to the subscriber's callback in another process; also from the
header's stamp, which is the time at which the driver received the package.
Plain rclpy: the same six messages at the same rate, from their stamp to the callback.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench import processes
from bench.recording import load
from bench.report import options, ratio, show, spread
from crtk_sim_backends.process import RunningSim

Microseconds = NDArray[np.float64]

SETTLE = 1.0
POLL = 0.25
"""Seconds between two requests for the simulator's trace; a larger one would take its time."""
FRONT_TIMEOUT = 30.0
MEASURED_JS = 0
"""Number of the topic in what the client noted."""


class Arrivals:
    """When (monotonic ns) the controller read each commanded position of the last joint."""

    def __init__(self, sim: RunningSim) -> None:
        self._sim = sim
        self._number = 0
        self.times: dict[float, int] = {}

    def collect(self, seconds: float, done: Callable[[], bool] = lambda: False) -> None:
        """Ask the simulator for its trace, now and then, for so long or until `done`."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and not done():
            time.sleep(POLL)
            for entry in self._sim.control.trace(after=self._number):
                self._number = entry["number"]
                position = entry["values"].get("input_double_register_5")
                if position is not None:
                    self.times.setdefault(position, entry["time_ns"])


def command_delays(
    sent: NDArray[np.float64], arrived: dict[float, int]
) -> tuple[Microseconds, int]:
    """Return the delays of the commands that arrived (µs), and how many did not."""
    delays = [(arrived[key] - at) / 1e3 for key, at in sent if key in arrived]
    return np.array(delays), len(sent) - len(delays)


def match(keys: NDArray[np.float64], table: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return, for each of `keys`, the second column of the row of `table` that begins with it."""
    known = dict(table.tolist())
    return np.array([known.get(key, np.nan) for key in keys.tolist()])


class Figures:
    """All delays in µs, collected over the segments."""

    def __init__(self) -> None:
        self.delays: dict[str, list[Microseconds]] = {}
        self.lost = 0
        self.sent = 0

    def add(self, name: str, delays: Microseconds) -> None:
        """Add those of a segment."""
        self.delays.setdefault(name, []).append(delays[np.isfinite(delays)])

    def of(self, name: str) -> Microseconds:
        """Return all of them."""
        return np.concatenate(self.delays[name])


def measure_node(seconds: float, rate: float, publish_rate: float, figures: Figures) -> None:
    """Run one segment of driver, client and simulator."""
    with tempfile.TemporaryDirectory() as folder:
        records = Path(folder)
        with processes.simulator(records) as sim:
            arrived = Arrivals(sim)
            with (
                processes.driver(sim, records, publish_rate),
                processes.client(records, "--enable", "--servo", str(rate)) as client,
            ):
                processes.wait_ready(client)
                arrived.collect(SETTLE)
                begin = time.time_ns()
                arrived.collect(seconds)
                end = time.monotonic_ns()
            arrived.collect(2.0 * POLL)
        heard, sent = load(records, "client_heard"), load(records, "client_sent")
        samples, packages = load(records, "samples"), load(records, "sent")
    sent = sent[sent[:, 1] < end]
    delays, lost = command_delays(sent, arrived.times)
    figures.add("command, ROS", delays)
    figures.lost += lost
    figures.sent += len(sent)
    valid = (heard[:, 1] > 0.0) & (heard[:, 2] > begin)
    mine = heard[valid & (heard[:, 0] == MEASURED_JS)]
    _, first = np.unique(mine[:, 1], return_index=True)
    stamps, called = mine[first, 1], mine[first, 2]
    figures.add("sample, stamp to callback", (called - stamps) / 1e3)
    package_times = match(match(stamps, samples[:, (2, 0)]), packages)
    figures.add("sample, package to callback", (called - package_times) / 1e3)
    figures.add("sample, package to stamp", (stamps - package_times) / 1e3)


def measure_front(seconds: float, rate: float, figures: Figures) -> None:
    """Run one segment of the plain Python front."""
    with tempfile.TemporaryDirectory() as folder:
        records = Path(folder)
        command = [*processes.module("bench.python_front"), "--seconds", str(seconds)]
        with processes.simulator(records) as sim:
            arrived = Arrivals(sim)
            arguments = ["--host", sim.host, "--rate", str(rate)]
            with processes.running([*command, *arguments], records) as front:
                arrived.collect(seconds + FRONT_TIMEOUT, lambda: front.poll() is not None)
            arrived.collect(2.0 * POLL)
        sent = load(records, "front_sent")
        figures.add("command, Python", command_delays(sent, arrived.times)[0])


def measure_bare(seconds: float, rate: float, figures: Figures) -> None:
    """Run one segment of the plain rclpy pair."""
    with tempfile.TemporaryDirectory() as folder:
        records = Path(folder)
        command = [*processes.module("bench.bare_publisher"), "--rate", str(rate)]
        with (
            processes.running([*command, "--namespace", processes.NAMESPACE], records),
            processes.client(records) as client,
        ):
            processes.wait_ready(client)
            time.sleep(SETTLE)
            begin = time.time_ns()
            time.sleep(seconds)
        heard = load(records, "client_heard")
    heard = heard[(heard[:, 0] == MEASURED_JS) & (heard[:, 2] > begin)]
    figures.add("rclpy pair, stamp to callback", (heard[:, 2] - heard[:, 1]) / 1e3)


def main() -> None:
    """Measure and print."""
    given = options(
        __doc__ or "",
        seconds=(30.0, "of each kind"),
        segments=(3, "into which they are split"),
        rate=(125.0, "servo commands a second"),
        publish_rate=(500.0, "messages a second on each topic"),
    )
    figures = Figures()
    each = given.seconds / given.segments
    for _ in range(given.segments):
        measure_node(each, given.rate, given.publish_rate, figures)
        measure_bare(each, given.publish_rate, figures)
        measure_front(each, given.rate, figures)
    yardstick = figures.of("rclpy pair, stamp to callback")
    rows = []
    for name in figures.delays:
        values = figures.of(name)
        rows.append(
            [
                name,
                str(len(values)),
                *spread(values),
                ratio(float(np.median(values)), float(np.median(yardstick))),
                ratio(float(np.percentile(values, 99)), float(np.percentile(yardstick, 99))),
            ]
        )
    show(
        f"Latency, servo_jp at {given.rate:g} Hz, six topics at {given.publish_rate:g} Hz",
        ("what", "n", "p50 µs", "p99 µs", "max µs", "p50 / rclpy", "p99 / rclpy"),
        rows,
        [
            f"{figures.lost} of {figures.sent} ROS commands were replaced by a newer one before they "
            "were sent, or refused.",
        ],
    )


if __name__ == "__main__":
    main()
