"""The binary protocol of a WSG: known frames, and what damaged bytes become."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crtk_driver_weiss_wsg.binary import BinaryCodec, crc, frame
from crtk_driver_weiss_wsg.tables import COMMANDS, Command, Flag, Message
from rigs.examples import examples

REQUESTS = {
    "AAAAAA 22 0000 0E76": (Command.STOP,),
    "AAAAAA 23 0000 AC1C": (Command.FAST_STOP,),
    "AAAAAA 24 0300 61636B DCB9": (Command.ACKNOWLEDGE,),
    "AAAAAA 20 0100 00 8F83": (Command.HOME, 0),
    "AAAAAA 25 0800 00002042 00004842 835C": (Command.GRASP, 0.04, 0.05, 20.0),
    "AAAAAA 43 0300 01 1400 368D": (Command.WIDTH, 1, 0.02),
}
"""Requests as two clients send them (nalt/wsg50-ros-pkg, drake-schunk-driver)."""
ANSWERS = {
    "AAAAAA 43 0600 0000 00004842 62FF": Message(Command.WIDTH, 0, (0.05,)),
    "AAAAAA 20 0200 0000 B3FD": Message(Command.HOME, 0),
    "AAAAAA 21 0200 1A00 67CB": Message(Command.MOVE, 26),
    "AAAAAA 21 0200 0000 2804": Message(Command.MOVE, 0),
}
"""Answers, some of them from the examples of the manual."""
OTHERS = {
    "AAAAAA 01 0000 E810": (0x01, b""),
    "AAAAAA 01 0200 1234 6D66": (0x01, b"\x12\x34"),
    "AAAAAA 90 0200 0E00 FD02": (0x90, b"\x0e\x00"),
    "AAAAAA 30 0600 0000 00001643 DCCB": (0x30, b"\0\0\0\0\x16\x43"),
}
"""Further frames of the manual (1.2)."""

messages = st.one_of(
    st.builds(
        Message,
        st.sampled_from([Command.WIDTH, Command.SPEED, Command.FORCE]),
        st.just(0),
        st.tuples(st.integers(-400, 400).map(float)),
    ),
    st.builds(
        Message, st.sampled_from([Command.MOVE, Command.STOP]), st.integers(0, 30), st.just(())
    ),
)


def wire(message: Message) -> bytes:
    """The frame by which a gripper tells a message; values in its own units."""
    values = struct.pack(f"<{len(message.values)}f", *message.values)
    return frame(message.about, message.status.to_bytes(2, "little") + values)


def told(message: Message) -> Message:
    """The same in SI units."""
    scales = COMMANDS[message.about].reply_scales
    return message._replace(
        values=tuple(v / scale for v, scale in zip(message.values, scales, strict=False))
    )


@pytest.mark.parametrize(("text", "command"), REQUESTS.items())
def test_known_requests(text: str, command: tuple[Command, float]) -> None:
    assert BinaryCodec().encode(*command) == bytes.fromhex(text)


@pytest.mark.parametrize(("text", "message"), ANSWERS.items())
def test_known_answers(text: str, message: Message) -> None:
    codec = BinaryCodec()
    assert codec.feed(bytes.fromhex(text)) == [message]
    assert codec.strange == 0


@pytest.mark.parametrize(("text", "parts"), OTHERS.items())
def test_known_frames(text: str, parts: tuple[int, bytes]) -> None:
    assert frame(*parts) == bytes.fromhex(text)


@pytest.mark.parametrize("text", [*REQUESTS, *ANSWERS, *OTHERS])
def test_the_crc_over_a_whole_frame_is_zero(text: str) -> None:
    assert crc(bytes.fromhex(text)) == 0


def test_a_move_is_absolute_and_clamps() -> None:
    data = BinaryCodec().encode(Command.MOVE, 0.04, 0.05)
    assert data[3:15] == bytes.fromhex("21 0900 00 00002042 00004842")


def test_the_limits_are_told_in_si_units() -> None:
    values = struct.pack("<8f", 110, 5, 420, 100, 5000, 5, 80, 120)
    (message,) = BinaryCodec().feed(frame(0x53, b"\0\0" + values))
    assert message.values == pytest.approx((0.11, 0.005, 0.42, 0.1, 5.0, 5.0, 80.0, 120.0))


def test_flags_are_the_bits_of_the_manual() -> None:
    (message,) = BinaryCodec().feed(frame(0x40, b"\0\0" + (0x1001).to_bytes(4, "little")))
    assert Flag(int(message.values[0])) == Flag.REFERENCED | Flag.FAST_STOP


@settings(max_examples=examples(40))
@given(st.lists(messages, max_size=8), st.data())
def test_frames_may_be_cut_anywhere(sent: list[Message], data: st.DataObject) -> None:
    stream = b"".join(map(wire, sent))
    codec, found = BinaryCodec(), []
    while stream:
        size = data.draw(st.integers(1, len(stream)))
        found += codec.feed(stream[:size])
        stream = stream[size:]
    assert found == [told(message) for message in sent]
    assert codec.strange == 0


@settings(max_examples=examples(60))
@given(st.lists(messages, min_size=1, max_size=6), st.data())
def test_a_damaged_frame_costs_itself_alone(sent: list[Message], data: st.DataObject) -> None:
    frames = list(map(wire, sent))
    which = data.draw(st.integers(0, len(frames) - 1))
    at = data.draw(st.integers(6, len(frames[which]) - 1))
    flip = data.draw(st.integers(1, 255))
    bad = bytearray(frames[which])
    bad[at] ^= flip
    frames[which] = bytes(bad)
    codec = BinaryCodec()
    found = codec.feed(b"".join(frames))
    kept = [told(message) for index, message in enumerate(sent) if index != which]
    assert [message for message in found if message in kept] == found
    assert len(found) == len(kept)
    assert codec.strange > 0


@given(st.binary(max_size=200))
def test_rubbish_is_no_message_and_what_follows_is_found(rubbish: bytes) -> None:
    codec = BinaryCodec()
    codec.feed(rubbish)
    good = wire(Message(Command.MOVE, 26))
    found = [message for _ in range(20) for message in codec.feed(good)]
    assert found[-1] == Message(Command.MOVE, 26)


@pytest.mark.parametrize("payload", [b"", b"\0", b"\0\0\0", b"\0\0" + bytes(5)])
def test_a_frame_of_another_size_is_strange(payload: bytes) -> None:
    codec = BinaryCodec()
    assert codec.feed(frame(Command.WIDTH, payload)) == []
    assert codec.strange == 8 + len(payload)


def test_a_length_that_no_answer_has_is_not_waited_for() -> None:
    codec = BinaryCodec()
    good = bytes.fromhex("AAAAAA 21 0200 1A00 67CB".replace(" ", ""))
    assert codec.feed(b"\xaa\xaa\xaa\x43\xff\xff" + good) == [Message(Command.MOVE, 26)]
