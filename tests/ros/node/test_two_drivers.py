"""Two drivers in one namespace: both say so, and the one that was there first serves."""

from __future__ import annotations

import json
import logging
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from crtk_msgs.msg import OperatingState, StringStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, String

from crtk_drivers.config import NodeConfig
from crtk_drivers.engine import Engine
from crtk_drivers.ros import presence
from crtk_drivers.samples import Number
from crtk_drivers.testing.loopback import LoopbackConfig
from rigs.loopback_node import Rig, serve
from rigs.ros_client import RosClient
from rigs.waiting import LONG, eventually

SCRIPT = Path(__file__).parents[2] / "rigs" / "serve_loopback.py"
PROCESS_TIMEOUT = 40.0
"""Seconds in which a process starts on a busy machine."""


def note(engine: Engine) -> str:
    return " ".join(n.text for n in engine.health().notes if n.key == "another driver")


def refused(engine: Engine, name: str) -> int:
    return engine.health().refusals.get(f"{name}: second_driver", 0)


def refuses(rig: Rig, engine: Engine, name: str, message: Any) -> Callable[[], bool]:
    """Whether a command was refused there, which is sent again: nothing tells when the two have met."""

    def seen() -> bool:
        rig.client.send(name, message)
        return refused(engine, name) > 0

    return seen


def obeys(client: RosClient, engine: Engine) -> None:
    """It is enabled as soon as the client has found it: topics of another driver do not tell when that is."""

    def enabled() -> bool:
        client.state_command("enable")
        return engine.status.state == "ENABLED"

    eventually(enabled, "it obeys")


@contextmanager
def second(rig: Rig, **node: Any) -> Iterator[Engine]:
    """Another driver in the namespace of the first."""
    config = NodeConfig(**node)
    with serve(LoopbackConfig(), rig.client.namespace, [], config) as (session, _):
        eventually(lambda: bool(note(session.engine)), "the second has found the first")
        eventually(lambda: bool(note(rig.session.engine)), "the first has found the second")
        eventually(lambda: session.engine.status.state == "DISABLED", "the second is connected")
        yield session.engine
    eventually(lambda: not note(rig.session.engine), "the first is alone again")


def told(rig: Rig, text: str) -> Any:
    return rig.client["/diagnostics"].wait(
        lambda m: any(text in s.message and s.level == b"\x01" for s in m.status)
    )


def test_both_say_so_and_only_the_first_serves(rig: Rig, caplog: pytest.LogCaptureFixture) -> None:
    first, since = rig.session.engine, rig.client["refusals"].mark()
    with caplog.at_level(logging.WARNING), second(rig) as other:
        assert "this driver serves commands" in note(first)
        assert "this driver does not serve commands" in note(other)
        told(rig, "this driver serves")
        told(rig, "this driver does not serve")
        eventually(
            lambda: sum("--ns" in r.getMessage() for r in caplog.records) >= 2, "both logged it"
        )
        rig.client.reach("enable", "ENABLED")
        again = StringStamped(string="enable")
        eventually(refuses(rig, other, "state_command", again), "the second refuses it")
        goal = JointState(position=[0.01, 0.0, 0.0, 0.0])
        rig.client.move("move_jp", goal)
        eventually(refuses(rig, other, "move_jp", goal), "the second refuses the move")
        assert other.status.state == "DISABLED"
        assert first.status.state == "ENABLED"
        told_of_state = rig.client["operating_state"]
        mark = told_of_state.mark()
        eventually(lambda: told_of_state.mark() > mark + 5, "heartbeats")
        assert {m.state for m in told_of_state.messages[mark:]} == {"ENABLED"}
    assert rig.client["refusals"].mark() == since, "the client's own driver refused nothing"


def test_one_that_is_told_to_serves_beside_the_first(rig: Rig) -> None:
    with second(rig, share_namespace=True) as other:
        assert "this driver serves commands" in note(other)
        obeys(rig.client, other)
        eventually(lambda: rig.session.engine.status.state == "ENABLED", "the first obeys")


def said_text(**values: Any) -> str:
    """What a driver says that started long before this one."""
    content = {"id": "other", "driver": "other", "host": "lab", "pid": 1, "started": 0}
    return json.dumps({**content, "established": False, "there": True, **values})


def said(rig: Rig, **values: Any) -> String:
    return String(data=said_text(**values))


def test_a_name_with_control_characters_is_cleaned() -> None:
    word = presence.read_word(said_text(host="lab\x1b[2J", driver="ur\n"))
    assert word is not None
    assert word.name == "ur (process 1 on lab[2J)"


@pytest.fixture
def publisher(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """What says it once, and counts as there until it says that it goes."""
    monkeypatch.setattr(presence, "GONE_AFTER", LONG)
    publisher = rig.client.node.create_publisher(String, f"{rig.client.namespace}/drivers", 10)
    eventually(lambda: publisher.get_subscription_count() == 1, "they have met")
    yield publisher
    publisher.publish(said(rig, there=False))
    eventually(lambda: not note(rig.session.engine), "alone again")
    rig.client.node.destroy_publisher(publisher)


def test_one_that_turns_out_to_be_second_holds_and_goes_on_when_it_is_alone(
    rig: Rig, publisher: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(presence, "ESTABLISHED_AFTER", 3600.0)
    engine = rig.session.engine
    rig.client.reach("enable", "ENABLED")
    since = rig.client["operating_state"].mark()
    engine.submit("trajectory_j/set_ratio", Number(0.02))
    rig.client.send("move_jp", JointState(position=[0.9, 0.0, 0.0, 0.0]))
    rig.client["operating_state"].wait(lambda m: m.is_busy, since)
    publisher.publish(said(rig))
    eventually(lambda: "does not serve" in note(engine), "it stands by")
    eventually(lambda: not engine.status.is_busy, "the move is over")
    engine.submit("trajectory_j/set_ratio", Number(1.0))
    found = engine.feedback("measured_js")
    assert found is not None
    assert found[0].position[0] < 0.8, "it was held on the way"  # type: ignore[union-attr]
    before = refused(engine, "move_jp")
    rig.client.send("move_jp", JointState(position=[0.9, 0.0, 0.0, 0.0]))
    eventually(lambda: refused(engine, "move_jp") > before, "a move is refused")
    rig.client.send("hold", Empty())
    rig.client.state_command("disable")
    eventually(lambda: engine.status.state == "DISABLED", "a stop is not refused")
    assert refused(engine, "hold") == 0
    publisher.publish(said(rig, there=False))
    eventually(lambda: not note(engine), "it is alone")
    assert engine.status.state == "DISABLED", "nothing happens by itself"
    rig.client.reach("enable", "ENABLED")


def test_one_that_has_served_for_long_goes_before_one_with_an_earlier_clock(
    rig: Rig, publisher: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(presence, "ESTABLISHED_AFTER", 0.0)
    publisher.publish(said(rig))
    eventually(lambda: bool(note(rig.session.engine)), "it is noticed")
    assert "this driver serves commands" in note(rig.session.engine)
    rig.client.reach("enable", "ENABLED")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        "nonsense",
        '{"id": 1, "started": "x"}',
        '{"id": 1, "driver": 2, "pid": 3, "host": 4, "established": 0, "started": 1e999}',
        "[" * 100_000,
    ],
    ids=["empty", "list", "object", "words", "no number", "endless number", "deep"],
)
def test_what_is_not_of_a_driver_is_nobody(rig: Rig, publisher: Any, text: str) -> None:
    publisher.publish(String(data=text))
    publisher.publish(said(rig, id="later"))
    eventually(lambda: "other" in note(rig.session.engine), "what came after it is heard")
    publisher.publish(said(rig, id="later", there=False))


def test_a_stranger_that_tells_an_operating_state_is_noticed(rig: Rig) -> None:
    with RosClient("/stranger") as stranger:
        stranger.node.create_publisher(
            OperatingState, f"{rig.client.namespace}/operating_state", 10
        )
        eventually(lambda: "/test_client" in note(rig.session.engine), "the note names its node")
        assert "this driver serves commands" in note(rig.session.engine)
    eventually(lambda: not note(rig.session.engine), "it is gone")


@contextmanager
def process(namespace: str) -> Iterator[subprocess.Popen[bytes]]:
    child = subprocess.Popen([sys.executable, str(SCRIPT), namespace], stdout=subprocess.DEVNULL)
    try:
        yield child
    finally:
        child.kill()
        child.wait()


@pytest.mark.slow
def test_a_killed_driver_is_followed_by_the_second_and_does_not_lock_out_a_new_one() -> None:
    """DDS keeps the endpoints of what was killed for 20 s."""
    namespace = "/killed_first"
    with RosClient(namespace) as client, process(namespace) as child:
        end = time.monotonic() + PROCESS_TIMEOUT
        while not client["operating_state"].messages:
            assert time.monotonic() < end, "the process does not serve"
            time.sleep(0.05)
        with serve(LoopbackConfig(), namespace, []) as (session, _):
            engine = session.engine
            eventually(lambda: "does not serve" in note(engine), "the second stands by")
            assert f"process {child.pid} " in note(engine)
            child.send_signal(signal.SIGKILL)
            eventually(lambda: not note(engine), "the second is alone")
            assert engine.status.state == "DISABLED"
            obeys(client, engine)
        with serve(LoopbackConfig(), namespace, []) as (session, _):
            topic = f"{namespace}/operating_state"
            eventually(
                lambda: client.node.count_publishers(topic) > 1, "the killed one's is still there"
            )
            eventually(lambda: session.engine.status.state == "DISABLED", "it is connected")
            obeys(client, session.engine)
            assert note(session.engine) == ""
