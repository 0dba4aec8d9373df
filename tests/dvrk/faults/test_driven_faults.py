"""What goes wrong while an arm is driven: no current and no power are left, and it is said why."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from bench.reliability.activities import Plan
from crtk_drivers.errors import CommandRefused, TransitionFailed
from crtk_drivers.front import LocalDevice
from crtk_drivers.state import OperatingState
from crtk_sim_backends.dvrk import SIM, RunningSim
from rigs import victims
from rigs.dvrk_bench import (
    DRIVEN,
    UNHURRIED,
    ZERO,
    arm_at,
    boards_of,
    configuration,
    datagrams,
    driven_at,
    is_dead,
    push,
)
from rigs.dvrk_client import BoardClient
from rigs.waiting import eventually

EFFORT = [0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    with SIM.spawn(**UNHURRIED) as sim:
        yield sim


@pytest.fixture
def sim(shared: RunningSim) -> Iterator[RunningSim]:
    shared.control.clear()
    yield shared
    shared.control.clear()


@pytest.fixture(scope="module")
def lonely() -> Iterator[RunningSim]:
    with SIM.spawn(**UNHURRIED) as sim:
        yield sim


@pytest.fixture
def other_sim(lonely: RunningSim) -> Iterator[RunningSim]:
    """For those who have a driver of their own: two at one controller notice each other."""
    lonely.control.clear()
    yield lonely
    lonely.control.clear()


@pytest.fixture(scope="module")
def driver(shared: RunningSim) -> Iterator[LocalDevice]:
    with driven_at(shared) as arm:
        yield arm


@pytest.fixture
def arm(sim: RunningSim, driver: LocalDevice) -> LocalDevice:
    """ENABLED, with the current of an effort."""
    eventually(lambda: driver.engine.connected and driver.engine.has_sample, "it is connected")
    driver.disable()
    before = driver.health().samples
    eventually(lambda: driver.health().samples > before + 3, "it reads")
    if "encoders" in {note.key for note in driver.health().notes}:
        driver.set_encoders()
    driver.enable()
    pushes(sim, driver)
    return driver


def pushes(sim: RunningSim, arm: LocalDevice) -> None:
    """Stream efforts until a current flows."""

    def flows() -> bool:
        push(arm, EFFORT)
        return bool(boards_of(sim)[0]["command"][0] != ZERO[0])

    eventually(flows, "a current flows")


@contextmanager
def pushed(arm: LocalDevice) -> Iterator[None]:
    """A client that goes on streaming efforts that change, whatever is said of them."""
    ends = threading.Event()

    def stream() -> None:
        for number in itertools.count():
            if ends.wait(0.01):
                return
            with contextlib.suppress(CommandRefused):  # as it is in FAULT
                arm.servo_jf([0.1 + 0.02 * (number % 7)] + [0.0] * 6)

    thread = threading.Thread(target=stream)
    thread.start()
    try:
        yield
    finally:
        ends.set()
        thread.join()


def ends_in(sim: RunningSim, arm: LocalDevice, words: str) -> None:
    """It is in FAULT by these words and a remedy, and nothing is left on."""
    eventually(lambda: arm.operating_state().state is OperatingState.FAULT, words)
    detail = arm.operating_state().detail
    assert words in detail
    assert "send enable" in detail
    eventually(lambda: is_dead(sim), "nothing is left on")


@pytest.mark.parametrize(
    ("kind", "parameters", "words"),
    [
        ("watchdog", {"node": 1}, "board 7: its watchdog has expired"),
        ("relay_open", {}, "board 6: its safety relay is open"),
        ("supply_off", {"node": 1}, "board 7: its motors have lost their voltage"),
        ("supply_fault", {}, "board 6: the supply of its motors has a fault"),
        ("encoder_supply", {}, "board 6: the supply of its encoders"),
        ("heat", {"node": 1}, "board 7: its amplifiers are hotter than 65"),
        ("trip", {"axis": 2}, "axis 2 of board 6: its amplifier was switched off by the board"),
        ("amplifier", {"axis": 1}, "axis 1 of board 6: its amplifier tells a fault"),
        ("encoder_overflow", {"axis": 3}, "has counted beyond its range"),
        ("encoder_error", {"axis": 1}, "axis 1 of board 6: the signals of its encoder"),
        ("encoder_velocity", {"axis": 1}, "axis 1 of board 6: its encoder does not move as"),
        ("potentiometer", {"node": 1, "axis": 1}, "axis 1 of board 7: its potentiometer says"),
        ("current", {"axis": 1, "by": 0.43}, "axis 1 of board 6: -0.43"),
    ],
)
@pytest.mark.sweep(5)
def test_what_boards_tell_ends_it(
    sim: RunningSim, arm: LocalDevice, kind: str, parameters: dict[str, Any], words: str
) -> None:
    with pushed(arm):
        sim.control.inject(kind, **parameters)
        ends_in(sim, arm, words)


def test_an_encoder_that_leaps_ends_it(sim: RunningSim, arm: LocalDevice) -> None:
    sim.control.call("place", node=0, axis=2, counts=200_000)
    ends_in(sim, arm, "axis 2 of board 6: its encoder has leapt")
    sim.control.call("place", node=0, axis=2)


@pytest.mark.parametrize("kind", ["silence", "mute", "loss"])
@pytest.mark.sweep(3)
def test_boards_that_do_not_tell_their_state_end_it_before_the_link_counts_as_lost(
    other_sim: RunningSim, kind: str
) -> None:
    """Nothing comes back, and what is sent arrives: amplifiers are off though nobody can say so."""
    with driven_at(other_sim, feedback_timeout=1.0, sample_timeout=3.0) as other:
        other.enable()
        pushes(other_sim, other)
        parameters = {"mute": {"node": 1}, "loss": {"every": 1}}.get(kind, {})
        with pushed(other):
            other_sim.control.inject(kind, **parameters)
            detail = eventually(
                lambda: (
                    other.operating_state().state is OperatingState.FAULT
                    and other.operating_state().detail
                ),
                "it is told",
            )
        assert "boards have not told their state for" in detail
        if kind != "silence":  # in which boards do not hear, either
            eventually(lambda: is_dead(other_sim), "nothing is left on")
        other_sim.control.clear()
        eventually(lambda: is_dead(other_sim), "nothing is left on")
        eventually(lambda: other.engine.device.has_stopped, "that is read back")


@pytest.mark.parametrize(
    ("kind", "parameters"),
    [
        ("write_loss", {"every": 3}),
        ("write_duplicate", {"every": 1}),
        ("write_late", {"every": 3, "by": 2}),
        ("loss", {"every": 4}),
        ("duplicate", {"every": 1}),
        ("late", {"every": 5, "by": 2}),
        ("short", {"every": 5}),
        ("empty", {"every": 2}),
    ],
)
@pytest.mark.sweep(8)
def test_single_packets_that_go_wrong_end_nothing_and_leave_no_current(
    sim: RunningSim, arm: LocalDevice, kind: str, parameters: dict[str, Any]
) -> None:
    sim.control.inject(kind, **parameters)
    with pushed(arm):
        goal = arm.health().samples + 60
        eventually(lambda: arm.health().samples > goal or not arm.is_enabled(), "it goes on")
        assert arm.is_enabled(), arm.operating_state().detail
    eventually(lambda: boards_of(sim)[0]["command"][:4] == ZERO[:4], "the current ends")
    arm.disable()
    assert is_dead(sim)


@pytest.mark.slow
def test_writes_that_do_not_arrive_end_it(sim: RunningSim, arm: LocalDevice) -> None:
    with pushed(arm):
        sim.control.inject("write_late", every=1, by=12)
        eventually(lambda: arm.operating_state().state is OperatingState.FAULT, "it is told")
    assert "does not take the currents that are sent" in arm.operating_state().detail
    sim.control.clear()
    eventually(lambda: is_dead(sim), "nothing is left on")


def test_writes_that_are_all_lost_are_met_by_the_watchdog() -> None:
    """By the boards themselves, in their own time."""
    with SIM.spawn(power_delay=0.02, patience=2.0) as hurried, driven_at(hurried) as other:
        other.enable()
        pushes(hurried, other)
        hurried.control.inject("write_loss", every=1)
        eventually(lambda: not any(boards_of(hurried)[0]["on"]), "amplifiers are off")
        assert boards_of(hurried)[0]["timed_out"]
        eventually(lambda: other.operating_state().state is OperatingState.FAULT, "it is told")
        hurried.control.clear()
        eventually(lambda: is_dead(hurried), "nothing is left on")


@pytest.mark.parametrize("kind", ["bus_reset", "restart"])
@pytest.mark.slow
def test_a_bus_that_is_reset_ends_it_by_the_watchdog(kind: str) -> None:
    """Nodes may be others: nothing is written to them."""
    with SIM.spawn(power_delay=0.02, patience=2.0) as hurried, driven_at(hurried) as other:
        other.enable()
        pushes(hurried, other)
        with pushed(other):
            hurried.control.inject(kind)
            eventually(lambda: other.operating_state().state is OperatingState.FAULT, "it is told")
            eventually(
                lambda: not any(on for board in boards_of(hurried) for on in board["on"]),
                "amplifiers are off",
            )
        eventually(lambda: other.engine.connected and is_dead(hurried), "it is switched off")


@pytest.mark.slow
def test_a_board_that_is_left_alone_is_switched_off_at_its_new_node() -> None:
    """The other one is gone, so the arm cannot be reached again; what it has left has power still."""
    with SIM.spawn(**UNHURRIED) as lone, driven_at(lone) as other:
        other.enable()
        lone.control.inject("write_loss", every=1)
        lone.control.inject("mute", node=1)
        lone.control.inject("other_board", node=0, number=7)
        lone.control.inject("bus_reset")
        eventually(lambda: "board 6 is not there" in other.operating_state().detail, "it is told")
        assert boards_of(lone)[0]["power"]
        lone.control.clear("write_loss")
        eventually(lambda: not boards_of(lone)[0]["power"], "board 7 is switched off")
        assert not other.engine.connected


# ------------------------------------------------------------------------------------ another program


@pytest.mark.parametrize(
    ("address", "value", "words"),
    [
        (0x21, 0x80009000, "currents that this driver did not send"),
        (0x21, 0x20000000, "axis 1 of board 6: its amplifier is off"),
        (0, 0x00080000, "board 6: its motors have lost their voltage"),
        (0, 0x00020000, "board 6: its safety relay is open"),
        (3, 0, "board 6: the period of its watchdog was changed to 0"),
        (0x24, 0x800100, "board 6: the encoder of axis 1 was set anew"),
    ],
)
@pytest.mark.sweep(3)
def test_another_program_that_writes_is_noticed(
    sim: RunningSim, arm: LocalDevice, address: int, value: int, words: str
) -> None:
    with datagrams(sim) as door, pushed(arm):
        other = BoardClient(sim, door, node=0)

        def noticed() -> bool:
            if arm.is_enabled():
                other.write(address, value)
            return arm.operating_state().state is OperatingState.FAULT

        eventually(noticed, words)
        if "currents" in words:  # which may have come after those of the driver had been ended
            other.write(address, 0x80000000 | ZERO[1])
        ends_in(sim, arm, words)


@pytest.mark.slow
def test_another_program_that_reads_is_noticed(other_sim: RunningSim) -> None:
    with driven_at(other_sim) as arm, datagrams(other_sim) as door:
        arm.enable()
        other = BoardClient(other_sim, door, node=1)

        def noticed() -> bool:
            other.state()
            return arm.operating_state().state is OperatingState.FAULT

        eventually(noticed, "it is told")
        ends_in(other_sim, arm, "another program reads the state of board 7")

        def refused() -> bool:
            other.state()
            with contextlib.suppress(TransitionFailed):
                arm.enable()
            return "enable: another program reads" in arm.operating_state().detail

        eventually(refused, "nor is it enabled")


def test_an_arm_that_another_program_drives_is_not_enabled(other_sim: RunningSim) -> None:
    with arm_at(other_sim, **DRIVEN) as mine, datagrams(other_sim) as door:
        other = BoardClient(other_sim, door, node=0)
        other.write(0, 0x000C0000)
        other.write(0x21, 0x30000000)
        eventually(lambda: boards_of(other_sim)[0]["on"][1], "it drives")
        eventually(lambda: mine.state.amplifiers()[1] == 1.0, "that is read")
        with pytest.raises(TransitionFailed, match="axes 1 are on, and not by this driver"):
            mine.enable()
        assert boards_of(other_sim)[0]["on"][1]  # which is not ours to switch off
        other.write(0, 0x00080000)


def test_power_that_an_earlier_driver_left_on_is_taken_by_disable(other_sim: RunningSim) -> None:
    """It was killed: watchdogs have switched amplifiers off, and nothing else."""
    with datagrams(other_sim) as door:
        for node in (0, 1):
            BoardClient(other_sim, door, node).write(0, 0x000C0000)
        eventually(lambda: all(board["power"] for board in boards_of(other_sim)), "power is on")
    with arm_at(other_sim, **DRIVEN) as mine:
        assert "motor power is on" in mine.operating_state().detail
        assert boards_of(other_sim)[0]["power"]
        mine.disable()
        assert is_dead(other_sim)
        assert mine.engine.device.has_stopped


def test_a_packet_of_before_that_switches_power_on_late_is_undone(
    sim: RunningSim, arm: LocalDevice
) -> None:
    arm.disable()
    assert is_dead(sim)
    with datagrams(sim) as door:
        currents = [0x80000000 | zero for zero in ZERO[:4]]
        BoardClient(sim, door, node=0).command(6, currents, 0x000C0000)
        undone = ["power on", "power off"]
        eventually(lambda: boards_of(sim)[0]["events"][-2:] == undone, "it is undone")
    eventually(lambda: arm.engine.device.has_stopped, "that is read back")
    assert is_dead(sim)
    assert arm.health().device["late switches"] >= 1


# ------------------------------------------------------------------------------------ steps that fail


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("relay_open", "board 6: its safety relay does not close within 2 s"),
        ("supply_off", "board 6: its motors do not get their voltage within 3 s"),
        ("amplifier_dead", "board 6: the amplifier of axis 0 is not on within 2 s"),
    ],
)
@pytest.mark.slow
def test_a_step_of_enable_that_fails_leaves_nothing_on(
    sim: RunningSim, driver: LocalDevice, kind: str, words: str
) -> None:
    driver.disable()
    sim.control.inject(kind)
    with pytest.raises(TransitionFailed, match=words):
        driver.enable()
    eventually(lambda: is_dead(sim), "nothing is left on")


def test_a_watchdog_that_expires_during_enable_is_told_as_that(
    sim: RunningSim, driver: LocalDevice
) -> None:
    """As where the program is held up for a moment: motors and their cables are in order."""
    driver.disable()
    sim.control.inject("amplifier_dead")

    def expire() -> None:
        eventually(lambda: boards_of(sim)[0]["events"][-1:] == ["amplifier 0 on"], "it is asked")
        sim.control.inject("watchdog", node=1)

    thread = threading.Thread(target=expire)
    thread.start()
    with pytest.raises(TransitionFailed, match="board 7: its watchdog has expired"):
        driver.enable()
    thread.join()
    eventually(lambda: is_dead(sim), "nothing is left on")


@pytest.mark.slow
def test_a_watchdog_that_is_not_read_back_is_not_relied_on(other_sim: RunningSim) -> None:
    """It holds another period of before."""
    with driven_at(other_sim, watchdog=0.2) as other:
        other_sim.control.inject("write_loss", every=1)
        with pytest.raises(TransitionFailed, match="after 0x9600 was written"):
            other.enable()
        assert is_dead(other_sim)


@pytest.mark.slow
def test_the_relay_is_opened_again_only_where_it_was_closed_by_an_enable_that_failed(
    sim: RunningSim, driver: LocalDevice
) -> None:
    """Other arms may have their power through it."""
    driver.disable()
    with datagrams(sim) as door:
        BoardClient(sim, door, node=0).write(0, 0x00020000)
        BoardClient(sim, door, node=1).write(0, 0x00030000)
    eventually(lambda: [board["relay"] for board in boards_of(sim)] == [False, True], "so they are")
    sim.control.inject("amplifier_dead")
    with pytest.raises(TransitionFailed, match="amplifier"):
        driver.enable()
    eventually(lambda: is_dead(sim), "nothing is left on")
    assert [board["relay"] for board in boards_of(sim)] == [False, True]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "words"), [("amplifier_sticks", "amplifiers"), ("power_sticks", "power")]
)
def test_what_cannot_be_switched_off_is_said(
    sim: RunningSim, arm: LocalDevice, kind: str, words: str
) -> None:
    """A stop is believed when it is read back, and not before."""
    sim.control.inject(kind)
    with pytest.raises(TransitionFailed, match=f"{words}.* not read back as off"):
        arm.disable()
    assert arm.operating_state().state is OperatingState.FAULT
    assert not arm.engine.device.has_stopped
    with pytest.raises(TransitionFailed, match="cannot be read back as off"):
        arm.enable()
    sim.control.clear()
    eventually(lambda: is_dead(sim), "it goes on being told to")
    arm.disable()


@pytest.mark.slow
@pytest.mark.parametrize("end", ["kill", "freeze"])
def test_a_driver_that_dies_or_freezes_lets_the_watchdog_cut(end: str) -> None:
    """And the next one finds power on, drives nothing, and may enable."""
    with SIM.spawn(power_delay=0.02, patience=2.0) as hurried:
        with driven_at(hurried):
            config = configuration(hurried, **DRIVEN)
        with victims.victim("dvrk", config, Plan(0.0, 0.0, effort=0.2), "servo_jf") as process:
            eventually(lambda: boards_of(hurried)[0]["command"][0] != ZERO[0], "a current flows")
            os.kill(process.pid, signal.SIGKILL if end == "kill" else signal.SIGSTOP)
            eventually(
                lambda: not any(on for board in boards_of(hurried) for on in board["on"]),
                "amplifiers are off",
            )
            assert all(board["timed_out"] for board in boards_of(hurried))
        with arm_at(hurried, **DRIVEN) as arm:
            assert "motor power is on" in arm.operating_state().detail
            assert arm.operating_state().state is OperatingState.DISABLED
            assert not any(on for board in boards_of(hurried) for on in board["on"])
            arm.enable()
            assert boards_of(hurried)[0]["command"] == ZERO[:4]
        assert is_dead(hurried)
