"""The simulated robot's side of ROS: the only part of the simulators that imports it."""
