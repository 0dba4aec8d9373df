"""The simulated drives by a program that is not ours: rates, breaks, answers, motion."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest
import serial

from crtk_sim_backends.copley import SIM, RunningSim
from rigs.waiting import LONG, eventually

IN_MOTION = 1 << 27
ABORTED = 1 << 14
RUNNING = 1 << 15

Ask = Callable[[str], str]


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    with SIM.spawn() as sim:
        yield sim


@pytest.fixture
def line(shared: RunningSim) -> Iterator[serial.Serial]:
    """A program at the line of drives that have just been switched on."""
    shared.control.call("place")
    with serial.Serial(shared.ttys["serial"], 9600, timeout=LONG) as opened:
        yield opened


@pytest.fixture
def ask(line: serial.Serial) -> Ask:
    """What it is answered."""

    def asked(command: str) -> str:
        line.write(f"{command}\r".encode())
        answer = line.read_until(b"\r").decode()
        assert answer.endswith("\r"), f"no answer to {command}"
        return answer[:-1]

    return asked


def number(answer: str) -> int:
    return int(answer.split()[1])


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        ("g r0x32", "v 0"),
        ("2 g r50", "v 0"),
        (".A g r0x90", "v 9600"),
        ("g r0x115", "v 32 0"),
        ("s r0xcb 1000", "ok"),
        ("1 enc clear", "ok"),
        ("s r 0x30 1", "e 33"),
        ("t2", "e 33"),
        ("x", "e 3"),
        ("g r0x1ff", "e 9"),
        ("s r0xa0 1", "e 11"),
        ("s r0x24 99", "e 10"),
        (".B g r0x32", "e 36"),
        ("9 g r0x32", "e 32"),
        ("s r0x115 30 0", "e 4"),
        ("s r0x115 256 0 0", "e 10"),
    ],
)
def test_answers(ask: Ask, command: str, answer: str) -> None:
    assert ask(command) == answer


def test_it_is_raised_from_9600_and_a_break_brings_it_back(
    shared: RunningSim, line: serial.Serial, ask: Ask
) -> None:
    assert ask("s r0x90 115200") == "ok"
    line.baudrate = 115200
    assert ask("g r0x90") == "v 115200"
    line.baudrate = 9600
    line.write(b"g r0x90\r")  # nobody understands that
    line.baudrate = 115200
    eventually(lambda: shared.control.status()["baud"] == 115200, "it hears nothing")
    line.write(b"\0")  # a pseudo-terminal carries no break
    eventually(lambda: shared.control.status()["baud"] == 9600, "it is back")


def test_a_reset_is_not_answered_and_forgets(
    shared: RunningSim, line: serial.Serial, ask: Ask
) -> None:
    assert ask("s r0x24 21") == "ok"
    assert shared.control.status()["on"][0]
    line.write(b"r\r")
    eventually(lambda: not shared.control.status()["on"][0], "it starts anew")
    assert ask("g r0x24") == "v 0"


def test_points_that_run_out_in_motion_are_a_stop(ask: Ask) -> None:
    """As in the vendor's example, without its last point, which has no time."""
    for command in ("s r0x24 21", "s r0x115 0x8000", "s r0xc8 3"):
        assert ask(command) == "ok"
    for place in range(4):
        assert ask(f"s r0x115 250 {place * 2500} 100000") == "ok"
    assert ask("g r0x115") == "v 28 4"
    assert ask("t 1") == "ok"
    assert number(ask("g r0xa0")) & IN_MOTION
    eventually(lambda: not number(ask("g r0xc9")) & RUNNING, "it is over")
    assert number(ask("g r0xc9")) & ABORTED
    assert number(ask("g r0x2d")) < 9500


def test_the_end_of_points_is_the_one_without_time(ask: Ask) -> None:
    for command in ("s r0x24 21", "s r0xc8 3", "s r0x115 100 0 0", "s r0x115 0 500 0", "t 1"):
        assert ask(command) == "ok"
    eventually(lambda: not number(ask("g r0xc9")) & RUNNING, "it is over")
    assert not number(ask("g r0xc9")) & ABORTED
    assert number(ask("g r0x2d")) == 500


def test_a_goal_may_change_on_the_way(ask: Ask) -> None:
    for command in ("s r0x24 21", "s r0xca 20000", "t 1", "s r0xca -300", "t 1"):
        assert ask(command) == "ok"
    eventually(lambda: number(ask("g r0x2d")) == -300, "it is there")


def test_answers_take_the_time_of_the_line() -> None:
    with (
        SIM.spawn(nodes=1, line_time=True) as sim,
        serial.Serial(sim.ttys["serial"], 9600, timeout=LONG) as line,
    ):
        begun = time.monotonic()
        for _ in range(5):
            line.write(b"g r0x32\r")
            assert line.read_until(b"\r") == b"v 0\r"
        assert time.monotonic() - begun > 5 * (12 * 10 / 9600 + 0.001)
