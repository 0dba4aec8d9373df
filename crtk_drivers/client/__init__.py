"""A CRTK device on the far side of ROS 2, with the methods of one in your own process.

    with crtk_drivers.client.connect("/ur5") as arm:
        arm.enable()
        arm.move_jp(arm.setpoint_js().position + 0.1).wait()

`crtk_drivers.client.compat` runs scripts that were written for the official CRTK Python client.
"""

from crtk_drivers.client.remote import RemoteDevice, connect

__all__ = ["RemoteDevice", "connect"]
