"""A device without an operating state of its own behind a device: it follows that of the one in front."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from dataclasses import replace

import pytest

from crtk_drivers.device import Device, Steps
from crtk_drivers.engine import Observer
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.front import LocalDevice
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.samples import Pose, Stamp, vector
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState, Status
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
from crtk_drivers.wrappers.base_frame import PlacedDevice
from rigs.waiting import LONG, eventually

GOAL = vector((0.01, 0.0, 0.0, 0.0))


class WithJaw(LoopbackDevice):
    """A gantry that carries another one, as a dVRK arm its jaw."""

    def __init__(self, config: LoopbackConfig | None = None) -> None:
        super().__init__(config)
        self.jaw = LoopbackDevice(config)

    @property
    def children(self) -> Mapping[str, Device]:
        return {"jaw": self.jaw}

    @property
    def followers(self) -> frozenset[str]:
        return frozenset({"jaw"})


PLUGIN = DevicePlugin("with-jaw", "A gantry with another one.", LoopbackConfig, WithJaw)


class Told(Observer):
    def __init__(self) -> None:
        self.busy: list[bool] = []

    def status_changed(self, status: Status, stamp: Stamp) -> None:
        self.busy.append(status.is_busy)


@pytest.fixture
def arm() -> Iterator[LocalDevice]:
    session = Session(PLUGIN, LoopbackConfig())
    with LocalDevice(session) as arm:
        session.start()
        eventually(lambda: all(engine.has_sample for engine in session.engines), "connected")
        yield arm


def jaw_is(arm: LocalDevice, state: str) -> None:
    eventually(lambda: arm.jaw.engine.status.state == state, f"the jaw is {state}")


def enabled(arm: LocalDevice) -> LocalDevice:
    arm.enable(LONG)
    jaw_is(arm, "ENABLED")
    return arm


def test_it_offers_no_state_and_all_else(arm: LocalDevice) -> None:
    assert {"move_jp", "servo_jp", "measured_js"} <= arm.jaw.crtk_commands.keys()
    assert not {"operating_state", "state_command"} & arm.jaw.crtk_commands.keys()
    assert {"operating_state", "state_command"} <= arm.crtk_commands.keys()


@pytest.mark.parametrize("command", ["disable", "pause"])
def test_it_is_enabled_and_stopped_with_the_device(arm: LocalDevice, command: str) -> None:
    enabled(arm)
    arm.jaw.move_jp(GOAL).wait(LONG)
    arm.state_command(command, LONG)
    state = arm.operating_state().state
    jaw_is(arm, state)
    with pytest.raises(CommandRefused) as refused:
        arm.jaw.move_jp(0.0 * GOAL)
    assert refused.value.reason is Reason.NOT_ENABLED
    if command == "pause":
        arm.resume(LONG)
        jaw_is(arm, "ENABLED")


def test_the_device_is_busy_while_it_moves(arm: LocalDevice) -> None:
    enabled(arm)
    told = Told()
    arm.engine.add_observer(told)
    arm.jaw.move_jp(GOAL).wait(LONG)
    eventually(lambda: told.busy == [True, False], f"a pulse, only {told.busy}")
    arm.move_jp(GOAL).wait(LONG)
    eventually(lambda: told.busy == [True, False, True, False], f"another, only {told.busy}")


def test_a_fault_of_the_device_pauses_it(arm: LocalDevice) -> None:
    enabled(arm)
    arm.engine.device.reachable = False
    eventually(lambda: arm.operating_state().state == "FAULT", "lost")
    jaw_is(arm, "PAUSED")
    arm.engine.device.reachable = True
    eventually(lambda: arm.operating_state().state == "DISABLED", "back")
    jaw_is(arm, "DISABLED")
    enabled(arm)


def test_one_that_was_lost_is_enabled_by_the_next_enable_alone(arm: LocalDevice) -> None:
    enabled(arm)
    arm.jaw.engine.device.reachable = False
    jaw_is(arm, "FAULT")
    assert arm.is_enabled()
    arm.jaw.engine.device.reachable = True
    jaw_is(arm, "DISABLED")
    before = arm.health().samples
    eventually(lambda: arm.health().samples > before + 50, "a while: ten looks at it")
    assert arm.jaw.engine.status.state is OperatingState.DISABLED
    arm.disable(LONG)
    enabled(arm)


def test_one_that_is_connected_late_is_enabled_then() -> None:
    session = Session(PLUGIN, LoopbackConfig())
    with LocalDevice(session) as arm:
        arm.jaw.engine.device.reachable = False
        session.start()
        eventually(lambda: session.engine.has_sample, "connected")
        arm.enable(LONG)
        jaw_is(arm, "FAULT")
        arm.jaw.engine.device.reachable = True
        jaw_is(arm, "ENABLED")


def test_a_wrapped_device_keeps_them() -> None:
    base = Pose(vector((0, 0, 1)), vector((0, 0, 0, 1)), "world")
    assert PlacedDevice(WithJaw(), base).followers == {"jaw"}


class SlowJaw(LoopbackDevice):
    """It moves to be enabled, for as long as it is let."""

    def __init__(self, config: LoopbackConfig | None = None) -> None:
        super().__init__(config)
        self._capabilities = replace(self._capabilities, enable_moves=True, transition_timeout=60.0)
        self.moves, self.was_ended = threading.Event(), threading.Event()

    def enable(self) -> Steps:
        self.moves.set()
        try:
            while True:
                yield
        finally:
            self.was_ended.set()


@pytest.mark.parametrize("command", ["disable", "pause"])
def test_what_it_does_to_be_enabled_ends_with_the_device(command: str) -> None:
    def with_slow_jaw(config: LoopbackConfig) -> WithJaw:
        device = WithJaw(config)
        device.jaw = SlowJaw(config)
        return device

    plugin = DevicePlugin("with-jaw", "A gantry with another one.", LoopbackConfig, with_slow_jaw)
    session = Session(plugin, LoopbackConfig())
    with LocalDevice(session) as arm:
        session.start()
        eventually(lambda: all(engine.has_sample for engine in session.engines), "connected")
        arm.enable(LONG)
        jaw = arm.jaw.engine.device
        assert jaw.moves.wait(LONG)
        arm.state_command(command, LONG)
        assert jaw.was_ended.wait(LONG)
        jaw_is(arm, "DISABLED")
