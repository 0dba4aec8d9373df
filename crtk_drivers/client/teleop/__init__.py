"""Teleoperation over ROS 2: two devices and their pedals, by the states of `crtk_drivers.motion.teleop`."""

from crtk_drivers.client.teleop.loop import Teleoperation, reached_sides
from crtk_drivers.client.teleop.pedals import Pedal, TopicPedal, topic_pedals

__all__ = ["Pedal", "Teleoperation", "TopicPedal", "reached_sides", "topic_pedals"]
