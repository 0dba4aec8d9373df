"""The example that has no client of ours: rclpy and topics, at a simulated arm."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from crtk_msgs.msg import OperatingState

from rigs.programs import COMMAND, Start
from rigs.ros_client import RosClient
from rigs.waiting import LONG

SCRIPT = Path(__file__).parents[2] / "examples" / "bare_topics" / "move_and_stream.py"


@contextmanager
def simulated_arm(start: Start, namespace: str, *options: str) -> Iterator[None]:
    """Run a simulated UR as users do, until it is connected."""
    arguments = ("ur", "--ns", namespace, "--sim", "--set", "sample_timeout=3", *options)
    driver = start(COMMAND, *arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        with RosClient(namespace) as client:
            client["operating_state"].wait(is_disabled)
        yield
    finally:
        driver.terminate()
        driver.communicate(timeout=LONG)


def is_disabled(message: OperatingState) -> bool:
    return message.state == "DISABLED"


def run(namespace: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(SCRIPT), namespace]
    return subprocess.run(command, capture_output=True, text=True, timeout=LONG)


def test_bare_topics_move_a_simulated_arm(start: Start) -> None:
    with simulated_arm(start, "/bare", "--set", "stream_timeout=0.5"):
        done = run("/bare")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "the last joint moved by 0.050 rad",
        "it is DISABLED again",
    ]


def test_bare_topics_say_why_refused(start: Start) -> None:
    with simulated_arm(start, "/bare_local", "--sim-set", "remote=false"):
        done = run("/bare_local")
    assert done.returncode == 1
    assert "state_command refused: enable: the teach pendant has control" in done.stderr
