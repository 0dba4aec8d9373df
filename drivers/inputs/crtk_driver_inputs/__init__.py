"""Foot pedals, buttons, joysticks and six-axis mice of Linux, as CRTK devices."""

from crtk_driver_inputs.plugin import PLUGIN

__all__ = ["PLUGIN"]
