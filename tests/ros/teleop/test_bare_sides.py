"""Sides as anybody may write them: without a state, without hold, and with messages that come late."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped

from crtk_drivers.client import RemoteDevice, discovery
from crtk_drivers.client.ros_link import Link
from crtk_drivers.client.teleop import Teleoperation, loop, reached_sides
from crtk_drivers.client.teleop.side import Listened
from crtk_drivers.motion.teleop import Heard, Phase, TeleopSettings
from rigs.waiting import LONG, eventually

LEADER, FOLLOWER = "/bare_hand", "/bare_arm"
IDENTITY = (0.0, 0.0, 0.0, 1.0)


class Bare:
    """Tells the same again and again, and keeps what it was sent last."""

    def __init__(self) -> None:
        self.quaternion = IDENTITY
        self.sides: tuple[RemoteDevice, ...] = ()
        self.sent: dict[str, Any] = {}
        self._link = Link("bare")
        make = self._link.node.create_publisher
        self._told = {
            f"{side}/{name}": make(kind, f"{side}/{name}", 10)
            for side in (LEADER, FOLLOWER)
            for name, kind in (
                ("measured_cp", PoseStamped),
                ("measured_cv", TwistStamped),
                ("measured_cf", WrenchStamped),
            )
        }
        for topic, kind in (
            (f"{LEADER}/servo_cf", WrenchStamped),
            (f"{FOLLOWER}/servo_cp", PoseStamped),
            (f"{FOLLOWER}/servo_cv", TwistStamped),
        ):
            self._link.node.create_subscription(
                kind, topic, lambda message, topic=topic: self.sent.update({topic: message}), 10
            )
        self._link.node.create_timer(0.02, self._tell)
        self._link.start()

    def _tell(self) -> None:
        for topic, publisher in self._told.items():
            message = publisher.msg_type()
            message.header.stamp = self._link.node.get_clock().now().to_msg()
            if isinstance(message, PoseStamped):
                q = message.pose.orientation
                q.x, q.y, q.z, q.w = self.quaternion if topic.startswith(FOLLOWER) else IDENTITY
            elif isinstance(message, TwistStamped):
                message.twist.linear.x = 0.1
            else:
                message.wrench.force.x = 2.0
            publisher.publish(message)

    def force(self) -> float:
        """Return what the leader was sent last, along x."""
        sent = self.sent.get(f"{LEADER}/servo_cf")
        return math.nan if sent is None else float(sent.wrench.force.x)

    def velocity(self) -> float:
        """Return what the follower was sent last, along x."""
        sent = self.sent.get(f"{FOLLOWER}/servo_cv")
        return math.nan if sent is None else float(sent.twist.linear.x)

    def close(self) -> None:
        self._link.close()


class Foot:
    """A pedal in this process."""

    pressed = False
    doubt = ""

    def read(self) -> Heard[bool]:
        return Heard(self.pressed, math.inf)


@pytest.fixture(scope="module")
def bare() -> Iterator[Bare]:
    both = Bare()
    try:
        with reached_sides(LEADER, FOLLOWER, LONG) as (_, leader, follower):
            both.sides = leader, follower
            yield both
    finally:
        both.close()


@contextmanager
def coupled(bare: Bare, **given: Any) -> Iterator[Teleoperation]:
    """A teleoperation that is coupled, and stepped by the test."""
    settings = TeleopSettings(leader=LEADER, follower=FOLLOWER, engage={"key": "e"}, **given)
    settings = settings.model_copy(update={"timeout": LONG})
    foot = Foot()
    running = Teleoperation(settings, *bare.sides, {"engage": foot})
    try:
        eventually(lambda: stepped(running).coupled.phase is Phase.RELEASED, "released")
        foot.pressed = True
        eventually(lambda: stepped(running).coupled.phase is Phase.FOLLOWING, "coupled")
        yield running
    finally:
        running.close()
        bare.quaternion = IDENTITY


def stepped(running: Teleoperation) -> Teleoperation:
    running.step()
    return running


def test_a_leader_that_takes_no_hold_is_pushed_no_more_when_they_are_held(bare: Bare) -> None:
    with coupled(bare, force={"ramp": 0.01}) as running:
        eventually(lambda: stepped(running) is running and bare.force() > 0.9, "it is pushed")
        bare.quaternion = (0.0, 0.0, 0.0, 0.0)
        eventually(lambda: stepped(running).coupled.phase is Phase.HELD, "held")
        eventually(lambda: bare.force() == 0.0, "it is pushed no more")


def test_a_follower_that_takes_no_hold_is_told_to_stand_at_the_end(bare: Bare) -> None:
    with coupled(bare, mode="velocity") as running:
        eventually(lambda: stepped(running) is running and bare.velocity() > 0.01, "it moves")
        assert running.end() == ""
        eventually(lambda: bare.velocity() == 0.0, "it is told to stand")


def test_a_follower_that_tells_no_pose_is_not_seen_to_stand(
    bare: Bare, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loop, "STAND_TIMEOUT", 0.3)
    with coupled(bare) as running:
        bare.quaternion = (0.0, 0.0, 0.0, 0.0)
        eventually(lambda: stepped(running).coupled.phase is Phase.HELD, "held")
        assert "was not seen to stand" in running.end()


def test_a_message_that_comes_late_is_left_out_and_one_of_a_clock_that_was_set_back_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(discovery, "SETTLE", 0.0)  # a side is known whole by its one topic
    link = Link("late")
    told = link.node.create_publisher(PoseStamped, "/late_hand/measured_cp", 10)
    link.start()

    def say(stamp: float, x: float) -> None:
        message = PoseStamped()
        message.header.stamp = Time(sec=int(stamp), nanosec=int(stamp % 1.0 * 1e9))
        message.pose.position.x, message.pose.orientation.w = x, 1.0
        told.publish(message)

    try:
        with reached_sides("/late_hand", "/late_hand", LONG) as (_, side, _same):
            arrived: list[float] = []
            heard = Listened(side, ("measured_cp",), (), (), (), lambda: None)
            side.on("measured_cp", lambda value, stamp: arrived.append(stamp))
            eventually(told.get_subscription_count, "they have met")

            def newest(stamp: float, x: float) -> float:
                count = len(arrived)
                say(stamp, x)
                eventually(lambda: len(arrived) > count, "it has arrived")
                pose = heard.read().pose
                assert pose is not None
                return float(pose.value.position[0])

            assert newest(1000.0, 0.1) == 0.1
            assert newest(1000.5, 0.2) == 0.2
            assert newest(1000.25, 0.3) == 0.2, "late"
            assert newest(1000.5, 0.4) == 0.2, "twice"
            assert newest(0.0, 0.5) == 0.2, "not valid"
            assert newest(900.0, 0.6) == 0.6, "the clock was set back"
    finally:
        link.close()
