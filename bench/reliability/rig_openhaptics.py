"""OpenHaptics: a Touch by a library that stands for the vendor's, in the process that has it."""

from __future__ import annotations

from bench.reliability.haptic import LIBRARY_ABSENT, PATIENT, STOP, HapticRig, library_ways
from bench.reliability.table import Absent, Way
from crtk_driver_openhaptics import PLUGIN
from crtk_sim_backends.openhaptics import SIM

WAYS = (
    *library_ways("Communication error", "already initiated"),
    Way("F12", "a force error", kind="saturated", detail="Force error", stands=STOP),
)

ABSENT = (*LIBRARY_ABSENT, Absent("F14", "nothing at the device that its library tells of"))


class OpenHapticsRig(HapticRig):
    """The device."""

    name = "openhaptics"
    plugin = PLUGIN
    simulator = SIM
    ways = WAYS
    absent = ABSENT
    values = {**PATIENT, "force_timeout": 0.3}  # noqa: RUF012
