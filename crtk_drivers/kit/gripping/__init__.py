"""What grippers have in common: a driver brings a `Hand`, and `GripperDevice` makes a CRTK device of it."""

from crtk_drivers.kit.gripping.adjustable import Adjustable
from crtk_drivers.kit.gripping.doing import EMPTY, ENDS_WELL, HELD, ON_ITS_WAY, Doing, Fault, Weight
from crtk_drivers.kit.gripping.echo import Echo
from crtk_drivers.kit.gripping.gripper_device import GripperDevice, OnClose
from crtk_drivers.kit.gripping.hand import Hand, HandService, Measured, When
from crtk_drivers.kit.gripping.readying import not_made_ready
from crtk_drivers.kit.gripping.smoothed_rate import SmoothedRate

__all__ = [
    "EMPTY",
    "ENDS_WELL",
    "HELD",
    "ON_ITS_WAY",
    "Adjustable",
    "Doing",
    "Echo",
    "Fault",
    "GripperDevice",
    "Hand",
    "HandService",
    "Measured",
    "OnClose",
    "SmoothedRate",
    "Weight",
    "When",
    "not_made_ready",
]
