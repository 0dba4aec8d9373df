"""One question at a time: answers in a later call, commands that are acknowledged, and lost answers."""

from __future__ import annotations

import time

import pytest

from crtk_driver_robotiq.links import GripperRegisters, UrcapLink
from crtk_driver_robotiq.registers import Command, Status
from crtk_drivers.errors import ProtocolError
from crtk_drivers.kit.modbus_frames import Framing, Mbap, Rtu, crc
from crtk_drivers.kit.modbus_link import ModbusLink
from rigs.waiting import endless

GripperLink = ModbusLink[Command, Status]

TIMEOUT = 0.05
CLOSE = Command(go=True, position=255)


class Line:
    """A transport whose far side a test speaks for."""

    where = "a line"

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.coming: list[bytes] = []
        self.now = 0.0

    def open(self, deadline: float) -> None:
        pass

    def close(self) -> None:
        pass

    def write(self, data: bytes) -> None:
        self.sent.append(data)

    def read(self, deadline: float) -> bytes:
        """What was put into `coming` answers the question that was sent before, not earlier."""
        if self.coming and deadline > 0.0:
            return self.coming.pop(0)
        return b""

    def functions(self) -> list[int]:
        functions = [frame[1] for frame in self.sent]
        self.sent.clear()
        return functions


def frame(function: int, position: int = 0) -> bytes:
    body = bytes((9, function, 6, 0x39, 0, 0, 255, position, 0))
    return body + crc(body)


@pytest.fixture
def line() -> Line:
    return Line()


@pytest.fixture
def link(line: Line) -> GripperLink:
    return ModbusLink(GripperRegisters(), line, Rtu(9), TIMEOUT, lambda: 0.0)


def test_a_command_and_the_status_are_one_exchange(line: Line, link: GripperLink) -> None:
    line.coming = [frame(23, 7)]
    answer = link.exchange(CLOSE, 1.0)
    assert answer is not None
    assert answer.delivered is CLOSE
    assert answer.status.position == 7
    line.coming = [frame(3, 8)]
    answer = link.exchange(None, 1.0)
    assert answer is not None
    assert answer.delivered is None
    assert line.functions() == [23, 3]


def test_an_answer_in_a_later_call_is_followed_by_a_new_question(
    line: Line, link: GripperLink
) -> None:
    """The newest counts, and what the first has acknowledged is not lost."""
    assert link.exchange(CLOSE, 0.001) is None
    line.coming = [frame(23, 7), frame(3, 8)]
    answer = link.exchange(CLOSE, 0.002)
    assert answer is not None
    assert answer.status.position == 8
    assert answer.delivered is CLOSE
    assert line.functions() == [23, 3]


def test_of_two_the_one_that_came_is_returned_where_the_second_is_late(
    line: Line, link: GripperLink
) -> None:
    link.exchange(None, 0.001)
    line.coming = [frame(3, 7)]
    answer = link.exchange(CLOSE, 0.002)
    assert answer is not None
    assert answer.status.position == 7
    assert answer.delivered is None
    assert line.functions() == [3, 23]


def test_what_lies_on_the_line_before_the_first_question_is_left_out(
    line: Line, link: GripperLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    coming = [frame(3, 7), b"", frame(23, 8)]
    monkeypatch.setattr(line, "read", lambda deadline: coming.pop(0))
    answer = link.exchange(CLOSE, 1.0)
    assert answer is not None
    assert (answer.status.position, answer.delivered) == (8, CLOSE)
    assert link.counters["strange_bytes"] == len(frame(3))


def test_a_state_that_no_gripper_has_is_no_gripper(line: Line) -> None:
    each = [b"GTO 1\n", b"PRE 0\n", b"OBJ 9\n", b"POS 0\n"]
    line.coming = [*each, b"STA 3\n", *each, b"FLT 0\n", *each, b"ACT 1\n"]
    with pytest.raises(ProtocolError, match="9 is not a valid Contact"):
        UrcapLink(line, lambda: 0.0).exchange(None, 1.0)


@pytest.mark.parametrize("framing", [Rtu(9), Mbap(9)])
def test_who_sends_without_end_keeps_nobody(
    line: Line, framing: Framing, monkeypatch: pytest.MonkeyPatch
) -> None:
    of_another = bytes.fromhex("FFFF 0000 0003 09 03 00")
    monkeypatch.setattr(line, "read", endless(of_another))
    link = ModbusLink(GripperRegisters(), line, framing, TIMEOUT)
    for _ in range(2):
        assert link.exchange(CLOSE, time.monotonic()) is None


@pytest.mark.parametrize("command", [None, CLOSE])
def test_after_a_lost_answer_another_question_is_asked_first(line: Line, command: Command) -> None:
    """When that is answered, no answer to an earlier one can come any more."""
    link = ModbusLink(GripperRegisters(), line, Rtu(9), 0.0, lambda: float("inf"))
    line.open(0.0)
    assert link.exchange(command, 1.0) is None
    asked = 23 if command else 3
    late = frame(asked, 1)
    probe = bytes((9, 4, 4, 0, 0, 0, 0))
    line.coming = [late, probe + crc(probe), frame(asked, 8)]
    answer = link.exchange(command, 2.0)
    assert answer is not None
    assert answer.status.position == 8, "what comes late is told apart"
    assert answer.delivered is command
    assert line.functions() == [asked, 4, asked]
    assert link.counters["missed"] == 1
    assert link.counters["strange_bytes"] == len(late)


def test_after_a_silence_nothing_is_written_before_the_status_is_told(line: Line) -> None:
    """Not even where it is asked in one call and comes in the next."""
    link = ModbusLink(GripperRegisters(), line, Rtu(9), 0.0, lambda: line.now)
    line.now = float("inf")
    assert link.exchange(CLOSE, 1.0) is None
    line.now = 0.0
    probe = bytes((9, 4, 4, 0, 0, 0, 0))
    line.coming = [probe + crc(probe)]
    assert link.exchange(CLOSE, 2.0) is None
    line.coming = [frame(3, 8), frame(23, 9)]
    answer = link.exchange(CLOSE, 3.0)
    assert answer is not None
    assert answer.status.position == 8
    assert line.functions() == [23, 4, 3]


def test_an_answer_that_comes_twice_is_not_taken_for_that_to_the_next_question(
    line: Line, link: GripperLink
) -> None:
    """Even if the second copy comes after that was asked: no two in a row look alike."""
    line.coming = [frame(3, 7)]
    assert link.exchange(None, 1.0) is not None
    for earlier, function in ((3, 4), (4, 3)):
        line.coming = [frame(earlier, 7), frame(function, 8)]
        answer = link.exchange(None, 1.0)
        assert answer is not None
        assert answer.status.position == 8
    line.coming = [frame(23, 9)]
    assert link.exchange(CLOSE, 1.0) is not None
    again = Command(go=True, position=3)
    line.coming = [frame(23, 9), frame(3, 10), frame(23, 11)]
    for position, delivered in ((10, None), (11, again)):
        answer = link.exchange(again, 1.0)
        assert answer is not None
        assert (answer.status.position, answer.delivered) == (position, delivered)


def test_an_exception_that_passes_leaves_the_command_to_be_sent(
    line: Line, link: GripperLink
) -> None:
    busy = b"\x09\x97\x06"
    line.coming = [busy + crc(busy)]
    assert link.exchange(CLOSE, 1.0) is None
    assert "busy" in link.trouble[0]
    line.coming = [frame(23)]
    answer = link.exchange(CLOSE, 2.0)
    assert answer is not None
    assert answer.delivered is CLOSE
    assert link.counters["exceptions"] == 1


def test_an_exception_that_does_not_pass_is_raised(line: Line, link: GripperLink) -> None:
    line.coming = [bytes.fromhex("0983024133")]
    with pytest.raises(ProtocolError, match=r"exception 2.*ePick"):
        link.exchange(None, 1.0)


def test_a_late_answer_to_a_probe_is_told_apart_from_that_to_the_next(line: Line) -> None:
    link = ModbusLink(GripperRegisters(), line, Rtu(9), 0.0, lambda: float("inf"))
    for _ in range(3):
        assert link.exchange(None, 1.0) is None
    late = bytes((9, 4, 4, 0, 0, 0, 0))
    line.coming = [late + crc(late)]
    assert link.exchange(None, 1.0) is None
    assert line.functions() == [3, 4, 3, 3], "no answer was believed"


def test_what_one_connection_left_hinders_no_other(line: Line) -> None:
    """A peer that ended in the middle of an answer, or spoke something else."""
    link = ModbusLink(GripperRegisters(), line, Mbap(9), TIMEOUT, lambda: 0.0)
    status = b"\x03\x06" + bytes(6)
    line.coming = [bytes.fromhex("0001 0000 0009 0903")]
    assert link.exchange(None, 1.0) is None
    for number, strange in ((2, b"HTTP/1.1 200 OK\r\n"), (4, b"")):
        link.open(1.0)
        line.coming = [bytes((0, number, 0, 0, 0, 9, 9)) + status]
        assert link.exchange(None, 1.0) is not None
        line.coming = [strange] if strange else []
        if strange:
            with pytest.raises(ProtocolError, match="not Modbus TCP"):
                link.exchange(None, 1.0)
