"""The twenty bad inputs on the devices that need no hardware and no simulator: see `bad_inputs`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from bad_inputs import BAD_INPUTS, Bench, NotApplicable

from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState
from crtk_drivers.testing import loopback
from crtk_drivers.testing.loopback import LoopbackConfig


def a_loopback() -> Session:
    config = LoopbackConfig(limits={"max_command_age": 1.0}, base={"position": (0.1, 0.2, 0.3)})
    return Session(loopback.PLUGIN, config)


def a_loopback_that_homes() -> Session:
    config = LoopbackConfig(needs_homing=True, transition_time=0.3)
    return Session(loopback.PLUGIN, config)


def a_virtual_arm() -> Session:
    pytest.importorskip("pinocchio")
    from crtk_driver_virtual import PLUGIN
    from crtk_driver_virtual.config import VirtualConfig

    return Session(PLUGIN, VirtualConfig(transition_time=0.0, limits={"max_command_age": 1.0}))


def a_haptic_arm() -> Session:
    pytest.importorskip("pinocchio")
    from crtk_driver_virtual import PLUGIN
    from crtk_driver_virtual.config import VirtualConfig

    return Session(PLUGIN, VirtualConfig(model="haptic", transition_time=0.0))


DEVICES: tuple[Callable[[], Session], ...] = (
    a_loopback,
    a_loopback_that_homes,
    a_virtual_arm,
    a_haptic_arm,
)
NOT_THERE = {
    "a_loopback": {"I18"},
    "a_loopback_that_homes": {"I11", "I18"},
    "a_virtual_arm": {"I18"},
    "a_haptic_arm": {"I11", "I18"},
}
"""What says that it does not apply; nothing else may."""


@pytest.fixture(scope="module", params=DEVICES, ids=lambda make: make.__name__)
def running(request: pytest.FixtureRequest) -> Iterator[tuple[str, Session, LocalDevice]]:
    session = request.param()
    with LocalDevice(session) as arm:
        session.start()
        arm.measured_js(wait=10.0)
        arm.enable()
        if session.engine.capabilities.needs_homing:
            arm.home()
        yield request.param.__name__, session, arm


@pytest.mark.parametrize("number", BAD_INPUTS)
def test_bad_input(running: tuple[str, Session, LocalDevice], number: str, tmp_path: Path) -> None:
    name, session, arm = running
    bench = Bench(session, arm, tmp_path)
    if number in NOT_THERE[name]:
        with pytest.raises(NotApplicable) as reason:
            BAD_INPUTS[number](bench)
        pytest.skip(str(reason.value))
    assert BAD_INPUTS[number](bench) > 0
    assert arm.operating_state().state is OperatingState.ENABLED
    assert not arm.is_busy()
