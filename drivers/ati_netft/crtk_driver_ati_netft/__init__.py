"""ATI NetFT force/torque sensors: Net Box, Ethernet Axia, SCHUNK FTN and OnRobot HEX."""

from crtk_driver_ati_netft.plugin import PLUGIN

__all__ = ["PLUGIN"]
