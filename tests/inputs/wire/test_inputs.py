"""The driver at simulated pedals, joystick and mouse."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from crtk_driver_inputs import PLUGIN
from crtk_driver_inputs.config import InputsConfig
from crtk_drivers.config import from_values, load
from crtk_drivers.errors import ConfigError, ConnectionFailed, TransitionFailed
from crtk_drivers.front import LocalDevice
from crtk_drivers.samples import Joy
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState
from crtk_sim_backends.inputs import SIM, RunningSim
from rigs.waiting import LONG, eventually

PEDALS = {"clutch": 30, "coag": 48}


def configuration(sim: RunningSim, **values: Any) -> InputsConfig:
    patient = {"sample_timeout": 1.0, "pedals": PEDALS}
    pointed = PLUGIN.sim_config(load(InputsConfig, from_values({**patient, **values})), sim)
    assert isinstance(pointed, InputsConfig)
    return pointed


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with SIM.spawn() as running:
        yield running


@contextmanager
def device(config: InputsConfig) -> Iterator[Any]:
    session = Session(PLUGIN, config)
    front: Any = LocalDevice(session)
    session.start()
    try:
        eventually(lambda: session.engine.connected and session.engine.has_sample, "connected")
        yield front
    finally:
        front.close()


@pytest.fixture(params=["evdev", "js", "spacenavd"])
def inputs(sim: RunningSim, request: pytest.FixtureRequest) -> Iterator[Any]:
    with device(configuration(sim, link=request.param)) as front:
        yield front
    sim.control.clear()


def holds(told: Callable[[], Joy], pressed: int) -> None:
    eventually(lambda: told().buttons == (pressed,), f"{pressed}")


def test_a_pedal_is_told_by_its_name_and_all_of_them_together(inputs: Any, sim: RunningSim) -> None:
    holds(inputs.clutch, 0)
    sim.control.inject("press", code=30)
    holds(inputs.clutch, 1)
    assert inputs.coag() == Joy(buttons=(0,))
    assert inputs.joy().buttons == (1, 0)
    sim.control.clear("press")
    holds(inputs.clutch, 0)


def test_what_is_unplugged_is_released(inputs: Any, sim: RunningSim) -> None:
    sim.control.inject("press", code=30)
    holds(inputs.clutch, 1)
    inputs.enable()
    sim.control.inject("disconnect")
    eventually(lambda: inputs.clutch() == Joy(buttons=(0,), is_valid=False), "not known")
    assert not inputs.joy().is_valid
    eventually(lambda: inputs.operating_state().state is OperatingState.FAULT, "FAULT")
    sim.control.clear()
    eventually(lambda: inputs.operating_state().state is OperatingState.DISABLED, "back")
    eventually(lambda: inputs.clutch().is_valid, "known again")


def test_a_mouse_is_a_velocity(sim: RunningSim) -> None:
    with device(configuration(sim, link="spacenavd", deadband=0.0)) as mouse:
        sim.control.inject("push", x=35, y=70, z=-350, rx=35, ry=-70, rz=175)
        expected = [0.1, -0.01, 0.02, -0.25, -0.05, -0.1]
        eventually(lambda: np.allclose(mouse.measured_cv().vector, expected), "it moves")
        sim.control.clear("push")
        eventually(lambda: not mouse.measured_cv().vector.any(), "it is let go")


def test_a_mouse_that_falls_silent_while_it_is_pushed_is_let_go(sim: RunningSim) -> None:
    with device(configuration(sim, link="spacenavd", silence=0.1)) as mouse:
        sim.control.inject("push", z=-350)
        eventually(lambda: mouse.measured_cv().linear[0] > 0.09, "it moves")
        sim.control.inject("stuck")
        eventually(lambda: not mouse.measured_cv().vector.any(), "it is let go")
    sim.control.clear()


def test_a_mouse_that_is_unplugged_from_the_daemon(sim: RunningSim) -> None:
    with device(configuration(sim, link="spacenavd")) as mouse:
        mouse.enable()
        sim.control.inject("push", z=-350)
        eventually(lambda: mouse.measured_cv().linear[0] > 0.09, "it moves")
        sim.control.inject("no_mouse")
        eventually(lambda: mouse.operating_state().state is OperatingState.FAULT, "FAULT")
        assert not mouse.measured_cv().vector.any()
        assert not mouse.joy().is_valid, "nor are its buttons known"
        with pytest.raises(TransitionFailed, match="no mouse"):
            mouse.enable()
    with device(configuration(sim, link="spacenavd")) as mouse:
        eventually(lambda: mouse.operating_state().state is OperatingState.FAULT, "asked for")
        sim.control.clear()
        eventually(lambda: mouse.health().device["mice"] == 1.0, "plugged in")
        mouse.enable()


def test_a_daemon_that_knows_no_protocol_but_the_first() -> None:
    with (
        SIM.spawn(protocol=0) as old,
        device(configuration(old, link="spacenavd")) as mouse,
    ):
        old.control.inject("push", z=-350)
        eventually(lambda: mouse.measured_cv().linear[0] > 0.09, "it moves")


def test_missing_events_release_what_cannot_be_asked_for(sim: RunningSim) -> None:
    with device(configuration(sim, link="evdev")) as pedals:
        sim.control.inject("press", code=48)
        holds(pedals.coag, 1)
        counted = pedals.health().device["dropped"]
        sim.control.inject("overrun")
        eventually(lambda: pedals.health().device["dropped"] > counted, "told")
    sim.control.clear()


def test_a_daemon_that_sends_no_events_is_left_and_asked_again(tmp_path: Path) -> None:
    path = tmp_path / "s"
    values = {"link": "spacenavd", "path": str(path)}
    session = Session(PLUGIN, load(InputsConfig, from_values(values)))
    front: Any = LocalDevice(session)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen(4)
        listener.settimeout(LONG)
        session.start()
        try:
            for _ in range(2):
                peer, _ = listener.accept()
                with peer:
                    peer.recv(64)
                    peer.sendall(b"\xef\xbe\xad\xde" * 8)
                    eventually(lambda: "no kind of event" in front.operating_state().detail, "told")
        finally:
            front.close()


def test_a_device_that_is_not_there(tmp_path: Path) -> None:
    import crtk_drivers

    with pytest.raises(ConnectionFailed, match="No such file"):
        crtk_drivers.connect("inputs", path=str(tmp_path / "none"), timeout=0.5)
    with pytest.raises(ConfigError, match="is missing"):
        crtk_drivers.connect("inputs")


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"pedals": {"state": 1}}, "no name for a topic"),
        ({"pedals": {"measured_js": 1}}, "no name for a topic"),
        ({"pedals": {"a/b": 1}}, "no name for a topic"),
        ({"pedals": {"clutch": 768}}, "is no code"),
        ({"pedals": {"clutch": "a"}}, "whole number"),
        ({"link": "spacenavd", "grab": True}, "grab: is of the link evdev"),
        ({"deadband": 1.0}, "less than 1"),
    ],
)
def test_settings_that_cannot_be(values: dict[str, Any], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        load(InputsConfig, from_values(values))
