"""Weiss Robotics (SCHUNK) WSG grippers: WSG 50 and WSG 32."""

from crtk_driver_weiss_wsg.plugin import PLUGIN

__all__ = ["PLUGIN"]
