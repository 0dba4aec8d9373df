"""One question at a time: answers in a later call, commands that are acknowledged, and lost answers."""

from __future__ import annotations

import pytest

from crtk_driver_robotiq.links import ModbusLink
from crtk_driver_robotiq.modbus import Rtu, crc
from crtk_driver_robotiq.registers import Command
from crtk_drivers.errors import ProtocolError

TIMEOUT = 0.05
CLOSE = Command(go=True, position=255)


class Line:
    """A transport whose far side a test speaks for."""

    where = "a line"

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.coming: list[bytes] = []

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


ACK = bytes.fromhex("091003E800030130")


@pytest.fixture
def line() -> Line:
    return Line()


@pytest.fixture
def link(line: Line) -> ModbusLink:
    return ModbusLink(line, Rtu(9), TIMEOUT, lambda: 0.0)


def test_a_command_and_the_status_are_one_exchange(line: Line, link: ModbusLink) -> None:
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
    line: Line, link: ModbusLink
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
    line: Line, link: ModbusLink
) -> None:
    link.exchange(None, 0.001)
    line.coming = [frame(3, 7)]
    answer = link.exchange(CLOSE, 0.002)
    assert answer is not None
    assert answer.status.position == 7
    assert answer.delivered is None
    assert line.functions() == [3, 23]


@pytest.mark.parametrize("command", [None, CLOSE])
def test_after_a_lost_answer_the_other_functions_are_used(line: Line, command: Command) -> None:
    link = ModbusLink(line, Rtu(9), 0.0, lambda: float("inf"))
    line.open(0.0)
    assert link.exchange(command, 1.0) is None
    late = frame(23 if command else 3, 1)
    line.coming = [late, *([ACK] if command else []), frame(4, 8)]
    answer = link.exchange(command, 2.0)
    assert answer is not None
    assert answer.status.position == 8, "what comes late is told apart"
    assert answer.delivered is command
    assert line.functions() == ([23, 16, 4] if command else [3, 4])
    assert link.counters["missed"] == 1
    assert link.counters["strange_bytes"] == len(late)


def test_an_exception_that_passes_leaves_the_command_to_be_sent(
    line: Line, link: ModbusLink
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


def test_an_exception_that_does_not_pass_is_raised(line: Line, link: ModbusLink) -> None:
    line.coming = [bytes.fromhex("0983024133")]
    with pytest.raises(ProtocolError, match=r"exception 2.*ePick"):
        link.exchange(None, 1.0)
