"""A simulated force sensor in its own process, and its driver in this one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from crtk_driver_robotiq.ft300 import PLUGIN
from crtk_driver_robotiq.ft300.config import Ft300Config
from crtk_drivers.config import from_values, load
from crtk_sim_backends.robotiq.ft300 import SIM, RunningSim
from rigs.sensor_bench import SensorBench

FREE_PORTS = {"tool_port": 0, "modbus_port": 0}
LOAD = {"fx": 10.0, "fy": -20.0, "fz": 30.0, "mx": 1.0, "my": -2.0, "mz": 0.5}


def configuration(sim: RunningSim, **values: Any) -> Ft300Config:
    """Return the driver's configuration for a running simulator."""
    patient = {"sample_timeout": 1.0, "open_timeout": 10.0}
    pointed = PLUGIN.sim_config(load(Ft300Config, from_values({**patient, **values})), sim)
    assert isinstance(pointed, Ft300Config)
    return pointed


class Ft300Bench(SensorBench):
    """A driver and the simulator that it is connected to."""

    def __init__(self, sim: RunningSim, config: Ft300Config) -> None:
        super().__init__(PLUGIN, sim, config)


@contextmanager
def bench(
    link: str = "serial", *, simulated: dict[str, Any] | None = None, **values: Any
) -> Iterator[Ft300Bench]:
    """Run a simulator and the driver at it, connected."""
    with (
        SIM.spawn(**FREE_PORTS, **(simulated or {})) as sim,
        Ft300Bench(sim, configuration(sim, link=link, **values)) as running,
    ):
        yield running
