"""Robots behind ros2_control: their controllers in, their joint states out."""

from crtk_driver_ros2_control.plugin import PLUGIN

__all__ = ["PLUGIN"]
