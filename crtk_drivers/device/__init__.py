"""The contract between the core and a device, on one page each: what it can do, and what it is asked.

`Device` is what a plugin implements, with `Kinematics` if it has them; `crtk_drivers.device.interface` has
the rules.
"""

from crtk_drivers.device.arm_kinematics import Kinematics
from crtk_drivers.device.capabilities import (
    Capabilities,
    CartesianLimits,
    Following,
    JointLimits,
    Mode,
    StopPolicy,
    mode_of,
)
from crtk_drivers.device.device_kind import DeviceKind
from crtk_drivers.device.extras import (
    READINGS,
    Answer,
    Input,
    Note,
    Reading,
    Service,
    Severity,
    Steps,
)
from crtk_drivers.device.interface import Device, Sensor
from crtk_drivers.device.values import FULL, Condition, Goal, MoveProgress, Ratios, Setpoint

__all__ = [
    "FULL",
    "READINGS",
    "Answer",
    "Capabilities",
    "CartesianLimits",
    "Condition",
    "Device",
    "DeviceKind",
    "Following",
    "Goal",
    "Input",
    "JointLimits",
    "Kinematics",
    "Mode",
    "MoveProgress",
    "Note",
    "Ratios",
    "Reading",
    "Sensor",
    "Service",
    "Setpoint",
    "Severity",
    "Steps",
    "StopPolicy",
    "mode_of",
]
