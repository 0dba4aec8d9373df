"""A simulated vacuum gripper in its own process, and its driver in this one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from crtk_driver_robotiq.epick import PLUGIN
from crtk_driver_robotiq.epick.config import EpickConfig
from crtk_drivers.config import from_values, load
from crtk_sim_backends.robotiq.epick import SIM, RunningSim
from rigs.gripper_bench import GripperBench

FREE_PORTS = {"tool_port": 0, "modbus_port": 0}


def configuration(sim: RunningSim, **values: Any) -> EpickConfig:
    """Return the driver's configuration for a running simulator."""
    timeouts = {"sample_timeout": 2.0, "open_timeout": 10.0, "stream_timeout": 2.0}
    patient = {**timeouts, "timeout": 0.5, "release_timeout": 0.5}
    pointed = PLUGIN.sim_config(load(EpickConfig, from_values({**patient, **values})), sim)
    assert isinstance(pointed, EpickConfig)
    return pointed


class EpickBench(GripperBench):
    """A driver and the simulator that it is connected to."""

    def __init__(self, sim: RunningSim, config: EpickConfig) -> None:
        super().__init__(PLUGIN, sim, config)


@contextmanager
def bench(
    link: str = "tool", *, simulated: dict[str, Any] | None = None, **values: Any
) -> Iterator[EpickBench]:
    """Run a simulator and the driver at it, connected."""
    with (
        SIM.spawn(**FREE_PORTS, **(simulated or {})) as sim,
        EpickBench(sim, configuration(sim, link=link, **values)) as running,
    ):
        yield running
