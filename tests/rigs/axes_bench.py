"""Simulated axes of a controller or of drives in a process of their own, and their driver in this one."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from crtk_drivers.config import DeviceConfig, from_values, load
from crtk_drivers.errors import CommandRefused, CrtkError, Reason
from crtk_drivers.front import LocalDevice
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.session import Session
from crtk_sim_backends.kit import RunningSim, Simulator
from rigs.beside import beside
from rigs.waiting import LONG, eventually

STEP = 0.004
"""Seconds from one setpoint to the next."""


def streamed(arm: LocalDevice, goal: np.ndarray) -> np.ndarray:
    """Send a setpoint (n,) of a stream; return from where it goes on: its stream may have ended meanwhile."""
    try:
        arm.servo_jp(goal)
    except CommandRefused as refusal:
        if refusal.reason is not Reason.STEP_TOO_LARGE:
            raise
        return np.array(arm.setpoint_js(age=0).position)
    return goal


class AxesBench(NamedTuple):
    """One driver and its simulator.

    Attributes:
        plugin, simulator: of them.
        typical: values of the configuration, `joints` among them.
    """

    plugin: DevicePlugin
    simulator: Simulator[Any, Any]
    typical: Mapping[str, Any]

    @contextmanager
    def spawned(self, **options: Any) -> Iterator[RunningSim]:
        """A simulator."""
        with self.simulator.spawn(**options) as sim:
            yield sim

    def configuration(self, sim: RunningSim, **values: Any) -> Any:
        """Return the driver's configuration for a running simulator."""
        far = {"following_error": 1.0}  # axes, or a stream to them, may get no time for a while
        patient = {"sample_timeout": 1.0, "open_timeout": 10.0, "limits": far, **self.typical}
        config = load(self.plugin.config, from_values({**patient, **values}))
        pointed = self.plugin.sim_config(config, sim)
        assert isinstance(pointed, DeviceConfig)
        return pointed

    def joints(self, **keys: Any) -> dict[str, Any]:
        """The typical joints, each with changes."""
        return {name: {**joint, **keys} for name, joint in self.typical["joints"].items()}

    @contextmanager
    def arm_at(self, sim: RunningSim, **values: Any) -> Iterator[LocalDevice]:
        """The driver at a simulator, connected."""
        arm = LocalDevice(Session(self.plugin, self.configuration(sim, **values)))
        try:
            arm._session.start()
            eventually(lambda: arm.engine.connected and arm.engine.has_sample, "it is connected")
            yield arm
        finally:
            arm.close()

    def refused(self, sim: RunningSim, words: str, **values: Any) -> None:
        """The driver says so, and does not get connected."""
        arm = LocalDevice(Session(self.plugin, self.configuration(sim, **values)))
        try:
            arm._session.start()
            eventually(lambda: words in arm.operating_state().detail, words)
            assert not arm.engine.connected
        finally:
            arm.close()

    @contextmanager
    def moving(
        self, sim: RunningSim, velocity: float = 0.5, **values: Any
    ) -> Iterator[LocalDevice]:
        """An arm whose first joint follows a stream, which goes on until the end."""
        with self.arm_at(sim, **values) as arm:
            arm.enable(LONG)

            def stream(over: threading.Event) -> None:
                goal = arm.setpoint_js().position.copy()
                while not over.wait(STEP):
                    goal[0] += velocity * STEP
                    try:
                        goal = streamed(arm, goal)
                    except CrtkError:
                        return

            with beside(stream):
                eventually(
                    lambda: abs(arm.measured_js(age=0).velocity[0]) > 0.2 * abs(velocity),
                    "it moves",
                )
                yield arm


def fault(arm: LocalDevice, words: str) -> None:
    """It comes to FAULT, and says so."""
    eventually(lambda: arm.operating_state().state == "FAULT", "it is in FAULT")
    detail = arm.operating_state().detail
    eventually(lambda: words in arm.operating_state().detail, f"{words!r}, but first {detail!r}")


def stands(sim: RunningSim) -> bool:
    """Whether no axis moves, twice in a row: between two looks the simulator may get no time to move one."""
    looks = [sim.control.status()["position"]]
    for _ in range(2):
        time.sleep(0.02)
        looks.append(sim.control.status()["position"])
    return bool(np.abs(np.diff(looks, axis=0)).max() < 2.0)
