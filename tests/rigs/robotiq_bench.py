"""A simulated gripper in its own process, and its driver in this one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from crtk_driver_robotiq import PLUGIN
from crtk_driver_robotiq.config import RobotiqConfig
from crtk_drivers.config import from_values, load
from crtk_sim_backends.robotiq import SIM, RunningSim
from rigs.gripper_bench import GripperBench
from rigs.waiting import eventually

__all__ = [
    "AJAR",
    "FREE_PORTS",
    "LINKS",
    "RobotiqBench",
    "activate_anew",
    "bench",
    "configuration",
    "eventually",
]

FREE_PORTS = {"tool_port": 0, "modbus_port": 0, "controller_port": 0, "urcap_port": 0}
LINKS = ("serial", "tool", "modbus", "controller", "urcap")
AJAR = 0.08
"""Width in m of something that leaves open fingers of a 2F-85 little way to go: an activation soon ends."""


def configuration(sim: RunningSim, **values: Any) -> RobotiqConfig:
    """Return the driver's configuration for a running simulator."""
    patient = {"sample_timeout": 2.0, "open_timeout": 10.0, "stream_timeout": 2.0}
    config = load(RobotiqConfig, from_values({**patient, **values}))
    pointed = PLUGIN.sim_config(config, sim)
    assert isinstance(pointed, RobotiqConfig)
    return pointed


def activate_anew(sim: RunningSim) -> None:
    """Have another master reset a gripper and activate it; nothing lies between its fingers then."""
    sim.control.inject("object", width=AJAR)
    sim.control.inject("deactivated")
    sim.control.inject("activated")
    eventually(lambda: sim.control.call("status")["state"] == "active", "activated")
    sim.control.clear("object")


class RobotiqBench(GripperBench):
    """A driver and the simulator that it is connected to."""

    def __init__(self, sim: RunningSim, config: RobotiqConfig) -> None:
        super().__init__(PLUGIN, sim, config)


@contextmanager
def bench(
    link: str = "tool", *, simulated: dict[str, Any] | None = None, **values: Any
) -> Iterator[RobotiqBench]:
    """Run a simulator and the driver at it, connected."""
    with (
        SIM.spawn(**FREE_PORTS, **(simulated or {})) as sim,
        RobotiqBench(sim, configuration(sim, link=link, **values)) as running,
    ):
        yield running
