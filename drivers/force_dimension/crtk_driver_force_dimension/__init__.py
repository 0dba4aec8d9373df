"""Haptic devices of Force Dimension, and the Novint Falcon, by the vendor's library."""

from crtk_driver_force_dimension.plugin import PLUGIN

__all__ = ["PLUGIN"]
