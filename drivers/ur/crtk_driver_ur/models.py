"""The arms that this driver knows, as a table.

Lengths in metres, angles in radians, torques in N·m, masses in kilograms.

Sources: Universal Robots, "DH parameters for calculations of kinematics and dynamics"; "Max. joint
torques"; the joint limits of Universal_Robots_ROS2_Description (`config/<model>/joint_limits.yaml`).
The description package halves the range of the elbow to help motion planners; here it has the
controller's own range, ±360°.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TypeAlias

__all__ = ["JOINT_NAMES", "MODELS", "Generation", "Limits", "RobotModel", "model_named"]

JOINT_NAMES = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
"""Joint names from base to flange, as in the manufacturer's robot description."""

Vector6: TypeAlias = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class Limits:
    """Lower and upper bound of each joint; unlimited joints have infinite bounds."""

    lower: Vector6
    upper: Vector6


@dataclass(frozen=True, slots=True)
class Generation:
    """What all arms of one controller generation have in common."""

    name: str
    frequency: float
    """Control rate in hertz, which is also the highest RTDE rate."""


CB3 = Generation("CB3", 125.0)
E_SERIES = Generation("e-Series", 500.0)


@dataclass(frozen=True, slots=True)
class RobotModel:
    """Kinematic constants and limits of one arm.

    The link geometry is standard Denavit-Hartenberg with the twists π/2, 0, 0, π/2, -π/2, 0; all
    lengths that are not named are zero.
    """

    name: str
    generation: Generation
    d1: float
    a2: float
    a3: float
    d4: float
    d5: float
    d6: float
    position_limits: Limits
    velocity_limits: Vector6
    torque_limits: Vector6
    payload: float
    """That it is rated for."""

    @property
    def largest_payload(self) -> float:
        """That some software permits, in kg."""
        return _LARGER_PAYLOADS.get(self.name, self.payload)

    def limited_to(
        self, joints: Mapping[str, tuple[float | None, float | None, float | None]]
    ) -> RobotModel:
        """Return it with narrower limits: least and largest position, and speed, by name of the joint."""
        lower, upper = list(self.position_limits.lower), list(self.position_limits.upper)
        speeds = list(self.velocity_limits)
        for name, (least, most, speed) in joints.items():
            index = JOINT_NAMES.index(name)
            lower[index] = max(lower[index], -math.inf if least is None else least)
            upper[index] = min(upper[index], math.inf if most is None else most)
            speeds[index] = min(speeds[index], math.inf if speed is None else speed)
        return replace(
            self,
            position_limits=Limits(_six(lower), _six(upper)),
            velocity_limits=_six(speeds),
        )

    @property
    def frequency(self) -> float:
        """Control rate of the arm's controller in hertz."""
        return self.generation.frequency


# model: generation, (d1, a2, a3, d4, d5, d6), joint speeds in deg/s, joint torques, payload
_E, _C = E_SERIES, CB3
_TABLE: Mapping[str, tuple[Generation, Vector6, Vector6, Vector6, float]] = {
    "ur3": (
        _C,
        (0.1519, -0.24365, -0.21325, 0.11235, 0.08535, 0.0819),
        (180, 180, 180, 360, 360, 360),
        (56, 56, 28, 12, 12, 12),
        3.0,
    ),
    "ur5": (
        _C,
        (0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823),
        (180, 180, 180, 180, 180, 180),
        (150, 150, 150, 28, 28, 28),
        5.0,
    ),
    "ur10": (
        _C,
        (0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922),
        (120, 120, 180, 180, 180, 180),
        (330, 330, 150, 56, 56, 56),
        10.0,
    ),
    "ur3e": (
        _E,
        (0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921),
        (180, 180, 180, 360, 360, 360),
        (54, 54, 28, 9, 9, 9),
        3.0,
    ),
    "ur5e": (
        _E,
        (0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
        (180, 180, 180, 180, 180, 180),
        (150, 150, 150, 28, 28, 28),
        5.0,
    ),
    "ur10e": (
        _E,
        (0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
        (120, 120, 180, 180, 180, 180),
        (330, 330, 150, 54, 54, 54),
        12.5,
    ),
    "ur16e": (
        _E,
        (0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655),
        (120, 120, 180, 180, 180, 180),
        (330, 330, 150, 54, 54, 54),
        16.0,
    ),
    "ur20": (
        _E,
        (0.2363, -0.862, -0.7287, 0.201, 0.1593, 0.1543),
        (120, 120, 150, 210, 210, 210),
        (738, 738, 433, 107, 107, 107),
        20.0,
    ),
    "ur30": (
        _E,
        (0.2363, -0.637, -0.5037, 0.201, 0.1593, 0.1543),
        (120, 120, 150, 210, 210, 210),
        (730, 730, 430, 100, 100, 100),
        30.0,
    ),
}

_LARGER_PAYLOADS: Mapping[str, float] = MappingProxyType({"ur20": 25.0, "ur30": 35.0})
"""Of arms whose newer software permits more than they were rated for first."""

_ENDLESS_WRIST_3 = {"ur3", "ur3e"}


def _six(values: Sequence[float]) -> Vector6:
    a, b, c, d, e, f = values
    return a, b, c, d, e, f


def _model(name: str) -> RobotModel:
    generation, (d1, a2, a3, d4, d5, d6), speeds, torques, payload = _TABLE[name]
    turn = 2 * math.pi
    last = math.inf if name in _ENDLESS_WRIST_3 else turn
    v1, v2, v3, v4, v5, v6 = (math.radians(speed) for speed in speeds)
    return RobotModel(
        name=name,
        generation=generation,
        d1=d1,
        a2=a2,
        a3=a3,
        d4=d4,
        d5=d5,
        d6=d6,
        position_limits=Limits(
            (-turn, -turn, -turn, -turn, -turn, -last), (turn, turn, turn, turn, turn, last)
        ),
        velocity_limits=(v1, v2, v3, v4, v5, v6),
        torque_limits=torques,
        payload=payload,
    )


MODELS: Mapping[str, RobotModel] = MappingProxyType({name: _model(name) for name in _TABLE})
"""Every supported arm by its lower-case name."""


def model_named(name: str) -> RobotModel:
    """Return the model called `name`, in any case.

    Raises:
        ValueError: no such model; the text lists those there are.
    """
    try:
        return MODELS[name.lower()]
    except KeyError:
        raise ValueError(
            f"there is no Universal Robots model {name!r}; choose one of {', '.join(MODELS)}"
        ) from None
