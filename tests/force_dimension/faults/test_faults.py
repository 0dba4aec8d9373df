"""What goes wrong with a haptic device whose forces are on: they are zero, and the state says why.

The rows of the fault table that apply: F1 and F7 (unplugged), F2 (hangs), F3 (nothing there at start), F5
(numbers that are none), F9 (it forgot where it is), F12 and F14 (its forces are switched off), F16 (a process
is killed or stands), F20 (another program has it). It has no bytes of ours to damage, and no joints.
"""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Iterator
from typing import Any

import pytest

from crtk_driver_force_dimension import PLUGIN
from crtk_driver_force_dimension.traits import traits_of
from crtk_drivers.errors import ConnectionFailed, ConnectionLost, TransitionFailed
from crtk_drivers.kit.haptics.haptic_device import HapticDevice
from crtk_drivers.samples import Text
from crtk_drivers.session import Session
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

PULL = json.dumps({"pull": {"kind": "spring", "point": [0.02, 0, 0], "stiffness": 100}})


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with haptic_sim() as running:
        yield running


@pytest.fixture
def bench(sim: RunningSim) -> Iterator[HapticBench]:
    """A device that pulls at a hand which holds it."""
    sim.control.inject("hold")
    with haptic_bench(sim) as bench:
        bench.device.fixtures(PULL)
        enable(bench)
        eventually(lambda: bench.force()[0] > 1.5, "it pulls")
        yield bench


def enable(bench: HapticBench) -> None:
    """Enable, again where a process that was held up has let the device's watchdog expire."""

    def is_enabled() -> bool:
        try:
            bench.device.enable(LONG)
        except TransitionFailed:
            return False
        return True

    eventually(is_enabled, "it is enabled")


def is_in(bench: HapticBench, state: OperatingState) -> bool:
    return bench.device.operating_state().state is state


def child_of(bench: HapticBench) -> int:
    return int(bench.status("opened_by"))


def until_back(bench: HapticBench) -> None:
    """It comes back DISABLED and forceless, its fixtures count once it is enabled, and not before."""
    engine = bench.session.engine
    eventually(lambda: engine.connected and engine.has_sample, "it is there again")
    eventually(lambda: is_in(bench, OperatingState.DISABLED), "DISABLED")
    assert not bench.status("forces_on")
    enable(bench)
    eventually(lambda: bench.force()[0] > 1.5, "it pulls again")


def test_unplugged(bench: HapticBench) -> None:
    bench.sim.control.inject("unplugged")
    bench.told.detail(OperatingState.FAULT, "communication error")
    eventually(lambda: not bench.status("forces_on"), "its watchdog has ended its forces")
    assert bench.status("force_off_cause") == 3
    bench.sim.control.clear("unplugged")
    until_back(bench)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["hang", "crash", "killed"])
def test_the_process_of_the_library_hangs_or_ends(bench: HapticBench, kind: str) -> None:
    if kind == "killed":
        os.kill(child_of(bench), signal.SIGKILL)
    else:
        bench.sim.control.inject(kind)
    eventually(lambda: not bench.status("forces_on"), "its watchdog has ended its forces")
    assert bench.status("force_off_cause") == 3
    words = {"hang": "sample", "crash": "signal 6", "killed": "signal 9"}
    bench.told.detail(OperatingState.FAULT, words[kind])
    bench.sim.control.clear()
    bench.sim.control.inject("hold")
    until_back(bench)


@pytest.mark.slow
def test_its_process_stands_for_a_moment(bench: HapticBench) -> None:
    child = child_of(bench)
    os.kill(child, signal.SIGSTOP)
    eventually(lambda: not bench.status("forces_on"), "its watchdog has ended its forces")
    os.kill(child, signal.SIGCONT)
    eventually(
        lambda: is_in(bench, OperatingState.FAULT) or bench.status("forces_on"),
        "they rise again, or nobody heard it for too long",
    )


@pytest.mark.slow
def test_numbers_that_are_none(bench: HapticBench) -> None:
    bench.sim.control.inject("broken")
    eventually(lambda: not any(bench.force()), "no force from no position")
    detail = bench.told.detail(OperatingState.FAULT)
    assert "not finite" in detail or "nan" in detail
    bench.sim.control.clear("broken")


@pytest.mark.sweep(2)
@pytest.mark.parametrize(
    ("cause", "state", "words"),
    [(1, OperatingState.PAUSED, "force button"), (2, OperatingState.FAULT, "too fast")],
)
def test_its_forces_are_switched_off(
    bench: HapticBench, cause: int, state: OperatingState, words: str
) -> None:
    bench.sim.control.inject("forces_off", cause=cause)
    bench.told.detail(state, words)
    assert not bench.status("forces_on")
    eventually(lambda: not any(bench.status("sent")), "no force waits for who presses it again")
    if state is OperatingState.PAUSED:
        bench.device.resume(LONG)
    else:
        bench.device.enable(LONG)
    eventually(lambda: bench.force()[0] > 1.5, "it pulls again")


@pytest.mark.slow
def test_it_forgets_where_it_is(bench: HapticBench) -> None:
    bench.sim.control.inject("uncalibrated")
    eventually(lambda: not any(bench.force()), "no force from a position that is none")
    eventually(lambda: not bench.device.operating_state().is_homed, "is_homed says so")
    bench.device.home(LONG)
    eventually(lambda: bench.force()[0] > 1.0, "it pulls again")


@pytest.mark.slow
def test_another_program_has_it(bench: HapticBench) -> None:
    second = HapticDevice(traits_of(PLUGIN.sim_config(configured(), bench.sim)))
    with pytest.raises(ConnectionFailed, match="already in use"):
        second.open(_far())
    second.close()
    assert bench.device.is_enabled()


def _far() -> float:
    return time.monotonic() + LONG


@pytest.mark.sweep(3)
@pytest.mark.parametrize(
    ("fault", "values", "words"),
    [
        ("no_device", {}, "there are 0 devices"),
        ("open_fails", {}, "drdOpenID: the device is not ready"),
        ("", {"model": "omega.3"}, "another device than omega.3: omega.7"),
        ("", {"serial": 7}, "its serial number is 2026, not 7"),
        ("", {"index": 3}, "there are 1 devices, and it would be number 3"),
    ],
)
def test_what_it_says_when_it_is_not_there(
    sim: RunningSim, fault: str, values: dict[str, Any], words: str
) -> None:
    sim.control.clear()
    if fault:
        sim.control.inject(fault)
    device = HapticDevice(traits_of(PLUGIN.sim_config(configured(**values), sim)))
    try:
        with pytest.raises(ConnectionFailed, match=words) as caught:
            device.open(_far())
        assert caught.value.remedy
        assert caught.value.where
    finally:
        device.close()
        sim.control.clear()


@pytest.mark.parametrize(
    ("library", "words"),
    [("/nowhere/libdrd.so", "cannot be loaded"), ("libc.so.6", "has no dhdGetSDKVersion")],
)
def test_without_the_library_it_says_where_to_get_it(library: str, words: str) -> None:
    device = HapticDevice(traits_of(configured(library=library)))
    with pytest.raises(ConnectionFailed, match=words) as caught:
        device.open(_far())
    assert "Force Dimension SDK" in caught.value.remedy
    device.close()


@pytest.mark.slow
def test_another_version_of_the_library_is_refused() -> None:
    with haptic_sim(version=4) as sim:
        device = HapticDevice(traits_of(PLUGIN.sim_config(configured(), sim)))
        with pytest.raises(ConnectionFailed, match=r"SDK 4\.16\.0\.1, and this driver knows 3"):
            device.open(_far())
        device.close()


def test_the_driver_falls_silent_or_ends(sim: RunningSim) -> None:
    """The I/O thread stands: nobody calls read. Then the driver's end of the socket closes."""
    sim.control.inject("hold")
    config = PLUGIN.sim_config(configured(driver_timeout=0.3), sim)
    session = Session(PLUGIN, config)
    device = session.engine.device
    assert isinstance(device, HapticDevice)

    def bring(steps: Any) -> None:
        for _ in steps:
            device.read(_far())

    def status(name: str) -> Any:
        return sim.control.status()[name]

    device.open(_far())
    device.inputs["fixtures"].take(Text(PULL))
    bring(device.enable())

    def pulls() -> bool:
        device.read(_far())
        return bool(status("force")[0] > 1.5)

    eventually(pulls, "it pulls")
    eventually(lambda: not any(status("force")), "forces are zero while nobody is heard")
    eventually(lambda: status("forces_on"), "its process goes on, and feeds the watchdog")
    eventually(pulls, "it is heard again")
    bring(device.disable())
    given_up = device.enable()
    next(given_up)
    given_up.close()
    for _ in range(30):
        device.read(_far())
    assert not any(status("force")), "an enable that was given up enables nothing"
    device.close()
    with pytest.raises(ConnectionLost):
        device.read(_far())
    eventually(lambda: not status("forces_on"), "it is closed")
    assert status("opened_by") == 0
    sim.control.clear()
    session.close()


def test_a_stop_of_the_gripper_is_believed_when_its_process_has_taken_it(sim: RunningSim) -> None:
    device = HapticDevice(traits_of(PLUGIN.sim_config(configured(), sim)))
    gripper = device.children["gripper"]
    device.open(_far())
    try:
        gripper.open(_far())
        os.kill(device._child.pid, signal.SIGSTOP)
        gripper.stop()
        assert not gripper.has_stopped
        os.kill(device._child.pid, signal.SIGCONT)
        eventually(lambda: device.read(_far()) and gripper.has_stopped, "it is told")
    finally:
        gripper.close()
        device.close()
    assert gripper.has_stopped, "its forces have ended with its process"


@pytest.mark.slow
def test_homing_is_ended_where_nobody_could_stop_it() -> None:
    """The I/O thread stands while it moves; what was measured before is not told as measured now."""
    with haptic_sim(initialized=False, home_time=60.0) as sim:
        device = HapticDevice(traits_of(PLUGIN.sim_config(configured(driver_timeout=0.3), sim)))
        device.open(_far())
        steps = device.home()
        try:
            next(steps)

            def homes() -> bool:
                device.read(_far())
                return bool(sim.control.status()["homing"])

            eventually(homes, "it moves")

            def told() -> bool:
                device.read(_far())
                found = device.gripper_sample
                return found is not None and not found.values

            eventually(told, "no angle is told that was measured before")
            assert not device._button(0).is_valid
            eventually(lambda: not sim.control.status()["homing"], "it stands")
            assert not sim.control.status()["regulated"]
        finally:
            steps.close()
            device.close()
