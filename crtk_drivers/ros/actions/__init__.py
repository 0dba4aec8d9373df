"""Actions: what a client asks, hears of while it is done, and may cancel.

An action is three services and two topics (design article "Actions", ROS 2), and is made of these here:
that of rclpy publishes and converts with Python's global lock held, and no I/O thread runs meanwhile.
"""
