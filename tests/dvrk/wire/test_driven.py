"""An arm that is driven: switched on in order, moved by efforts, switched off; each step read back."""

from __future__ import annotations

import contextlib
import copy
import json
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from crtk_driver_dvrk.plugin import PLUGIN, TYPICAL
from crtk_drivers.errors import CommandRefused, TransitionFailed
from crtk_drivers.front import LocalDevice
from crtk_drivers.state import OperatingState
from crtk_sim_backends.dvrk import SIM, RunningSim
from rigs.dvrk_bench import (
    DRIVEN,
    PSM,
    UNHURRIED,
    ZERO,
    arm_at,
    boards_of,
    configuration,
    driven_at,
    is_dead,
    notes,
    push,
)
from rigs.waiting import eventually

EFFORT = [0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
BITS = round(32768 - 5242.88 * 0.2 * 0.4040893846)


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with SIM.spawn(**UNHURRIED) as sim:
        yield sim


@pytest.fixture(scope="module")
def other_sim() -> Iterator[RunningSim]:
    """Boards for those who have a driver of their own: two at one controller notice each other."""
    with SIM.spawn(**UNHURRIED) as sim:
        yield sim


@pytest.fixture(scope="module")
def driver(sim: RunningSim) -> Iterator[LocalDevice]:
    with driven_at(sim) as arm:
        yield arm


@pytest.fixture
def arm(driver: LocalDevice) -> Iterator[LocalDevice]:
    """DISABLED."""
    driver.disable()
    yield driver
    driver.disable()


def test_without_drive_nothing_can_be_commanded_and_nothing_is_switched(
    other_sim: RunningSim,
) -> None:
    with arm_at(other_sim, drive=False) as read:
        assert "servo_jf" not in read.crtk_commands
        assert not hasattr(read, "set_encoders")
        before = [board["events"] for board in boards_of(other_sim)]
        read.enable()
        samples = read.health().samples
        eventually(lambda: read.health().samples > samples + 20, "it reads")
        read.disable()
        assert [board["events"] for board in boards_of(other_sim)] == before


def test_efforts_are_all_that_is_offered(arm: LocalDevice) -> None:
    moving = {
        name for name in arm.crtk_commands if name.startswith(("servo", "move", "interp", "hold"))
    }
    assert moving == {"servo_jf", "servo_js", "interpolate_jf", "hold"}
    assert "without power: nothing holds the arm" in notes(arm)


def test_boards_are_switched_on_and_off_in_order(sim: RunningSim, arm: LocalDevice) -> None:
    before = [len(board["events"]) for board in boards_of(sim)]
    arm.enable()
    assert [board["timed_out"] for board in boards_of(sim)] == [False, False]
    assert arm.state.amplifiers() == (1.0,) * 7
    assert arm.state.motor_power() is True
    arm.disable()
    assert is_dead(sim)
    for board, seen, axes in zip(boards_of(sim), before, (4, 3), strict=True):
        events = board["events"][min(seen, len(board["events"])) :] or board["events"]
        on = [f"amplifier {axis} on" for axis in range(axes)]
        wanted = ["watchdog 57600", "power on", *on]
        assert [event for event in events if event in wanted][-len(wanted) :] == wanted
        assert events[-1] == "power off"
        assert board["watchdog"] == 57600  # it stays armed


def test_an_effort_becomes_a_current_and_moves_the_arm(sim: RunningSim, arm: LocalDevice) -> None:
    arm.enable()
    before = arm.measured_js().position[0]

    def pushes() -> bool:
        push(arm, EFFORT)
        return boards_of(sim)[0]["command"][0] == BITS

    eventually(pushes, "the current is that of the effort")
    assert boards_of(sim)[0]["command"][1:] == ZERO[1:4]

    def moves() -> bool:
        push(arm, EFFORT)
        told = arm.setpoint_js(age=0).effort == pytest.approx(EFFORT)
        return bool(told and arm.measured_js().position[0] > before + 0.01)

    eventually(moves, "it moves the way of the effort, which is told as the setpoint")
    eventually(lambda: boards_of(sim)[0]["command"][:4] == ZERO[:4], "it ends with its stream")
    eventually(lambda: arm.engine._stopping.confirmed, "the stop is read back")
    assert arm.is_enabled()


@pytest.mark.slow
def test_a_measured_effort_is_that_of_the_current(sim: RunningSim, arm: LocalDevice) -> None:
    arm.enable()

    def measures() -> bool:
        push(arm, EFFORT)
        return bool(abs(arm.measured_js().effort[0] - EFFORT[0]) < 0.01)

    eventually(measures, "the effort is measured")


def test_efforts_beyond_the_limits_are_refused(sim: RunningSim, arm: LocalDevice) -> None:
    arm.enable()
    most = arm.engine.capabilities.limits[0].effort
    assert most == pytest.approx(0.5 * 1.34 / 0.4040893846)
    with pytest.raises(CommandRefused):
        arm.servo_jf([most * 1.01] + [0.0] * 6)
    with pytest.raises(CommandRefused):
        arm.servo_jf([np.nan] * 7)
    assert boards_of(sim)[0]["command"] == ZERO[:4]
    assert arm.is_enabled()


def test_a_joint_that_gets_too_fast_is_not_driven_on(sim: RunningSim, arm: LocalDevice) -> None:
    arm.enable()
    limit = arm.engine.capabilities.limits[0]
    sim.control.call("turn", node=0, axis=0, velocity=1.3 * limit.velocity / 7.722695805e-06)

    def ended() -> bool:
        with contextlib.suppress(CommandRefused):
            arm.servo_jf(EFFORT)
        return not arm.is_enabled()

    eventually(ended, "it is not driven on")
    sim.control.call("turn", node=0, axis=0)
    sim.control.call("place", node=0, axis=0)
    eventually(lambda: is_dead(sim), "nothing is left on")


def test_pause_switches_off_and_resume_on_again(sim: RunningSim, arm: LocalDevice) -> None:
    arm.enable()
    arm.pause()
    assert is_dead(sim)
    arm.resume()
    assert all(boards_of(sim)[0]["on"])


def test_hold_is_no_current(sim: RunningSim, arm: LocalDevice) -> None:
    arm.enable()
    push(arm, EFFORT)
    arm.hold()
    eventually(lambda: boards_of(sim)[0]["command"] == ZERO[:4], "no current is left")
    assert arm.is_enabled()


def test_a_program_that_ends_while_enabled_leaves_nothing_on(other_sim: RunningSim) -> None:
    with driven_at(other_sim) as other:
        other.enable()
        push(other, EFFORT)
    assert is_dead(other_sim)


def test_encoders_that_nobody_has_set_are_no_place_to_drive_from(other_sim: RunningSim) -> None:
    other_sim.control.inject("restart", node=1)
    with arm_at(other_sim, **DRIVEN) as other:
        with pytest.raises(TransitionFailed, match="encoders of board 7 have not been set"):
            other.enable()
        assert is_dead(other_sim)
        assert "encoders: those of board" in notes(other)
        assert "7 axes" in other.set_encoders()
        assert "encoders: those of board" not in notes(other)
        other.enable()
        # A computer that stands still for long lets the watchdogs expire: then it is being switched off.
        with pytest.raises(TransitionFailed, match=r"have power|may be on"):
            other.set_encoders()
    assert is_dead(other_sim)


@pytest.mark.real_time  # its loop takes no time in a world
def test_encoders_are_not_set_before_boards_have_told_their_state(other_sim: RunningSim) -> None:
    """It is asked for as soon as there is a connection: whether there is power is not known yet."""
    device = PLUGIN.create(configuration(other_sim, **DRIVEN))
    device.open(time.monotonic() + 30.0)
    try:
        steps = device.services["set_encoders"].run()
        while next(steps, "it has ended") is None:
            device.read(time.monotonic() + 0.01)
        assert device.counters["readings"] > 0
    finally:
        device.close()


@pytest.mark.slow
def test_encoders_are_set_to_what_potentiometers_say(other_sim: RunningSim) -> None:
    other_sim.control.call("place", node=0, axis=1, counts=50_000)
    other_sim.control.inject("restart", node=0)
    with driven_at(other_sim) as other:
        told = eventually(lambda: other.measured2_js().position[1], "potentiometers tell it")
        eventually(lambda: abs(other.measured_js().position[1] - told) < 1e-4, "encoders do, too")
    other_sim.control.call("place", node=0, axis=1, counts=0)
    other_sim.control.inject("restart", node=0)


@pytest.mark.slow
def test_encoders_of_an_arm_that_moves_are_not_set(other_sim: RunningSim) -> None:
    other_sim.control.call("turn", node=0, axis=2, velocity=20_000.0)
    with (
        arm_at(other_sim, **DRIVEN) as other,
        pytest.raises(TransitionFailed, match="the arm moves"),
    ):
        other.set_encoders()
    other_sim.control.call("turn", node=0, axis=2, velocity=0.0)
    other_sim.control.call("turn", node=0, axis=2)
    other_sim.control.call("place", node=0, axis=2)


def test_an_arm_outside_its_soft_limits_is_not_driven(
    other_sim: RunningSim, tmp_path: Path
) -> None:
    found = copy.deepcopy(PSM)
    found["robots"][0]["actuators"][3]["encoder"]["position_limits_soft"] = {
        "lower": 0.5,
        "upper": 1.0,
    }
    io = tmp_path / "io.json"
    io.write_text(json.dumps(found))
    with driven_at(other_sim, **{**TYPICAL, "io": str(io)}) as other:
        with pytest.raises(TransitionFailed, match=r"axis 3 of board 6: .* outside \[0.5, 1\]"):
            other.enable()
        assert other.operating_state().state is OperatingState.FAULT
        eventually(lambda: is_dead(other_sim), "nothing is left on")


def test_an_arm_with_brakes_is_refused_when_it_is_to_be_driven(tmp_path: Path) -> None:
    """ECM: brakes hold it without power. Reading it needs nothing of that."""
    from crtk_driver_dvrk.config import DvrkConfig
    from crtk_drivers.errors import ConfigError

    found = copy.deepcopy(PSM)
    found["robots"][0].update(name="ECM", number_of_brakes=3)
    io = tmp_path / "io.json"
    io.write_text(json.dumps(found))
    PLUGIN.create(DvrkConfig(io=str(io)))
    with pytest.raises(ConfigError, match="ECM has 3 brakes"):
        PLUGIN.create(DvrkConfig(io=str(io), drive=True))


@pytest.mark.slow
def test_an_arm_with_weight_falls_when_its_efforts_end_and_that_is_a_fault() -> None:
    """Lifted by an effort, then let go: it does not stand as a stop should, and is switched off."""
    slow = {"angular_velocity": 0.2, "linear_velocity": 0.2}
    with SIM.spawn(**UNHURRIED, gravity=0.3) as sim, driven_at(sim, **slow) as arm:
        arm.enable()
        lift = [-0.9 * arm.engine.capabilities.limits[0].effort] + [0.0] * 6

        def lifts() -> bool:
            push(arm, lift)
            return bool(boards_of(sim)[0]["position"][0] > 8000.0)

        eventually(lifts, "it is lifted")
        eventually(
            lambda: arm.operating_state().state is OperatingState.FAULT, "that it falls is told"
        )
        assert "does it fall?" in arm.operating_state().detail
        eventually(lambda: is_dead(sim), "nothing is left on")
        eventually(lambda: boards_of(sim)[0]["velocity"][0] == 0.0, "it lies")
        eventually(lambda: arm.engine._stopping.confirmed, "that is seen")


def test_an_arm_that_falls_while_enabled_is_a_fault(sim: RunningSim, arm: LocalDevice) -> None:
    """No effort is asked for, and it is fast all the same."""
    arm.enable()
    sim.control.call("turn", node=1, axis=2, velocity=110_000.0)
    eventually(lambda: arm.operating_state().state is OperatingState.FAULT, "it is told")
    sim.control.call("turn", node=1, axis=2)
    sim.control.call("place", node=1, axis=2)
    assert "does it fall?" in arm.operating_state().detail
    eventually(lambda: is_dead(sim), "nothing is left on")
