"""crtk-drivers: hardware drivers that speak CRTK, on ROS 2 and in plain Python."""

from crtk_drivers.front import LocalDevice, connect
from crtk_drivers.samples import JointState, Pose, Twist, Wrench

__all__ = ["JointState", "LocalDevice", "Pose", "Twist", "Wrench", "connect"]
