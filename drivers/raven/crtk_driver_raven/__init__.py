"""Raven II by its teleoperation packets: one way, to both arms."""

from crtk_driver_raven.plugin import PLUGIN

__all__ = ["PLUGIN"]
