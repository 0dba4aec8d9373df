"""Touch, Omni and other devices of OpenHaptics, by the vendor's library."""

from crtk_driver_openhaptics.plugin import PLUGIN

__all__ = ["PLUGIN"]
