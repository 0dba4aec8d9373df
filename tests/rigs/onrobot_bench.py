"""A simulated OnRobot gripper in its own process, and its driver in this one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from crtk_driver_onrobot import PLUGIN
from crtk_driver_onrobot.config import OnRobotConfig
from crtk_drivers.config import from_values, load
from crtk_sim_backends.onrobot import SIM, RunningSim
from rigs.gripper_bench import GripperBench

FREE_PORTS = {"tool_port": 0, "modbus_port": 0}
LINKS = ("modbus", "serial", "tool")


def configuration(sim: RunningSim, **values: Any) -> OnRobotConfig:
    """Return the driver's configuration for a running simulator."""
    patient = {"sample_timeout": 2.0, "open_timeout": 10.0, "stream_timeout": 2.0}
    config = load(OnRobotConfig, from_values({**patient, **values}))
    pointed = PLUGIN.sim_config(config, sim)
    assert isinstance(pointed, OnRobotConfig)
    return pointed


class OnRobotBench(GripperBench):
    """A driver and the simulator that it is connected to."""

    def __init__(self, sim: RunningSim, config: OnRobotConfig) -> None:
        super().__init__(PLUGIN, sim, config)


@contextmanager
def bench(
    model: str = "rg2",
    link: str = "modbus",
    *,
    simulated: dict[str, Any] | None = None,
    **values: Any,
) -> Iterator[OnRobotBench]:
    """Run a simulator and the driver at it, connected."""
    with (
        SIM.spawn(**FREE_PORTS, model=model, **(simulated or {})) as sim,
        OnRobotBench(sim, configuration(sim, model=model, link=link, **values)) as running,
    ):
        yield running
