"""Universal Robots arms (CB3 and e-Series) over RTDE."""

from crtk_driver_ur.plugin import PLUGIN

__all__ = ["PLUGIN"]
