"""The TCP channel over a connection: cut anywhere, silent, closed; and the stream that stands on it."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import pytest

from crtk_driver_ati_netft import tools
from crtk_driver_ati_netft.config import NetFtConfig
from crtk_driver_ati_netft.device import NetFtDevice
from crtk_driver_ati_netft.profiles import Action
from crtk_driver_ati_netft.recording import read_recording
from crtk_driver_ati_netft.tcp49151 import TcpChannel
from crtk_driver_ati_netft.tcp_stream import TcpStream
from crtk_driver_ati_netft.tools import RecordOptions
from crtk_drivers.config import from_values, load
from crtk_drivers.errors import ConnectionFailed, ConnectionLost, ProtocolError
from crtk_drivers.samples import Wrench
from rigs.waiting import LONG

SCALE = bytes.fromhex("1234 02 03 000F4240 000F4240 000A 000A 000A 0014 0014 0014")
READING = bytes.fromhex("1234 8002 0064 FF9C 0001 0032 FFCE 0002")

SCALE_TYPED = {"counts_per_force": 1e6, "counts_per_torque": 1e6}

TRIED = 4.0
"""Seconds for a connection of which half is waited out, as no UDP comes: the other half is for TCP."""

Answer = Callable[[bytes], list[bytes]]


def normal(request: bytes) -> list[bytes]:
    return [SCALE] if request[0] == 1 else [READING]


@contextmanager
def sensor(answer: Answer = normal) -> Iterator[tuple[int, list[bytes]]]:
    """Answer each request with the pieces that `answer` gives; none: never, an empty one: close."""
    requests: list[bytes] = []
    ended = threading.Event()
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(0.02)

    def serve(peer: socket.socket) -> None:
        peer.settimeout(0.02)
        data = b""
        while not ended.is_set():
            with suppress(TimeoutError):
                piece = peer.recv(4096)
                if not piece:
                    return
                data += piece
            while len(data) >= 20:
                requests.append(data[:20])
                pieces, data = answer(data[:20]), data[20:]
                for part in pieces:
                    if not part:
                        return
                    peer.sendall(part)

    def run() -> None:
        while not ended.is_set():
            with suppress(TimeoutError, ConnectionError):
                peer, _ = listener.accept()
                with peer:
                    serve(peer)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield listener.getsockname()[1], requests
    finally:
        ended.set()
        thread.join()
        listener.close()


def soon(seconds: float = 10.0) -> float:
    return time.monotonic() + seconds


def test_measurements_are_in_si_units() -> None:
    with sensor() as (port, requests):
        stream = TcpStream("127.0.0.1", port)
        stream.open(soon())
        try:
            first, second = stream.receive(soon()), stream.receive(soon())
        finally:
            stream.close()
        assert first is not None
        assert second is not None
        assert first.values[0] == pytest.approx([1e-3, -1e-3, 1e-5, 1e-3, -1e-3, 4e-5])
        assert first.status.tolist() == [0x80020000]
        assert (first.sequence[0], second.sequence[0]) == (1, 2)
        assert first.times[0] < second.times[0] < time.monotonic()
        assert len(requests) == 3


def test_replies_may_come_in_pieces() -> None:
    def pieces(request: bytes) -> list[bytes]:
        (whole,) = normal(request)
        return [whole[i : i + 1] for i in range(len(whole))]

    with sensor(pieces) as (port, _):
        stream = TcpStream("127.0.0.1", port)
        stream.open(soon())
        try:
            assert stream.receive(soon()) is not None
        finally:
            stream.close()


def test_a_late_reply_is_waited_for_and_not_asked_for_again() -> None:
    release = threading.Event()

    def slow(request: bytes) -> list[bytes]:
        if request[0] == 0:
            release.wait(LONG)
        return normal(request)

    with sensor(slow) as (port, requests):
        channel = TcpChannel("127.0.0.1", port)
        channel.open(soon())
        try:
            assert channel.read(soon(0.05)) is None
            assert channel.read(soon(0.05)) is None
            release.set()
            assert channel.read(soon()) is not None
        finally:
            channel.close()
        assert len(requests) == 1


def test_bias_and_latch_go_with_the_next_measurement() -> None:
    with sensor() as (port, requests):
        stream = TcpStream("127.0.0.1", port)
        stream.open(soon())
        try:
            stream.receive(soon())
            stream.request(Action.BIAS)
            stream.request(Action.CLEAR_LATCH)
            stream.receive(soon())
            stream.receive(soon())
        finally:
            stream.close()
        assert [request[-1] for request in requests] == [0, 0, 3, 0]
        with pytest.raises(ProtocolError, match="unbias"):
            stream.request(Action.UNBIAS)


def test_a_bias_that_is_asked_for_while_an_answer_is_awaited_goes_with_the_next_question() -> None:
    held, release = threading.Event(), threading.Event()
    release.set()

    def slow(request: bytes) -> list[bytes]:
        if request[0] == 0:
            held.set()
            release.wait(LONG)
        return normal(request)

    with sensor(slow) as (port, requests):
        stream = TcpStream("127.0.0.1", port)
        stream.open(soon())
        try:
            stream.receive(soon())
            held.clear()
            release.clear()
            assert stream.receive(soon(0.05)) is None
            assert held.wait(LONG)
            stream.request(Action.BIAS)
            release.set()
            assert stream.receive(soon()) is not None
            assert stream.receive(soon()) is not None
            assert stream.receive(soon()) is not None
        finally:
            stream.close()
        assert [request[-1] for request in requests] == [0, 0, 0, 1, 0]


def test_a_bias_that_was_asked_for_is_not_set_by_the_next_connection() -> None:
    with sensor() as (port, requests):
        stream = TcpStream("127.0.0.1", port)
        for _ in range(2):
            stream.open(soon())
            stream.request(Action.BIAS)
            stream.request(Action.CLEAR_LATCH)
            stream.close()
        assert [request[-1] for request in requests] == [0] * 4


@pytest.mark.parametrize(
    ("answer", "within", "error", "message"),
    [
        (lambda r: [], 1.0, ConnectionFailed, "no answer in time"),
        (lambda r: [b""], 10.0, ConnectionLost, "closed the connection"),
        (lambda r: [b"\x00" * 24], 10.0, ProtocolError, "header"),
        (lambda r: [SCALE] if r[0] else [], 1.0, ConnectionFailed, "no measurement"),
        (lambda r: [SCALE] if r[0] else [b"\xff" * 16], 10.0, ProtocolError, "header"),
        (lambda r: [SCALE] if r[0] else [READING[:7], b""], 10.0, ConnectionLost, "closed"),
    ],
    ids=["silent", "closes", "not a scale", "no measurement", "not one", "half of one"],
)
def test_what_is_no_sensor_is_said_so(answer, within, error, message) -> None:
    with sensor(answer) as (port, _):
        stream = TcpStream("127.0.0.1", port)
        with pytest.raises(error, match=message) as caught:
            stream.open(soon(within))
        assert str(port) in caught.value.where
        assert caught.value.remedy


def test_a_closed_port_is_no_connection() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(ConnectionFailed, match="refused"):
        TcpStream("127.0.0.1", port).open(soon())


def test_waiting_can_be_ended() -> None:
    with sensor(lambda request: []) as (port, requests):
        stream = TcpStream("127.0.0.1", port)
        failed: list[Exception] = []

        def run() -> None:
            try:
                stream.open(soon(600.0))
            except (ConnectionFailed, ConnectionLost) as error:
                failed.append(error)

        thread = threading.Thread(target=run)
        thread.start()
        deadline = soon()
        while not requests:
            assert time.monotonic() < deadline
            time.sleep(0.002)
        stream.abort()
        thread.join(LONG)
        assert not thread.is_alive()
        assert "given up" in str(failed[0])


def test_on_hold_nothing_is_asked_for() -> None:
    with sensor() as (port, requests):
        stream = TcpStream("127.0.0.1", port)
        stream.open(soon())
        try:
            stream.receive(soon())
            stream.hold()
            assert stream.receive(soon(0.05)) is None
            stream.resume()
            assert stream.receive(soon()) is not None
        finally:
            stream.close()
        assert len(requests) == 3


def device_at(tcp_port: int, **values: Any) -> NetFtDevice:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        closed = listener.getsockname()[1]
    config = {
        "host": "127.0.0.1",
        "tcp_port": tcp_port,
        "rdt_port": closed,
        "http_port": closed,
        "rate": 100.0,
        **values,
    }
    return NetFtDevice(load(NetFtConfig, from_values(config)))


def test_a_sensor_without_web_page_and_udp_is_measured_over_tcp(caplog) -> None:
    with sensor() as (port, _):
        device = device_at(port)
        device.open(soon(TRIED))
        try:
            sample = device.read(soon())
            assert sample is not None
            wrench = sample.values["raw/measured_cf"]
            assert isinstance(wrench, Wrench)
            assert wrench.force == pytest.approx([1e-3, -1e-3, 1e-5])
            assert sample.stamp.wall_ns > 0
            assert {"web page", "transport"} <= {note.key for note in device.notes}
        finally:
            device.close()
    assert "read over TCP" in caplog.text
    assert "measuring over TCP instead" in caplog.text


def test_tcp_alone_may_be_asked_for() -> None:
    with sensor() as (port, _):
        device = device_at(port, transport="tcp", http=False, scale=SCALE_TYPED, profile="axia")
        device.open(soon())
        try:
            begin = time.monotonic()
            for _ in range(5):
                assert device.read(soon()) is not None
            assert time.monotonic() - begin > 0.03, "not faster than it was asked to"
            assert not any(note.key == "transport" for note in device.notes)
        finally:
            device.close()


def test_a_sensor_that_cannot_be_reached_in_any_way_says_what_was_tried() -> None:
    with sensor(lambda request: [b""]) as (port, _):
        device = device_at(port)
        with pytest.raises(ConnectionFailed) as caught:
            device.open(soon())
        assert "netftapi2.xml" in caught.value.message
        assert "over TCP" in caught.value.message
        typed = device_at(port, http=False, scale=SCALE_TYPED)
        with pytest.raises(ConnectionFailed, match=r"RDT port is closed.*over TCP"):
            typed.open(soon(TRIED))
        device.close()
        typed.close()


def test_a_recording_goes_on_when_a_sensor_that_is_back_says_strange_things_at_first(
    tmp_path,
) -> None:
    scales = [SCALE, b"", b"\x00" * 24, SCALE]
    readings = 0

    def answer(request: bytes) -> list[bytes]:
        nonlocal readings
        if request[0] == 1:
            return [scales.pop(0) if len(scales) > 1 else SCALE]
        readings += 1
        if readings == 20:
            os.kill(os.getpid(), signal.SIGINT)
        return [b""] if readings == 6 else [READING]

    with sensor(answer) as (port, _):
        values = {"transport": "tcp", "http": False, "scale": SCALE_TYPED, "profile": "axia"}
        out = tmp_path / "load.ftrec"
        config = load(
            NetFtConfig,
            from_values({"host": "127.0.0.1", "tcp_port": port, "rate": 100.0} | values),
        )
        assert tools.record(config, RecordOptions(out=str(out), seconds=60.0)) == 0
    assert len(scales) == 1, "all of them were said"
    assert len(read_recording(out).data) >= 10
