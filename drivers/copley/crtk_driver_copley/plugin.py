"""The entry point of the driver."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from crtk_driver_copley.config import CopleyConfig
from crtk_drivers.device import Device, DeviceKind
from crtk_drivers.plugins import DevicePlugin, RunningSim, axes_ways

SIMULATED_NODES = 3
"""Drives of the arm that ``--sim`` shows when no joints are configured."""


def _simulated_joint(node: int) -> dict[str, Any]:
    return {
        "node": node,
        "counts": 100_000 / (2.0 * math.pi),
        "lower": -3.0,
        "upper": 3.0,
        "velocity": 2.0,
        "acceleration": 10.0,
    }


TYPICAL: Mapping[str, Any] = {
    "joints": {f"joint_{node + 1}": _simulated_joint(node) for node in range(SIMULATED_NODES)}
}
"""The arm that ``--sim`` shows when no joints are configured: 100 000 counts a turn."""


def _create(config: CopleyConfig) -> Device:
    from crtk_driver_copley.controller import create

    return create(config)


def _at_sim(config: CopleyConfig, sim: RunningSim) -> CopleyConfig:
    config = axes_ways.with_joints(config, TYPICAL)
    return config.model_copy(update={"port": sim.ttys["serial"]})


def _sim_options(config: CopleyConfig) -> Mapping[str, Any]:
    """As many drives as the joints are on."""
    return {"nodes": 1 + max((joint.node for joint in config.joints.values()), default=2)}


PLUGIN = DevicePlugin(
    name="copley",
    summary="Copley Controls drives (Accelnet, Xenus, ...) by ASCII over serial: their axes as one arm",
    config=CopleyConfig,
    kind=DeviceKind.ARM,
    create=_create,
    sim="copley",
    extra="copley",
    addresses=("port",),
    check_real=axes_ways.check_real(
        "copley", {"port": "--port /dev/ttyUSB0", "joints": "--config arm.yaml"}
    ),
    sim_config=_at_sim,
    sim_options=_sim_options,
    typical=TYPICAL,
)
