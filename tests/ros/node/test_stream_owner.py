"""A stream has an owner, over DDS: of two nodes that stream, only the first is obeyed."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty

from crtk_drivers.device import Setpoint
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
from rigs.loopback_node import Rig, rig_of
from rigs.waiting import eventually

SCRIPT = Path(__file__).parents[2] / "rigs" / "stream_positions.py"
MINE, OTHERS = 0.01, 0.02


class RecordingDevice(LoopbackDevice):
    """Remembers which first joint's positions were written."""

    def __init__(self, config: LoopbackConfig) -> None:
        super().__init__(config)
        self.written: set[float] = set()

    def write(self, setpoint: Setpoint) -> None:
        super().write(setpoint)
        self.written.add(float(setpoint.values[0]))


PLUGIN = DevicePlugin("loopback", "remembers", LoopbackConfig, RecordingDevice)


@pytest.fixture(scope="module")
def shared_rig() -> Iterator[Rig]:
    # Long enough for this machine not to end a stream by being busy elsewhere.
    with rig_of("/owned", plugin=PLUGIN, stream_timeout=3.0, mode_switch_dwell=0.1) as rig:
        yield rig


@pytest.fixture
def owned(rig: Rig) -> Rig:
    rig.client.reach("enable", "ENABLED")
    written(rig).clear()
    return rig


def written(rig: Rig) -> set[float]:
    assert isinstance(rig.device, RecordingDevice)
    return rig.device.written


def position(x: float) -> JointState:
    return JointState(position=[x, 0.0, 0.0, 0.0])


def refused(rig: Rig, name: str) -> int:
    return rig.session.engine.health().refusals.get(f"{name}: stream_owned", 0)


def streaming_until(rig: Rig, condition: Any, what: str) -> None:
    """Stream, as one that does not stop, until a condition holds."""

    def sent() -> bool:
        rig.client.send("servo_jp", position(MINE))
        return bool(condition())

    eventually(sent, what)


def told(rig: Rig, since: int, text: str) -> None:
    rig.client["refusals"].wait(lambda m: text in json.loads(m.data)["message"], since)


@contextmanager
def another_process(name: str) -> Iterator[subprocess.Popen[bytes]]:
    values = (str(OTHERS), "0", "0", "0")
    child = subprocess.Popen(
        [sys.executable, str(SCRIPT), "/owned", name, *values],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    try:
        assert child.stdout is not None
        assert child.stdout.readline() == b"ready\n"
        yield child
    finally:
        child.kill()
        child.communicate()


@pytest.mark.slow  # two nodes of a process are its quick brother
def test_another_process_is_refused_takes_over_and_is_held(owned: Rig) -> None:
    since, before = owned.client["refusals"].mark(), refused(owned, "servo_jp")
    with another_process("elsewhere") as child:
        streaming_until(owned, lambda: MINE in written(owned), "the first is obeyed")
        assert child.stdin is not None
        child.stdin.write(b"go\n")
        child.stdin.flush()
        streaming_until(owned, lambda: refused(owned, "servo_jp") > before + 5, "it is refused")
        told(owned, since, "the node /test_client streams servo_jp")
        assert written(owned) == {MINE}

        eventually(lambda: OTHERS in written(owned), "it takes over when the first is silent")
        before = refused(owned, "servo_jp")
        streaming_until(owned, lambda: refused(owned, "servo_jp") > before, "the first is refused")
        told(owned, since, "the node /elsewhere streams servo_jp")
        owned.client.send("move_jp", position(0.3))
        eventually(lambda: refused(owned, "move_jp") > 0, "a move of another is refused")

        owned.client.send("hold", Empty())
        told(owned, since, "the node /test_client ended this stream with hold")
        owned.client.move("move_jp", position(0.3))
        measured = owned.client["measured_js"]
        measured.wait(lambda m: abs(m.position[0] - 0.3) < 1e-3, measured.mark())


@contextmanager
def another_node(rig: Rig, name: str) -> Iterator[Node]:
    """In the process, and the ROS context, of the first."""
    node = rclpy.create_node(
        name, context=rig.client.node.context, enable_rosout=False, start_parameter_services=False
    )
    try:
        yield node
    finally:
        node.destroy_node()


def test_two_nodes_of_a_process_are_two_clients(owned: Rig) -> None:
    since, before = owned.client["refusals"].mark(), refused(owned, "servo_jp")
    with another_node(owned, "neighbour") as node:
        publisher = node.create_publisher(JointState, "/owned/servo_jp", 10)
        eventually(lambda: publisher.get_subscription_count() == 1, "they have met")
        streaming_until(owned, lambda: MINE in written(owned), "the first is obeyed")

        def both_sent() -> bool:
            publisher.publish(position(OTHERS))
            return refused(owned, "servo_jp") > before + 20

        streaming_until(owned, both_sent, "the second is refused")
        told(owned, since, "the node /test_client streams servo_jp")
        assert written(owned) == {MINE}


def test_topics_of_a_node_are_one_client(owned: Rig) -> None:
    before = refused(owned, "move_jp")
    streaming_until(owned, lambda: MINE in written(owned), "it streams")
    owned.client.move("move_jp", position(0.2))
    assert refused(owned, "move_jp") == before
    owned.client.send("servo_jp", position(0.2))
    eventually(lambda: 0.2 in written(owned), "it streams again")
