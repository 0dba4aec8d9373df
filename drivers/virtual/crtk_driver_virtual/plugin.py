"""The entry point of the driver."""

from __future__ import annotations

from importlib.util import find_spec

from crtk_driver_virtual.config import VirtualConfig
from crtk_driver_virtual.defective_device import DefectiveDevice
from crtk_driver_virtual.defects_config import DefectsConfig
from crtk_driver_virtual.device import VirtualDevice
from crtk_drivers.device import DeviceKind
from crtk_drivers.errors import MissingExtra
from crtk_drivers.plugins import DevicePlugin


def _create(config: VirtualConfig) -> VirtualDevice:
    if find_spec("pinocchio") is None:
        raise MissingExtra("pinocchio", "kinematics")
    if config.defects != DefectsConfig():
        return DefectiveDevice(config)
    return VirtualDevice(config)


PLUGIN = DevicePlugin(
    name="virtual",
    summary="an arm with dynamics in this process, without hardware: every CRTK command, walls to touch",
    config=VirtualConfig,
    kind=DeviceKind.ARM,
    create=_create,
    extra="kinematics",
    is_model=True,
)
