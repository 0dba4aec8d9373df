"""What motion controllers and drives of several axes have in common, whatever their protocol.

A driver brings a `MotionController`, and `AxesDevice` makes a CRTK device of it.
"""

from crtk_drivers.kit.axes.axes_device import AxesDevice, AxesOnClose
from crtk_drivers.kit.axes.axes_promises import braking_time, following_of, promises
from crtk_drivers.kit.axes.counting import Counting, can_have_gone, is_astray
from crtk_drivers.kit.axes.motion_controller import (
    AxisTold,
    Complaint,
    Counted,
    Heard,
    MotionController,
    Words,
)
from crtk_drivers.kit.axes.piece_ends import PieceEnds

__all__ = [
    "AxesDevice",
    "AxesOnClose",
    "AxisTold",
    "Complaint",
    "Counted",
    "Counting",
    "Heard",
    "MotionController",
    "PieceEnds",
    "Words",
    "braking_time",
    "can_have_gone",
    "following_of",
    "is_astray",
    "promises",
]
