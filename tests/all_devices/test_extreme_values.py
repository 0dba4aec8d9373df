"""Whatever numbers a command holds: it is refused, or accepted and what is sent is finite. Nothing else."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from crtk_drivers.commands import Direction, Payload
from crtk_drivers.device import Device, Goal, Setpoint
from crtk_drivers.engine import Engine
from crtk_drivers.errors import CommandRefused
from crtk_drivers.samples import Pose
from crtk_drivers.session import engine_options
from crtk_drivers.state import OperatingState
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
from rigs.examples import examples
from rigs.extreme_values import IN_REAL_TIME, values_of
from rigs.waiting import LONG

PATIENT: dict[str, Any] = {"sample_timeout": 10.0, "limits": {"following_error": 10.0}}
"""No cycle comes while a test computes, and this machine does other things too."""


class Hand:
    """Turns an engine by hand, and keeps all that reaches its device."""

    def __init__(self, device: Device, engine: Engine) -> None:
        self.device, self.engine = device, engine
        self.sent: list[np.ndarray] = []
        write, move = device.write, device.move

        def written(setpoint: Setpoint) -> None:
            self.sent.append(setpoint.values)
            write(setpoint)

        def moved(goal: Goal) -> None:
            if goal.pose is not None:
                self.sent.append(np.concatenate((goal.pose.position, goal.pose.orientation)))
            self.sent.append(goal.joints)
            move(goal)

        device.write, device.move = written, moved  # type: ignore[method-assign]
        engine.connect(time.monotonic() + LONG)
        self.cycle()
        self.enable()

    def cycle(self, count: int = 1) -> None:
        for _ in range(count):
            time.sleep(0.0005)
            self.engine.cycle(time.monotonic() + 1.0)

    def enable(self) -> None:
        self.engine.state_command("enable")
        deadline = time.monotonic() + LONG
        while self.engine.status.state is not OperatingState.ENABLED:
            assert time.monotonic() < deadline, self.engine.status
            self.cycle()

    def pose(self) -> Pose:
        found = self.engine.feedback("setpoint_cp")
        assert found is not None
        assert isinstance(found[0], Pose)
        return found[0]

    def rest(self) -> None:
        self.engine.submit("hold")
        self.cycle(2)
        self.sent.clear()


def loopback() -> Hand:
    config = LoopbackConfig(base={"position": (0.1, 0.2, 0.3), "rpy": (0.0, 0.0, 1.0)}, **PATIENT)
    device = LoopbackDevice(config)
    return Hand(device, Engine(device, "loopback", engine_options(config)))


def virtual() -> Hand:
    pytest.importorskip("pinocchio")
    from crtk_driver_virtual import PLUGIN
    from crtk_driver_virtual.config import VirtualConfig

    config = VirtualConfig(transition_time=0.0, base={"position": (0.1, 0.2, 0.3)}, **PATIENT)
    device = PLUGIN.make(config)
    return Hand(device, Engine(device, "virtual", engine_options(config)))


@pytest.fixture(scope="module", params=[loopback, virtual], ids=["loopback", "virtual"])
def hand(request: pytest.FixtureRequest) -> Iterator[Hand]:
    hand = request.param()
    yield hand
    hand.engine.shut_down()


@pytest.mark.sweep(2)
@pytest.mark.timeout(240)
@settings(
    max_examples=examples(150),
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    **IN_REAL_TIME,
)
@given(data=st.data())
def test_only_finite_numbers_reach_the_device(hand: Hand, data: st.DataObject) -> None:
    engine, device = hand.engine, hand.device
    commands = [
        command
        for command in engine.commands.values()
        if command.direction is Direction.COMMANDED
        and command.payload not in (Payload.TEXT, Payload.EMPTY)
    ]
    command = data.draw(st.sampled_from(commands), "command")
    capabilities = device.capabilities
    frames = (capabilities.base_frame, capabilities.tool_frame, "local")
    hand.rest()
    for _ in range(data.draw(st.integers(1, 3), "times")):
        value = data.draw(values_of(command, capabilities.joints, hand.pose(), frames))
        before = engine.status
        try:
            engine.submit(command.name, value)
        except CommandRefused:
            assert engine.status == before
        if data.draw(st.booleans(), "a cycle in between"):
            hand.cycle()
    hand.cycle(4)
    assert all(np.isfinite(values).all() for values in hand.sent)
    assert engine.status.state is OperatingState.ENABLED, engine.status
    for name in ("setpoint_js", "goal_js", "goal_cp"):
        found = engine.feedback(name) if name == "setpoint_js" else engine.latched(name)
        if found is not None:
            for part in ("position", "velocity", "orientation"):
                assert np.isfinite(getattr(found[0], part, 0.0)).all(), name
