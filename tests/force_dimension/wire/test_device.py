"""Force Dimension's driver at a library that stands for the vendor's: forces, fixtures, gripper, homing."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from crtk_driver_force_dimension import PLUGIN
from crtk_drivers.errors import CommandRefused, ConfigError, TransitionFailed
from crtk_drivers.kit.haptics.child_messages import Flags, State
from crtk_drivers.kit.haptics.fixtures import Motion
from crtk_drivers.kit.haptics.haptic_device import HapticDevice
from crtk_drivers.samples import Flag, Pose, vector
from crtk_drivers.state import OperatingState
from rigs.haptic_bench import (
    HapticBench,
    RunningSim,
    configured,
    haptic_bench,
    haptic_sim,
    needs_compiler,
)
from rigs.waiting import LONG, eventually

pytestmark = needs_compiler

FLOOR = {
    "kind": "wall",
    "point": [0, 0, -0.02],
    "normal": [0, 0, 1],
    "stiffness": 600,
    "damping": 5,
}


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with haptic_sim(model="sigma.7") as running:
        yield running


@pytest.fixture(scope="module")
def connected(sim: RunningSim) -> Iterator[HapticBench]:
    with haptic_bench(sim, model="sigma.7", max_force=6.0) as bench:
        yield bench


@pytest.fixture
def bench(connected: HapticBench) -> Iterator[HapticBench]:
    """The device, ENABLED, in the middle, without fixtures."""
    device, gripper = connected.device, connected.device.gripper
    connected.sim.control.clear()
    connected.sim.control.inject("hold")
    device.disable()
    eventually(lambda: not gripper.is_enabled(), "its gripper is DISABLED, too")
    device.fixtures("{}")
    eventually(lambda: np.abs(device.measured_cp().position).max() < 1e-3, "it is in the middle")
    connected.sim.control.clear("hold")
    device.enable(LONG)
    eventually(gripper.is_enabled, "its gripper follows")
    yield connected
    connected.sim.control.clear()


def until_streamed(
    bench: HapticBench, send: Callable[[], Any], holds: Callable[[], Any], what: str
) -> Any:
    """Send again and again until something holds."""

    def step() -> Any:
        send()
        return holds()

    return eventually(step, what)


def is_forceless(bench: HapticBench) -> bool:
    return not any(bench.force())


def test_servo_cf_pushes_and_ends_with_its_stream(bench: HapticBench) -> None:
    device = bench.device
    bench.sim.control.inject("hold")
    until_streamed(
        bench,
        lambda: device.servo_cf([0.0, 3.0, 0.0, 0.0, 0.0, 0.1]),
        lambda: bench.force() == [0.0, 3.0, 0.0] and bench.status("torque") == [0.0, 0.0, 0.1],
        "it pushes with what was asked for",
    )
    until_streamed(
        bench,
        lambda: device.servo_cf([0.0, 3.0, 0.0, 0.0, 0.0, 0.1]),
        lambda: (
            device.measured_cf().force.tolist() == [0.0, 3.0, 0.0]
            and device.setpoint_cf(age=0).force.tolist() == [0.0, 3.0, 0.0]
        ),
        "it tells that",
    )
    eventually(lambda: is_forceless(bench), "the stream has ended, and so has its force")
    assert device.is_enabled()


def test_a_force_is_clipped_as_a_whole(bench: HapticBench) -> None:
    bench.sim.control.inject("hold")
    far = {"kind": "spring", "point": [0.3, 0.0, -0.4], "stiffness": 1000}
    bench.device.fixtures(json.dumps({"far": far}))
    eventually(
        lambda: np.allclose(bench.force(), [3.6, 0.0, -4.8], atol=0.1),
        "6 N, not 500, in the direction that it pulls",
    )
    assert bench.status("strongest") <= 6.0 + 1e-9


@pytest.mark.parametrize("ends", ["disable", "pause"])
def test_forces_end_with_enabled(bench: HapticBench, ends: str) -> None:
    device = bench.device
    spring = {"kind": "spring", "point": [0.01, 0, 0], "stiffness": 300}
    bench.sim.control.inject("hold")
    device.fixtures(json.dumps({"there": spring}))
    eventually(lambda: math.hypot(*bench.force()) > 2.0, "the spring draws")
    getattr(device, ends)(LONG)
    assert is_forceless(bench)
    assert bench.status("forces_on") is (ends == "pause"), "a pause keeps its power"
    device.disable(LONG)


def test_a_hand_is_kept_off_a_wall(bench: HapticBench) -> None:
    device = bench.device
    device.fixtures(json.dumps({"floor": FLOOR}))
    assert json.loads(device.state.fixtures()) == {"floor": FLOOR}
    bench.sim.control.inject("push", z=-3.0)
    eventually(lambda: device.measured_cp().position[2] < -0.02, "it touches the wall")
    eventually(
        lambda: (
            abs(device.measured_cp().position[2] + 0.025) < 1e-3
            and abs(bench.force()[2] - 3.0) < 0.2
        ),
        "it rests 5 mm in the wall, as 3 N press it",
    )
    assert device.clear_fixtures() == "taken away: floor"
    assert device.clear_fixtures() == "there were none"
    eventually(lambda: device.measured_cp().position[2] < -0.1, "nothing keeps it")


def test_bad_fixtures_are_refused_and_change_nothing(bench: HapticBench) -> None:
    device = bench.device
    device.fixtures(json.dumps({"floor": FLOOR}))
    for text in ("", "{", json.dumps({"floor": {**FLOOR, "stiffness": 1e9}})):
        with pytest.raises(CommandRefused) as caught:
            device.fixtures(text)
        assert "wall" in caught.value.remedy
    assert json.loads(device.state.fixtures()) == {"floor": FLOOR}


def test_servo_cp_draws_the_hand_and_ends(bench: HapticBench) -> None:
    device = bench.device
    goal = np.array([0.01, -0.01, 0.0])
    turned = device.measured_cp().orientation
    until_streamed(
        bench,
        lambda: device.servo_cp(Pose(vector(goal), turned)),
        lambda: (
            np.abs(device.measured_cp().position - goal).max() < 2e-3
            and device.setpoint_cp(age=0).position.tolist() == goal.tolist()
        ),
        "it is drawn there",
    )
    eventually(lambda: is_forceless(bench), "it is drawn no longer")


def test_its_gripper_tells_an_angle_and_pushes(bench: HapticBench) -> None:
    gripper = bench.device.gripper
    assert 0.0 <= gripper.measured_js().position[0] <= 0.6
    bench.sim.control.inject("squeeze", torque=2.0)
    eventually(lambda: gripper.measured_js().position[0] < 0.01, "it is closed")
    until_streamed(
        bench,
        lambda: gripper.servo_jf([4.0]),
        lambda: bench.status("gripper_force") == 4.0 and gripper.measured_js().effort[0] == 4.0,
        "it pushes",
    )
    eventually(lambda: bench.status("gripper_force") == 0.0, "no longer than its stream")


def test_a_button_is_told(bench: HapticBench) -> None:
    device = bench.device
    assert device.button().buttons == (0,)
    bench.sim.control.inject("press", button=0)
    eventually(lambda: device.button().buttons == (1,), "it is pressed")
    bench.sim.control.clear("press")
    eventually(lambda: device.button().buttons == (0,), "it is let go")


def test_gravity_compensation_is_passed_on(bench: HapticBench) -> None:
    assert bench.status("gravity_compensation")
    bench.device.use_gravity_compensation(False)
    eventually(lambda: not bench.status("gravity_compensation"), "it is off")
    bench.device.use_gravity_compensation(True)
    eventually(lambda: bench.status("gravity_compensation"), "it is on")


def test_gravity_compensation_is_not_known_of_one_that_is_closed() -> None:
    device = PLUGIN.create(configured())
    assert isinstance(device, HapticDevice)
    tell = device.readings["gravity_compensation"].tell
    assert tell() is None
    device.is_open = True
    device._state = State(1.0, Motion((0.0, 0.0, 0.0)), flags=Flags.WEIGHTLESS)
    assert tell() == Flag(True)
    device.close()
    assert tell() is None


def test_gravity_compensation_is_read_back(bench: HapticBench) -> None:
    def is_noted() -> bool:
        return any(note.key == "gravity compensation" for note in bench.device.health().notes)

    carries = bench.device.state.gravity_compensation
    eventually(carries, "it is on")
    bench.device.use_gravity_compensation(False)
    eventually(lambda: not carries(), "it is off")
    bench.sim.control.inject("keeps_gravity")
    bench.device.use_gravity_compensation(True)
    eventually(is_noted, "it says that it was not done")
    assert not carries()
    bench.sim.control.clear()
    bench.device.use_gravity_compensation(True)
    eventually(lambda: carries() and not is_noted(), "it is on again")


def test_diagnostics_say_what_it_is(bench: HapticBench) -> None:
    health = bench.device.health()
    assert "name sigma.7, serial 2026, hand right, SDK 3.16.0.1" in [n.text for n in health.notes]
    assert health.device["cycles"] > 0
    bench.sim.control.inject("saturated")
    eventually(
        lambda: "at their limit" in [n.text for n in bench.device.health().notes], "it is told"
    )
    bench.sim.control.inject("time_guard")
    before = bench.device.health().samples
    eventually(lambda: bench.device.health().samples > before + 20, "the same data are no error")
    assert bench.device.is_enabled()


@pytest.mark.parametrize("key", ["max_force", "max_torque", "max_grip"])
def test_no_more_is_let_through_than_a_model_has(key: str) -> None:
    has = {"max_force": 20.0, "max_torque": 0.4, "max_grip": 8.0}[key]
    configured(model="sigma.7", **{key: has})
    with pytest.raises(ConfigError, match=f"{key}.*more than sigma.7 has"):
        configured(model="sigma.7", **{key: 1.01 * has})


@pytest.mark.slow
def test_a_left_handed_gripper_has_the_same_signs() -> None:
    with haptic_sim(model="omega.7", left=True) as sim, haptic_bench(sim) as bench:
        bench.device.enable(LONG)
        assert bench.device.gripper.measured_js().position[0] == pytest.approx(0.3, abs=1e-6)
        eventually(bench.device.gripper.is_enabled, "it follows")
        until_streamed(
            bench,
            lambda: bench.device.gripper.servo_jf([0.5]),
            lambda: bench.status("gripper_force") > 0.0,
            "a positive force opens it",
        )
        eventually(lambda: bench.device.gripper.measured_js().position[0] > 0.4, "it opens")
    assert not sim.running


@pytest.mark.slow
def test_it_homes_when_it_is_told_to_and_not_before() -> None:
    with (
        haptic_sim(model="omega.3", initialized=False, home_time=0.5) as sim,
        haptic_bench(sim, model="omega.3") as bench,
    ):
        device = bench.device
        assert not device.operating_state().is_homed
        device.enable(LONG)
        assert not bench.status("homing")
        assert not bench.status("initialized")
        device.fixtures(
            json.dumps({"pull": {"kind": "spring", "point": [0.1, 0, 0], "stiffness": 99}})
        )
        counted = sum(device.health().refusals.values())
        device.servo_cf([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        eventually(lambda: sum(device.health().refusals.values()) > counted, "refused")
        assert is_forceless(bench)
        sim.control.inject("home_fails")
        with pytest.raises(TransitionFailed):
            device.home(LONG)
        eventually(lambda: not bench.status("regulated"), "nothing moves it on")
        sim.control.clear("home_fails")
        eventually(
            lambda: device.operating_state().state is OperatingState.FAULT, "that is a fault"
        )
        device.enable(LONG)
        device.home(LONG)
        assert device.operating_state().is_homed
        eventually(lambda: math.hypot(*bench.force()) > 0.5, "now fixtures count")
        device.unhome(LONG)
        eventually(lambda: is_forceless(bench), "and now not any more")
        assert not device.operating_state().is_homed


@pytest.mark.slow
def test_hold_ends_homing() -> None:
    with (
        haptic_sim(model="omega.3", initialized=False, home_time=60.0) as sim,
        haptic_bench(sim, model="omega.3") as bench,
    ):
        device = bench.device
        device.enable(LONG)
        device.home(timeout=0.0)
        eventually(lambda: bench.status("homing"), "it moves")
        device.hold()
        eventually(lambda: not bench.status("homing"), "it stands")
        assert not device.operating_state().is_homed
