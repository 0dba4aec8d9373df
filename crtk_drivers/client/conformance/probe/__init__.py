"""Looks at a CRTK device over ROS 2, for the judges of `crtk_drivers.client.conformance`.

It subscribes as each publisher offers: asked for more, a best-effort publisher would not be heard at all,
and the first fault would hide all others.
"""
