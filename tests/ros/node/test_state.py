"""operating_state, state_command, services and parameters, by the rules of the official client."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from itertools import pairwise

import pytest
from crtk_msgs.srv import QueryForwardKinematics, QueryInverseKinematics, TriggerOperatingState
from rcl_interfaces.srv import DescribeParameters
from rclpy.context import Context
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from crtk_drivers.config import NodeConfig
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.ros.operating_state import BURST, StatusTopic
from crtk_drivers.ros.publishing import PublishingThread
from crtk_drivers.ros.refusals import RefusalTopic
from crtk_drivers.ros.unlocked import UnlockedNode
from crtk_drivers.samples import Pose, Stamp, Vector
from crtk_drivers.state import OperatingState, Status
from crtk_drivers.testing.loopback import LoopbackConfig
from rigs.loopback_node import RATE, Rig, rig_of, serve, slowly
from rigs.ros_client import RosClient, stamp_ns
from rigs.waiting import LONG, eventually


def test_heartbeat_has_strictly_increasing_stamps(rig: Rig) -> None:
    inbox = rig.client["operating_state"]
    start = inbox.mark()
    inbox.wait(since=start + 5)
    stamps = rig.client.state_stamps
    assert all(a < b for a, b in pairwise(stamps))
    assert stamps[0] > 0


def test_stamps_increase_although_the_clock_jumps_back(rig: Rig) -> None:
    """F18."""
    inbox = rig.client["operating_state"]
    since = inbox.mark()
    hour_ago = Stamp(time.time_ns() - 3600 * 10**9, time.monotonic())
    status = Status(OperatingState.PAUSED, True, False, "")
    rig.serving.driver._listener.status_changed(status, hour_ago)
    inbox.wait(lambda m: m.state == "PAUSED", since)
    assert all(a < b for a, b in pairwise(rig.client.state_stamps))


def told_in_two_parts(topic: StatusTopic, statuses: list[Status]) -> list[bool]:
    """Announce all, the first of which is published at once; return what is told of busy after that."""
    told: list[Status] = []
    topic._send = lambda status, stamp_ns: told.append(status)  # type: ignore[method-assign]
    topic.announce(statuses[0], Stamp.now())
    topic._publish()
    for status in statuses[1:]:
        topic.announce(status, Stamp.now())
    topic._publish()
    return [status.is_busy for status in told[1:]]


def test_pulses_are_thinned_out_and_none_is_lost_that_somebody_waits_for() -> None:
    """A short move after a refused one: its client saw half of the pulse before, and waits for another."""
    idle = Status(OperatingState.ENABLED, True, False, "")
    busy = replace(idle, is_busy=True)
    with Context() as context:
        node = UnlockedNode("pulses", context=context, enable_rosout=False)
        for statuses, expected in (
            ([busy, idle, busy, idle], [False, True, False]),
            ([idle, busy, idle, busy, idle], [True, False]),
        ):
            topic = StatusTopic(node, PublishingThread("pulses"), idle)
            assert told_in_two_parts(topic, statuses) == expected
        node.destroy_node()


def test_a_change_of_state_waits_for_no_pulse_that_is_held_back() -> None:
    idle = Status(OperatingState.ENABLED, True, False, "")
    busy, fault = replace(idle, is_busy=True), replace(idle, state=OperatingState.FAULT)
    with Context() as context:
        node = UnlockedNode("held_back", context=context, enable_rosout=False)
        topic = StatusTopic(node, PublishingThread("held_back"), idle)
        told: list[Status] = []
        send = topic._send

        def noted(status: Status, stamp_ns: int) -> None:
            told.append(status)
            send(status, stamp_ns)

        topic._send = noted  # type: ignore[method-assign]
        topic._refill = lambda: None  # type: ignore[method-assign]  # no time passes
        for status in [busy, idle] * int(BURST):
            topic.announce(status, Stamp.now())
            topic._publish()
        assert len(told) == BURST
        topic.announce(fault, Stamp.now())
        topic._publish()
        assert told[-1] == fault
        node.destroy_node()


def test_a_refusal_is_told_before_the_pulse_of_the_move_that_is_refused() -> None:
    """Who waits for busy alone would take the move for accepted, were the refusal to follow later."""
    idle = Status(OperatingState.DISABLED, True, False, "")
    told: list[str | bool] = []
    with Context() as context:
        node = UnlockedNode("refused", context=context, enable_rosout=False)
        thread = PublishingThread("refused")
        refusals = RefusalTopic(node, thread)
        refusals._tell = lambda refusal, count: told.append(refusal.command)  # type: ignore[method-assign]
        topic = StatusTopic(node, thread, idle, before=refusals.publish)
        topic._send = lambda status, stamp_ns: told.append(status.is_busy)  # type: ignore[method-assign]
        refusals.add(CommandRefused("move_jp", Reason.NOT_ENABLED, "it is DISABLED"))
        topic.announce(replace(idle, is_busy=True), Stamp.now())
        topic.announce(idle, Stamp.now())
        topic._publish()  # the thread came to this job when both were told
        node.destroy_node()
    assert told == ["move_jp", True, False]


def test_every_transition(rig: Rig) -> None:
    for command, state in (
        ("enable", "ENABLED"),
        ("pause", "PAUSED"),
        ("resume", "ENABLED"),
        ("disable", "DISABLED"),
        ("enable", "ENABLED"),
    ):
        assert rig.client.reach(command, state).is_homed


def test_a_command_that_changes_nothing_is_answered(rig: Rig) -> None:
    rig.client.reach("enable", "ENABLED")
    assert rig.client.reach("enable", "ENABLED").state == "ENABLED"


def test_a_command_that_changes_nothing_is_answered_though_no_heartbeat_comes(rig: Rig) -> None:
    """The answers to many are thinned out: the last one is told as soon as it may be."""
    rig.client.reach("enable", "ENABLED")
    heartbeat = rig.serving.driver._status.job
    heartbeat.set_rate(0.0)
    try:
        for _ in range(2 * int(BURST)):
            assert rig.client.reach("enable", "ENABLED").state == "ENABLED"
    finally:
        heartbeat.set_rate(NodeConfig().heartbeat_rate)


def test_busy_rises_and_falls(rig: Rig) -> None:
    rig.client.reach("enable", "ENABLED")
    rig.client.move("move_jp", JointState(position=[0.1, 0.0, 0.0, 0.0]))
    rig.client.move("move_jp", JointState(position=[0.1, 0.0, 0.0, 0.0]))  # already there
    rig.client.move("move_jp", JointState(position=[0.1]))  # refused
    rig.client.reach("disable", "DISABLED")
    rig.client.move("move_jp", JointState(position=[0.0, 0.0, 0.0, 0.0]))  # not enabled


def test_servo_is_not_busy(rig: Rig) -> None:
    rig.client.reach("enable", "ENABLED")
    since = rig.client["operating_state"].mark()
    writes = rig.device.writes

    def stream() -> bool:
        rig.client.send("servo_jp", JointState(position=[0.001, 0.0, 0.0, 0.0]))
        return rig.client["operating_state"].mark() > since + 2 and rig.device.writes > writes

    eventually(stream, "two heartbeats while it streams")
    assert not any(m.is_busy for m in rig.client["operating_state"].messages[since:])


def test_hold_ends_a_move(rig: Rig) -> None:
    rig.client.reach("enable", "ENABLED")
    since = rig.client["operating_state"].mark()
    with slowly(rig.session.engine):
        rig.client.send("move_jp", JointState(position=[0.9, 0.0, 0.0, 0.0]))
        rig.client["operating_state"].wait(lambda m: m.is_busy, since)
        rig.client.send("hold", Empty())
        rig.client.wait_for_busy(since)
    assert rig.client["measured_js"].messages[-1].position[0] < 0.85


def test_lost_and_found_again(rig: Rig) -> None:
    rig.client.reach("enable", "ENABLED")
    inbox = rig.client["operating_state"]
    since = inbox.mark()
    rig.device.reachable = False
    inbox.wait(lambda m: m.state == "FAULT", since)
    since = inbox.mark()
    rig.device.reachable = True
    assert inbox.wait(lambda m: m.state != "FAULT", since).state == "DISABLED"


def test_homing() -> None:
    with rig_of("/unhomed", needs_homing=True, transition_time=0.1) as rig:
        assert not rig.client.state.is_homed
        rig.client.reach("enable", "ENABLED")
        since = rig.client["operating_state"].mark()
        rig.client.state_command("home")
        rig.client["operating_state"].wait(lambda m: m.is_homed and not m.is_busy, since)
        rig.client.state_command("unhome")
        rig.client["operating_state"].wait(lambda m: not m.is_homed, since)


def test_an_old_enable_is_not_replayed_to_a_new_node() -> None:
    """F19: the client latches its state commands; a node that starts must not hear them."""
    with RosClient("/restarted") as client:
        client.state_command("enable")
        with serve(LoopbackConfig(), "/restarted", []) as (session, _):
            client.check_connections()
            inbox = client["operating_state"]
            inbox.wait(since=inbox.mark() + 3)
            assert session.engine.status.state == "DISABLED"
            assert all(m.state != "ENABLED" for m in inbox.messages)
            assert client.reach("enable", "ENABLED").state == "ENABLED"


def test_services(rig: Rig) -> None:
    state = rig.client.call("operating_state", TriggerOperatingState.Request()).operating_state
    assert state.state == "DISABLED"
    assert stamp_ns(state) > 0
    version = rig.client.call("crtk_version", Trigger.Request())
    assert (version.success, version.message) == (True, "1.3.0")
    forward = rig.client.call(
        "forward_kinematics", QueryForwardKinematics.Request(jp=[0.1, 0.2, 0.3, 0.0])
    )
    assert forward.result, forward.message
    assert (forward.cp.position.x, forward.cp.position.z) == (0.1, 0.3)
    inverse = rig.client.call(
        "inverse_kinematics", QueryInverseKinematics.Request(cp=forward.cp, jp=[0.0] * 4)
    )
    assert inverse.result, inverse.message
    assert list(inverse.jp) == pytest.approx([0.1, 0.2, 0.3, 0.0])


def test_who_asks_for_inverse_kinematics_holds_nobody_up(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pose out of reach takes generic ones 0.2 s, and many may be asked for."""
    kinematics, begun, may_end = rig.device.kinematics, threading.Event(), threading.Event()
    solve = kinematics.inverse

    def slow(pose: Pose, reference: Vector) -> Vector:
        begun.set()
        assert may_end.wait(LONG)
        return solve(pose, reference)

    monkeypatch.setattr(kinematics, "inverse", slow)
    forward = rig.client.call(
        "forward_kinematics", QueryForwardKinematics.Request(jp=[0.1, 0.2, 0.3, 0.0])
    )
    request = QueryInverseKinematics.Request(cp=forward.cp, jp=[0.0] * 4)
    asked = rig.client.clients["inverse_kinematics"].call_async(request)
    try:
        assert begun.wait(LONG)
        rig.client.reach("enable", "ENABLED")
        assert not asked.done()
    finally:
        may_end.set()
    eventually(asked.done, "an answer")
    assert list(asked.result().jp) == pytest.approx([0.1, 0.2, 0.3, 0.0])


def test_parameters_have_descriptions_and_ranges(rig: Rig) -> None:
    names = ["publish_rate", "tf_rate", "heartbeat_rate", "diagnostics_rate", "frame_prefix"]
    response = rig.client.call(
        "crtk_driver/describe_parameters", DescribeParameters.Request(names=names)
    )
    assert all(d.description for d in response.descriptors)
    assert [bool(d.floating_point_range) for d in response.descriptors] == [True] * 4 + [False]
    assert response.descriptors[4].read_only


def test_rates_change_while_it_runs(rig: Rig) -> None:
    inbox = rig.client["crtk_driver/crtk_capabilities"]
    assert rig.client.set_parameter("publish_rate", 7.0)
    assert '"publish": 7.0' in inbox.wait(lambda m: '"publish": 7.0' in m.data).data
    assert not rig.client.set_parameter("publish_rate", -1.0)
    assert not rig.client.set_parameter("publish_rate", 1e9)
    assert not rig.client.set_parameter("heartbeat_rate", 100.0)
    assert rig.serving.driver.node.get_parameter("publish_rate").value == 7.0
    assert rig.client.set_parameter("publish_rate", RATE)
