"""An arm of simulated drives for tests: slow enough for a busy machine, and with every mode."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from crtk_driver_canopen import PLUGIN
from crtk_driver_canopen.config import CanopenConfig
from crtk_sim_backends.canopen import SIM
from crtk_sim_backends.process import RunningSim

PERIOD = 0.01
JOINT = {
    "gear": 100.0,
    "lower": -3.0,
    "upper": 3.0,
    "velocity": 2.0,
    "acceleration": 10.0,
    "effort": 20.0,
    "modes": ("csp", "csv", "cst"),
}


def arm_on(
    sim: RunningSim, count: int, joint: dict[str, Any] | None = None, **keys: Any
) -> CanopenConfig:
    """Return the configuration of `count` drives, with changes for every joint, and for the arm."""
    values = {
        "bus": {"interface": "crtk", "channel": sim.paths["crtk"]},
        "joints": {
            f"joint_{node}": {"node": node, **JOINT, **(joint or {})}
            for node in range(1, count + 1)
        },
        "period": PERIOD,
        "missed_cycles": 20,
        "heartbeat": {"ours_timeout": 0.5, "drives_timeout": 0.5},
        "open_timeout": 10.0,
        **keys,
    }
    config = PLUGIN.load_config(values, {})
    assert isinstance(config, CanopenConfig)
    return config


@contextmanager
def drives(count: int, **options: Any) -> Iterator[RunningSim]:
    """Simulated drives on a bus of their own."""
    with SIM.spawn(nodes=count, realtime=True, **options) as sim:
        yield sim
