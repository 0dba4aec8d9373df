"""A simulated WSG gripper in its own process, and its driver in this one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from crtk_driver_weiss_wsg import PLUGIN
from crtk_driver_weiss_wsg.config import WsgConfig
from crtk_drivers.config import from_values, load
from crtk_sim_backends.weiss_wsg import SIM, RunningSim
from rigs.gripper_bench import GripperBench

FREE_PORTS = {"binary_port": 0, "text_port": 0}
LINKS = ("tcp", "text", "serial")


def configuration(sim: RunningSim, **values: Any) -> WsgConfig:
    """Return the driver's configuration for a running simulator."""
    patient = {"sample_timeout": 2.0, "open_timeout": 10.0, "stream_timeout": 2.0}
    config = load(WsgConfig, from_values({**patient, **values}))
    pointed = PLUGIN.sim_config(config, sim)
    assert isinstance(pointed, WsgConfig)
    return pointed


class WsgBench(GripperBench):
    """A driver and the simulator that it is connected to."""

    def __init__(self, sim: RunningSim, **values: Any) -> None:
        super().__init__(PLUGIN, sim, configuration(sim, **values))


@contextmanager
def bench(*, simulated: dict[str, Any] | None = None, **values: Any) -> Iterator[WsgBench]:
    """Run a simulator and the driver at it, connected."""
    with (
        SIM.spawn(**FREE_PORTS, **(simulated or {})) as sim,
        WsgBench(sim, **values) as running,
    ):
        yield running
