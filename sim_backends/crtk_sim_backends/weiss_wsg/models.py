"""The simulated models, their states and answers, as data (manuals of WSG 50 and WSG 32, command set)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from crtk_sim_backends.kit import FaultKind, KindTable, Parameter
from crtk_sim_backends.kit.jaw import JAW_KINDS


@dataclass(frozen=True)
class Model:
    """In mm, mm/s, mm/s² and N, as the device has them: least and greatest, of the force overdrive too."""

    stroke: float
    speed: tuple[float, float] = (5.0, 420.0)
    acceleration: tuple[float, float] = (100.0, 5000.0)
    force: tuple[float, float, float] = (5.0, 80.0, 120.0)


MODELS: Final[Mapping[str, Model]] = {
    "wsg-50-110": Model(110.0),
    "wsg-50-210": Model(210.0),
    "wsg-32-068": Model(68.0, (5.0, 400.0), force=(5.0, 50.0, 75.0)),
}

OK, NOT_REFERENCED, RUNNING, CHECKSUM, NO_PARAMETER, TOO_FEW = 0, 3, 4, 11, 12, 13
UNKNOWN, FORMAT, DENIED, FAILED, ABORTED, PARAMETER, PENDING, BLOCKED = (
    14,
    15,
    16,
    18,
    19,
    24,
    26,
    29,
)
"""Status codes."""

IDLE, GRASPING, NO_PART, PART_LOST, HOLDING, RELEASING, POSITIONING, ERROR = range(8)
"""Grasping states."""

FLAGS: Final[Mapping[str, int]] = {
    "referenced": 0,
    "moving": 1,
    "blocked_minus": 2,
    "blocked_plus": 3,
    "soft_limit_minus": 4,
    "soft_limit_plus": 5,
    "axis_stopped": 6,
    "target_reached": 7,
    "force_control": 9,
    "fast_stop": 12,
    "temperature_warning": 13,
    "temperature": 14,
    "power": 15,
    "current": 16,
    "finger": 17,
    "command_failure": 18,
    "script_running": 19,
    "script_failure": 20,
}
"""Bits of the system state."""
STOPPING: Final = ("temperature", "power", "current", "finger")
"""Those whose cause stops it fast."""

_CODE: Final = Parameter(int, minimum=1, maximum=30)
_COMMAND: Final = Parameter(str, "")
_EVERY: Final = Parameter(int, 1, minimum=1)
KINDS: Final[KindTable] = {
    kind.name: kind
    for kind in (
        *JAW_KINDS.values(),
        FaultKind(
            "flag",
            "a flag of the system state is set; one of a fault stops it fast",
            {"name": Parameter(str, choices=tuple(FLAGS))},
            lasting=True,
        ),
        FaultKind(
            "grasping",
            "it tells this grasping state",
            {"state": Parameter(int, minimum=0, maximum=7)},
            lasting=True,
        ),
        FaultKind("fast_stop", "it stops fast, as by an error"),
        FaultKind(
            "unpowered", "its supply was away: it has no reference, and all connections are gone"
        ),
        FaultKind(
            "as_new",
            "it has a reference, holds nothing, and is open by so much, in m",
            {"opening": Parameter(float, minimum=0.0, maximum=0.3)},
        ),
        FaultKind("other_program", "a script moves it", {"opening": Parameter(float, minimum=0.0)}),
        FaultKind(
            "refuse",
            "a command (all, if empty) is refused with a status code",
            {"command": _COMMAND, "status": _CODE},
            lasting=True,
        ),
        FaultKind(
            "fail",
            "a motion (all, if empty) ends with a status code",
            {"command": _COMMAND, "status": _CODE},
            lasting=True,
        ),
        FaultKind(
            "swallow",
            "a command (all, if empty) is carried out and not answered",
            {"command": _COMMAND},
            True,
        ),
        FaultKind("deaf", "a command (all, if empty) is not heard", {"command": _COMMAND}, True),
        FaultKind(
            "held",
            "answers to commands come later by so many seconds, updates at once",
            {"seconds": Parameter(float, minimum=0.0, maximum=10.0)},
            lasting=True,
        ),
        FaultKind("doubled", "every n-th answer comes twice", {"every": _EVERY}, lasting=True),
        FaultKind("bad_crc", "every n-th frame has a wrong CRC", {"every": _EVERY}, lasting=True),
    )
}
