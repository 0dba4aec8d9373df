"""The node as a process: signals, exits, and two devices side by side.

A node ends within two seconds: bench/ measures that on a quiet machine.
"""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from sensor_msgs.msg import JointState

from rigs.programs import Program, Start
from rigs.ros_client import RosClient
from rigs.waiting import LONG


@contextmanager
def process(start: Start, *arguments: str) -> Iterator[Program]:
    pipe = subprocess.PIPE
    child = start("rigs.serve_loopback", *arguments, stdout=pipe, stderr=pipe)
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
def test_signals_end_it_with_the_arm_held(start: Start, numbers: list[signal.Signals]) -> None:
    with RosClient("/signalled") as client, process(start, "/signalled") as child:
        client.check_connections()
        client.reach("enable", "ENABLED")
        client.send("move_jp", JointState(position=[0.9, 0.0, 0.0, 0.0]))
        client["operating_state"].wait(lambda m: m.is_busy)
        for number in numbers:
            child.send_signal(number)
        out, err = child.communicate(timeout=LONG)
        assert child.returncode == 0, err
        assert "held" in out
        assert "Traceback" not in err
        last = client["operating_state"].wait(lambda m: m.state == "DISABLED" and not m.is_busy)
        assert last is not None


def test_it_ends_although_a_writer_blocks(start: Start) -> None:
    with process(start, "/blocked", "--block") as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "blocked\n"
        child.send_signal(signal.SIGTERM)
        out, err = child.communicate(timeout=LONG)
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
def test_bad_ros_arguments_end_it_at_once(start: Start, arguments: list[str], text: str) -> None:
    with process(start, "/refused", *arguments) as child:
        _, err = child.communicate(timeout=LONG)
        assert child.returncode != 0
        assert text in err


def test_two_processes_in_two_namespaces(start: Start) -> None:
    with (
        RosClient("/west") as west,
        RosClient("/east") as east,
        process(start, "/west"),
        process(start, "/east"),
    ):
        for client in (west, east):
            client.check_connections()
        west.reach("enable", "ENABLED")
        west.move("move_jp", JointState(position=[0.1, 0.0, 0.0, 0.0]))
        assert east.state.state == "DISABLED"
        east.reach("enable", "ENABLED")
        assert east["measured_js"].wait(since=east["measured_js"].mark()).position[0] == 0.0
        tf = west["/tf"]
        for frame in ("west/tool", "east/tool"):
            tf.wait(lambda m, frame=frame: m.transforms[0].child_frame_id == frame)
