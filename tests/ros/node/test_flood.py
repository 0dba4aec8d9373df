"""Stops have a way of their own: no other command delays them, and none that is older follows them."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from crtk_msgs.msg import StringStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty

from crtk_drivers.ros.command_threads import _without_repetitions
from crtk_drivers.ros.received import Received
from rigs.loopback_node import Rig
from rigs.waiting import eventually

SCRIPT = Path(__file__).parents[2] / "rigs" / "flood_positions.py"
NAMESPACE = "/test_flood"
TRIES = 10
FLOODED = 0.5
"""Seconds of a flood before a stop is sent."""
EXCESS = 0.4
"""Seconds by which a stop may be later in a flood, on a machine whose processors six others may use, too.

An executor that all commands go through takes 0.6 s and more on an idle one.
"""


KEPT = 200
"""Increments that DDS keeps."""
SENDERS = 400
INCREMENT = 1e-5
MANY = """
import sys, time, rclpy
from sensor_msgs.msg import JointState
rclpy.init()
node = rclpy.create_node("many")
made = [node.create_publisher(JointState, sys.argv[1], 10) for _ in range(int(sys.argv[2]))]
while not all(each.get_subscription_count() for each in made):
    time.sleep(0.01)
for number, each in enumerate(made):
    each.publish(JointState(position=[0.0, float(sys.argv[3]), 0.0, 0.0]))
    time.sleep(0.001)
print("sent", flush=True)
sys.stdin.read()
"""


def joints(*position: float) -> JointState:
    return JointState(position=list(position))


def word(text: str) -> StringStamped:
    return StringStamped(string=text)


def refused(rig: Rig, name: str, reason: str = "too_old") -> int:
    return rig.session.engine.health().refusals.get(f"{name}: {reason}", 0)


@contextmanager
def busy_commands(rig: Rig) -> Iterator[threading.Event]:
    """Let whoever carries out the next servo_jr stay busy with it until the event is set."""
    engine = rig.session.engine
    busy, free = threading.Event(), threading.Event()

    def hear(name: str, value: Any, stamp_ns: int) -> None:
        if name == "servo_jr":
            busy.set()
            assert free.wait(60.0)

    before, engine.hearers = engine.hearers, (*engine.hearers, hear)
    try:
        rig.client.send("servo_jr", joints(0.0, 0.0, 0.0, 0.0))
        assert busy.wait(60.0)
        yield free
    finally:
        free.set()
        engine.hearers = before


@pytest.mark.parametrize("stop", ["disable", "pause"])
def test_a_stop_waits_for_no_other_command(rig: Rig, stop: str) -> None:
    rig.client.reach("enable", "ENABLED")
    with busy_commands(rig):
        since = rig.client["operating_state"].mark()
        rig.client.send("state_command", word(stop))
        reached = {"disable": "DISABLED", "pause": "PAUSED"}[stop]
        rig.client["operating_state"].wait(lambda m: m.state == reached, since)


def test_a_command_from_before_hold_is_not_carried_out_after(rig: Rig) -> None:
    rig.client.reach("enable", "ENABLED")
    heard = threading.Event()
    engine = rig.session.engine
    with busy_commands(rig) as free:
        rig.client.send("move_jp", joints(0.5, 0.0, 0.0, 0.0))
        engine.hearers = (*engine.hearers, lambda name, *_: name == "hold" and heard.set())
        rig.client.send("hold", Empty())
        assert heard.wait(60.0)
        before = refused(rig, "move_jp")
        free.set()
        eventually(lambda: refused(rig, "move_jp") == before + 1, "the older move is refused")
    assert not engine.status.is_busy


@pytest.mark.parametrize("first", ["pause", "disable"])
def test_what_enables_again_revives_no_older_command(rig: Rig, first: str) -> None:
    rig.client.reach("enable", "ENABLED")
    engine = rig.session.engine
    with busy_commands(rig) as free:
        rig.client.send("move_jp", joints(0.5, 0.0, 0.0, 0.0))
        rig.client.reach(first, {"disable": "DISABLED", "pause": "PAUSED"}[first])
        rig.client.reach({"disable": "enable", "pause": "resume"}[first], "ENABLED")
        before = refused(rig, "move_jp")
        free.set()
        eventually(lambda: refused(rig, "move_jp") == before + 1, "the older move is refused")
    assert not engine.status.is_busy


def test_a_move_right_behind_enable_is_carried_out(rig: Rig) -> None:
    """And one right behind hold: two threads read them, and keep their order."""
    inbox = rig.client["measured_js"]
    for number in range(TRIES):
        goal = 0.01 * (number + 1)
        rig.client.send("state_command", word("enable"))
        rig.client.send("move_jp", joints(goal, 0.0, 0.0, 0.0))
        inbox.wait(lambda m, at=goal: abs(m.position[0] - at) < 1e-4, inbox.mark())
        rig.client.send("hold", Empty())
        rig.client.send("move_jp", joints(0.0, 0.0, 0.0, 0.0))
        inbox.wait(lambda m: abs(m.position[0]) < 1e-4, inbox.mark())
        rig.client.reach("disable", "DISABLED")
    assert not refused(rig, "move_jp", "not_enabled")


def test_no_increment_is_lost_beside_an_absolute_stream(rig: Rig) -> None:
    rig.client.reach("enable", "ENABLED")
    inbox = rig.client["setpoint_js"]
    before = inbox.messages[-1].position[1]
    with busy_commands(rig):
        for _ in range(100):
            rig.client.send("servo_jr", joints(0.0, 1e-4, 0.0, 0.0))
    inbox.wait(lambda m: abs(m.position[1] - before - 0.01) < 1e-6, inbox.mark())


def test_lost_increments_are_told(rig: Rig) -> None:
    """DDS keeps 200 of them until they are read, and they are motion."""
    rig.client.reach("enable", "ENABLED")
    inbox = rig.client["setpoint_js"]
    before = inbox.wait(since=inbox.mark()).position[1]
    since = rig.client["refusals"].mark()
    count = refused(rig, "servo_jr", "lost")
    with busy_commands(rig):
        for _ in range(KEPT + 50):
            rig.client.send("servo_jr", joints(0.0, 1e-4, 0.0, 0.0))
    inbox.wait(lambda m: abs(m.position[1] - before - KEPT * 1e-4) < 1e-6, inbox.mark())
    assert refused(rig, "servo_jr", "lost") == count + 1
    told = rig.client["refusals"].wait(lambda m: '"lost"' in m.data, since)
    assert "50 of the node /" in told.data
    report = rig.client["/diagnostics"]
    report.wait(
        lambda m: any(
            value.key == "refused servo_jr: lost" for each in m.status for value in each.values
        )
    )
    rig.client.reach("disable", "DISABLED")


def test_hundreds_of_senders_lose_no_increment(rig: Rig) -> None:
    """Of one node, which the graph has to be asked for."""
    rig.client.reach("enable", "ENABLED")
    script = [sys.executable, "-c", MANY, f"{NAMESPACE}/servo_jr", str(SENDERS), str(INCREMENT)]
    inbox = rig.client["setpoint_js"]
    before = inbox.wait(since=inbox.mark()).position[1]
    with subprocess.Popen(script, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        try:
            assert child.stdout is not None
            assert child.stdout.readline() == b"sent\n"
            moved = SENDERS * INCREMENT
            inbox.wait(lambda m: abs(m.position[1] - before - moved) < 1e-9, inbox.mark())
        finally:
            child.kill()
    rig.client.reach("disable", "DISABLED")


@contextmanager
def flood(name: str) -> Iterator[None]:
    child = subprocess.Popen(
        [sys.executable, str(SCRIPT), NAMESPACE, name, "0.02", "0", "0", "0"],
        stdout=subprocess.PIPE,
    )
    try:
        assert child.stdout is not None
        assert child.stdout.readline() == b"ready\n"
        yield
    finally:
        child.kill()
        child.communicate()


def time_to_take(rig: Rig, stop: str) -> float:
    """Return how many seconds after it was sent a stop was taken; enabled before."""
    rig.client.reach("enable", "ENABLED")
    taken: list[float] = []
    engine = rig.session.engine

    def hear(name: str, value: Any, stamp_ns: int) -> None:
        if name in (stop, "state_command"):
            taken.append(time.monotonic())

    before, engine.hearers = engine.hearers, (*engine.hearers, hear)
    try:
        sent = time.monotonic()
        rig.client.send(*(("hold", Empty()) if stop == "hold" else ("state_command", word(stop))))
        eventually(lambda: taken, "the stop is taken")
    finally:
        engine.hearers = before
    return taken[0] - sent


@pytest.mark.slow
@pytest.mark.parametrize("stop", ["hold", "disable"])
def test_a_flood_delays_no_stop_and_is_named(rig: Rig, stop: str) -> None:
    quiet = sorted(time_to_take(rig, stop) for _ in range(5))[2]
    senders = rig.serving.driver._commands.senders
    with flood(f"flooder_{stop}"):
        eventually(lambda: senders.floods, "the flood is seen")
        report = rig.client["/diagnostics"]
        since = report.mark()

        def names_it(message: Any) -> bool:
            texts = [each.message for each in message.status if each.name.endswith(": commands")]
            return any(f"the node /flooder_{stop} sends" in text for text in texts)

        told = report.wait(names_it, since)
        assert told.status
        time.sleep(FLOODED)
        flooded = sorted(time_to_take(rig, stop) for _ in range(5))[2]
    assert flooded < quiet + EXCESS
    eventually(lambda: not senders.floods, "it is over")


def test_a_repetition_is_carried_out_once_and_the_order_kept() -> None:
    a, b, topic = object(), object(), object()

    def said(sender: object, text: bytes, at: int) -> Any:
        return topic, Received(at.to_bytes(12, "little") + text, sender, at)  # type: ignore[arg-type]

    taken = [said(a, b"enable", 1), said(b, b"disable", 2), said(a, b"enable", 3)]
    taken += [said(b, b"enable", 4), said(a, b"enable", 5)]
    kept = [(message.sender is a, message.data[12:]) for _, message in _without_repetitions(taken)]
    assert kept == [(False, b"disable"), (False, b"enable"), (True, b"enable")]
