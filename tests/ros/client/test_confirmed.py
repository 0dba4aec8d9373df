"""A stop that a client sends last has arrived, or it says that nobody confirmed it."""

from __future__ import annotations

import logging
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import Empty

from crtk_drivers import client
from crtk_drivers.client import RemoteDevice, connect, remote
from crtk_drivers.client.remote import CONFIRM_TIMEOUT
from crtk_drivers.errors import CommandRefused, ConnectionLost, StopUnconfirmed
from crtk_drivers.state import REPEATED, OperatingState
from rigs.loopback_client import Far, Node, driver_process, far_device
from rigs.programs import Program, Start
from rigs.waiting import LONG, eventually

NAMESPACE = "/client_confirmed"
SOON = CONFIRM_TIMEOUT + 3.0
"""Seconds in which a stop fails that nobody confirms, on a busy machine."""
TRIES = 20
UNCONFIRMED = 1.0
STOPPED = {"disable": "DISABLED", "pause": "PAUSED"}
SET_GOING = {"disable": "enable", "pause": "resume"}

LISTENER = """
import sys, rclpy
from std_msgs.msg import Empty
rclpy.init()
node = rclpy.create_node("recorder")
node.create_subscription(Empty, sys.argv[1], lambda _: print("hold", flush=True), 10)
print("ready", flush=True)
rclpy.spin(node)
"""


@pytest.fixture(scope="module")
def far() -> Iterator[Far]:
    with far_device(NAMESPACE) as far:
        far.arm.add("operating_state", "hold")
        yield far


@contextmanager
def frozen(process: Any) -> Iterator[None]:
    process.send_signal(signal.SIGSTOP)
    told = Path(f"/proc/{process.pid}/stat")
    eventually(lambda: told.read_text().rpartition(")")[2].split()[0] == "T", "it stands still")
    try:
        yield
    finally:
        process.send_signal(signal.SIGCONT)


@pytest.fixture
def driver(start: Start) -> Iterator[tuple[Program, RemoteDevice]]:
    """A driver in a process of its own, and a client that has found it."""
    with driver_process(start, "/confirmed_alone") as again:
        process = again()
        with connect("/confirmed_alone", timeout=LONG) as arm:
            arm.add("hold", "state_command", "operating_state", "free")
            yield process, arm


STOPPING: dict[str, Callable[[RemoteDevice], None]] = {
    "hold": lambda arm: arm.hold(),
    "disable": lambda arm: arm.disable(),
    "pause": lambda arm: arm.state_command("pause", timeout=0.0),
}


@pytest.mark.parametrize("stop", STOPPING)
def test_a_stop_that_a_frozen_driver_misses_is_told(
    driver: tuple[Program, RemoteDevice], stop: str
) -> None:
    process, arm = driver
    arm.enable(timeout=LONG)
    arm.hold()
    with frozen(process):
        began = time.monotonic()
        with pytest.raises(StopUnconfirmed, match=f"{stop} was sent, and nobody confirmed it"):
            STOPPING[stop](arm)
        assert time.monotonic() - began < SOON
        with pytest.raises(ConnectionLost):
            arm.free()
    eventually(lambda: arm.operating_state().is_busy is False, "it is back")
    arm.hold()


def test_the_command_line_fails_where_a_frozen_driver_misses_hold(
    driver: tuple[Program, RemoteDevice],
    run_far: Callable[..., tuple[int, str, str]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It is found before it freezes."""
    process, arm = driver
    monkeypatch.setattr(client, "connect", lambda namespace, timeout: arm)
    with frozen(process):
        code, _, err = run_far("hold", "/confirmed_alone")
    assert code == 1
    told = " ".join(err.split())
    assert "hold was sent, and nobody confirmed it in 2 s" in told
    assert "If it moves, press its emergency stop." in told


def test_the_first_hold_of_a_client_is_confirmed_or_told(
    driver: tuple[Program, RemoteDevice],
) -> None:
    process, _ = driver
    with connect("/confirmed_alone", timeout=LONG, features=["hold"]) as other, frozen(process):
        began = time.monotonic()
        with pytest.raises(StopUnconfirmed, match="nobody confirmed it"):
            other.hold()
        assert time.monotonic() - began < SOON


def test_a_live_driver_confirms_each_stop_at_once(
    driver: tuple[Program, RemoteDevice],
) -> None:
    """Fast DDS asks for it every 3 s, unless the history of what is sent is full."""
    _, arm = driver
    began = time.monotonic()
    for _ in range(TRIES):
        with connect("/confirmed_alone", timeout=LONG) as other:
            outbox: Any = other._space.connected("hold")
            outbox.send(None)
            assert outbox.confirmed(CONFIRM_TIMEOUT)
    for _ in range(TRIES):
        arm.state_command("disable", timeout=0.0)
    assert time.monotonic() - began < TRIES * 1.0


def test_a_stop_right_after_the_driver_is_found_arrives(far: Far) -> None:
    heard: list[str] = []
    before = far.engine.hearers
    far.engine.hearers = (lambda name, *_: heard.append(name),)
    try:
        for number in range(TRIES):
            with connect(NAMESPACE, timeout=LONG) as arm:
                space = arm._space
                outbox: Any = space.connected("hold")
                outbox.send(None)
                arm._require_arrival("hold", outbox)
            eventually(lambda at=number: heard.count("hold") == at + 1, "it has arrived")
    finally:
        far.engine.hearers = before


def test_a_recorder_that_stands_still_fails_no_hold(
    far: Far, caplog: pytest.LogCaptureFixture
) -> None:
    topic = f"{NAMESPACE}/hold"
    link = far.arm._space.link
    known = link.subscribers(topic)
    with subprocess.Popen([sys.executable, "-c", LISTENER, topic], stdout=subprocess.PIPE) as child:
        try:
            assert child.stdout is not None
            assert child.stdout.readline() == b"ready\n"
            outbox: Any = far.arm._space.connected("hold")
            eventually(lambda: outbox.listeners == known + 1, "it listens")
            far.arm.hold()
            with frozen(child), caplog.at_level(logging.WARNING):
                began = time.monotonic()
                far.arm.hold()
                assert time.monotonic() - began < CONFIRM_TIMEOUT
            holds: list[bytes] = []
            threading.Thread(target=lambda: holds.extend(child.stdout or ()), daemon=True).start()
            eventually(lambda: len(holds) > 2, "the second is sent again")
        finally:
            child.kill()
    assert re.search(
        "One of the 2 who listen has not confirmed it, but the device answers", caplog.text
    )


def test_a_stop_that_waits_stops_no_thread_beside_it(
    driver: tuple[Program, RemoteDevice],
) -> None:
    """A program has streams and stops of other devices in its other threads."""
    process, arm = driver
    arm.enable(timeout=LONG)
    outbox: Any = arm._space.connected("hold")
    with frozen(process), ThreadPoolExecutor(1) as pool:
        outbox.send(None)
        waiting = pool.submit(outbox.confirmed, UNCONFIRMED)
        turns = 0
        while not waiting.done():
            time.sleep(UNCONFIRMED / 100)
            turns += 1
        assert not waiting.result()
    assert turns > 10


def test_listeners_at_best_effort_delay_no_hold(far: Far) -> None:
    outbox: Any = far.arm._space.connected("hold")
    with Node("best_effort") as other:
        known = outbox.listeners
        other.node.create_subscription(Empty, f"{NAMESPACE}/hold", id, qos_profile_sensor_data)
        eventually(lambda: outbox.listeners == known + 1, "it listens")
        began = time.monotonic()
        far.arm.hold()
        assert time.monotonic() - began < CONFIRM_TIMEOUT


def _listening(topic: str, kind: str) -> Any:
    """A recorder of a topic, which says when it is ready."""
    script = LISTENER.replace("std_msgs", "crtk_msgs").replace("Empty", kind)
    return subprocess.Popen([sys.executable, "-c", script, topic], stdout=subprocess.PIPE)


@pytest.mark.parametrize("stop", ["disable", "pause"])
def test_a_repeated_stop_undoes_no_later_enable(
    far: Far, monkeypatch: pytest.MonkeyPatch, stop: str
) -> None:
    """A recorder that stands still confirms nothing, and lets each stop be sent again."""
    monkeypatch.setattr(remote, "REPEAT", 0.5)
    monkeypatch.setattr(remote, "ANSWER_TIMEOUT", 1.0)
    topic, engine = f"{NAMESPACE}/state_command", far.engine
    far.reset()
    outbox: Any = far.arm._space.connected("state_command")
    known, before, seen = outbox.listeners, engine.hearers, list[OperatingState]()

    def hear(name: str, value: Any, _: int) -> None:
        if value.value == stop:
            seen.append(engine.status.state)

    with _listening(topic, "StringStamped") as child:
        try:
            assert child.stdout is not None
            assert child.stdout.readline() == b"ready\n"
            eventually(lambda: outbox.listeners == known + 1, "it listens")
            far.arm.enable(timeout=LONG)
            engine.hearers = (hear,)
            with frozen(child), ThreadPoolExecutor(1) as pool:
                stopping = pool.submit(far.arm.state_command, stop)
                eventually(lambda: engine.status.state == STOPPED[stop], "it is carried out")
                engine.state_command(SET_GOING[stop])
                eventually(lambda: engine.status.state == "ENABLED", "it is set going again")
                assert not stopping.done(), "it waits still"
                at = len(seen)
                eventually(lambda: len(seen) > at, "the stop is sent again")
                with suppress(CommandRefused):  # where it was not heard that it had stopped
                    stopping.result(LONG)
            assert engine.transition_ended
            assert engine.status.state == "ENABLED"
            far.arm.state_command(stop)
            assert engine.status.state == STOPPED[stop], "a new one is carried out"
        finally:
            engine.hearers = before
            child.kill()


def test_a_repeated_stop_whose_first_was_lost_stops(far: Far) -> None:
    outbox: Any = far.arm._space.connected("state_command")
    far.reset()
    far.arm.enable(timeout=LONG)
    outbox.send("disable", REPEATED, time.time_ns())
    eventually(lambda: far.engine.status.state == "DISABLED", "it is carried out")


def test_a_driver_that_stands_by_confirms_no_stop_of_another(start: Start) -> None:
    """It answers the queries of clients, while the one that moves stands still."""
    with driver_process(start, "/confirmed_two") as again:
        first = again()
        with connect("/confirmed_two", timeout=LONG) as arm:
            arm.add("hold", "state_command", "operating_state")
            arm.enable(timeout=LONG)
            outbox: Any = arm._space.connected("hold")
            again()
            eventually(lambda: outbox.listeners == 2, "the second listens")
            with frozen(first):
                outbox.send(None)
                with pytest.raises(StopUnconfirmed, match="of 2 drivers"):
                    arm._require_arrival("hold", outbox)
