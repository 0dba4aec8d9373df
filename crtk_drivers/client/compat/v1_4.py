"""As `crtk_drivers.client.compat`, with the calls of release 1.4 of the official client.

    import crtk_drivers.client.compat.v1_4 as crtk

Feedback is ``value, stamp = arm.measured_cp(wait_timeout=1.0)``, with the stamp in seconds. TimeoutError is
raised when the last message is older than `connection_timeout`.
"""

from crtk_drivers.client.compat import joystick_button, measured_cp, ral, wait_move_handle
from crtk_drivers.client.compat.utilities import NoData, UtilsWithStamps

utils = UtilsWithStamps

__all__ = ["NoData", "joystick_button", "measured_cp", "ral", "utils", "wait_move_handle"]
