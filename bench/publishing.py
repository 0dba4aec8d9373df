"""What publishing costs: six topics at 500 Hz over UDP, all heard by another process that reads bytes.

A message: processor time of the thread that publishes a joint state of six joints, bare rclpy (a message
object whose stamp is set) beside the driver's way (a value made into bytes, handed over with Python's lock
released). A node: processor time of the driver's whole process, simulated UR at 500 Hz, ENABLED and idle,
beside a process that publishes six such messages by bare rclpy at the same rate and does nothing else. The
two run alternately.
"""

from __future__ import annotations

import signal
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path

from crtk_drivers.ros.environment import share_no_memory

share_no_memory()

import numpy as np  # noqa: E402 - the transport is chosen before
import rclpy  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.signals import SignalHandlerOptions  # noqa: E402
from sensor_msgs.msg import JointState as JointStateMessage  # noqa: E402

from bench import processes  # noqa: E402
from bench.report import options, show  # noqa: E402
from bench.ros_client import TOPICS  # noqa: E402
from crtk_drivers.recording import cdr  # noqa: E402
from crtk_drivers.ros.unlocked import UnlockedNode  # noqa: E402
from crtk_drivers.samples import JointState, vector  # noqa: E402

RATE = 500.0
JOINTS = tuple(f"joint_{index}" for index in range(6))
SETTLE = 1.0


def of_messages(seconds: float, rounds: int) -> dict[str, list[float]]:
    """Return the thread's µs a message, of each round."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    bare, ours = Node("bench_bare"), UnlockedNode("bench_ours")
    topics = [f"/bench/heard_{index}" for index in range(6)]
    with tempfile.TemporaryDirectory() as folder, raw_subscriber(folder, "--joints", *topics):
        plain = [bare.create_publisher(JointStateMessage, topic, 10) for topic in topics]
        unlocked = [ours.create_publisher(JointStateMessage, topic, 10) for topic in topics]
        while any(each.get_subscription_count() == 0 for each in (*plain, *unlocked)):
            time.sleep(0.05)
        message = JointStateMessage(name=list(JOINTS), position=[0.1] * 6, velocity=[0.2] * 6)
        message.effort = [0.3] * 6
        state = JointState(*(vector(np.full(6, x)) for x in (0.1, 0.2, 0.3)), JOINTS)

        def publish_bare(number: int) -> None:
            message.header.stamp.sec = number
            for publisher in plain:
                publisher.publish(message)

        def publish_ours(number: int) -> None:
            for publisher in unlocked:
                publisher.publish(cdr.encode(state, number * 10**9, "base"))

        found: dict[str, list[float]] = {"bare rclpy": [], "the driver's way": []}
        ways = dict(zip(found, (publish_bare, publish_ours), strict=True))
        for _ in range(rounds):
            for name, way in ways.items():
                found[name].append(microseconds(way, round(seconds * RATE)))
    bare.destroy_node()
    ours.destroy_node()
    rclpy.try_shutdown()
    return found


def raw_subscriber(folder: str, *arguments: str) -> AbstractContextManager[subprocess.Popen[str]]:
    """Return `bench.raw_subscriber` to be run in its process."""
    command = [*processes.module("bench.raw_subscriber"), "--namespace", processes.NAMESPACE]
    return processes.running([*command, *arguments], Path(folder))


def microseconds(publish: Callable[[int], None], cycles: int) -> float:
    """Return this thread's processor time a message, at `RATE`."""
    used, due = time.thread_time(), time.monotonic()
    for number in range(cycles):
        publish(number)
        due += 1.0 / RATE
        time.sleep(max(0.0, due - time.monotonic()))
    return 1e6 * (time.thread_time() - used) / (6 * cycles)


def of_node(seconds: float, driven: bool) -> tuple[float, float]:
    """Return CPU in percent of a core, and messages heard a second: of the driver, or of bare rclpy."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        records = Path(folder)
        if driven:
            sim = stack.enter_context(processes.simulator(records, recorded=False))
            node = stack.enter_context(processes.driver(sim, records, RATE, recorded=False))
            enabling = stack.enter_context(processes.client(records, "--enable", "--quiet"))
            processes.wait_ready(enabling)
            enabling.terminate()
            enabling.wait(processes.STOP_TIMEOUT)
        else:
            command = [*processes.module("bench.bare_publisher"), "--rate", str(RATE)]
            node = stack.enter_context(
                processes.running([*command, "--namespace", processes.NAMESPACE], records)
            )
        subscriber = stack.enter_context(raw_subscriber(folder))
        processes.wait_ready(subscriber)
        time.sleep(SETTLE)
        before, begin = processes.usage(node.pid), time.monotonic()
        subscriber.send_signal(signal.SIGUSR1)
        time.sleep(seconds)
        share, elapsed = processes.usage(node.pid).share_since(before), time.monotonic() - begin
        return share, heard_by(subscriber) / elapsed


def heard_by(subscriber: subprocess.Popen[str]) -> int:
    """End `bench.raw_subscriber`, and return how many messages it has heard."""
    subscriber.terminate()
    out, _ = subscriber.communicate(timeout=processes.STOP_TIMEOUT)
    return int(out.split()[-1])


def main() -> None:
    """Measure and print."""
    given = options(__doc__ or "", seconds=(6.0, "of each turn"), turns=(4, "of each way"))
    messages = of_messages(given.seconds, given.turns)
    bare = statistics.median(messages["bare rclpy"])
    rows = [
        [name, f"{(middle := statistics.median(values)):.1f}", f"{middle / bare:.2f}"]
        for name, values in messages.items()
    ]
    show("Publishing a heard message over UDP", ("way", "us a message", "ratio"), rows)
    shares: dict[bool, list[tuple[float, float]]] = {False: [], True: []}
    for _ in range(given.turns):
        for driven, found in shares.items():
            found.append(of_node(given.seconds, driven))
    peer = statistics.median(share for share, _ in shares[False])
    rows = []
    for driven, name in ((False, f"bare rclpy, {len(TOPICS)} messages"), (True, "the driver")):
        share = statistics.median(cpu for cpu, _ in shares[driven])
        rate = statistics.median(heard for _, heard in shares[driven])
        rows.append([name, f"{share:.1f}", f"{share / peer:.2f}", f"{rate:.0f}"])
    show(
        f"A process that publishes {len(TOPICS)} topics at {RATE:g} Hz, all heard",
        ("process", "CPU % of a core", "ratio", f"heard a second, of {len(TOPICS) * RATE:g}"),
        rows,
    )


if __name__ == "__main__":
    main()
