"""``crtk-driver igtl`` as a process, at a device on ROS: seen, moved, and held when the peer is gone."""

from __future__ import annotations

import re
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from crtk_drivers.cli import main  # noqa: E402
from crtk_drivers.samples import JointState, Number  # noqa: E402
from crtk_drivers.testing.loopback import LoopbackConfig  # noqa: E402
from rigs.igtl_peer import IgtlPeer, sensor, string  # noqa: E402
from rigs.loopback_node import serve  # noqa: E402
from rigs.programs import COMMAND, Program, Start  # noqa: E402
from rigs.waiting import LONG, eventually  # noqa: E402


@contextmanager
def bridging(start: Start, *arguments: str) -> Iterator[tuple[Program, int]]:
    """The command as a process, and its port."""
    words = ("igtl", *arguments, "--port", "0", "--timeout", f"{LONG}")
    with start(COMMAND, *words, stderr=subprocess.PIPE) as process:
        try:
            assert process.stderr is not None
            for line in process.stderr:
                if found := re.search(r"listening at 127\.0\.0\.1:(\d+)", line):
                    yield process, int(found[1])
                    break
            else:
                pytest.fail("it does not listen")
        finally:
            process.kill()


def test_a_device_on_ros_is_seen_and_moved_and_held_when_the_peer_or_the_bridge_is_gone(
    start: Start,
) -> None:
    with (
        serve(LoopbackConfig(), "/igtl_arm", []) as (session, _),
        bridging(start, "left=/igtl_arm", "--units", "m") as (process, port),
    ):
        engine = session.engine
        for leave in ("peer", "bridge"):
            peer = IgtlPeer.connected(port)
            peer.until("TRANSFORM", "left/measured_cp")
            peer.send("STRING", "left/state_command", string("enable"))
            eventually(lambda: engine.status.state == "ENABLED", "it is enabled")
            engine.submit("trajectory_j/set_ratio", Number(0.05))
            goal = 0.9 if leave == "peer" else -0.9
            peer.send("SENSOR", "left/move_jp", sensor(goal, 0.0, 0.0, 0.0))
            eventually(lambda: engine.status.is_busy, "it moves")
            if leave == "peer":
                peer.close()
            else:
                process.send_signal(signal.SIGINT)
            eventually(lambda: not engine.status.is_busy, "it is held")
            found = engine.feedback("measured_js")
            assert found is not None
            assert isinstance(found[0], JointState)
            assert abs(found[0].position[0]) < 0.8
            assert engine.status.state == "ENABLED"
        assert process.wait(LONG) == 0
        peer.close()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["a/b=/ur5"], "a/b name of messages"),
        (["/a/arm", "/b/arm"], "is there twice"),
        (["/ur5", "--units", "inch"], "is no unit"),
        (["/ur5", "--connect", "host:port"], "is no port"),
    ],
)
def test_what_cannot_be_used_is_refused_before_anything_is_looked_for(
    arguments: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["igtl", *arguments]) == 2
    assert told in capsys.readouterr().err
