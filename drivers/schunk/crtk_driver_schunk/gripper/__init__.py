"""SCHUNK grippers EGU, EGK and EZU, by the web server of their fieldbus module or Modbus RTU."""

from crtk_driver_schunk.gripper.plugin import PLUGIN

__all__ = ["PLUGIN"]
