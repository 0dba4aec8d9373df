"""What goes out in each cycle of an arm that is driven: a current is never sent on by itself."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

from crtk_driver_dvrk.arm import States
from crtk_driver_dvrk.boards import Boards
from crtk_driver_dvrk.drive import Drive
from crtk_driver_dvrk.motor_file import read_motors
from crtk_driver_dvrk.plugin import TYPICAL
from crtk_driver_dvrk.registers import state_of
from crtk_sim_backends.dvrk import SIM, RunningSim
from rigs.dvrk_bench import UNHURRIED, ZERO, boards_of, is_dead
from rigs.waiting import LONG, eventually

MOTORS = read_motors(TYPICAL["io"])
NODES = {6: 0, 7: 1}
BITS = tuple(zero + 100 for zero in ZERO)


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with SIM.spawn(**UNHURRIED) as sim:
        yield sim


@pytest.fixture
def boards(sim: RunningSim) -> Iterator[Boards]:
    boards = Boards(sim.host, sim.ports["boards"], "", 0.03)
    boards.open(time.monotonic() + 30.0, NODES)
    yield boards
    boards.close()


@pytest.fixture
def drive(sim: RunningSim, boards: Boards) -> Iterator[Drive]:
    """With amplifiers on."""
    drive = Drive(boards, MOTORS, tuple(ZERO))
    drive.reached(NODES)
    drive.begin()
    drive.switch(relay=True, power=True)
    eventually(lambda: all(board["power"] for board in boards_of(sim)), "there is power")
    for motor in MOTORS:
        drive.switch(amplifier=motor)
    eventually(lambda: boards_of(sim)[1]["on"][:3] == [True] * 3, "amplifiers are on")
    drive.on()
    yield drive
    drive.off()
    eventually(lambda: is_dead(sim), "nothing is left on")


def look(drive: Drive, boards: Boards) -> tuple[States, float]:
    """Read both boards, as a cycle does; return what they told, and when they were asked."""
    asked, states = time.monotonic(), {}
    for number, node in NODES.items():
        label = boards.ask_state(node)
        reply = boards.answer(node, label, time.monotonic() + LONG)
        assert reply is not None
        states[number] = state_of(reply.quadlets)
    drive.take(states, asked)
    assert drive.trouble(states, asked) is None
    return states, asked


def commands(sim: RunningSim) -> list[int]:
    """The currents that boards were told last."""
    first, second = boards_of(sim)
    return [*first["command"], *second["command"][:3]]


def test_a_current_that_no_cycle_renews_is_replaced_by_none(
    sim: RunningSim, boards: Boards, drive: Drive
) -> None:
    drive.currents(BITS)
    drive.cycle()  # of the next cycle: it was just sent
    look(drive, boards)
    assert commands(sim) == list(BITS)
    assert not drive.has_stopped
    drive.cycle()  # nothing has come since
    look(drive, boards)
    assert commands(sim) == ZERO
    assert drive.has_stopped


def test_a_stop_is_believed_by_what_is_asked_for_after_it(
    sim: RunningSim, boards: Boards, drive: Drive
) -> None:
    states, asked = look(drive, boards)
    drive.currents(BITS)
    drive.zero()
    drive.take(states, asked)  # which tells no current, too
    assert not drive.has_stopped
    look(drive, boards)
    assert drive.has_stopped


def test_a_stop_that_is_sent_again_while_boards_are_read_is_believed(
    sim: RunningSim, boards: Boards, drive: Drive
) -> None:
    """A reading may take longer than it is until a stop is sent again."""
    drive.currents(BITS)
    drive.zero()
    states, asked = look(drive, boards)
    drive.zero()
    drive.take(states, asked)
    assert drive.has_stopped


def test_after_off_no_current_goes_out_and_it_is_told_until_it_is_read_back(
    sim: RunningSim, boards: Boards, drive: Drive
) -> None:
    sim.control.inject("write_loss", every=1)
    drive.off()
    drive.currents(BITS)
    look(drive, boards)
    assert not drive.has_stopped
    sim.control.clear()
    for _ in range(3):
        assert not drive.is_free
        drive.currents(BITS)
        drive.cycle()
        look(drive, boards)
    assert drive.is_free
    assert is_dead(sim)
    drive.currents(BITS)
    drive.cycle()
    look(drive, boards)
    assert is_dead(sim)


def test_nothing_is_sent_before_it_begins(sim: RunningSim, boards: Boards) -> None:
    before = [board["written"] for board in boards_of(sim)]
    drive = Drive(boards, MOTORS, tuple(ZERO))
    drive.reached(NODES)
    for tell in (drive.cycle, drive.zero, drive.off):
        tell()
    drive.currents(BITS)
    drive.switch(power=True)
    look(drive, boards)
    assert [board["written"] for board in boards_of(sim)] == before
    assert is_dead(sim)


def test_a_relay_that_is_to_be_opened_is_read_back(sim: RunningSim, boards: Boards) -> None:
    """That nothing has power is no proof: it may not have got there yet."""
    drive = Drive(boards, MOTORS, tuple(ZERO))
    drive.reached(NODES)
    drive.begin()
    drive.switch(relay=True)
    eventually(lambda: all(board["relay"] for board in boards_of(sim)), "relays are closed")
    sim.control.inject("write_loss", every=1)
    drive.off(NODES)
    for _ in range(5):
        drive.cycle()
        look(drive, boards)
    assert not drive.is_free
    sim.control.clear()
    for _ in range(3):
        drive.cycle()
        look(drive, boards)
    assert drive.is_free
    assert not any(board["relay"] for board in boards_of(sim))
