"""OnRobot grippers: RG2, RG6, 2FG7, 2FG14, 3FG15, VG10 and VGC10."""

from crtk_driver_onrobot.plugin import PLUGIN

__all__ = ["PLUGIN"]
