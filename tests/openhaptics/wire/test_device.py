"""OpenHaptics' driver at a library that stands for the vendor's: forces, axes, calibration, faults."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from crtk_driver_openhaptics import PLUGIN
from crtk_driver_openhaptics.config import OpenHapticsConfig
from crtk_driver_openhaptics.shim import Mailbox, Shim
from crtk_drivers.config import from_values, load
from crtk_drivers.errors import CommandRefused, ConnectionFailed, TransitionFailed
from crtk_drivers.kit.haptics.child_messages import Flags
from crtk_drivers.kit.haptics.haptic_device import HapticDevice
from crtk_drivers.state import OperatingState
from crtk_sim_backends.openhaptics import SIM, RunningSim
from rigs.haptic_bench import PATIENT, HapticBench, bench_of, needs_compiler
from rigs.waiting import LONG, eventually

pytestmark = needs_compiler

PULL = json.dumps({"pull": {"kind": "spring", "point": [0.02, 0, 0], "stiffness": 100}})


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with SIM.spawn() as running:
        yield running


def configured(sim: RunningSim | None = None, **values: Any) -> OpenHapticsConfig:
    config = load(OpenHapticsConfig, from_values({**PATIENT, "force_timeout": 0.1, **values}))
    return config if sim is None else PLUGIN.sim_config(config, sim)


@pytest.fixture
def bench(sim: RunningSim) -> Iterator[HapticBench]:
    """A device that pulls at a hand which holds it."""
    sim.control.clear()
    sim.control.inject("initialized")
    sim.control.inject("hold")
    with bench_of(PLUGIN, configured(sim), sim) as bench:
        bench.device.fixtures(PULL)
        bench.device.enable(LONG)
        eventually(lambda: bench.force()[0] > 1.5, "it pulls")
        yield bench


def test_forces_and_positions_are_in_our_axes(bench: HapticBench) -> None:
    device = bench.device
    eventually(lambda: np.allclose(bench.force(), [2.0, 0.0, 0.0], atol=0.1), "it pulls ahead")
    eventually(
        lambda: np.allclose(device.measured_cf().force, bench.force(), atol=0.1), "it tells them"
    )
    bench.sim.control.inject("hold", x=0.01, y=-0.02, z=0.03)

    def moved() -> bool:
        position = device.measured_cp().position
        return bool(np.allclose(position, bench.status("position"), atol=1e-3))

    eventually(lambda: bench.status("position")[2] > 0.028 and moved(), "it tells where it is")
    bench.sim.control.inject("press", button=1)
    eventually(lambda: device.back().buttons == (1,), "its second button")
    assert device.front().buttons == (0,)
    with pytest.raises(CommandRefused, match="torque"):
        device.servo_cf([0.0, 0.0, 0.0, 0.0, 0.0, 0.1])
    device.disable(LONG)
    assert not bench.status("forces_on")


@pytest.mark.slow
def test_it_is_calibrated_by_hand(bench: HapticBench) -> None:
    device = bench.device
    bench.sim.control.inject("uncalibrated")
    eventually(lambda: not any(bench.force()), "no force from a position that is none")
    eventually(lambda: not device.operating_state().is_homed, "it says so")
    with pytest.raises(TransitionFailed, match="by hand"):
        device.home(LONG)
    bench.sim.control.inject("initialized")
    eventually(lambda: device.operating_state().is_homed, "a person has done that")
    seen = device.health().samples
    eventually(lambda: device.health().samples > seen + 20, "a while")
    assert device.operating_state().state is OperatingState.FAULT
    assert not any(bench.force()), "in FAULT it makes none"
    device.enable(LONG)
    eventually(lambda: bench.force()[0] > 1.5, "it pulls again")


@pytest.mark.slow
def test_hold_ends_a_calibration_and_no_process(bench: HapticBench) -> None:
    device = bench.device
    before = bench.status("opened_by")
    bench.sim.control.inject("home_fails")
    bench.sim.control.inject("uncalibrated")
    eventually(lambda: not device.operating_state().is_homed, "it says so")
    device.home(timeout=0.0)
    inner = bench.session.engine.device
    assert isinstance(inner, HapticDevice)
    eventually(lambda: Flags.HOMING in inner._state.flags, "the library looks")
    device.hold()
    eventually(lambda: Flags.HOMING not in inner._state.flags, "no longer")
    bench.sim.control.inject("initialized")
    eventually(lambda: device.operating_state().is_homed, "it is calibrated")
    assert device.is_enabled()
    assert bench.status("opened_by") == before


def test_a_force_error_switches_forces_off(bench: HapticBench) -> None:
    bench.sim.control.inject("saturated")
    bench.told.detail(OperatingState.FAULT, "Force error (0x0204)")
    eventually(lambda: not bench.status("forces_on"), "they are off")
    bench.sim.control.clear("saturated")
    bench.device.enable(LONG)
    eventually(lambda: bench.force()[0] > 1.5, "it pulls again")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("unplugged", "Communication error"),
        ("hang", ""),
        ("crash", "signal 6"),
        ("killed", "signal 9"),
    ],
)
def test_it_is_lost_and_comes_back(bench: HapticBench, kind: str, words: str) -> None:
    if kind == "killed":
        os.kill(bench.status("opened_by"), signal.SIGKILL)
    else:
        bench.sim.control.inject(kind)
    bench.told.detail(OperatingState.FAULT, words)
    eventually(lambda: not bench.status("forces_on"), "forces are off")
    bench.sim.control.clear()
    bench.sim.control.inject("hold")
    bench.told.detail(OperatingState.DISABLED)
    bench.device.enable(LONG)
    eventually(lambda: bench.force()[0] > 1.5, "it pulls again")


def test_the_callback_makes_no_force_that_is_not_sent_again(sim: RunningSim) -> None:
    """The library's thread goes on while nobody puts anything into the mailbox."""
    sim.control.clear()
    shim, box = Shim(sim.paths["library"]), Mailbox()
    assert shim.call("open", b"", 1.5) == 0
    try:
        shim.call("enable", 1)
        shim.call("push", 0.0, 1.0, 0.0)
        eventually(lambda: sim.control.status()["force"] == [0.0, 0.0, 1.0], "it pushes up")
        eventually(lambda: not any(sim.control.status()["force"]), "no longer than 1.5 s")
        shim.read(box)
        before = box.frames

        def goes_on() -> bool:
            shim.read(box)
            return box.frames > before

        eventually(goes_on, "the callback goes on")
        eventually(lambda: sim.control.status()["forces_on"], "and its output stays on")
    finally:
        shim.call("close")
    assert not sim.control.status()["forces_on"]


@pytest.mark.sweep(3)
@pytest.mark.parametrize(
    ("values", "fault", "words"),
    [
        ({"library": "/nowhere/libHD.so"}, "", "cannot be used: load: /nowhere"),
        ({"library": "libc.so.6"}, "", "it lacks: hdInitDevice"),
        ({}, "no_device", "hdInitDevice: Communication error"),
        ({}, "open_fails", "hdInitDevice: Device fault"),
    ],
)
def test_what_it_says_when_it_is_not_there(
    sim: RunningSim, values: dict[str, str], fault: str, words: str
) -> None:
    sim.control.clear()
    if fault:
        sim.control.inject(fault)
    device = PLUGIN.create(configured(None if values else sim, **values))
    try:
        with pytest.raises(ConnectionFailed, match=words) as caught:
            device.open(time.monotonic() + LONG)
        assert "OpenHaptics" in caught.value.remedy
    finally:
        device.close()
        sim.control.clear()


@pytest.mark.slow
def test_without_a_compiler_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setenv("CC", "no-such-compiler")
    device = PLUGIN.create(configured())
    with pytest.raises(ConnectionFailed, match="there is no C compiler"):
        device.open(time.monotonic() + LONG)
    device.close()
