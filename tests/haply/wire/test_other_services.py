"""The driver at services that are not ours, made of the unmodified library `websockets`."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.frames import Frame, Opcode
from websockets.sync.server import ServerConnection, serve

from crtk_driver_haply import PLUGIN, link
from crtk_driver_haply.config import HaplyConfig
from crtk_driver_haply.device import HaplyDevice
from crtk_drivers.config import from_values, load
from crtk_drivers.device import Mode, Setpoint
from crtk_drivers.front import LocalDevice
from crtk_drivers.kit import TcpTransport
from crtk_drivers.samples import vector
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState
from rigs.beside import beside
from rigs.waiting import LONG, endless, eventually

STATE: Any = {
    "inverse3": [
        {
            "device_id": "0",
            "state": {
                "cursor_position": {"x": 0.0, "y": 0.05, "z": 0.0},
                "cursor_velocity": {"x": 0.0, "y": 0.0, "z": 0.0},
            },
        }
    ]
}


class Heard:
    """What came to a service."""

    def __init__(self) -> None:
        self.messages: list[Any] = []

    def force(self, number: int = -1) -> Any:
        """Return the force of a message, that which came last if no other is meant."""
        return self.messages[number]["inverse3"][0]["commands"]["set_cursor_force"]["values"]


@contextmanager
def service(handle: Callable[[ServerConnection, Heard], None]) -> Iterator[tuple[int, Heard]]:
    heard = Heard()

    def connected(connection: ServerConnection) -> None:
        try:
            handle(connection, heard)
        except ConnectionClosed:
            return

    with serve(connected, "127.0.0.1", 0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield server.socket.getsockname()[1], heard
        finally:
            server.shutdown()
            thread.join()


@contextmanager
def driver(port: int, **values: Any) -> Iterator[tuple[LocalDevice, Session]]:
    given = {"host": "127.0.0.1", "port": port, "grip": False, "ramp": 0.0, "sample_timeout": 2.0}
    config = load(HaplyConfig, from_values({**given, "open_timeout": 10.0, **values}))
    session = Session(PLUGIN, config)
    front = LocalDevice(session)
    try:
        session.start()
        yield front, session
    finally:
        front.close()


def jhu(connection: ServerConnection, heard: Heard) -> None:
    """As sawHaplyService's own test service: it says nothing before it was asked, and takes 10 ms."""
    pause = threading.Event()
    for text in connection:
        heard.messages.append(json.loads(text))
        connection.send(json.dumps(STATE))
        pause.wait(0.01)


def test_a_service_that_answers_slowly_and_only_when_it_is_asked() -> None:
    with service(jhu) as (port, heard), driver(port) as (front, session):
        eventually(lambda: session.engine.connected and session.engine.has_sample, "connected")
        assert heard.messages[0] == {"session": {"force_render_full_state": {}}}
        assert front.measured_cp().position.tolist() == [0.0, 0.05, 0.0]
        front.enable()

        def is_heard() -> bool:
            front.servo_cf([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
            return bool(heard.force() == {"x": 1.0, "y": 0.0, "z": 0.0})

        eventually(is_heard, "the force")
        front.disable()
        eventually(lambda: heard.force() == {"x": 0.0, "y": 0.0, "z": 0.0}, "no force")
        assert front.operating_state().state is OperatingState.DISABLED


def test_who_sends_no_text_without_end_keeps_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    with service(jhu) as (port, _):
        way = link.ServiceLink("127.0.0.1", port, lambda: False)
        way.open(time.monotonic() + LONG)
        with monkeypatch.context() as patched:
            read = endless(Frame(Opcode.BINARY, b"x").serialize(mask=False))
            patched.setattr(TcpTransport, "read", lambda self, deadline: read(deadline))
            assert way.receive(time.monotonic()) == []
        way.close()


def test_the_last_message_before_a_goodbye_has_no_force() -> None:
    with service(jhu) as (port, heard):
        with driver(port) as (front, session):
            eventually(lambda: session.engine.connected and session.engine.has_sample, "connected")
            front.enable()

            def is_heard() -> bool:
                front.servo_cf([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
                return bool(heard.force()["y"] == 1.0)

            eventually(is_heard, "the force")
        eventually(lambda: heard.force() == {"x": 0.0, "y": 0.0, "z": 0.0}, "no force")


def test_a_stop_is_believed_by_the_answer_to_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("crtk_driver_haply.device.UNASKED", LONG)
    monkeypatch.setattr(link, "ANSWERS", 60.0)
    answers = threading.Semaphore(0)

    def slow(connection: ServerConnection, heard: Heard) -> None:
        connection.send(json.dumps(STATE))
        for text in connection:
            heard.messages.append(json.loads(text))
            answers.acquire(timeout=LONG)
            connection.send(json.dumps(STATE))

    with service(slow) as (port, heard):
        given = {"host": "127.0.0.1", "port": port, "grip": False, "ramp": 0.0}
        device = HaplyDevice(load(HaplyConfig, from_values(given)))

        def reads() -> bool:
            return device.read(time.monotonic() + 0.05) is not None

        try:
            device.open(time.monotonic() + LONG)
            device.write(Setpoint(Mode.CARTESIAN_EFFORT, vector((1.0, *[0.0] * 5))))
            device.stop()
            assert not device.has_stopped
            answers.release()
            eventually(reads, "the answer to the force")
            assert not device.has_stopped
            answers.release()
            eventually(reads, "the answer to the stop")
            assert device.has_stopped
            assert heard.force()["x"] == 0.0
        finally:
            for _ in range(9):
                answers.release()
            device.close()


def test_an_answer_that_comes_late_is_not_one_to_the_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    """After a while the driver asks again, and the service answers everything at last."""
    monkeypatch.setattr("crtk_driver_haply.device.UNASKED", LONG)
    monkeypatch.setattr(link, "NEVER", 60.0)
    answers = threading.Semaphore(0)

    def late(connection: ServerConnection, heard: Heard) -> None:
        def hear() -> None:
            for text in connection:
                heard.messages.append(json.loads(text))

        connection.send(json.dumps(STATE))
        hearing = threading.Thread(target=hear)
        hearing.start()
        while hearing.is_alive():
            if answers.acquire(timeout=0.1):
                connection.send(json.dumps(STATE))
        hearing.join()

    with service(late) as (port, heard):
        given = {"host": "127.0.0.1", "port": port, "grip": False, "ramp": 0.0}
        device = HaplyDevice(load(HaplyConfig, from_values({**given, "stream_timeout": 0.5})))
        push = Setpoint(Mode.CARTESIAN_EFFORT, vector((1.0, *[0.0] * 5)))

        def asks_again() -> bool:
            device.write(push)
            device.read(time.monotonic() + 0.05)
            return len(heard.messages) > 2

        def answered() -> bool:
            return device.read(time.monotonic() + 0.05) is not None

        try:
            device.open(time.monotonic() + LONG)
            eventually(asks_again, "three messages without an answer")
            device.stop()
            eventually(lambda: heard.force()["x"] == 0.0, "the stop")
            pushes = [number for number in range(len(heard.messages)) if heard.force(number)["x"]]
            for _ in range(pushes[-1] + 1):
                answers.release()
                eventually(answered, "an answer to a force")
                assert not device.has_stopped
            answers.release()
            eventually(answered, "the answer to the stop")
            assert device.has_stopped
        finally:
            device.close()


def test_nothing_piles_up_at_a_service_that_is_slow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("crtk_driver_haply.device.UNASKED", LONG)
    monkeypatch.setattr(link, "ANSWERS", 60.0)

    def silent(connection: ServerConnection, heard: Heard) -> None:
        connection.send(json.dumps(STATE))
        for text in connection:
            heard.messages.append(json.loads(text))

    with service(silent) as (port, heard):
        given = {"host": "127.0.0.1", "port": port, "grip": False, "rate": 1000.0}
        device = HaplyDevice(load(HaplyConfig, from_values(given)))
        try:
            device.open(time.monotonic() + LONG)
            for _ in range(20):
                device.read(time.monotonic() + 0.002)
            eventually(lambda: heard.messages, "it is asked")
        finally:
            device.close()
    assert len(heard.messages) == 1


def refused(handle: Callable[[ServerConnection, Heard], None], words: str, **values: Any) -> None:
    with service(handle) as (port, _), driver(port, **values) as (_, session):
        engine = session.engine
        eventually(lambda: words in engine.status.detail, words)
        assert engine.status.state is OperatingState.FAULT


def too_long(connection: ServerConnection, heard: Heard) -> None:
    connection.send("x" * (1 << 19))
    for _ in connection:
        pass


def goodbye(connection: ServerConnection, heard: Heard) -> None:
    connection.close(1012, "restart")


def several(connection: ServerConnection, heard: Heard) -> None:
    second = {**STATE["inverse3"][0], "device_id": "1"}
    connection.send(json.dumps({"inverse3": [*STATE["inverse3"], second]}))
    for _ in connection:
        pass


def two_grips(connection: ServerConnection, heard: Heard) -> None:
    grips = [{"device_id": name, "state": {}} for name in "ab"]
    connection.send(json.dumps({**STATE, "wireless_verse_grip": grips}))
    for _ in connection:
        pass


def test_a_message_without_end_is_not_read() -> None:
    refused(too_long, "the service ended it")


def test_a_service_that_says_goodbye() -> None:
    refused(goodbye, "1012")


def test_one_of_several_must_be_chosen() -> None:
    refused(several, "several Inverse3: 0, 1")
    refused(two_grips, "several VerseGrips: a, b", grip=True)


@pytest.mark.parametrize("said", [b"HTTP/1.1 404 Not Found\r\n\r\n", b"\x00\xff nonsense\r\n\r\n"])
def test_what_speaks_no_websocket(said: bytes) -> None:
    import socket

    with socket.create_server(("127.0.0.1", 0)) as listener:

        def answer(over: threading.Event) -> None:
            listener.settimeout(0.1)
            while not over.is_set():
                try:
                    peer, _ = listener.accept()
                except TimeoutError:
                    continue
                with peer:
                    peer.settimeout(LONG)
                    peer.recv(4096)
                    peer.sendall(said)

        with beside(answer), driver(listener.getsockname()[1]) as (_, session):
            engine = session.engine
            eventually(lambda: "speaks no WebSocket" in engine.status.detail, "it is told")
