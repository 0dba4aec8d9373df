"""What goes wrong with boards and their link: told in words, and never as a fresh position."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from crtk_drivers.front import LocalDevice
from crtk_drivers.state import OperatingState
from crtk_sim_backends.dvrk import SIM, RunningSim
from rigs.dvrk_bench import arm_at, notes, refused
from rigs.waiting import eventually


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    with SIM.spawn() as sim:
        yield sim


@pytest.fixture
def sim(shared: RunningSim) -> Iterator[RunningSim]:
    shared.control.clear()
    yield shared
    shared.control.clear()


@pytest.fixture(scope="module")
def driver(shared: RunningSim) -> Iterator[LocalDevice]:
    with arm_at(shared) as arm:
        yield arm


@pytest.fixture
def arm(sim: RunningSim, driver: LocalDevice) -> LocalDevice:
    """The driver, which has got over what went wrong before, ENABLED."""
    before = driver.health().samples
    eventually(lambda: driver.health().samples > before + 5, "it reads")
    eventually(lambda: driver.engine.connected and is_told(driver, "measured_js"), "it is back")
    driver.enable()
    return driver


def is_fault(arm: LocalDevice, words: str) -> bool:
    status = arm.operating_state()
    return status.state is OperatingState.FAULT and words in status.detail


def is_told(arm: LocalDevice, name: str) -> bool:
    """Whether a value is told as valid."""
    found = arm.engine.feedback(name)
    return found is not None and found[1].wall_ns > 0


def goes_on(arm: LocalDevice, samples: int = 30) -> None:
    goal = arm.health().samples + samples
    eventually(lambda: arm.health().samples >= goal, "it goes on")
    assert arm.is_enabled()


@pytest.mark.parametrize(
    ("kind", "parameters", "counter"),
    [
        ("loss", {"every": 3}, "lost replies"),
        ("duplicate", {"every": 2}, "stray datagrams"),
        ("late", {"every": 5, "by": 2}, "stray datagrams"),
        ("short", {"every": 4}, "damaged datagrams"),
        ("long", {"every": 4}, "damaged datagrams"),
        ("corrupt", {"every": 6}, "damaged datagrams"),
        ("empty", {"every": 2}, ""),
    ],
)
@pytest.mark.sweep(4)
def test_datagrams_that_go_wrong_are_counted(
    sim: RunningSim, arm: LocalDevice, kind: str, parameters: dict[str, Any], counter: str
) -> None:
    before = arm.measured_js().position
    sim.control.inject(kind, **parameters)
    if counter:
        eventually(lambda: arm.health().device[counter] > 3, f"{counter} are counted")
    goes_on(arm)
    if kind != "corrupt":  # a board's own replies have no CRC
        assert arm.measured_js().position == pytest.approx(before, abs=1e-9)


def test_a_state_that_jumps_once_is_not_believed_and_twice_it_is(
    sim: RunningSim, arm: LocalDevice
) -> None:
    """As when an encoder is set: the next reading tells the same."""
    before = arm.health().device["doubted states"]
    sim.control.call("place", node=0, axis=0, counts=4_000_000)
    eventually(lambda: arm.health().device["doubted states"] > before, "it was doubted")
    eventually(lambda: abs(arm.measured_js().position[0]) > 20.0, "it is believed")
    sim.control.call("place", node=0, axis=0, counts=0)


@pytest.mark.parametrize(
    ("kind", "parameters", "words"),
    [
        ("encoder_overflow", {"axis": 1}, "board 6: the encoder of axis 1 has counted beyond"),
        ("encoder_supply", {"node": 1}, "board 7: the supply of its encoders"),
    ],
)
def test_encoders_that_cannot_be_relied_on_are_a_fault(
    sim: RunningSim, arm: LocalDevice, kind: str, parameters: dict[str, Any], words: str
) -> None:
    sim.control.inject(kind, **parameters)
    eventually(lambda: is_fault(arm, words), words)
    eventually(lambda: not is_told(arm, "measured_js"), "positions are not told as valid")
    sim.control.clear()
    eventually(lambda: is_told(arm, "measured_js"), "they are again")
    arm.enable()


def test_an_axis_that_the_arm_does_not_have_is_nobodys_fault(
    sim: RunningSim, arm: LocalDevice
) -> None:
    sim.control.inject("encoder_overflow", node=1, axis=3)
    goes_on(arm)


@pytest.mark.parametrize(
    ("kind", "parameters", "words"),
    [
        ("watchdog", {"node": 1}, "board 7: watchdog has expired"),
        ("supply_fault", {}, "board 6: motor supply has a fault"),
        ("amplifier", {"node": 1, "axis": 2}, "amplifier of jaw: tells a fault"),
        ("trip", {"axis": 0}, "amplifier of yaw: switched off by the board"),
    ],
)
@pytest.mark.sweep(2)
def test_faults_of_the_drives_are_told_and_reading_goes_on(
    sim: RunningSim, arm: LocalDevice, kind: str, parameters: dict[str, Any], words: str
) -> None:
    sim.control.inject(kind, **parameters)
    eventually(lambda: words in notes(arm), words)
    goes_on(arm, 5)


def test_errors_of_an_encoder_are_counted(sim: RunningSim, arm: LocalDevice) -> None:
    sim.control.inject("encoder_error", axis=2)
    eventually(lambda: arm.health().device["encoder errors"] > 2, "they are counted")
    assert arm.is_enabled()


@pytest.mark.parametrize("kind", ["silence", "mute", "delay"])
@pytest.mark.sweep(3)
def test_boards_that_do_not_answer_are_a_fault_and_come_back_disabled(
    sim: RunningSim, arm: LocalDevice, kind: str
) -> None:
    parameters = {"mute": {"node": 1}, "delay": {"seconds": 0.4}}.get(kind, {})
    sim.control.inject(kind, **parameters)
    eventually(lambda: is_fault(arm, ""), "it is told")
    eventually(lambda: not is_told(arm, "measured_js"), "nothing is told as valid")
    sim.control.clear()
    eventually(lambda: arm.engine.connected and is_told(arm, "measured_js"), "it is back")
    assert arm.operating_state().state is OperatingState.DISABLED


def test_a_bus_that_is_reset_is_looked_at_anew(
    sim: RunningSim, arm: LocalDevice, caplog: pytest.LogCaptureFixture
) -> None:
    """And no request of the bus as it was is answered."""
    sim.control.inject("bus_reset")
    eventually(lambda: "FAULT: the FireWire bus was reset" in caplog.text, "it was noticed")
    eventually(lambda: arm.engine.connected and is_told(arm, "measured_js"), "it is back")


def test_a_program_that_ends_as_the_link_is_lost_speaks_of_no_stop(sim: RunningSim) -> None:
    """Nothing of ours moves the arm, so there is none to be read back."""
    with arm_at(sim) as arm:
        arm.enable()
        sim.control.inject("bus_reset")


def test_a_board_in_the_place_of_another_is_noticed(sim: RunningSim, arm: LocalDevice) -> None:
    sim.control.inject("other_board", node=1, number=9)
    eventually(lambda: is_fault(arm, "board 7 is not there; boards are: 6, 9"), "it is told")
    sim.control.clear()
    eventually(lambda: arm.engine.connected, "it is back")


def test_a_board_with_other_firmware_is_refused(sim: RunningSim, arm: LocalDevice) -> None:
    sim.control.inject("other_firmware", node=0, version=7)
    eventually(lambda: is_fault(arm, "board 6 has firmware 7"), "it is told")
    assert not is_told(arm, "measured_js")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"hardware": "DQLA"}, "the board is DQLA (two QLAs on one FPGA), not QLA1"),
        ({"firmware": 9}, "board 6 has firmware 9"),
        ({"boards": "6"}, "board 7 is not there; boards are: 6"),
        ({"boards": "6,7,7"}, "two boards have the number 7"),
    ],
)
@pytest.mark.sweep(4)
def test_what_is_not_the_arm_is_refused(options: dict[str, Any], words: str) -> None:
    with SIM.spawn(**options) as sim:
        refused(sim, words)


def test_nobody_at_the_address_is_told_with_what_to_do(sim: RunningSim) -> None:
    sim.control.inject("silence")
    refused(sim, "no board answers", open_timeout=0.5)
