"""Sub-namespaces, mixed setpoints, ratios and the echo of stamps, on the wire."""

from __future__ import annotations

import json
import math
import time
from typing import Any

import pytest
from crtk_msgs.msg import JointServo, SetpointMode
from geometry_msgs.msg import TwistStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from crtk_drivers.ros.messages import set_stamp
from rigs.loopback_node import Rig
from rigs.ros_client import stamp_ns
from rigs.waiting import LONG, eventually

STAMP = 1_700_000_000_123_456_789


def joints(*position: float, stamp: int = STAMP) -> JointState:
    message = JointState(position=list(position))
    set_stamp(message.header.stamp, stamp)
    return message


def stream(rig: Rig, name: str, message: Any, inbox: str, accept: Any) -> Any:
    """Send a message again and again until an answer is accepted; return that."""
    since = rig.client[inbox].mark()
    end = time.monotonic() + LONG
    while time.monotonic() < end:
        rig.client.send(name, message)
        time.sleep(0.01)
        for answer in rig.client[inbox].messages[since:]:
            if accept(answer):
                return answer
    raise AssertionError(f"{name} was never answered on {inbox}")


def refusals_since(rig: Rig, since: int) -> list[dict[str, Any]]:
    return [json.loads(message.data) for message in rig.client["refusals"].messages[since:]]


def test_ratios_are_told_when_they_change_and_a_bad_one_changes_nothing(rig: Rig) -> None:
    client = rig.client
    for name, number in (("set_ratio", 0.5), ("set_ratio_v", 0.25), ("set_ratio", 1.0)):
        since = client["trajectory_j/ratio_v"].mark()
        client.send(f"trajectory_j/{name}", Float64(data=number))
        client["trajectory_j/ratio_v"].wait(lambda m, n=number: m.data == n, since)
    eventually(
        lambda: client["trajectory_j/ratio"].messages[-1].data == 1.0, "each on its own topic"
    )
    since = client["refusals"].mark()
    client.send("trajectory_j/set_ratio", Float64(data=math.nan))
    client["refusals"].wait(lambda m: "is no ratio" in m.data, since)
    assert client["trajectory_j/ratio"].messages[-1].data == 1.0


def test_a_servo_command_is_recognised_by_its_stamp_in_the_setpoint(rig: Rig) -> None:
    rig.client.reach("enable", "ENABLED")
    echoed = stream(
        rig, "servo_jp", joints(0.01, 0, 0, 0), "setpoint_js", lambda m: stamp_ns(m) == STAMP
    )
    assert echoed.position[0] == pytest.approx(0.01)
    # When the stream has ended, the setpoint is as fresh as the sample that it is told with.
    since = rig.client["setpoint_js"].mark()
    rig.client["setpoint_js"].wait(lambda m: stamp_ns(m) > STAMP, since)


def test_goals_and_refusals_carry_the_stamp_of_their_command(rig: Rig) -> None:
    client = rig.client
    client.reach("enable", "ENABLED")
    since = client["goal_js"].mark()
    client.send("move_jp", joints(0.02, 0, 0, 0, stamp=STAMP + 1))
    client["goal_js"].wait(lambda m: stamp_ns(m) == STAMP + 1, since)
    since = client["refusals"].mark()
    for number in (2, 3, 4):  # each refused move is told, also those that follow at once
        client.send("move_jp", joints(0.02, stamp=STAMP + number))
        client["refusals"].wait(lambda m, n=number: f"{123_456_789 + n}" in m.data, since)
    # A stream that was refused before is told of when two seconds are over.
    told = [r for r in refusals_since(rig, since) if r["command"] == "move_jp"]
    assert [r["reason"] for r in told] == ["wrong_size"] * 3


def test_a_twist_in_the_axes_of_the_tool(rig: Rig) -> None:
    client = rig.client
    client.reach("enable", "ENABLED")
    since = client["operating_state"].mark()
    client.send("move_jp", joints(0.0, 0.0, 0.0, math.pi / 2))
    client.wait_for_busy(since)
    twist = TwistStamped()
    twist.twist.linear.x = 0.1
    stream(rig, "body/servo_cv", twist, "measured_js", lambda m: m.position[1] > 0.02)
    assert abs(client["measured_js"].messages[-1].position[0]) < 1e-3
    told = client["body/measured_cv"].wait(lambda m: m.twist.linear.x > 0.05)
    assert told.header.frame_id.endswith("tool")


def test_joints_that_follow_different_kinds_of_values(rig: Rig) -> None:
    client = rig.client
    client.reach("enable", "ENABLED")
    kinds = (SetpointMode.POSITION, SetpointMode.VELOCITY, SetpointMode.NONE, SetpointMode.NONE)
    message = JointServo(
        position=[0.03, 0.0, 0.0, 0.0],
        velocity=[0.0, 0.1, 0.0, 0.0],
        mode=[SetpointMode(value=kind) for kind in kinds],
    )
    there = pytest.approx(0.03, abs=5e-3)  # where the first goes at once, if it is given the time
    reached = stream(
        rig,
        "servo_js",
        message,
        "measured_js",
        lambda m: m.position[1] > 0.02 and m.position[0] == there,
    )
    assert abs(reached.position[2]) < 1e-6
