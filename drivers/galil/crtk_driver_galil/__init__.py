"""Galil DMC motion controllers: their axes as one CRTK arm."""

from crtk_driver_galil.plugin import PLUGIN

__all__ = ["PLUGIN"]
