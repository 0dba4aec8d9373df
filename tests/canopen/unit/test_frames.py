"""Frames as bytes, against linux/can.h by hand and against python-can."""

import sys

import can
import pytest
from can.interfaces.socketcan.socketcan import build_can_frame, dissect_can_frame
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_canopen.candump import candump_line
from crtk_driver_canopen.frames import ERROR, EXTENDED, REMOTE, Frame, pack, unpack
from crtk_drivers.errors import ProtocolError

DATA = st.binary(max_size=8)


@pytest.mark.skipif(sys.byteorder != "little", reason="struct can_frame has the machine's order")
@pytest.mark.parametrize(
    ("frame", "raw"),
    [
        (Frame(0x080, b""), "80000000 00 000000 0000000000000000"),
        (Frame(0x181, b"\x37\x02\x10\x27\x00\x00"), "81010000 06 000000 3702102700000000"),
        (Frame(0x7FF, bytes(range(1, 9))), "ff070000 08 000000 0102030405060708"),
        (Frame(ERROR | 0x040, bytes(8)), "40000020 08 000000 0000000000000000"),
        (Frame(EXTENDED | 0x1234567, b"\xaa"), "67452381 01 000000 aa00000000000000"),
    ],
)
def test_the_layout_of_the_kernel(frame: Frame, raw: str) -> None:
    assert pack(frame) == bytes.fromhex(raw)
    assert unpack(bytes.fromhex(raw)) == frame


@given(st.integers(0, 0xFFFF_FFFF), DATA)
def test_python_can_reads_what_is_packed(can_id: int, data: bytes) -> None:
    found, _, _, read = dissect_can_frame(pack(Frame(can_id, data)))
    assert (found, read) == (can_id, data)


@given(st.integers(0, 0x7FF), DATA)
def test_what_python_can_packs_is_read(can_id: int, data: bytes) -> None:
    message = can.Message(arbitration_id=can_id, data=data, is_extended_id=False)
    assert unpack(build_can_frame(message)) == Frame(can_id, data)


@given(st.binary(min_size=16, max_size=72))
def test_no_bytes_have_more_than_eight_data(raw: bytes) -> None:
    assert len(unpack(raw).data) == min(raw[4], 8)


@given(st.binary(max_size=15))
def test_what_is_too_short_is_no_frame(raw: bytes) -> None:
    with pytest.raises(ProtocolError, match=f"{len(raw)} bytes are no CAN frame"):
        unpack(raw)


@pytest.mark.parametrize(
    ("frame", "text"),
    [
        (Frame(0x181, b"\x37\x02", time=1.5), "(1.500000) can0 181#3702"),
        (Frame(0x1, b"", time=1.5), "(1.500000) can0 001#"),
        (Frame(EXTENDED | 0x181, b"\x37", time=1.5), "(1.500000) can0 00000181#37"),
        (Frame(REMOTE | 0x701, b"", time=1.5), "(1.500000) can0 701#R"),
        (Frame(ERROR | 0x4, b"\0\x20", time=1.5), "(1.500000) can0 20000004#0020"),
    ],
)
def test_a_line_of_candump(frame: Frame, text: str) -> None:
    assert candump_line(frame, "can0") == text + "\n"
