"""CANopen joints: CiA 402 drives on a CAN bus as one arm."""

from crtk_driver_canopen.plugin import PLUGIN

__all__ = ["PLUGIN"]
