"""OptoForce force sensors at a USB port: 3 axes, 6 axes, four times 3 axes."""

from crtk_driver_optoforce.plugin import PLUGIN

__all__ = ["PLUGIN"]
