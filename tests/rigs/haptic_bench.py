"""A simulated haptic device and its driver."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import pytest

from crtk_driver_force_dimension import PLUGIN
from crtk_driver_force_dimension.config import ForceDimensionConfig
from crtk_drivers.config import DeviceConfig, from_values, load
from crtk_drivers.front import LocalDevice
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.session import Session
from crtk_sim_backends.force_dimension import SIM, RunningSim
from crtk_sim_backends.haptics import compiler
from rigs.told_states import ToldStates
from rigs.waiting import LONG, eventually

needs_compiler = pytest.mark.skipif(
    compiler() is None, reason="no C compiler builds the library that stands for the vendor's"
)

PATIENT: dict[str, Any] = {
    "loop_rate": 500.0,
    "rate": 100.0,
    "ramp": 0.05,
    "stream_timeout": 1.0,
    "sample_timeout": 2.0,
    "command_timeout": 0.5,
    "driver_timeout": 0.5,
    "open_timeout": LONG,
}
"""A busy machine is not what is tested."""


class HapticBench(NamedTuple):
    """Both, and what is told of the state."""

    device: LocalDevice
    session: Session
    sim: RunningSim
    told: ToldStates

    def status(self, name: str) -> Any:
        """What the simulator says."""
        return self.sim.control.status()[name]

    def force(self) -> list[float]:
        """N that the device makes."""
        return list(self.status("force"))


def configured(**values: Any) -> ForceDimensionConfig:
    """Return a configuration of Force Dimension that is patient."""
    return load(
        ForceDimensionConfig,
        from_values({"watchdog": 0.03, "watchdog_trips": 1000, **PATIENT, **values}),
    )


@contextmanager
def haptic_bench(sim: RunningSim, **values: Any) -> Iterator[HapticBench]:
    """The driver of Force Dimension at a simulator, connected."""
    with bench_of(PLUGIN, PLUGIN.sim_config(configured(**values), sim), sim) as bench:
        yield bench


@contextmanager
def bench_of(plugin: DevicePlugin, config: DeviceConfig, sim: RunningSim) -> Iterator[HapticBench]:
    """Any of these drivers at its simulator, connected."""
    session = Session(plugin, config)
    device = LocalDevice(session)
    told = ToldStates(session.engine)
    try:
        session.start()
        eventually(lambda: session.engine.connected and session.engine.has_sample, "connected")
        yield HapticBench(device, session, sim, told)
    finally:
        device.close()
        sim.control.clear()


@contextmanager
def haptic_sim(**options: Any) -> Iterator[RunningSim]:
    """A simulated device."""
    with SIM.spawn(**options) as sim:
        yield sim
