"""The node as a process: signals, exits, and two devices side by side."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from sensor_msgs.msg import JointState

from rigs.ros_client import RosClient

SCRIPT = Path(__file__).parents[2] / "rigs" / "serve_loopback.py"
EXIT = 10.0
"""Seconds. The promise is two; bench/ measures it on a quiet machine."""


@contextmanager
def process(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    child = subprocess.Popen(
        [sys.executable, str(SCRIPT), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield child
    finally:
        child.kill()
        child.communicate()


@pytest.mark.sweep(3)
@pytest.mark.parametrize(
    "numbers",
    [[signal.SIGINT], [signal.SIGTERM], [signal.SIGINT, signal.SIGINT]],
    ids=["interrupted", "terminated", "interrupted twice, as by a launcher that passes it on"],
)
def test_signals_end_it_with_the_arm_held(numbers: list[signal.Signals]) -> None:
    with RosClient("/signalled") as client, process("/signalled") as child:
        client.check_connections()
        client.reach("enable", "ENABLED")
        client.send("move_jp", JointState(position=[0.9, 0.0, 0.0, 0.0]))
        client["operating_state"].wait(lambda m: m.is_busy)
        for number in numbers:
            child.send_signal(number)
        out, err = child.communicate(timeout=EXIT)
        assert child.returncode == 0, err
        assert "held" in out
        assert "Traceback" not in err
        last = client["operating_state"].wait(lambda m: m.state == "DISABLED" and not m.is_busy)
        assert last is not None


def test_it_ends_although_a_writer_blocks() -> None:
    with process("/blocked", "--block") as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "blocked\n"
        child.send_signal(signal.SIGTERM)
        out, err = child.communicate(timeout=EXIT)
        assert child.returncode == 0, err
        assert "held" in out
        assert "still blocks" in err


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--ros-args", "-p", "publish_rate:=fast"], "publish_rate is of the wrong type"),
        (["--ros-args", "-p", "publish_rate:=-3.0"], "publish_rate is out of range"),
        (["--ros-args", "-r", "nonsense"], "ROS does not accept the arguments"),
    ],
)
def test_bad_ros_arguments_end_it_at_once(arguments: list[str], text: str) -> None:
    with process("/refused", *arguments) as child:
        _, err = child.communicate(timeout=EXIT)
        assert child.returncode != 0
        assert text in err


def test_two_processes_in_two_namespaces() -> None:
    with (
        RosClient("/west") as west,
        RosClient("/east") as east,
        process("/west"),
        process("/east"),
    ):
        for client in (west, east):
            client.check_connections()
        west.reach("enable", "ENABLED")
        west.move("move_jp", JointState(position=[0.1, 0.0, 0.0, 0.0]))
        assert east.state.state == "DISABLED"
        east.reach("enable", "ENABLED")
        assert east["measured_js"].messages[-1].position[0] == 0.0
        tf = west["/tf"]
        for frame in ("west/tool", "east/tool"):
            tf.wait(lambda m, frame=frame: m.transforms[0].child_frame_id == frame)
