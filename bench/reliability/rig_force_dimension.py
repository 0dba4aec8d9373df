"""Force Dimension: an omega.7 by a library that stands for the vendor's, in the process that has it."""

from __future__ import annotations

from bench.reliability.haptic import LIBRARY_ABSENT, PATIENT, STOP, HapticRig, library_ways
from bench.reliability.table import Way
from crtk_driver_force_dimension import PLUGIN
from crtk_sim_backends.force_dimension import SIM

WAYS = (
    *library_ways("communication error", "already in use"),
    Way("F12", "it moved too fast", kind="forces_off", parameters={"cause": 2}, detail="too fast",
        stands=STOP),
    Way("F14", "its force button", kind="forces_off", parameters={"cause": 1}, states=("PAUSED",),
        detail="force button", stands=STOP),
)  # fmt: skip


class ForceDimensionRig(HapticRig):
    """The device."""

    name = "force-dimension"
    plugin = PLUGIN
    simulator = SIM
    ways = WAYS
    absent = LIBRARY_ABSENT
    values = {**PATIENT, "watchdog": 0.03, "watchdog_trips": 1000}  # noqa: RUF012
