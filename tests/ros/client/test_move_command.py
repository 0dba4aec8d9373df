"""`crtk-driver move` to joint positions of devices whose names, places or units are unusual."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from crtk_msgs.msg import OperatingState as OperatingStateMessage
from sensor_msgs.msg import JointState as JointStateMessage
from std_msgs.msg import Empty

from crtk_drivers.cli import move_command
from crtk_drivers.client import move_handle
from crtk_drivers.errors import ConfigError
from crtk_drivers.samples import JointState, vector
from rigs.loopback_client import Node
from rigs.waiting import LONG, eventually

pytestmark = pytest.mark.ros

FOUND = ("--timeout", str(LONG))
Run = Callable[..., tuple[int, str, str]]


class Still:
    """A device at a place, with what its manifest says of its joints."""

    namespace = "/still"
    crtk_commands = ("measured_js", "move_jp")

    def __init__(self, names: Sequence[str], place: Sequence[float], **joints: Any) -> None:
        self._measured = JointState(vector(place), name=tuple(names))
        self.manifest = {"joints": [{"name": name, **each} for name, each in joints.items()]}

    def measured_js(self) -> JointState:
        return self._measured


def goal(device: Still, *values: str, relative: bool = False, degrees: bool = False) -> list[float]:
    anything: Any = device
    found = move_command._joint_goal(anything, values, relative, degrees)
    return np.asarray(found.value).tolist()  # type: ignore[no-any-return]


def refusal(device: Still, *values: str, relative: bool = False, degrees: bool = False) -> str:
    with pytest.raises(ConfigError) as caught:
        goal(device, *values, relative=relative, degrees=degrees)
    return str(caught.value)


@contextmanager
def another_makers(namespace: str, message: JointStateMessage) -> Iterator[list[list[float]]]:
    """Publish where its joints are, and that it is ENABLED; give the goals that it receives."""
    goals: list[list[float]] = []
    ended = threading.Event()
    with Node(namespace.strip("/")) as made:
        node = made.node
        node.create_subscription(
            JointStateMessage,
            f"{namespace}/move_jp",
            lambda heard: goals.append(list(heard.position)),
            10,
        )
        node.create_subscription(Empty, f"{namespace}/hold", lambda heard: None, 10)
        places = node.create_publisher(JointStateMessage, f"{namespace}/measured_js", 10)
        states = node.create_publisher(OperatingStateMessage, f"{namespace}/operating_state", 10)

        def publish() -> None:
            while not ended.wait(0.02):
                now = node.get_clock().now().to_msg()
                message.header.stamp = now
                places.publish(message)
                state = OperatingStateMessage(state="ENABLED", is_homed=True)
                state.header.stamp = now
                states.publish(state)

        thread = threading.Thread(target=publish)
        thread.start()
        try:
            yield goals
        finally:
            ended.set()
            thread.join()


@pytest.mark.parametrize("names", [["", ""], ["j", "j"], []])
def test_values_in_order_reach_joints_in_order(
    run_far: Run, monkeypatch: pytest.MonkeyPatch, names: list[str]
) -> None:
    monkeypatch.setattr(move_handle, "ACCEPT_TIMEOUT", 0.05)
    monkeypatch.setattr(move_command, "START_TIMEOUT", 0.0)  # it never moves
    message = JointStateMessage(name=names, position=[0.0, 0.0])
    with another_makers("/unnamed", message) as goals:
        run_far("move", "/unnamed", "0.1", "0.7", *FOUND)
        eventually(lambda: goals, "the goal was received")
    assert np.allclose(goals[0], [0.1, 0.7])


def test_a_name_must_be_of_one_joint_and_given_once() -> None:
    two = Still(["j", "j"], [0.0, 0.0])
    assert "/still j: 2 joints have this name. Give one number for each of j, j." in refusal(
        two, "j=0.1"
    )
    assert "a: was given twice" in refusal(Still(["a", "b"], [0.0, 0.0]), "a=0.1", "a=0.5")
    assert goal(Still(["", ""], [0.0, 0.0]), "2=0.5") == [0.0, 0.5]
    assert goal(Still(["a", "a", "b"], [0.0] * 3), "b=0.5") == [0.0, 0.0, 0.5]
