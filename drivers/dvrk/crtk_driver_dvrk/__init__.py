"""A driver that reads the controllers of da Vinci Research Kits (dVRK): FPGA1394 boards over UDP."""

from crtk_driver_dvrk.plugin import PLUGIN

__all__ = ["PLUGIN"]
