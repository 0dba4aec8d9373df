"""The text mode of a WSG (GCL): known lines, and what becomes of others."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crtk_driver_weiss_wsg.tables import Command, Flag, Message
from crtk_driver_weiss_wsg.text import TextCodec
from rigs.examples import examples

REQUESTS = {
    "HOME(0)": (Command.HOME, 0),
    "MOVE(40,50)": (Command.MOVE, 0.04, 0.05),
    "GRIP(20,40,50)": (Command.GRASP, 0.04, 0.05, 20.0),
    "RELEASE(10,50)": (Command.RELEASE, 0.05, 0.05, 0.01),
    "STOP()": (Command.STOP,),
    "FASTSTOP()": (Command.FAST_STOP,),
    "FSACK()": (Command.ACKNOWLEDGE,),
    "BYE()": (Command.GOODBYE,),
}
ANSWERS = {
    "ACK MOVE": [Message(Command.MOVE, 26)],
    "FIN MOVE": [Message(Command.MOVE, 0)],
    "ERR MOVE 29": [Message(Command.MOVE, 29)],
    "ERR GRIP 18 no part": [Message(Command.GRASP, 18)],
    "ACK STOP": [Message(Command.STOP, 0)],
    "ACK FSACK": [Message(Command.ACKNOWLEDGE, 0)],
    "POS=20.0": [Message(Command.WIDTH, 0, (0.02,))],
    "@POS=20.0": [Message(Command.WIDTH, 0, (0.02,))],
    "@FORCE=-1.5": [Message(Command.FORCE, 0, (-1.5,))],
    "@SPEED=1e2\r": [Message(Command.SPEED, 0, (0.1,))],
    "ACK AUTOSEND": [],
    "ERR SYSFLAGS 14": [],
    "VERBOSE=0": [],
    "": [],
}


def flags(messages: list[Message]) -> Flag:
    """The system state in messages."""
    return next(Flag(int(m.values[0])) for m in messages if m.about is Command.SYSTEM)


@pytest.mark.parametrize(("line", "command"), REQUESTS.items())
def test_known_requests(line: str, command: tuple[Command, float]) -> None:
    assert TextCodec().encode(*command) == f"{line}\n".encode()


@pytest.mark.parametrize("command", [Command.SET_FORCE, Command.SET_SOFT_LIMITS])
def test_what_this_mode_does_not_have(command: Command) -> None:
    assert TextCodec().encode(command, 0.0, 1.0) == b""


@pytest.mark.parametrize(("line", "messages"), ANSWERS.items())
def test_known_answers(line: str, messages: list[Message]) -> None:
    codec = TextCodec()
    assert codec.feed(f"{line}\n".encode()) == messages
    assert codec.strange == 0


def test_a_grasping_state_tells_what_of_the_system_state_follows_from_it() -> None:
    codec = TextCodec()
    told = codec.feed(b"@GRIPSTATE=6\n")
    assert told[0] == Message(Command.GRASPING, 0, (6.0,))
    assert flags(told) == Flag.REFERENCED | Flag.MOVING
    assert flags(codec.feed(b"@GRIPSTATE=7\n")) == Flag.REFERENCED | Flag.FAST_STOP
    assert flags(codec.feed(b"@GRIPSTATE=0\n")) == Flag.REFERENCED


def test_flags_are_asked_for_in_turn_and_kept() -> None:
    codec = TextCodec()
    asked = [codec.ask() for _ in range(15)]
    assert asked[:3] == [b"SYSFLAGS[0]?\n", b"SYSFLAGS[12]?\n", b"SYSFLAGS[14]?\n"]
    assert b"SYSFLAGS[17]?\n" in asked
    assert codec.ask() == asked[0]
    assert flags(codec.feed(b"SYSFLAGS[0]=0\nSYSFLAGS[13]=1\n@GRIPSTATE=0\n")) == Flag(0)
    assert flags(codec.feed(b"@GRIPSTATE=0\n")) == Flag.WARM
    assert flags(codec.feed(b"SYSFLAGS[0]=1\n")) == Flag.REFERENCED | Flag.WARM


def test_a_gripper_that_tells_no_flags_says_by_a_refusal_that_it_has_no_reference() -> None:
    codec = TextCodec()
    codec.feed(b"ERR MOVE 3\n")
    assert flags(codec.feed(b"@GRIPSTATE=0\n")) == Flag(0)
    codec.feed(b"ACK HOME\nFIN HOME\n")
    assert flags(codec.feed(b"@GRIPSTATE=0\n")) == Flag.REFERENCED


def test_an_error_is_no_fast_stop_where_the_flag_says_so() -> None:
    codec = TextCodec()
    codec.feed(b"SYSFLAGS[12]=0\n")
    assert flags(codec.feed(b"@GRIPSTATE=7\n")) == Flag.REFERENCED
    assert Flag.FAST_STOP in flags(codec.feed(b"SYSFLAGS[12]=1\n"))


@settings(max_examples=examples(25))
@given(st.data())
def test_lines_may_be_cut_anywhere(data: st.DataObject) -> None:
    stream = "".join(f"{line}\n" for line in ANSWERS).encode()
    codec, found = TextCodec(), []
    while stream:
        size = data.draw(st.integers(1, len(stream)))
        found += codec.feed(stream[:size])
        stream = stream[size:]
    assert found == [message for messages in ANSWERS.values() for message in messages]


@given(st.binary(max_size=500))
def test_rubbish_does_no_harm(rubbish: bytes) -> None:
    codec = TextCodec()
    codec.feed(rubbish)
    codec.feed(b"\n")
    assert codec.feed(b"ACK MOVE\n") == [Message(Command.MOVE, 26)]


@pytest.mark.parametrize("line", ["MOVE", "ACKMOVE", "POS", "POS=", "POS=abc", "\xff\xfe"])
def test_other_lines_are_strange(line: str) -> None:
    codec = TextCodec()
    assert codec.feed(f"{line}\n".encode("latin-1")) == []
    assert codec.strange > 0
