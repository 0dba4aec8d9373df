"""An arm that exists in this process only, with dynamics and with every low-level mode."""

from crtk_driver_virtual.plugin import PLUGIN

__all__ = ["PLUGIN"]
