"""A simulated SCHUNK gripper in its own process, and its driver in this one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from crtk_driver_schunk.gripper import PLUGIN
from crtk_driver_schunk.gripper.config import SchunkConfig
from crtk_drivers.config import from_values, load
from crtk_sim_backends.schunk.gripper import SIM, RunningSim
from rigs.gripper_bench import GripperBench

FREE_PORTS = {"http_port": 0, "tool_port": 0, "modbus_port": 0}
LINKS = ("http", "serial", "tool", "modbus")
BRISK = {"speed": 0.5, "grip_speed": 0.25}
"""Of a simulated gripper, for those who do not look at speed."""


def configuration(sim: RunningSim, **values: Any) -> SchunkConfig:
    """Return the driver's configuration for a running simulator."""
    timeouts = {"sample_timeout": 2.0, "open_timeout": 10.0, "stream_timeout": 0.5}
    patient = {**timeouts, "rate": 100.0, "speed": 0.5}
    config = load(SchunkConfig, from_values({**patient, **values}))
    pointed = PLUGIN.sim_config(config, sim)
    assert isinstance(pointed, SchunkConfig)
    return pointed


class SchunkBench(GripperBench):
    """A driver and the simulator that it is connected to."""

    def __init__(self, sim: RunningSim, config: SchunkConfig) -> None:
        super().__init__(PLUGIN, sim, config)


@contextmanager
def bench(
    link: str = "http", *, simulated: dict[str, Any] | None = None, **values: Any
) -> Iterator[SchunkBench]:
    """Run a simulator and the driver at it, connected."""
    with (
        SIM.spawn(**{**FREE_PORTS, **BRISK, **(simulated or {})}) as sim,
        SchunkBench(sim, configuration(sim, link=link, **values)) as running,
    ):
        yield running
