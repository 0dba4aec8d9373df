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

from crtk_drivers.cli import move_command, typed_goals
from crtk_drivers.cli.state_view import print_position
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
    found = typed_goals.joint_goal(anything, values, relative, degrees)
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


def gripper(place: float, *, unit: str = "m", **limits: float) -> Still:
    joint = {"unit": unit, "lower": 0.0, "upper": 0.085, **limits}
    return Still(["opening"], [place], opening=joint)


@pytest.mark.parametrize(
    ("device", "options", "example"),
    [
        (gripper(0.085), {"relative": True}, "--relative opening=-0.01 (m, further)"),
        (gripper(0.0), {"relative": True}, "--relative opening=0.01 (m, further)"),
        (
            gripper(0.003, upper=0.0077),
            {"relative": True},
            "--relative opening=0.004 (m, further)",
        ),
        (gripper(0.0846, upper=0.0846), {}, "opening=0.084 (m, where it is)"),
        (gripper(0.0861), {}, "opening=0.085 (m, where it is)"),
        (gripper(1.5708, unit="rad", upper=1.5708), {}, "opening=1.57 (rad, where it is)"),
        (
            gripper(1.5708, unit="rad", upper=1.5708),
            {"relative": True, "degrees": True},
            "--relative --degrees opening=-1 (degrees, further)",
        ),
        (
            gripper(0.0199, unit="rad", upper=0.0199),
            {"degrees": True},
            "--degrees opening=1.1 (degrees, where it is)",
        ),
        (
            gripper(0.04),
            {"degrees": True},
            "Leave --degrees out: crtk-driver move /still opening=0.04 (m",
        ),
        (gripper(4e4, unit="Pa", upper=1e5), {"degrees": True}, "and this joint is in Pa"),
    ],
)
def test_a_proposed_example_is_within_the_limits(
    device: Still, options: dict[str, bool], example: str
) -> None:
    told = refusal(device, "opening", **options)
    assert example in told
    proposed = next((each for each in told.split() if each.startswith("opening=")), "")
    options = {key: f"--{key}" in example.replace("Leave --degrees", "") for key in options}
    limits: dict[str, float] = device.manifest["joints"][0]
    assert limits["lower"] <= goal(device, proposed, **options)[0] <= limits["upper"]


def test_no_example_is_made_of_a_place_that_is_not_finite() -> None:
    told = refusal(Still(["a"], [np.nan]), "a")
    assert (
        told == "/still a: has no value. Give one number for each of a; or joint=number for some."
    )


def test_degrees_of_what_is_no_angle_are_not_sent() -> None:
    told = refusal(gripper(0.04), "1", degrees=True)
    assert "/still opening: --degrees is for angles, and this joint is in m" in told
    assert np.allclose(goal(gripper(0.0, unit="rad"), "1", degrees=True), np.radians(1.0))
    assert np.allclose(goal(Still(["a"], [0.0]), "1", degrees=True), np.radians(1.0))


@pytest.mark.parametrize("text", ["=0.1", "="])
def test_an_empty_name_is_refused(text: str) -> None:
    assert f"value 1: {text!r} names no joint" in refusal(Still(["a"], [0.0]), text)


@pytest.mark.parametrize("text", ["0.1", "a=0.1", "a"])
def test_a_device_without_joints_is_refused(text: str) -> None:
    assert "/still: reports no joint positions" in refusal(Still([], []), text)


@pytest.mark.parametrize(
    ("units", "to_go", "heading"),
    [
        (["Pa"], "0.300 Pa to go", "measured (Pa)"),
        (["rad", "m"], "0.300 m to go", "measured (rad, m)"),
        (["rad", ""], "0.300 rad or m to go", "measured (rad, m)"),
    ],
)
def test_units_are_those_of_the_joints(
    capfd: pytest.CaptureFixture[str], units: list[str], to_go: str, heading: str
) -> None:
    names = ["a", "b"][: len(units)]
    joints = {
        n: {"unit": u, "lower": None, "upper": None} for n, u in zip(names, units, strict=True)
    }
    device: Any = Still(names, [0.0] * len(units), **joints)
    found = typed_goals.joint_goal(device, [f"{names[-1]}=0.3"], False, False)
    assert found.to_go() == to_go
    print_position(device)
    assert heading in capfd.readouterr().out
