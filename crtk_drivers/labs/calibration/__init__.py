"""Where things are that no data sheet tells: a pointer's tip, a model, a tracker, a marker. Pure."""

from crtk_drivers.labs.calibration.hand_eye import HandEye, hand_eye
from crtk_drivers.labs.calibration.pivot import Pivot, pivot
from crtk_drivers.labs.calibration.registration import Registration, register

__all__ = ["HandEye", "Pivot", "Registration", "hand_eye", "pivot", "register"]
