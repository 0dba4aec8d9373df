"""The entry point of the driver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from crtk_driver_force_dimension.config import ForceDimensionConfig
from crtk_drivers.device import Device, DeviceKind
from crtk_drivers.plugins import DevicePlugin, RunningSim


def _create(config: ForceDimensionConfig) -> Device:
    from crtk_driver_force_dimension.traits import traits_of
    from crtk_drivers.kit.haptics.haptic_device import HapticDevice

    return HapticDevice(traits_of(config))


def _at_sim(config: ForceDimensionConfig, sim: RunningSim) -> ForceDimensionConfig:
    return config.model_copy(update={"library": sim.paths["library"]})


def _sim_options(config: ForceDimensionConfig) -> Mapping[str, Any]:
    return {"model": config.model}


PLUGIN = DevicePlugin(
    name="force-dimension",
    summary="Force Dimension's omega, delta, sigma, lambda, and the Falcon, with a local force loop",
    config=ForceDimensionConfig,
    kind=DeviceKind.HAPTIC,
    create=_create,
    sim="force-dimension",
    addresses=("library", "index", "serial"),
    sim_config=_at_sim,
    sim_options=_sim_options,
)

__all__ = ["PLUGIN"]
