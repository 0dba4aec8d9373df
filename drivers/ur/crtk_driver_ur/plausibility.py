"""What an arm can carry, and how gravity can point: what is not so is refused before it is sent.

The controller balances the arm by these numbers: one that the arm cannot have lets it sink or rise by itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from crtk_driver_ur.models import RobotModel

__all__ = ["STANDARD_GRAVITY", "UPRIGHT", "gravity_problem", "payload_problem", "tilt_problem"]

STANDARD_GRAVITY: Final = 9.82
"""m/s², as the controller has it by default."""

UPRIGHT: Final = (0.0, 0.0, STANDARD_GRAVITY)
"""Of an arm that stands on the ground."""

ON_EARTH: Final = (9.7, 9.9)
"""m/s² that can be."""

LARGEST_TILT: Final = math.radians(45.0)
"""By which gravity may be turned at once: more is another mounting, which belongs in the configuration."""

FARTHEST_CENTER: Final = 1.0
"""m of a centre of gravity from the flange."""

LARGEST_RADIUS: Final = 1.0
"""m, radius of gyration of a payload."""

MEASURED: Final = 1.05
"""A moment of inertia may be larger than the sum of the others by what a measurement is wrong."""

ROUNDING: Final = 1e-9


def payload_problem(
    model: RobotModel, mass: float, center: Sequence[float], inertia: Sequence[float] | None
) -> str:
    """Return why `model` cannot carry that; empty if it can.

    Args:
        model: the arm.
        mass: kg.
        center: of gravity from the flange, m (3).
        inertia: about it: xx, yy, zz, xy, xz, yz, kg m² (6), or None.
    """
    if not 0.0 <= mass <= model.largest_payload:
        return f"a {model.name} carries 0 to {model.largest_payload:g} kg, not {mass:g} kg"
    distance = math.hypot(*center)
    if not distance <= FARTHEST_CENTER:
        return f"its centre of gravity is {distance:g} m from the flange"
    torque, most = mass * STANDARD_GRAVITY * distance, model.torque_limits[-1]
    if not torque <= most:
        return (
            f"{mass:g} kg, {distance:g} m from the flange, load the wrist with {torque:.3g} N·m, "
            f"and it holds {most:g} N·m"
        )
    return "" if inertia is None else _inertia_problem(mass, inertia)


def _inertia_problem(mass: float, inertia: Sequence[float]) -> str:
    xx, yy, zz, xy, xz, yz = inertia
    if not all(map(math.isfinite, inertia)):
        return "the inertia is not finite"
    moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    least, middle, most = moments.tolist()
    if least < -ROUNDING or most > MEASURED * (least + middle) + ROUNDING:
        return f"no body has the principal moments of inertia {least:.3g}, {middle:.3g}, {most:.3g} kg m²"
    if most > mass * LARGEST_RADIUS**2 + ROUNDING:
        return f"a moment of inertia of {most:.3g} kg m² is too much for {mass:g} kg"
    return ""


def gravity_problem(gravity: Sequence[float]) -> str:
    """Return why there is no such gravity (3, m/s²); empty if there is."""
    least, most = ON_EARTH
    size = math.hypot(*gravity)
    return "" if least <= size <= most else f"gravity is {least:g} to {most:g} m/s², not {size:g}"


def tilt_problem(before: Sequence[float], gravity: Sequence[float]) -> str:
    """Return why gravity (3, m/s²) cannot change from `before`; empty if it can."""
    cosine = np.dot(before, gravity) / (math.hypot(*before) * math.hypot(*gravity))
    angle = math.acos(max(-1.0, min(1.0, float(cosine))))
    if angle <= LARGEST_TILT:
        return ""
    return (
        f"gravity is turned by {math.degrees(angle):.0f}° from what it was; if the arm is mounted so, set "
        "`gravity` in the configuration"
    )
