"""Frames of Modbus: those of the manual, and what is left of them when the line is bad."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_robotiq.links import GripperRegisters
from crtk_driver_robotiq.registers import STATUS, Activation, Command, Contact, Status
from crtk_drivers.kit import modbus_frames
from crtk_drivers.kit.modbus_frames import Mbap, Question, Rtu, crc

REGISTERS = GripperRegisters()
write = REGISTERS.aside


def read(function: int) -> Question:
    return modbus_frames.read(STATUS, 3, function)


read_write = REGISTERS.write


def hexed(text: str) -> bytes:
    return bytes.fromhex(text.replace(" ", ""))


KNOWN = {
    "reset": (
        write(Command(activate=False)),
        "09 10 03E8 0003 06 0000 0000 0000 7330",
    ),
    "activate": (write(Command()), "09 10 03E8 0003 06 0100 0000 0000 72E1"),
    "close": (
        write(Command(go=True, position=255, speed=255, force=255)),
        "09 10 03E8 0003 06 0900 00FF FFFF 4229",
    ),
    "open": (
        write(Command(go=True, position=0, speed=255, force=255)),
        "09 10 03E8 0003 06 0900 0000 FFFF 7219",
    ),
    "close and read": (
        read_write(Command(go=True, position=255, speed=255, force=255)),
        "09 17 07D0 0003 03E8 0003 06 0900 00FF FFFF E63E",
    ),
    "read three": (read(4), "09 04 07D0 0003 B1CE"),
}
"""From the instruction manual (4.7), but for the last two: by the same CRC."""


@pytest.mark.parametrize(("question", "frame"), KNOWN.values(), ids=KNOWN)
def test_a_question_is_the_frame_of_the_manual(question: Question, frame: str) -> None:
    assert Rtu(9).ask(question) == hexed(frame)


GRASPED = hexed("09 04 06 B900 00FF BD00 5C9A")


def test_the_answer_after_a_grasp() -> None:
    line = Rtu(9)
    line.ask(read(4))
    reply = line.feed(GRASPED)
    assert reply is not None
    assert Status.parse(reply[2:]) == Status(
        activated=True,
        goes=True,
        activation=Activation.DONE,
        contact=Contact.WHILE_CLOSING,
        fault=0,
        controller_fault=0,
        requested=255,
        position=0xBD,
        current=0.0,
    )


@pytest.mark.parametrize(
    ("register", "activation", "contact"),
    [
        ("1100", Activation.RUNNING, Contact.MOVING),
        ("3100", Activation.DONE, Contact.MOVING),
        ("F900", Activation.DONE, Contact.AT_REQUEST),
    ],
)
def test_the_status_register(register: str, activation: Activation, contact: Contact) -> None:
    status = Status.parse(hexed(register) + bytes(4))
    assert (status.activation, status.contact) == (activation, contact)


def test_both_halves_of_the_fault_byte() -> None:
    status = Status.parse(hexed("3100 5D00 0000"))
    assert (status.controller_fault, status.fault) == (0x5, 0xD)


def test_the_answer_to_a_write_and_an_exception() -> None:
    line = Rtu(9)
    line.ask(write(Command()))
    assert line.feed(hexed("09 10 03E8 0003 0130")) == hexed("10 03E8 0003")
    line.ask(read(3))
    assert line.feed(hexed("09 83 02 4133")) == b"\x83\x02"


@pytest.mark.parametrize("block", [b"", bytes(5), bytes(7)])
def test_a_status_of_another_size_is_none(block: bytes) -> None:
    with pytest.raises(ValueError, match="unpack"):
        Status.parse(block)


BLOCKS = st.binary(min_size=6, max_size=6)
NOISE = st.binary(max_size=40)


def framed(body: bytes) -> bytes:
    return body + crc(body)


def fed(line: Rtu | Mbap, data: bytes, cuts: list[int]) -> list[bytes]:
    """Return the replies in data that comes in pieces."""
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    pieces = [data[a:b] for a, b in itertools.pairwise(edges)]
    return [reply for piece in pieces if (reply := line.feed(piece)) is not None]


@given(BLOCKS, NOISE, st.lists(st.integers(min_value=0), max_size=8))
def test_an_answer_is_found_behind_noise_wherever_it_is_cut(
    block: bytes, noise: bytes, cuts: list[int]
) -> None:
    line = Rtu(9)
    line.ask(read(3))
    frame = framed(b"\x09\x03\x06" + block)
    replies = fed(line, noise + frame, cuts)
    assert b"\x03\x06" + block in replies
    assert line.strange <= len(noise)


@given(BLOCKS, st.integers(0, 10), st.integers(1, 255))
def test_a_damaged_answer_is_none(block: bytes, at: int, change: int) -> None:
    line = Rtu(9)
    line.ask(read(3))
    frame = bytearray(framed(b"\x09\x03\x06" + block))
    frame[at] ^= change
    assert line.feed(bytes(frame)) is None


@given(BLOCKS, st.integers(0, 10))
def test_an_answer_that_ends_too_early_is_none_and_hinders_no_other(
    block: bytes, size: int
) -> None:
    line = Rtu(9)
    line.ask(read(3))
    frame = framed(b"\x09\x03\x06" + block)
    assert line.feed(frame[:size]) is None
    line.ask(read(4))
    other = framed(b"\x09\x04\x06" + block)
    assert line.feed(other) == b"\x04\x06" + block


@given(NOISE, BLOCKS)
def test_what_others_on_the_line_are_told_is_no_answer(noise: bytes, block: bytes) -> None:
    """Another unit, another function, another size."""
    line = Rtu(9)
    line.ask(read(3))
    for body in (b"\x0a\x03\x06" + block, b"\x09\x04\x06" + block, b"\x09\x03\x04" + block[:4]):
        assert line.feed(framed(body)) is None
    assert line.feed(framed(b"\x09\x03\x06" + block)) == b"\x03\x06" + block


@given(BLOCKS, st.lists(st.integers(min_value=0), max_size=8))
def test_modbus_tcp_answers_by_transaction(block: bytes, cuts: list[int]) -> None:
    line = Mbap(9)
    first, second = line.ask(read(3)), line.ask(read(3))
    assert first[:6] == hexed("0001 0000 0006")
    assert second[7:] == read(3).request
    late = hexed("0001 0000 0009 09 03 06") + bytes(6)
    answer = hexed("0002 0000 0009 09 03 06") + block
    assert fed(line, late + answer, cuts) == [b"\x03\x06" + block]
    assert line.strange == len(late)


def test_what_is_not_modbus_tcp_is_refused() -> None:
    line = Mbap(9)
    line.ask(read(3))
    with pytest.raises(ValueError, match="not Modbus TCP"):
        line.feed(b"HTTP/1.1 200 OK\r\n")


def test_a_command_aside_changes_nothing_of_what_is_waited_for() -> None:
    line, tcp = Rtu(9), Mbap(9)
    line.ask(read(3))
    assert line.aside(write(Command())) == hexed(KNOWN["activate"][1])
    assert line.feed(framed(b"\x09\x10\x03\xe8\x00\x03")) is None
    assert line.feed(framed(b"\x09\x03\x06" + bytes(6))) == b"\x03\x06" + bytes(6)
    tcp.ask(read(3))
    assert tcp.aside(write(Command()))[:2] == b"\0\0"
    assert tcp.feed(hexed("0001 0000 0009 09 03 06") + bytes(6)) == b"\x03\x06" + bytes(6)
