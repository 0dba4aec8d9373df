"""The relay of a CAN bus: a hub in place of an adapter, and python-can's socketcand where a driver has it."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from contextlib import suppress

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.errors import ConnectionFailed
from crtk_drivers.labs.bench.can_relay import frame_of, line_of
from crtk_drivers.labs.bench.relay import Mode, RelayProcess
from crtk_drivers.plugins import DeviceLink
from crtk_sim_backends.can import SIM
from rigs.waiting import LONG

SHORT = 0.2

FRAMES = st.builds(
    lambda extended, number, data: can.Message(
        arbitration_id=number if extended else number % 0x800,
        data=data,
        is_extended_id=extended,
        timestamp=1.5,
    ),
    st.booleans(),
    st.integers(0, 0x1FFF_FFFF),
    st.binary(max_size=8),
)


@pytest.fixture(scope="module")
def adapter() -> Iterator[dict[str, str]]:
    with SIM.spawn() as hub:
        yield {"interface": "crtk", "channel": hub.paths["crtk"]}


@pytest.fixture
def device(adapter: dict[str, str]) -> Iterator[can.BusABC]:
    with can.Bus(**adapter) as bus:
        yield bus


@pytest.fixture
def relay(adapter: dict[str, str]) -> Iterator[RelayProcess]:
    with RelayProcess(DeviceLink(can={"bus": adapter})) as made:
        yield made


def driver_at(relay: RelayProcess) -> can.BusABC:
    link = relay.link
    return can.Bus(interface="socketcand", channel="x", host=link.host, port=link.tcp["bus"])


@pytest.fixture
def driver(relay: RelayProcess, device: can.BusABC) -> Iterator[can.BusABC]:
    bus = driver_at(relay)
    bus.send(frame(0))  # whoever sends hears at once
    assert device.recv(LONG) is not None
    yield bus
    with suppress(OSError, can.CanError):
        bus.shutdown()


def frame(number: int, data: bytes = b"\1\2", *, extended: bool = False) -> can.Message:
    return can.Message(arbitration_id=number, data=data, is_extended_id=extended)


def passes(source: can.BusABC, target: can.BusABC, sent: can.Message, seconds: float) -> bool:
    source.send(sent)
    found = target.recv(seconds)
    return found is not None and found.equals(sent, check_channel=False, timestamp_delta=None)


def test_frames_pass_both_ways(driver: can.BusABC, device: can.BusABC) -> None:
    for sent in (
        frame(0x123),
        frame(0x7FF, b""),
        frame(0x12345, bytes(range(8)), extended=True),
    ):
        for source, target in ((driver, device), (device, driver)):
            source.send(sent)
            found = target.recv(LONG)
            assert found is not None
            assert (found.arbitration_id, bytes(found.data), found.is_extended_id) == (
                sent.arbitration_id,
                bytes(sent.data),
                sent.is_extended_id,
            )


@pytest.mark.parametrize("mode", [Mode.DEAF, Mode.SILENT])
def test_what_does_not_pass_is_lost(
    relay: RelayProcess, driver: can.BusABC, device: can.BusABC, mode: Mode
) -> None:
    relay.mode = mode
    driver.send(frame(1))
    assert device.recv(SHORT) is None
    device.send(frame(2))
    told = driver.recv(LONG if mode is Mode.DEAF else SHORT)
    assert (told is not None) is (mode is Mode.DEAF)
    relay.mode = Mode.OPEN
    driver.send(frame(3))
    found = device.recv(LONG)
    assert found is not None
    assert found.arbitration_id == 3, "the first one comes no more"


def test_one_that_is_pulled_out_hangs_up_and_is_there_again(
    relay: RelayProcess, driver: can.BusABC, device: can.BusABC
) -> None:
    port = relay.link.tcp["bus"]
    relay.mode = Mode.CLOSED
    end = time.monotonic() + LONG
    with suppress(OSError, can.CanError):
        while time.monotonic() < end:
            driver.recv(SHORT)
    assert time.monotonic() < end, "it hangs up"
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((relay.link.host, port), LONG)
    relay.mode = Mode.OPEN
    assert relay.link.tcp["bus"] == port
    with driver_at(relay) as again:
        again.send(frame(4))
        found = device.recv(LONG)
    assert found is not None
    assert found.arbitration_id == 4


def test_an_adapter_that_cannot_be_opened_is_told() -> None:
    nowhere = {"interface": "crtk", "channel": "/nowhere/bus.sock"}
    with pytest.raises(ConnectionFailed, match="cannot open crtk /nowhere/bus") as caught:
        RelayProcess(DeviceLink(can={"bus": nowhere}))
    assert "another program" in caught.value.remedy


# ------------------------------------------------------------------------------------------- the protocol


@pytest.mark.parametrize(
    ("words", "number", "data", "extended"),
    [
        (b"send 123 0", 0x123, b"", False),
        (b"send 1AAAAAAA 2 1 F1", 0x1AAAAAAA, b"\x01\xf1", True),
    ],
)
def test_what_is_sent_is_read_as_the_protocol_says(
    words: bytes, number: int, data: bytes, extended: bool
) -> None:
    found = frame_of(words.split())
    assert (found.arbitration_id, bytes(found.data), found.is_extended_id) == (
        number,
        data,
        extended,
    )


@pytest.mark.parametrize(
    ("told", "line"),
    [
        (can.Message(0x0, 0x123, is_extended_id=False, data=b"\x11\x22"), b"< frame 123 0.000000 1122 >"),
        (can.Message(2.5, 0x1ABCDEF, data=b""), b"< frame 01ABCDEF 2.500000  >"),
        (can.Message(1.0, 4, is_error_frame=True), b"< error 004 1.000000 >"),
        (can.Message(1.0, 4, is_remote_frame=True), b""),
    ],
)  # fmt: skip
def test_what_is_heard_is_told_as_the_protocol_says(told: can.Message, line: bytes) -> None:
    assert line_of(told) == line


@given(FRAMES)
def test_any_frame_comes_back_the_same(sent: can.Message) -> None:
    number = f"{sent.arbitration_id:08X}" if sent.is_extended_id else f"{sent.arbitration_id:03X}"
    words = [
        b"send",
        number.encode(),
        b"%X" % len(sent.data),
        *(b"%x" % each for each in sent.data),
    ]
    found = frame_of(words)
    assert line_of(sent).split()[2] == number.encode()
    assert (found.arbitration_id, bytes(found.data)) == (sent.arbitration_id, bytes(sent.data))


@given(st.lists(st.binary(max_size=10), min_size=1, max_size=12))
def test_what_is_no_frame_is_refused(words: list[bytes]) -> None:
    with suppress(ValueError, IndexError):
        frame_of(words)
