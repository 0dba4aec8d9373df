"""Robotiq force sensors: FT 300 and FT 300-S."""

from crtk_driver_robotiq.ft300.plugin import PLUGIN

__all__ = ["PLUGIN"]
