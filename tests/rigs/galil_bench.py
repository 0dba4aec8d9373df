"""A simulated Galil controller in its own process, and its driver in this one."""

from __future__ import annotations

from crtk_driver_galil import PLUGIN
from crtk_driver_galil.plugin import TYPICAL
from crtk_sim_backends.galil import SIM
from rigs.axes_bench import AxesBench

BENCH = AxesBench(PLUGIN, SIM, TYPICAL)
galil = BENCH.spawned
arm_at = BENCH.arm_at
configuration = BENCH.configuration
joints = BENCH.joints
moving = BENCH.moving
refused = BENCH.refused

TURN = 100_000
"""Counts of the simulated joints for a turn."""
