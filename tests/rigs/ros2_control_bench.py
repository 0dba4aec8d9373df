"""A driver in this process, a simulated robot behind ros2_control in its own, and what tests ask of both."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from crtk_driver_ros2_control import PLUGIN
from crtk_driver_ros2_control.config import Ros2ControlConfig
from crtk_drivers.config import from_values, load
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState
from crtk_sim_backends.process import RunningSim
from crtk_sim_backends.ros2_control import SIM
from rigs.told_states import ToldStates
from rigs.waiting import eventually

PATIENT = {
    "sample_timeout": 2.0,
    "open_timeout": 15.0,
    "service_timeout": 5.0,
    "stop_time": 4.0,
    "lag": 1.0,
}
"""Times in which a busy machine is no fault."""
POSITION, VELOCITY, EFFORT = (
    f"forward_{kind}_controller" for kind in ("position", "velocity", "effort")
)
TRAJECTORY = "joint_trajectory_controller"


def configuration(sim: RunningSim, **values: Any) -> Ros2ControlConfig:
    """Return the driver's configuration for a running simulator."""
    config = load(Ros2ControlConfig, from_values({**PATIENT, **values}))
    pointed = PLUGIN.sim_config(config, sim)
    assert isinstance(pointed, Ros2ControlConfig)
    return pointed


class Ros2ControlBench:
    """A driver and the simulated robot that it is connected to.

    Attributes:
        arm: the front of the driver.
        sim: the simulator.
        session: of both.
    """

    def __init__(self, sim: RunningSim, config: Ros2ControlConfig) -> None:
        self.sim = sim
        self.session = Session(PLUGIN, config)
        self.arm: Any = LocalDevice(self.session)
        self._told = ToldStates(self.session.engine)

    def connected(self) -> None:
        """Wait until joint states have come."""
        engine = self.session.engine
        eventually(lambda: engine.connected and engine.has_sample, "connected")

    def state(self, state: OperatingState, detail: str = "") -> None:
        """Wait until the robot is in a state, for a reason that has these words."""
        self._told.detail(state, detail)

    @property
    def positions(self) -> np.ndarray:
        """Where the joints really are."""
        return np.array(self.told("positions"))

    def told(self, key: str) -> Any:
        """Return what the simulator says of itself."""
        return self.sim.control.status()[key]

    def inject(self, kind: str, **parameters: Any) -> None:
        """Let a fault begin."""
        self.sim.control.inject(kind, **parameters)


@contextmanager
def ros2_control_bench(
    sim_options: dict[str, Any] | None = None, **values: Any
) -> Iterator[Ros2ControlBench]:
    """Start a robot and its driver, and wait until they are connected."""
    with SIM.spawn(**(sim_options or {})) as sim, driver_of(sim, **values) as bench:
        yield bench


@contextmanager
def driver_of(sim: RunningSim, **values: Any) -> Iterator[Ros2ControlBench]:
    """Start a driver of a robot that runs, and wait until it is connected; faults end with it."""
    bench = Ros2ControlBench(sim, configuration(sim, **values))
    bench.session.start()
    try:
        bench.connected()
        yield bench
    finally:
        sim.control.clear()
        bench.session.close()
