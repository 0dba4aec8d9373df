"""What goes between the core and a device while it moves: setpoints, goals, progress, condition."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from crtk_drivers.device.capabilities import Mode
from crtk_drivers.samples import Pose, Vector
from crtk_drivers.state import OperatingState


@dataclass(frozen=True, slots=True, eq=False)
class Setpoint:
    """One low-level setpoint: `values` in the units of `mode`.

    A joint mode has one value a joint. CARTESIAN_POSITION has seven (position, quaternion), the other
    Cartesian modes six (linear before angular, in the axes of the base frame at the tool point).
    """

    mode: Mode
    values: Vector


@dataclass(frozen=True, slots=True)
class Ratios:
    """``trajectory_j/set_ratio_v`` and ``_a``: shares of the limits of velocity and acceleration.

    Raises:
        ValueError: not in (0, 1].
    """

    velocity: float = 1.0
    acceleration: float = 1.0

    def __post_init__(self) -> None:
        for name in ("velocity", "acceleration"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise ValueError(f"the {name} ratio is {getattr(self, name)}, not in (0, 1]")


FULL = Ratios()


@dataclass(frozen=True, slots=True, eq=False)
class Goal:
    """Where a move is to end: exactly one of `joints` (n,) and `pose` is set.

    A pose is reached along a straight line. `ratios` are those of the speed that moves usually have.
    """

    joints: Vector | None = None
    pose: Pose | None = None
    ratios: Ratios = FULL


class MoveProgress(StrEnum):
    """Where a native move stands."""

    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Condition:
    """What the hardware says of itself: the best operating state that it allows, and why.

    ENABLED means that nothing is in the way; PAUSED that somebody else has control (pendant);
    DISABLED that power is off; FAULT that it must be attended to. `reason` says it in words.
    """

    allows: OperatingState = OperatingState.ENABLED
    reason: str = ""
