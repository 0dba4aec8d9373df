"""What the rigs of haptic devices share: ways in which a vendor's library, and the process that has it, fail.

They have no joints that a driver could move: what is watched is the impulse that motors have given, which
goes on as long as a force is exerted and stands when none is.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from typing_extensions import override

from bench.reliability.activities import Plan
from bench.reliability.common import outlived, own_process
from bench.reliability.rig import Rig
from bench.reliability.table import REST, Absent, Follows, Way

SAMPLES: Final = 1.0
"""`sample_timeout` of tests, s."""
SILENT: Final = 0.5
"""`driver_timeout` of tests, s."""
STOP: Final = 0.1
_STREAM: Final = 0.3
_OPENED: Final = 15.0
"""Seconds in which a Python starts for the process, and compiles and loads what it needs."""

PATIENT: Final[Mapping[str, Any]] = {
    "loop_rate": 500.0,
    "rate": 100.0,
    "ramp": 0.05,
    "stream_timeout": _STREAM,
    "sample_timeout": SAMPLES,
    "command_timeout": 0.5,
    "driver_timeout": SILENT,
    "open_timeout": _OPENED,
}


def library_ways(unplugged: str, in_use: str) -> tuple[Way, ...]:
    """Return the ways that all of them have.

    Args:
        unplugged: words with which a device that is gone is told.
        in_use: those with which a second program is refused.
    """
    return (
        Way("F2", "its library hangs", kind="hang", within=SAMPLES, stands=SAMPLES + STOP),
        Way("F2", "the process of its library ends", kind="crash", within=SAMPLES,
            detail="signal", stands=SAMPLES + STOP),
        Way("F3", "none is there", Follows.STARTS_LATER, "no_device", within=_OPENED),
        Way("F3", "it cannot be opened", Follows.STARTS_LATER, "open_fails", within=_OPENED),
        Way("F5", "it tells positions that are no numbers", kind="broken", within=SAMPLES,
            stands=SAMPLES + STOP),
        Way("F7", "it is unplugged", kind="unplugged", detail=unplugged, within=SAMPLES,
            stands=SAMPLES + STOP),
        *own_process(stop=STOP, stream=_STREAM, stuck=1.1 + SILENT),
        *outlived(stands=SILENT + STOP, activities=("servo_cf",)),
        Way("F20", "another program opens it", Follows.KEPT_OUT, detail=in_use),
    )  # fmt: skip


LIBRARY_ABSENT: Final = (
    Absent("F1", "by a vendor's library; what is unplugged is F7"),
    Absent("F4", "calls of a library, no packets"),
    Absent("F6", "one call has all axes"),
    Absent("F8", "calls of a library, no packets"),
    Absent("F9", "one that forgets where it is exerts nothing until it is homed, in any state"),
    Absent("F10", "no CAN"),
    Absent("F11", "no heartbeat but its samples, F2"),
    Absent("F13", "no safety system that its library tells of"),
)


class HapticRig(Rig):
    """One of them."""

    plan = Plan(velocity=0.0, far=0.0, force=1.0)
    activities = (REST, "servo_cf")
    thorough = False

    @override
    def joints(self) -> np.ndarray:
        assert self.sim is not None
        return np.array([self.sim.control.status()["impulse"]])
