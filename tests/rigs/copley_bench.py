"""Simulated Copley drives in their own process, and their driver in this one."""

from __future__ import annotations

from crtk_driver_copley import PLUGIN
from crtk_driver_copley.plugin import TYPICAL
from crtk_sim_backends.copley import SIM
from rigs.axes_bench import AxesBench

BENCH = AxesBench(PLUGIN, SIM, TYPICAL)
drives = BENCH.spawned
arm_at = BENCH.arm_at
configuration = BENCH.configuration
joints = BENCH.joints
moving = BENCH.moving
refused = BENCH.refused

ONE = {"joint_1": TYPICAL["joints"]["joint_1"]}
"""One joint only."""
PER_RADIAN = TYPICAL["joints"]["joint_1"]["counts"]
