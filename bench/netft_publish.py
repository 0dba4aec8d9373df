"""NetFT on ROS 2: what the node takes to publish measured_cf and raw/measured_cf, of a sensor at 7000 Hz."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions

from bench.netft_stream import sensor
from bench.processes import CRTK_DRIVER, NAMESPACE, running, usage
from bench.report import options, show, spread

INVALID = 1e6
"""Seconds: the age of a message with stamp 0, the mark of data that were too old when they were published."""
RATES = (100.0, 500.0, 1000.0, 2000.0)


def figure(rate: float, seconds: float) -> list[str]:
    """Run the node and a subscriber, and return a row."""
    ages: list[float] = []

    def heard(message: WrenchStamped) -> None:
        stamp = message.header.stamp
        ages.append(time.time() - stamp.sec - stamp.nanosec * 1e-9)

    node = rclpy.create_node("bench_netft", namespace=NAMESPACE)
    executor = EventsExecutor()
    executor.add_node(node)
    node.create_subscription(WrenchStamped, "measured_cf", heard, 10)
    with sensor(7000.0) as port, tempfile.TemporaryDirectory() as folder:
        settings = [
            "host=127.0.0.1", f"rdt_port={port}", "http=false", "profile=netbox", "transport=udp",
            "scale.counts_per_force=1", "scale.counts_per_torque=1",
            f"rate={max(rate, 500.0):g}", f"node.publish_rate={rate:g}",
        ]  # fmt: skip
        command = [*CRTK_DRIVER, "ati-netft", "--ns", NAMESPACE, "--log-level", "warning"]
        for setting in settings:
            command += ["--set", setting]
        with running(command, Path(folder)) as child:
            deadline = time.monotonic() + 30.0
            while len(ages) < 10 and time.monotonic() < deadline:
                executor.spin_once(timeout_sec=0.1)
            ages.clear()
            before, end = usage(child.pid), time.monotonic() + seconds
            while time.monotonic() < end:
                executor.spin_once(timeout_sec=0.01)
            share = usage(child.pid).share_since(before)
    node.destroy_node()
    valid = [age for age in ages if age < INVALID]
    stale = f"{len(ages) - len(valid)}"
    heard_rate = f"{len(ages) / seconds:.0f}"
    return [f"{rate:.0f} Hz", heard_rate, stale, f"{share:.1f}", *spread(valid, 1e3, 2)]


def main() -> None:
    """Measure and print."""
    given = options(__doc__ or "", seconds=(10.0, "for each rate"))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    rows = [figure(rate, given.seconds) for rate in RATES]
    rclpy.try_shutdown()
    columns = ("publish rate", "heard /s", "stale", "CPU %", "age p50 ms", "p99 ms", "max ms")
    notes = [
        "CPU of the whole node in percent of one core, the stream at 7000 Hz included.",
        "Age: from the stamp of the newest measurement in a value to the subscriber's callback.",
    ]
    show("NetFT on ROS 2", columns, rows, notes)


if __name__ == "__main__":
    main()
