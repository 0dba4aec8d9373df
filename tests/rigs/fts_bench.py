"""A simulated FTS in its own process, and its driver in this one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from crtk_driver_schunk.fts import PLUGIN
from crtk_driver_schunk.fts.config import FtsConfig
from crtk_drivers.config import from_values, load
from crtk_sim_backends.schunk.fts import SIM, RunningSim
from rigs.device_bench import DeviceBench
from rigs.waiting import eventually

LOAD = (1.0, -2.0, -20.0, 0.1, -0.2, 0.3)
SIMULATED = {"tcp_port": 0, "load": f"constant:{','.join(map(str, LOAD))}"}


def configuration(sim: RunningSim, **values: Any) -> FtsConfig:
    """Return the driver's configuration for a running simulator."""
    patient = {"sample_timeout": 2.0, "open_timeout": 10.0, "rate": 100.0}
    config = load(FtsConfig, from_values({**patient, **values}))
    pointed = PLUGIN.sim_config(config, sim)
    assert isinstance(pointed, FtsConfig)
    return pointed


class FtsBench(DeviceBench):
    """A driver and the simulator that it is connected to."""

    def __init__(self, sim: RunningSim, config: FtsConfig) -> None:
        super().__init__(PLUGIN, sim, config)

    def load(self) -> np.ndarray:
        """Return the newest load (6,)."""
        wrench = self.front.measured_cf()
        return np.concatenate((wrench.force, wrench.torque))

    def received(self, count: int) -> None:
        """Wait for so many more measurements."""
        goal = self.counter("received") + count
        eventually(lambda: self.counter("received") >= goal, f"{count} measurements")


@contextmanager
def fts_bench(sim: RunningSim, **values: Any) -> Iterator[FtsBench]:
    """A driver at a running simulator, connected."""
    with FtsBench(sim, configuration(sim, **values)) as bench:
        yield bench


@contextmanager
def simulated(**options: Any) -> Iterator[RunningSim]:
    """A simulated sensor."""
    with SIM.spawn(**{**SIMULATED, **options}) as sim:
        yield sim
