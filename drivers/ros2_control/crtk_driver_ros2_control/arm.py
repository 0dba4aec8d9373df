"""The joints of a robot: names, limits and geometry, from the configuration or from a URDF."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from crtk_driver_ros2_control.config import Ros2ControlConfig
from crtk_drivers.device import CartesianLimits, JointLimits
from crtk_drivers.errors import ConfigError
from crtk_drivers.kinematics.chain import Chain
from crtk_drivers.kinematics.urdf import joint_rates, parse_urdf
from crtk_drivers.wrappers.urdf_file import read_document

RISE_TIME: Final = 0.1
"""Seconds in which a joint reaches its acceleration limit: ros2_control knows no limit of jerk."""
NO_LIMIT: Final = 1e3
"""rad: range of a continuous joint."""


@dataclass(frozen=True, slots=True)
class Arm:
    """One arm.

    Attributes:
        joints: names, in the order of the device.
        limits: one for each joint.
        chain: geometry, None where no URDF is given.
        tool: limits of the tool, None without a chain.
    """

    joints: tuple[str, ...]
    limits: tuple[JointLimits, ...]
    chain: Chain | None = None
    tool: CartesianLimits | None = None


def load_arm(config: Ros2ControlConfig) -> Arm:
    """Return the joints that a configuration names.

    Raises:
        ConfigError: there are none, or its URDF cannot be used.
    """
    if config.urdf is not None:
        return _of_urdf(config, Path(config.urdf).expanduser())
    if not config.joints:
        raise ConfigError(
            "there are no joints",
            where="ros2-control",
            remedy="Name them in a file (--config) under joints, or give the robot's --urdf; "
            "`crtk-driver ros2-control describe` writes both from what the robot tells.",
        )
    limits = tuple(
        JointLimits(
            joint.lower,
            joint.upper,
            joint.velocity,
            joint.acceleration,
            joint.acceleration / RISE_TIME,
            joint.effort,
        )
        for joint in config.joints
    )
    return Arm(tuple(joint.name for joint in config.joints), limits)


def _of_urdf(config: Ros2ControlConfig, path: Path) -> Arm:
    document = read_document(path)
    chain = parse_urdf(document, base=config.base_link, tip=config.tip_link, where=str(path))
    rates = joint_rates(document, chain.names, where=str(path))
    limits = []
    for joint in chain.joints:
        rate = rates.get(joint.name)
        if rate is None or not 0.0 < rate.velocity < math.inf:
            raise ConfigError(
                f"joint {joint.name} has no limit of velocity above zero",
                where=str(path),
                remedy='Add <limit velocity="..."/> to it.',
            )
        limits.append(
            JointLimits(
                max(joint.lower, -NO_LIMIT),
                min(joint.upper, NO_LIMIT),
                rate.velocity,
                config.acceleration,
                config.acceleration / RISE_TIME,
                max(rate.effort, 0.0),
            )
        )
    tool = CartesianLimits(**config.tool_limits.model_dump())
    return Arm(chain.names, tuple(limits), chain, tool)
