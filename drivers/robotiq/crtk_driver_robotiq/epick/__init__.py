"""Robotiq's vacuum gripper with a pump: ePick."""

from crtk_driver_robotiq.epick.plugin import PLUGIN

__all__ = ["PLUGIN"]
