"""The line at a scripted drive: whose answer it is, whatever comes late, twice, damaged or not at all."""

from __future__ import annotations

import os
import select
import threading
import time
import tty
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import pytest

from crtk_driver_copley.codec import Reply
from crtk_driver_copley.config import CopleyConfig
from crtk_driver_copley.controller import CopleyController
from crtk_driver_copley.line import Line
from crtk_driver_copley.tables import Parameter, Trajectory
from crtk_driver_copley.tracking import ByPvt
from crtk_drivers.device import Mode, Setpoint
from crtk_drivers.errors import ConnectionFailed, ConnectionLost
from crtk_drivers.kit.axes import AxesDevice
from crtk_drivers.samples import vector
from rigs.copley_bench import ONE, joints
from rigs.waiting import LONG

RATE = b"v 115200\r"


class Drive:
    """The far end of a line, which says what it is told to."""

    def __init__(self) -> None:
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self.name = os.ttyname(slave)
        self._slave = slave

    def heard(self) -> str:
        """Return the next command, without the ends before it."""
        data = b""
        while not data.endswith(b"\r") or not data.strip(b"\r\0"):
            assert select.select([self._master], [], [], LONG)[0], "nothing was said"
            data += os.read(self._master, 1)
        return data.strip(b"\r\0").decode()

    def say(self, data: bytes) -> None:
        os.write(self._master, data)

    def close(self) -> None:
        os.close(self._master)
        os.close(self._slave)


@pytest.fixture
def drive() -> Iterator[Drive]:
    opened = Drive()
    yield opened
    opened.close()


@pytest.fixture
def line(drive: Drive) -> Iterator[Line]:
    """One at which nothing is under way: opened past its start, which the simulator is for.

    It waits for as long as a busy machine takes.
    """
    opened = begun(Line(CopleyConfig(port=drive.name, reply_timeout=2.0)))
    yield opened
    opened.close()


@pytest.fixture
def hasty(drive: Drive) -> Iterator[Line]:
    """One that does not wait for long."""
    opened = begun(Line(CopleyConfig(port=drive.name, reply_timeout=0.4)))
    yield opened
    opened.close()


def begun(line: Line) -> Line:
    line._link.open(time.monotonic() + 5.0)
    line._rate_told = (115200,)
    return line


class Arm(NamedTuple):
    """An axis at such a line, in this thread."""

    device: AxesDevice
    drives: CopleyController


@pytest.fixture
def arm(drive: Drive) -> Iterator[Arm]:
    config = CopleyConfig(port=drive.name, reply_timeout=2.0, joints=ONE)
    drives = CopleyController(config)
    device = AxesDevice(drives, drive.name, "power_off")
    device._io = threading.get_ident()
    begun(drives._line)
    yield Arm(device, drives)
    drives._line.close()


def answered(drive: Drive, line: Line, command: str, answer: bytes) -> None:
    """The next command is this one, and is answered."""
    assert drive.heard() == command
    drive.say(answer)
    end = time.monotonic() + LONG
    while line._asked is not None and line._asked.text == command:
        assert time.monotonic() < end
        line.pump(time.monotonic() + 0.005)
    line.pump(time.monotonic())  # a pump that was held up has not sent what follows


class Taken:
    """What was answered to commands, in the order of answers."""

    def __init__(self, line: Line) -> None:
        self.replies: dict[str, str | None] = {}
        self._line = line

    def ask(self, text: str, *, once: bool = False) -> None:
        def take(reply: Reply | None) -> None:
            self.replies[text] = None if reply is None else reply.text

        self._line.ask(text, take, once=once)

    def until(self, condition: Callable[[], object]) -> None:
        end = time.monotonic() + LONG
        while not condition():
            assert time.monotonic() < end
            self._line.pump(time.monotonic() + 0.005)
        self._line.pump(time.monotonic())  # a pump that was held up has not sent what follows


def test_one_command_at_a_time(drive: Drive, line: Line) -> None:
    taken = Taken(line)
    taken.ask("g r0x32")
    taken.ask("2 g r0x32")
    assert drive.heard() == "g r0x32"
    drive.say(b"v 5\r")
    taken.until(lambda: taken.replies)
    assert drive.heard() == "2 g r0x32"
    drive.say(b"v 7\r")
    taken.until(lambda: line.is_idle)
    assert taken.replies == {"g r0x32": "v 5", "2 g r0x32": "v 7"}
    assert line.doubts == 0


@pytest.mark.parametrize("damaged", [b"w 5\r", b"ok\r", b"v 5a\r", b"\xff\xfe\r"])
def test_an_answer_that_does_not_fit_is_asked_for_again(
    drive: Drive, line: Line, damaged: bytes
) -> None:
    taken = Taken(line)
    taken.ask("g r0x32")
    assert drive.heard() == "g r0x32"
    drive.say(damaged)
    taken.until(lambda: line.doubts)
    assert drive.heard() == "g r0x90"
    drive.say(b"v 77\r" + RATE)  # what came late is nobody's
    taken.until(lambda: line._asked is not None and line._asked.text == "g r0x32")
    assert drive.heard() == "g r0x32"
    drive.say(b"v 5\r")
    taken.until(lambda: line.is_idle)
    assert taken.replies == {"g r0x32": "v 5"}


def test_a_question_of_the_line_that_is_answered_twice_is_waited_for(
    drive: Drive, hasty: Line
) -> None:
    """Else the second answer would be taken for that of the next command."""
    taken = Taken(hasty)
    hasty.distrust()
    taken.ask("g r0x32")
    assert drive.heard() == "g r0x90"
    taken.until(lambda: hasty.doubts > 1)  # no answer, so it is asked once more
    assert drive.heard() == "g r0x90"
    drive.say(RATE)
    hasty.pump(time.monotonic() + 0.005)
    drive.say(RATE)
    taken.until(lambda: hasty._asked is not None and hasty._asked.text == "g r0x32")
    drive.heard()
    drive.say(b"v 5\r")
    taken.until(lambda: hasty.is_idle)
    assert taken.replies == {"g r0x32": "v 5"}


def test_what_may_not_be_sent_twice_is_not(drive: Drive, hasty: Line) -> None:
    taken = Taken(hasty)
    taken.ask("t 1", once=True)
    assert drive.heard() == "t 1"
    taken.until(lambda: taken.replies)
    assert taken.replies == {"t 1": None}
    taken.ask("g r0x32")
    assert drive.heard() == "g r0x90"


def test_an_error_is_believed_when_it_stays(drive: Drive, line: Line) -> None:
    taken = Taken(line)
    taken.ask("s r0xca 5")
    for _ in range(2):
        assert drive.heard() == "s r0xca 5"
        drive.say(b"e 10\r")
        taken.until(lambda: line._asked is not None and line._asked.take is None)
        assert drive.heard() == "g r0x90"
        drive.say(RATE)
        taken.until(lambda: line._asked is not None and line._asked.take is not None)
    assert drive.heard() == "s r0xca 5"
    drive.say(b"e 10\r")
    taken.until(lambda: line.is_idle)
    assert taken.replies == {"s r0xca 5": "e 10"}


def test_silence_is_a_lost_line(drive: Drive) -> None:
    line = begun(Line(CopleyConfig(port=drive.name, reply_timeout=0.02)))
    taken = Taken(line)
    taken.ask("g r0x32")
    with pytest.raises(ConnectionLost, match="no answer to"):
        taken.until(lambda: line.is_idle)
    line.close()


def test_what_is_withdrawn_is_not_sent(drive: Drive, line: Line) -> None:
    taken = Taken(line)
    taken.ask("g r0x32")
    waits = line.ask("t 1", once=True)
    line.withdraw([waits])
    drive.heard()
    drive.say(b"v 5\r")
    taken.until(lambda: line.is_idle)


def test_what_is_withdrawn_under_way_is_not_sent_again(drive: Drive, arm: Arm) -> None:
    """Else a motion would begin after the stop that took it back."""
    line = arm.drives._line
    moves = line.ask("t 1")
    assert drive.heard() == "t 1"
    line.withdraw([moves])
    line.stop_aside(["t 0"])
    line.ask_first([("t 0", lambda _: None)])
    assert drive.heard() == "t 0"
    line.pump(time.monotonic() + 0.005)
    drive.say(RATE)
    assert drive.heard() == "g r0x90"
    Taken(line).until(lambda: line._asked is not None and line._asked.text == "t 0")
    assert drive.heard() == "t 0"
    drive.say(b"ok\r")
    Taken(line).until(lambda: line.is_idle)


def test_a_stop_takes_back_a_motion_that_a_procedure_has_not_sent_yet(
    drive: Drive, arm: Arm
) -> None:
    line = arm.drives._line
    line.ask("g r0x32")
    procedure = arm.drives._procedures.do(["t 2"], once=True)
    next(procedure)
    arm.device.stop()
    answered(drive, line, "g r0x32", b"v 5\r")
    answered(drive, line, "t 0", b"ok\r")
    assert line.is_idle
    procedure.close()


def test_nothing_follows_a_stop_of_another_thread(drive: Drive, arm: Arm) -> None:
    """The thread that was held up had a setpoint in its hands."""
    arm.device._heard = time.monotonic()
    aside = threading.Thread(target=arm.device.stop)
    aside.start()
    aside.join()
    assert drive.heard() == "t 0"
    arm.device.write(Setpoint(Mode.JOINT_POSITION, vector([1.0])))
    assert arm.drives._line.is_idle


def test_an_answer_that_was_left_lying_is_as_old_as_its_question(drive: Drive, arm: Arm) -> None:
    rounds = arm.drives._rounds
    rounds._left = 1
    take = partial(rounds._heard_of, arm.drives._axes[0], Parameter.POSITION, 0.0)
    arm.drives._line.ask("g r0x32", take)
    assert drive.heard() == "g r0x32"
    heard = time.monotonic()
    drive.say(b"v 5\r")
    Taken(arm.drives._line).until(lambda: rounds.stamp is not None)
    assert rounds.stamp is not None
    assert rounds.stamp.monotonic <= heard


def test_currents_are_as_old_as_the_positions_that_they_are_told_with(drive: Drive) -> None:
    joint = {**next(iter(ONE.values())), "torque_per_ampere": 1.0}
    drives = CopleyController(CopleyConfig(port=drive.name, reply_timeout=2.0, joints={"a": joint}))
    begun(drives._line)
    asked: list[str] = []

    def answer() -> None:
        while len(asked) < 10:
            asked.append(drive.heard())
            drive.say(b"v 5\r")

    thread = threading.Thread(target=answer)
    thread.start()
    while thread.is_alive():
        drives.exchange(time.monotonic() + 0.005)
    thread.join()
    drives.close(power_off=False)
    assert asked.count("g r0x0c") == asked.count("g r0x32") == 2


def test_a_start_whose_time_cannot_be_told_is_begun_anew(drive: Drive, arm: Arm) -> None:
    tracking = arm.drives._tracking
    assert isinstance(tracking, ByPvt)
    tracking._start()
    assert drive.heard() == "t 1"
    time.sleep(0.1)  # held up, or the answer comes late
    drive.say(b"ok\r")
    Taken(arm.drives._line).until(lambda: arm.drives._line.is_idle)
    assert tracking.restarts == 1
    assert not tracking.wants_free


@pytest.mark.slow  # it is waited for no longer than an end may take
def test_power_is_taken_at_the_end_before_what_waits(drive: Drive, arm: Arm) -> None:
    arm.device._switched_on = True
    arm.drives._line.ask("g r0x32")
    arm.drives._line.ask("g r0x18")
    end = threading.Thread(target=arm.device.close)
    end.start()
    assert drive.heard() == "g r0x32"
    drive.say(b"v 5\r")
    heard = drive.heard()
    end.join()
    assert heard == "s r0x24 0"


def test_a_slow_line_is_not_taken_for_a_blind_one(drive: Drive) -> None:
    config = CopleyConfig(port=drive.name, baud=9600, joints=joints(), pvt_period=0.2)
    assert CopleyController(config).blind > 2.0 / config.carried


def test_stops_go_before_all_that_waits(drive: Drive, line: Line) -> None:
    taken = Taken(line)
    taken.ask("g r0x32")
    taken.ask("g r0x18")
    line.ask_first([("t 0", lambda _: None), ("1 t 0", lambda _: None)])
    for wanted, answer in (("g r0x32", b"v 1\r"), ("t 0", b"ok\r"), ("1 t 0", b"ok\r")):
        assert drive.heard() == wanted
        drive.say(answer)
        taken.until(lambda wanted=wanted: line._asked is None or line._asked.text != wanted)
    assert drive.heard() == "g r0x18"


@pytest.mark.parametrize("comes", ["repeated", "aside"])
def test_a_stop_that_is_repeated_leaves_room_for_what_the_axes_tell(
    drive: Drive, arm: Arm, comes: str
) -> None:
    """It is asked for every 50 ms, which is how long stops of four axes take at 9600 bit/s."""
    line, axis = arm.drives._line, arm.drives._axes[0]

    def tell(trajectory: int) -> None:
        take = partial(arm.drives._rounds._heard_of, axis, Parameter.TRAJECTORY, 0.0)
        line.ask("g r0xc9", take)
        arm.device.stop()
        answered(drive, line, "g r0xc9", b"v %d\r" % trajectory)

    arm.device.stop()
    arm.device.stop()
    answered(drive, line, "t 0", b"ok\r")
    arm.device.stop()
    if comes == "aside":
        aside = threading.Thread(target=arm.device.stop)
        aside.start()
        aside.join()
        assert drive.heard() == "t 0"
        arm.drives.halt(aside=False)
        assert drive.heard() == "t 0"
        return
    assert line.is_idle
    tell(Trajectory.RUNNING)
    assert not arm.device.has_stopped
    arm.device.stop()
    answered(drive, line, "t 0", b"ok\r")
    tell(0)
    assert arm.device.has_stopped


def test_a_stop_of_homing_waits_for_nothing(drive: Drive) -> None:
    """It began while the stop before it was overdue."""
    joint = {**next(iter(ONE.values())), "homing": {"method": "drive"}}
    drives = CopleyController(CopleyConfig(port=drive.name, reply_timeout=2.0, joints={"a": joint}))
    line = begun(drives._line)
    drives.halt(aside=False)
    answered(drive, line, "t 0", b"ok\r")
    next(drives.home(0))
    drives.halt(aside=False)
    answered(drive, line, "g r0xc2", b"v 512\r")
    answered(drive, line, "t 0", b"ok\r")
    line.close()


def test_nobody_there(drive: Drive) -> None:
    line = Line(CopleyConfig(port=drive.name, reply_timeout=0.01))
    with pytest.raises(ConnectionFailed, match="nobody answers"):
        line.open(time.monotonic(), lambda: False)
    line.close()
