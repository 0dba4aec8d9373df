"""The CANopen arm on simulated drives: power, modes, homing, and what it does when one joint has a fault."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from crtk_driver_canopen import PLUGIN, statemachine
from crtk_driver_canopen.modes import OpMode
from crtk_driver_canopen.statemachine import TIMEOUTS
from crtk_drivers.errors import CommandRefused, ConfigError, MotionAborted, TransitionFailed
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from crtk_sim_backends.process import RunningSim
from rigs.canopen_arm import PERIOD, arm_of, arm_on, device_of, drives, stream
from rigs.waiting import LONG, eventually

COUNT = 3


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """No drive is given more than a second for what it does at once, or not at all."""
    timeouts = {number: min(1.0, seconds) for number, seconds in TIMEOUTS.items()}
    monkeypatch.setattr(statemachine, "TIMEOUTS", timeouts)


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    with drives(COUNT) as sim:
        yield sim


@pytest.fixture
def sim(shared: RunningSim) -> Iterator[RunningSim]:
    yield shared
    shared.control.clear()


def state_is(arm: LocalDevice, state: str) -> Callable[[], bool]:
    return lambda: arm.operating_state().state == state


# ---------------------------------------------------------------------------------------- power and modes


def test_it_moves_by_positions_velocities_and_efforts_and_each_change_is_without_a_jump(
    sim: RunningSim,
) -> None:
    with arm_of(arm_on(sim, COUNT)) as arm:
        arm.enable(LONG)
        start = arm.measured_js().position
        goal = start + 0.05
        arm.move_jp(goal).wait(LONG)
        eventually(lambda: np.abs(arm.measured_js().position - goal).max() < 1e-3, "it is there")

        def moved() -> bool:
            arm.servo_jv([0.2] * COUNT)
            return bool((arm.measured_js().position - goal > 0.03).all())

        eventually(moved, "it has moved by velocities")
        eventually(lambda: arm.engine.is_at_rest, "the stream ends, and none waits")
        eventually(lambda: np.abs(arm.measured_js().velocity).max() < 1e-3, "it stands")
        stood = arm.measured_js().position
        stream(arm, "servo_jf", [0.0] * COUNT, 0.2)
        assert np.abs(arm.measured_js().position - stood).max() < 0.01
        axes = device_of(arm).axes
        eventually(
            lambda: all(axis.mode is OpMode.CSP for axis in axes), "it holds its position again"
        )
        eventually(lambda: device_of(arm).takes_setpoints, "it can be moved again")
        arm.move_jp(start).wait(LONG)
        eventually(lambda: np.abs(arm.measured_js().position - start).max() < 1e-3, "it is back")


def test_connecting_gives_no_power_and_disabling_takes_it(sim: RunningSim) -> None:
    with arm_of(arm_on(sim, COUNT)) as arm:
        axes = device_of(arm).axes
        assert not any(axis.is_enabled for axis in axes)
        arm.enable(LONG)
        assert all(axis.is_enabled for axis in axes)
        arm.disable(LONG)
        assert not any(axis.is_enabled for axis in axes)


def test_it_stays_disabled_until_somebody_enables_it(sim: RunningSim) -> None:
    with arm_of(arm_on(sim, COUNT)) as arm:
        counters = device_of(arm).link.counters
        enough = counters.cycles + 1.5 / PERIOD  # longer than a drive may take to show its mode
        eventually(lambda: counters.cycles > enough, "it has been connected for a while")
        assert state_is(arm, "DISABLED")()
        assert all(axis.failure == "" for axis in device_of(arm).axes)


@pytest.mark.usefixtures("impatient")
def test_drives_with_safe_torque_off_are_reached_and_say_why_they_cannot_be_enabled(
    sim: RunningSim,
) -> None:
    sim.control.inject("safe_torque_off", node=2)
    with arm_of(arm_on(sim, COUNT)) as arm:
        assert arm.operating_state().state == "DISABLED"
        assert arm.measured_js().position.size == COUNT
        with pytest.raises(TransitionFailed, match=r"joint joint_2 \(node 2\)"):
            arm.enable(LONG)
        axes = device_of(arm).axes
        eventually(lambda: not any(axis.is_enabled for axis in axes), "none keeps its power")
        sim.control.clear()
        arm.enable(LONG)


# --------------------------------------------------------------------------------------------- one fault


@pytest.mark.parametrize("policy", ["quick_stop", "hold", "disable"])
def test_a_fault_of_one_joint_is_named_and_the_others_do_what_is_configured(
    sim: RunningSim, policy: str
) -> None:
    with arm_of(arm_on(sim, COUNT, on_joint_fault=policy)) as arm:
        arm.enable(LONG)
        move = arm.move_jp(arm.setpoint_js().position + 2.0)
        sim.control.inject("fault", node=2, error="motor_blocked")
        eventually(state_is(arm, "FAULT"), "it is in FAULT")
        with pytest.raises(MotionAborted):
            move.wait(LONG)
        detail = arm.operating_state().detail
        assert "joint joint_2 (node 2)" in detail
        eventually(lambda: "motor blocked" in arm.operating_state().detail, "the emergency is told")
        others = [axis for axis in device_of(arm).axes if axis.name != "joint_2"]
        enabled = [axis.is_enabled for axis in others]
        if policy == "hold":
            assert enabled == [True, True]
        else:
            eventually(lambda: not any(axis.is_enabled for axis in others), "the others let go")
        arm.enable(LONG)
        assert arm.operating_state().state == "ENABLED"


@pytest.mark.usefixtures("impatient")
def test_a_fault_that_stays_is_not_enabled_over(sim: RunningSim) -> None:
    with arm_of(arm_on(sim, COUNT)) as arm:
        arm.enable(LONG)
        sim.control.inject("lasting_fault", node=1, error="encoder")
        eventually(state_is(arm, "FAULT"), "it is in FAULT")
        with pytest.raises(TransitionFailed, match="fault reset did not clear"):
            arm.enable(LONG)
        sim.control.clear()
        arm.enable(LONG)


def test_a_drive_that_starts_anew_is_told_and_set_up_again(sim: RunningSim) -> None:
    with arm_of(arm_on(sim, COUNT)) as arm:
        arm.enable(LONG)
        sim.control.inject("reset", node=3)
        eventually(state_is(arm, "FAULT"), "it is in FAULT")
        eventually(lambda: "node 3 has started anew" in arm.operating_state().detail, "it says why")
        arm.enable(LONG)
        arm.move_jp(arm.setpoint_js().position + 0.02).wait(LONG)


def test_a_silent_drive_is_named_and_its_return_enables_nothing(sim: RunningSim) -> None:
    with arm_of(arm_on(sim, COUNT)) as arm:
        arm.enable(LONG)
        sim.control.inject("silent", node=2)
        eventually(state_is(arm, "FAULT"), "it is in FAULT")
        eventually(lambda: "node 2" in arm.operating_state().detail, "it says who")
        sim.control.clear()
        eventually(lambda: arm.operating_state().state != "ENABLED", "it is not enabled")
        eventually(lambda: _enables(arm), "it can be enabled again")


def _enables(arm: LocalDevice) -> bool:
    try:
        arm.enable(LONG)
    except (TransitionFailed, CommandRefused):
        return False
    return True


def test_the_drives_stop_by_themselves_when_nobody_talks_to_them_any_more(sim: RunningSim) -> None:
    with arm_of(arm_on(sim, COUNT)) as arm:
        arm.enable(LONG)
    eventually(lambda: not any(_enabled(sim)), "the drives let go")


def _enabled(sim: RunningSim) -> list[bool]:
    """Whether each drive has power at its motor, by what it says itself."""
    from crtk_driver_canopen.objects import OBJECTS
    from crtk_driver_canopen.sdo import Sdo
    from crtk_driver_canopen.statemachine import State, decode
    from crtk_driver_canopen.tools import opened_master

    with opened_master(arm_on(sim, COUNT)) as master:
        words = [Sdo(master.sdo(n + 1)).read(OBJECTS["statusword"]) for n in range(COUNT)]
    return [decode(word) is State.ENABLED for word in words]


# ------------------------------------------------------------------------------------------------ homing


def test_homing_moves_to_the_switch_and_puts_the_position_right() -> None:
    joint: dict[str, Any] = {
        "homing": {
            "method": 24,
            "speed_switch": 2.0,
            "speed_zero": 0.5,
            "acceleration": 20.0,
            "position": 0.25,
            "required": True,
            "timeout": 20.0,
        },
        "gear": 10.0,
    }
    with drives(1) as sim, arm_of(arm_on(sim, 1, joint)) as arm:
        assert not arm.is_homed()
        arm.enable(LONG)
        arm.home(30.0)
        assert arm.is_homed()
        eventually(lambda: np.abs(arm.measured_js().velocity).max() < 1e-3, "it stands")
        assert abs(arm.measured_js().position[0] - 0.25) < 0.5
        arm.move_jp([0.0]).wait(LONG)
        arm.unhome(LONG)
        assert not arm.is_homed()


@pytest.mark.parametrize(
    ("make", "fits", "other"), [("standard", "position", "zero"), ("literal", "zero", "position")]
)
def test_the_home_offset_is_written_as_the_drive_takes_it(make: str, fits: str, other: str) -> None:
    def joint(home_offset: str) -> dict[str, Any]:
        return {"homing": {"method": 37, "position": 0.25, "home_offset": home_offset}}

    with drives(1, personality=make) as sim:
        with arm_of(arm_on(sim, 1, joint(fits))) as arm:
            eventually(arm.is_homed, "it is not required")
            arm.enable(LONG)
            arm.home(LONG)
            assert abs(arm.measured_js().position[0] - 0.25) > 0.1, "there was nothing to do"
            arm.unhome(LONG)
            assert not arm.is_homed()
            arm.home(LONG)
            assert arm.is_homed()
            eventually(lambda: abs(arm.measured_js().position[0] - 0.25) < 1e-3, "it is at home")
            assert abs(arm.setpoint_js().position[0] - 0.25) < 1e-3, "motion begins there"
            arm.move_jr([0.02]).wait(LONG)
            eventually(lambda: abs(arm.measured_js().position[0] - 0.27) < 1e-2, "it is there")
        with arm_of(arm_on(sim, 1, joint(other))) as arm:
            arm.enable(LONG)
            arm.unhome(LONG)
            with pytest.raises(TransitionFailed, match=r"joint_1 \(node 1\).*homing.home_offset"):
                arm.home(LONG)


# --------------------------------------------------------------------------------------- what is refused


def test_another_drive_than_the_configured_one_is_refused(sim: RunningSim) -> None:
    config = arm_on(sim, COUNT, {"identity": {"product": 0x1234}})
    arm = LocalDevice(Session(PLUGIN, config))
    try:
        arm._session.start()
        eventually(lambda: "another device" in arm.operating_state().detail, "it is refused")
    finally:
        arm.close()


def test_a_cycle_that_does_not_fit_the_bus_is_refused_with_the_arithmetic(sim: RunningSim) -> None:
    config = arm_on(sim, COUNT, period=0.001)
    with pytest.raises(ConfigError, match=r"in a period of 1 ms at 1000 kbit/s"):
        PLUGIN.make(config)


def test_all_frames_are_logged_where_asked(sim: RunningSim, tmp_path: Path) -> None:
    path = tmp_path / "frames.log"
    with arm_of(arm_on(sim, COUNT, candump=str(path))) as arm:
        arm.enable(LONG)
    lines = path.read_text().splitlines()
    assert any(" 080#" in line for line in lines)
    assert any(" 181#" in line for line in lines)
