"""Scripts that were written for the official CRTK Python client, with one line changed.

    import crtk_drivers.client.compat as crtk        # instead of: import crtk

    ral = crtk.ral("example", "left")
    arm = Arm(ral)                                   # a class populated by crtk.utils(self, ral)
    ral.check_connections()
    ral.spin()

This module has the calls of releases 1.2 and 1.3, which the CRTK documentation describes: ``measured_cp()``
returns a value. From 1.4 on it returns ``value, stamp``: scripts for that import
`crtk_drivers.client.compat.v1_4`.

Beyond the official client there is every CRTK command: `add_servo_jv`, `add_servo_cr`, `add_move_cr`,
`add_interpolate_*`, `add_goal_*`, `add_setpoint_cv`, `add_setpoint_cf`. Poses are PyKDL frames where PyKDL is
installed (Debian: python3-pykdl), and `crtk_drivers.Pose` otherwise.
"""

from crtk_drivers.ros import environment

environment.check()

from crtk_drivers.client.compat.classes import JoystickButton, MeasuredCp  # noqa: E402 - needs ROS
from crtk_drivers.client.compat.handles import WaitMoveHandle  # noqa: E402
from crtk_drivers.client.compat.utilities import NoData, Utils  # noqa: E402
from crtk_drivers.client.ral import Ral  # noqa: E402

ral = Ral
utils = Utils
wait_move_handle = WaitMoveHandle
joystick_button = JoystickButton
measured_cp = MeasuredCp

__all__ = ["NoData", "joystick_button", "measured_cp", "ral", "utils", "wait_move_handle"]
