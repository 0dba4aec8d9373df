"""A simulated OptoForce unit in its own process, and its driver in this one."""

from __future__ import annotations

from typing import Any

from crtk_driver_optoforce import PLUGIN
from crtk_driver_optoforce.config import OptoForceConfig
from crtk_drivers.config import from_values, load
from crtk_sim_backends.optoforce import RunningSim
from rigs.sensor_bench import SensorBench

LOAD = {"fx": 10.0, "fy": -20.0, "fz": 30.0, "mx": 1.0, "my": -2.0, "mz": 0.5}


def configuration(sim: RunningSim, **values: Any) -> OptoForceConfig:
    """Return the driver's configuration for a running simulator; a busy machine is no fault."""
    patient = {"sample_timeout": 1.0, "open_timeout": 10.0}
    pointed = PLUGIN.sim_config(load(OptoForceConfig, from_values({**patient, **values})), sim)
    assert isinstance(pointed, OptoForceConfig)
    return pointed


def optoforce(sim: RunningSim, **values: Any) -> SensorBench:
    """Return the driver at a running simulator, to be entered."""
    return SensorBench(PLUGIN, sim, configuration(sim, **values))
