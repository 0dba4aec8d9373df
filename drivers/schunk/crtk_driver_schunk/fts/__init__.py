"""SCHUNK force/torque sensors FTS at their Ethernet interface box."""

from crtk_driver_schunk.fts.plugin import PLUGIN

__all__ = ["PLUGIN"]
