"""The ROS 2 front: the only package that imports rclpy.

`crtk_drivers.ros.environment` and `crtk_drivers.ros.names` can be imported without ROS; check the first
before anything else here is loaded. `crtk_drivers.ros.serving.run` serves a session.
"""
