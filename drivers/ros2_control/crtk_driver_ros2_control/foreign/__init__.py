"""The robot's side of ROS: the only part of the driver that imports it."""
