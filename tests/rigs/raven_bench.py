"""A simulated Raven in its own process, and its driver in this one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from crtk_driver_raven import PLUGIN
from crtk_driver_raven.config import RavenConfig
from crtk_drivers.config import from_values, load
from crtk_drivers.front import LocalDevice
from crtk_drivers.samples import Pose, vector
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState
from crtk_sim_backends.raven import SIM, RunningSim
from rigs.told_states import ToldStates
from rigs.waiting import eventually

STAYS = vector((0.0, 0.0, 0.0, 1.0))
UM = 1e6
PACKET = 80
"""µm that one packet leads an arm by at most, if it is not late."""
SPEED = {"rate": 250, "tool": {"linear_velocity": 0.02}}


def configuration(sim: RunningSim, **values: Any) -> RavenConfig:
    """Return the driver's configuration for a running simulator; a busy machine is no fault."""
    patient = {"sample_timeout": 2.0, "stream_timeout": 1.0, **SPEED}
    pointed = PLUGIN.sim_config(load(RavenConfig, from_values({**patient, **values})), sim)
    assert isinstance(pointed, RavenConfig)
    return pointed


class RavenBench:
    """A driver and the simulator that hears it."""

    def __init__(self, sim: RunningSim, **values: Any) -> None:
        self.sim: Any = sim
        self.session = Session(PLUGIN, configuration(sim, **values))
        self.front: Any = LocalDevice(self.session)
        self._told = ToldStates(self.session.engine)

    def connected(self) -> None:
        """Wait until packets go out, and both arms are there."""
        engines = self.session.engines
        eventually(lambda: all(each.connected and each.has_sample for each in engines), "connected")

    def enabled(self) -> None:
        """Enable, and wait for the arms to follow, and for Raven's pedal."""
        self.front.enable()
        for arm in self.session.children.values():
            eventually(lambda arm=arm: arm.status.state is OperatingState.ENABLED, "enabled")
        self.until(lambda status: status["run_level"] == 3, "the pedal is down")

    def disabled(self) -> None:
        """Disable, and wait for the arms to follow."""
        self.front.disable()
        for arm in self.session.children.values():
            eventually(lambda arm=arm: arm.status.state is OperatingState.DISABLED, "disabled")

    def state(self, state: OperatingState, detail: str = "") -> None:
        """Wait for a state."""
        self._told.detail(state, detail)

    def until(self, test: Any, what: str) -> dict[str, Any]:
        """Wait until the simulator's status passes a test, and return it."""

        def passing() -> dict[str, Any] | None:
            status = self.sim.control.status()
            return status if test(status) else None

        found = eventually(passing, what)
        assert isinstance(found, dict)
        return found

    def lead(self, arm: str, way: tuple[float, float, float], steps: int = 1) -> None:
        """Lead an arm by so many steps of a way in m, each when the one before has gone out."""
        for _ in range(steps):
            goal = self.led(arm) + UM * np.array(way)
            getattr(self.front, arm).servo_cr(Pose(vector(way), STAYS))
            eventually(lambda goal=goal: np.abs(self.led(arm) - goal).max() < 2.0, f"led to {goal}")

    def at_rest(self, arm: str) -> np.ndarray:
        """Wait until packets lead an arm nowhere any more; return where they have led it, in µm."""

        def stands() -> bool:
            before = self.led(arm).tolist()
            self.used(3)
            return bool(self.led(arm).tolist() == before)

        eventually(stands, "at rest")
        return self.led(arm)

    def led(self, arm: str) -> np.ndarray:
        """Return where the driver has led an arm, in µm along the axes of packets."""
        device: Any = self.session.engine.device.children[arm]
        sample = device.read(0.0)
        return UM * np.asarray(sample.values["setpoint_cp"].position)

    def used(self, count: int) -> dict[str, Any]:
        """Wait until Raven has used so many more packets."""
        before = self.sim.control.status()["used"]
        return self.until(lambda status: status["used"] >= before + count, f"{count} packets")


@contextmanager
def raven(simulated: dict[str, Any] | None = None, **values: Any) -> Iterator[RavenBench]:
    """A simulator and the driver at it, connected."""
    with SIM.spawn(port=0, **(simulated or {})) as sim:
        bench = RavenBench(sim, **values)
        bench.session.start()
        try:
            bench.connected()
            yield bench
        finally:
            bench.front.close()
