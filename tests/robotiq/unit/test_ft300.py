"""The stream of the FT 300: known answers, and whatever else a line may bring."""

from __future__ import annotations

import socket
import struct
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_robotiq.ft300.config import Ft300Config
from crtk_driver_robotiq.ft300.link import SensorLink
from crtk_driver_robotiq.ft300.registers import Identity, loads_of
from crtk_driver_robotiq.ft300.stream import FRAME, STOP, stream_decoder
from crtk_drivers.config import from_values, load
from crtk_drivers.kit import SeekingDecoder, modbus_frames
from rigs.waiting import LONG

KNOWN = bytes.fromhex("204E 6400 38FF B80B 6400 38FF 2C01 8F67")
LOAD = [1.0, -2.0, 30.0, 0.1, -0.2, 0.3]
counts = st.lists(st.integers(-32768, 32767), min_size=6, max_size=6)


def frame(numbers: list[int]) -> bytes:
    body = b"\x20\x4e" + struct.pack("<6h", *numbers)
    value = 0xFFFF
    for byte in body:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return body + value.to_bytes(2, "little")


def fed(data: bytes, cuts: list[int]) -> tuple[SeekingDecoder[np.ndarray], list[np.ndarray]]:
    decoder, found, rest = stream_decoder(), [], data
    for cut in cuts:
        piece, rest = rest[:cut], rest[cut:]
        found += decoder.feed(piece)
    return decoder, found + decoder.feed(rest)


def test_a_frame_of_the_sensor() -> None:
    (load,) = stream_decoder().feed(KNOWN)
    assert load == pytest.approx(LOAD)
    assert len(STOP) == 50


def test_what_a_port_kept_while_this_computer_stood_still_is_as_old_as_it_is() -> None:
    stood, rest = 5.0, 500
    with socket.create_server(("127.0.0.1", 0)) as server:
        values = {"port": f"socket://127.0.0.1:{server.getsockname()[1]}"}
        link = SensorLink(load(Ft300Config, from_values(values)), lambda: False)
        link._transport.open(time.monotonic() + LONG)
        sensor, _ = server.accept()
        with sensor:
            sensor.sendall(KNOWN)
            assert link.read(time.monotonic() + LONG) is not None
            link._lateness._came -= stood
            sensor.sendall(rest * KNOWN)
            ages = []
            while rest:
                batch = link.read(time.monotonic() + LONG)
                assert batch is not None
                rest -= len(batch.loads)
                ages.append(time.monotonic() - batch.times[-1])
        link.close()
    assert ages[0] > 1.0
    assert ages[-1] < 1.0


def test_the_questions_of_the_manual() -> None:
    rtu = modbus_frames.Rtu(9)
    assert rtu.ask(modbus_frames.write(410, b"\x02\x00")).hex() == "0910019a0001020200cdca"
    assert rtu.feed(bytes.fromhex("0910019A00012152")) is not None
    assert rtu.ask(modbus_frames.read(180, 6)).hex() == "090300b4000684a6"


def test_registers_have_their_high_byte_first() -> None:
    assert loads_of(bytes.fromhex("0064FF380BB80064FF38012C")) == pytest.approx(LOAD)
    with pytest.raises(struct.error):
        loads_of(b"\0" * 10)


@pytest.mark.parametrize(
    ("firmware", "is_sensor"), [(b"FT1.05", True), (b"", False), (b"\xff\x00Fx\x00\x00", False)]
)
def test_what_it_says_of_itself(firmware: bytes, is_sensor: bool) -> None:
    identity = Identity.parse(firmware, b"FTS-0815", (2021).to_bytes(2))
    assert identity.is_sensor is is_sensor
    assert (identity.serial, identity.year) == ("FTS-0815", 2021)


@given(st.lists(counts, min_size=1, max_size=5), st.lists(st.integers(1, 40), max_size=8))
def test_it_may_be_cut_anywhere(measured: list[list[int]], cuts: list[int]) -> None:
    decoder, found = fed(b"".join(map(frame, measured)), cuts)
    scale = [100.0] * 3 + [1000.0] * 3
    assert [np.rint(load * scale).tolist() for load in found] == measured
    assert (decoder.strange, decoder.corrupt, decoder.pending) == (0, 0, 0)


@given(counts, st.integers(0, FRAME - 1), st.integers(1, 255))
def test_a_damaged_frame_is_left_out_and_the_next_one_taken(
    numbers: list[int], at: int, change: int
) -> None:
    damaged = bytearray(frame(numbers))
    damaged[at] ^= change
    decoder, found = fed(KNOWN + bytes(damaged) + KNOWN, [])
    assert [load.tolist() for load in found] == [pytest.approx(LOAD)] * 2
    assert (decoder.corrupt, decoder.strange) == (1, FRAME)


@given(st.binary(max_size=60), st.lists(st.integers(1, 20), max_size=5))
def test_it_finds_into_a_stream_wherever_it_begins(noise: bytes, cuts: list[int]) -> None:
    decoder, found = fed(noise + KNOWN + KNOWN, cuts)
    assert found[-1] == pytest.approx(LOAD)
    assert decoder.corrupt == 0 or frame([0] * 6)[:2] in noise


def test_a_truncated_frame_costs_nothing_but_itself() -> None:
    decoder, found = fed(KNOWN + KNOWN[:9] + KNOWN, [])
    assert len(found) == 2
    assert (decoder.corrupt, decoder.strange) == (1, 9)


def test_the_head_inside_a_frame_misleads_nobody() -> None:
    (inside,) = struct.unpack("<h", b"\x20\x4e")
    data = frame([inside] * 6)
    decoder, found = fed(data[5:] + data + data, [])
    assert len(found) == 2
    assert decoder.corrupt == 0
