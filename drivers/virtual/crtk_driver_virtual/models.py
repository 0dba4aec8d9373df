"""The arms: three that are built in, and any that a user has as a URDF."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from crtk_driver_virtual.config import VirtualConfig
from crtk_drivers.device import CartesianLimits, JointLimits
from crtk_drivers.errors import ConfigError
from crtk_drivers.kinematics.chain import Chain
from crtk_drivers.samples import Vector, vector
from crtk_drivers.wrappers.urdf_file import read_urdf

logger = logging.getLogger(__name__)

FOLDER: Final = Path(__file__).with_name("models")
FILE_ACCELERATION: Final = 5.0
"""rad/s² (m/s²) of the joints of a user's file; a URDF has no such limit."""
RISE_TIME: Final = 0.1
"""Seconds in which a joint reaches its acceleration limit, where no jerk limit is given."""
ROTOR_ACCELERATION: Final = 200.0
"""rad/s²: a geared motor, alone, reaches about this at its largest effort."""


@dataclass(frozen=True, slots=True)
class BuiltIn:
    """What a URDF does not hold of one of our own arms; a number counts for each joint."""

    start: tuple[float, ...]
    rotor_inertia: tuple[float, ...]
    acceleration: float
    tool: CartesianLimits


BUILT_IN: Mapping[str, BuiltIn] = MappingProxyType(
    {
        "six_axis": BuiltIn(
            start=(0.0, 0.4, 1.4, 0.0, 1.3416, 0.0),
            rotor_inertia=(0.6, 0.6, 0.6, 0.1, 0.1, 0.1),
            acceleration=6.0,
            tool=CartesianLimits(1.0, 3.0, 5.0, 15.0, force=150.0, torque=25.0),
        ),
        "seven_axis": BuiltIn(
            start=(0.0, 0.4, 0.0, 1.6, 0.0, 1.1416, 0.0),
            rotor_inertia=(0.4, 0.4, 0.4, 0.3, 0.3, 0.1, 0.1),
            acceleration=6.0,
            tool=CartesianLimits(1.0, 2.5, 5.0, 12.0, force=150.0, torque=30.0),
        ),
        "haptic": BuiltIn(
            start=(0.0, 0.2, 1.7, 0.0, 1.2416, 0.0),
            rotor_inertia=(4e-4, 4e-4, 4e-4, 5e-5, 5e-5, 5e-5),
            acceleration=30.0,
            tool=CartesianLimits(1.0, 10.0, 20.0, 100.0, force=4.0, torque=0.2),
        ),
    }
)


@dataclass(frozen=True, slots=True, eq=False)
class Arm:
    """One arm; vectors are (n,), in the order of the chain.

    Attributes:
        limits: of the joints.
        tool: limits of the tool.
        start: where it begins.
        damping: viscous friction, in N·m·s/rad (N·s/m).
        rotor_inertia: of the motors, in kg·m² (kg).
        inertias: of the moving links, as pinocchio has them, in the frames of their joints.
        has_masses: whether these are an arm's; if not, there is nothing to compute efforts with.
    """

    chain: Chain
    limits: tuple[JointLimits, ...]
    tool: CartesianLimits
    start: Vector
    damping: Vector
    rotor_inertia: Vector
    inertias: tuple[Any, ...]
    has_masses: bool


def load_arm(config: VirtualConfig) -> Arm:
    """Return the arm that a configuration names.

    Raises:
        ConfigError: a file that cannot be used, or a start that does not suit the arm.
    """
    known = BUILT_IN[config.model] if config.urdf is None else None
    if config.urdf is None:
        path, base, tip = FOLDER / f"{config.model}.urdf", "base_link", "tool0"
    else:
        path, base, tip = Path(config.urdf).expanduser(), config.base_link, config.tip_link
    chain = read_urdf(path, base=base, tip=tip)
    links = _Links(path, chain)
    acceleration = config.acceleration or (known.acceleration if known else FILE_ACCELERATION)
    jerk = config.jerk or acceleration / RISE_TIME
    limits = tuple(
        JointLimits(joint.lower, joint.upper, velocity, acceleration, jerk, effort)
        for joint, velocity, effort in zip(chain.joints, links.velocity, links.effort, strict=True)
    )
    if known is not None:
        tool, start, rotors = known.tool, known.start, known.rotor_inertia
    else:
        tool = CartesianLimits(1.0, 3.0, 5.0, 15.0, force=100.0, torque=20.0)
        start = tuple(_middle(limit) for limit in limits)
        rotors = tuple(limit.effort / ROTOR_ACCELERATION for limit in limits)
    if config.tool_limits is not None:
        tool = CartesianLimits(**config.tool_limits.model_dump())
    if config.rotor_inertia is not None:
        rotors = (config.rotor_inertia,) * len(limits)
    return Arm(
        chain=chain,
        limits=limits,
        tool=tool,
        start=_checked_start(config.start or start, limits),
        damping=vector(config.friction * links.damping),
        rotor_inertia=vector(rotors),
        inertias=links.inertias,
        has_masses=links.have_masses(str(path)),
    )


class _Links:
    """What pinocchio reads of the links and joints of a URDF that was checked before."""

    def __init__(self, path: Path, chain: Chain) -> None:
        import pinocchio as pin

        try:
            whole = pin.buildModelFromUrdf(str(path))
        except (RuntimeError, ValueError) as error:
            raise ConfigError(
                f"pinocchio cannot read it: {error}",
                where=str(path),
                remedy="Check the limits (velocity and effort) and inertias of its joints and links.",
            ) from error
        # What is not between base and tip (a gripper, another arm) is fixed where it is at zero.
        others = [i for i, name in enumerate(whole.names) if i and name not in chain.names]
        model = pin.buildReducedModel(whole, others, pin.neutral(whole))
        joints = [model.getJointId(joint.name) for joint in chain.joints]
        slots = [model.idx_vs[i] for i in joints]
        self.inertias = tuple(pin.Inertia(model.inertias[i]) for i in joints)
        self.velocity = _positive(model.upperVelocityLimit, slots, chain, "velocity", path)
        self.effort = _positive(model.upperEffortLimit, slots, chain, "effort", path)
        self.damping = np.array(model.damping)[slots]
        self._names = chain.names

    def have_masses(self, where: str) -> bool:
        """Whether a mass hangs from each joint; said in the log if not."""
        if self.inertias[-1].mass > 0.0:
            return True
        logger.warning(
            "%s has no mass beyond joint %s: the arm takes positions and velocities, no efforts. "
            "Give its links <inertial> for those.",
            where,
            self._names[-1],
        )
        return False


def _positive(
    values: Any, slots: Sequence[int], chain: Chain, what: str, path: Path
) -> list[float]:
    """Return the limits of the joints.

    Raises:
        ConfigError: one of them is missing.
    """
    found = [float(values[slot]) for slot in slots]
    missing = [
        joint.name
        for joint, value in zip(chain.joints, found, strict=True)
        if not 0.0 < value < math.inf
    ]
    if missing:
        raise ConfigError(
            f"no {what} limit above zero at {', '.join(missing)}",
            where=str(path),
            remedy=f'Add <limit {what}="..."/> to the joint.',
        )
    return found


def _middle(limit: JointLimits) -> float:
    if not (math.isfinite(limit.lower) and math.isfinite(limit.upper)):
        return min(max(0.0, limit.lower), limit.upper)
    return 0.5 * (limit.lower + limit.upper)


def _checked_start(start: Sequence[float], limits: Sequence[JointLimits]) -> Vector:
    within = len(start) == len(limits) and all(
        limit.lower <= value <= limit.upper for value, limit in zip(start, limits, strict=True)
    )
    if not within:
        ranges = ", ".join(f"{limit.lower:g} to {limit.upper:g}" for limit in limits)
        raise ConfigError(
            f"start: {list(start)} is no position of this arm",
            where="virtual",
            remedy=f"Give {len(limits)} positions within: {ranges}.",
        )
    return vector(start)
