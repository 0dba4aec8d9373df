"""A Robotiq gripper in the rig of the drivers: what is asked of every driver beside its faults.

It is not in the table of faults: a gripper has no watchdog, and lets nothing go where an arm must stop.
"""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from bench.reliability.rig import Rig
from bench.reliability.table import REST
from crtk_driver_robotiq import PLUGIN
from crtk_drivers.plugins import DevicePlugin, RunningSim
from crtk_sim_backends.robotiq import SIM
from rigs.robotiq_bench import FREE_PORTS


class RobotiqRig(Rig):
    """The gripper at a serial line."""

    name = "robotiq"
    ways = ()
    absent = ()
    activities = (REST,)
    values = {"sample_timeout": 2.0, "open_timeout": 3.0}  # noqa: RUF012

    @property
    @override
    def plugin(self) -> DevicePlugin:
        return PLUGIN

    @override
    def start_sim(self) -> RunningSim:
        return SIM.spawn(**FREE_PORTS)

    @override
    def joints(self) -> np.ndarray:
        assert self.sim is not None
        return np.array([self.sim.control.status()["opening"]])
