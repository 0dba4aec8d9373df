"""Copley Controls drives on a serial line: their axes as one CRTK arm."""

from crtk_driver_copley.plugin import PLUGIN

__all__ = ["PLUGIN"]
