"""Robotiq grippers: 2F-85, 2F-140 and Hand-E."""

from crtk_driver_robotiq.plugin import PLUGIN

__all__ = ["PLUGIN"]
