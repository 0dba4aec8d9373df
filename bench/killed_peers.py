"""What becomes of a ROS node when the nodes that it hears are killed: shared memory beside UDP.

Each round, six nodes flood a seventh and are killed (SIGKILL), as a crash or the kernel's memory killer
would. Then the seventh leaves. It may not hang or crash; how long it takes to leave is told.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress

from rich.console import Console
from rich.progress import track

from bench.report import options, show, spread
from crtk_drivers.ros.environment import LOOPBACK, PROFILES, RANGE, TRANSPORTS

PEERS = 6
HUNG = 20.0
"""Seconds."""
ON_THIS_MACHINE = {RANGE: "LOCALHOST"}
BY_UDP = {RANGE: "SYSTEM_DEFAULT", **dict.fromkeys(PROFILES, str(LOOPBACK))}
WAYS = {"shared memory": ON_THIS_MACHINE, "UDP": BY_UDP}


def peer() -> None:
    """Flood whoever listens."""
    import rclpy
    from std_msgs.msg import String

    rclpy.init()
    publisher = rclpy.create_node("peer").create_publisher(String, "text", 10)
    message = String(data="x" * 200)
    while publisher.get_subscription_count() == 0:
        time.sleep(0.01)
    sys.stdout.write("heard\n")
    sys.stdout.flush()
    while True:
        publisher.publish(message)


def survivor() -> None:
    """Hear the others until they are killed; leave, and write how many seconds that took."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from std_msgs.msg import String

    rclpy.init()
    node = rclpy.create_node("survivor")
    node.create_subscription(String, "text", lambda message: None, 10)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    stop = threading.Event()

    def spin() -> None:
        while not stop.is_set():
            executor.spin_once(timeout_sec=0.05)

    thread = threading.Thread(target=spin)
    thread.start()
    peers = [
        subprocess.Popen([*COMMAND, "peer"], stdout=subprocess.PIPE, text=True)
        for _ in range(PEERS)
    ]
    for process in peers:
        assert process.stdout is not None
        process.stdout.readline()
    time.sleep(random.random() * 0.3)
    for process in peers:
        process.kill()
        time.sleep(random.random() * 0.01)
    stop.set()
    thread.join()
    begin = time.monotonic()
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown()
    sys.stdout.write(f"{time.monotonic() - begin}\n")


COMMAND = [sys.executable, "-m", "bench.killed_peers"]
ROLES = {"peer": peer, "survivor": survivor}


def play(environment: dict[str, str]) -> float | str:
    """Play one round; return the seconds that the survivor took to leave, or what became of it."""
    known = {TRANSPORTS, RANGE, *PROFILES}
    inherited = {name: value for name, value in os.environ.items() if name not in known}
    process = subprocess.Popen(
        [*COMMAND, "survivor"],
        stdout=subprocess.PIPE,
        text=True,
        env=inherited | environment,
        start_new_session=True,
    )
    try:
        told, _ = process.communicate(timeout=HUNG)
    except subprocess.TimeoutExpired:
        return "hung"
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
    return float(told) if process.returncode == 0 else "crashed"


def main() -> None:
    """Play the rounds, both ways in turn, and print what became of the survivors."""
    rounds = int(options(__doc__ or "", rounds=(40, "rounds of each way")).rounds)
    ended: dict[str, list[float | str]] = {name: [] for name in WAYS}
    for _ in track(range(rounds), "rounds", console=Console(stderr=True)):
        for name, environment in WAYS.items():
            ended[name].append(play(environment))
    rows = []
    for name, results in ended.items():
        seconds = [result for result in results if not isinstance(result, str)]
        counts = [str(results.count(end)) for end in ("crashed", "hung")]
        rows.append((name, *counts, *spread(seconds, digits=3)))
    show(
        f"A node whose {PEERS} peers were killed, {rounds} times",
        ("", "crashed", "hung", "left in s: p50", "p99", "max"),
        rows,
    )


if __name__ == "__main__":
    if len(sys.argv) == 2 and sys.argv[1] in ROLES:
        ROLES[sys.argv[1]]()
    else:
        main()
