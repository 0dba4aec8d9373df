"""Grippers in the rig of the drivers: what is asked of every driver beside its faults.

They are not in the table of faults, as a Robotiq gripper is: what it asks of the link and of the process is
asked there of the same code.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from typing_extensions import override

from bench.reliability.rig import Rig
from bench.reliability.table import REST
from crtk_driver_onrobot import PLUGIN as ONROBOT
from crtk_driver_schunk.gripper import PLUGIN as SCHUNK
from crtk_driver_weiss_wsg import PLUGIN as WSG
from crtk_drivers.plugins import DevicePlugin, RunningSim
from crtk_sim_backends.onrobot import SIM as ONROBOT_SIM
from crtk_sim_backends.schunk.gripper import SIM as SCHUNK_SIM
from crtk_sim_backends.weiss_wsg import SIM as WSG_SIM
from rigs import onrobot_bench, schunk_bench, wsg_bench


class GripperRig(Rig):
    """A gripper, by the way to it that its driver takes by default."""

    ways = ()
    absent = ()
    activities = (REST,)
    values = {"sample_timeout": 2.0, "open_timeout": 3.0}  # noqa: RUF012
    gripper: ClassVar[DevicePlugin]
    simulator: ClassVar[Any]
    ports: ClassVar[dict[str, Any]]

    @property
    @override
    def plugin(self) -> DevicePlugin:
        return self.gripper

    @override
    def start_sim(self) -> RunningSim:
        found: RunningSim = self.simulator.spawn(**self.ports)
        return found

    @override
    def joints(self) -> np.ndarray:
        assert self.sim is not None
        return np.array([self.sim.control.status()["opening"]])


class OnRobotRig(GripperRig):
    """An RG2."""

    name = "onrobot"
    gripper, simulator, ports = ONROBOT, ONROBOT_SIM, onrobot_bench.FREE_PORTS


class SchunkRig(GripperRig):
    """A SCHUNK gripper."""

    name = "schunk"
    values = {**GripperRig.values, "speed": 0.5}  # noqa: RUF012
    gripper, simulator = SCHUNK, SCHUNK_SIM
    ports = {**schunk_bench.FREE_PORTS, **schunk_bench.BRISK}  # noqa: RUF012


class WsgRig(GripperRig):
    """A WSG 50."""

    name = "weiss-wsg"
    gripper, simulator, ports = WSG, WSG_SIM, wsg_bench.FREE_PORTS
