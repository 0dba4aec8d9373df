"""Units as the sensors write them, their factors to SI, and what a count is worth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from typing_extensions import override

from crtk_drivers.samples import Vector, vector

_POUND = 4.4482216152605
_KILOGRAM = 9.80665

FORCE: Final[Mapping[str, float]] = MappingProxyType(
    {
        "lbf": _POUND,
        "n": 1.0,
        "klbf": 1000.0 * _POUND,
        "kn": 1000.0,
        "kgf": _KILOGRAM,
        "gf": _KILOGRAM / 1000.0,
    }
)
"""N in one of each; the order is that of the unit codes, which begin with 1."""

TORQUE: Final[Mapping[str, float]] = MappingProxyType(
    {
        "lbfin": 0.1129848290276167,
        "lbfft": 1.3558179483314004,
        "nm": 1.0,
        "nmm": 0.001,
        "kgfcm": _KILOGRAM / 100.0,
        "knm": 1000.0,
    }
)
"""N·m in one of each; the order is that of the unit codes, which begin with 1."""

LENGTH: Final[Mapping[str, float]] = MappingProxyType(
    {"in": 0.0254, "ft": 0.3048, "mm": 0.001, "cm": 0.01, "m": 1.0}
)
ANGLE: Final[Mapping[str, float]] = MappingProxyType({"deg": 0.017453292519943295, "rad": 1.0})

_SPELLINGS = {
    "lb": "lbf", "lbs": "lbf", "pounds": "lbf", "newton": "n", "newtons": "n", "klb": "klbf",
    "kg": "kgf", "g": "gf",
    "lbin": "lbfin", "inlb": "lbfin", "inlbf": "lbfin", "inlbs": "lbfin", "lbsin": "lbfin",
    "lbft": "lbfft", "ftlb": "lbfft", "ftlbf": "lbfft", "ftlbs": "lbfft", "lbsft": "lbfft",
    "mn": "nm", "mmn": "nmm", "kgcm": "kgfcm", "cmkg": "kgfcm",
    "inch": "in", "inches": "in", "feet": "ft", "millimeters": "mm", "meters": "m",
    "degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad",
}  # fmt: skip


def factor(units: Mapping[str, float], text: str) -> float | None:
    """Return how much of the SI unit one of `text` is; None if it is in no spelling one of `units`."""
    plain = "".join(letter for letter in text.lower() if letter.isalpha())
    return units.get(plain, units.get(_SPELLINGS.get(plain, "")))


def factor_of_code(units: Mapping[str, float], code: int) -> float | None:
    """Return the same for a unit code; None if there is none such."""
    return list(units.values())[code - 1] if 1 <= code <= len(units) else None


LEAST_COUNT: Final = 1e-12
MOST_COUNT: Final = 10.0
"""N or N·m that a count may be worth: 32 bits reach from there beyond 2 mN, or 20 GN."""


@dataclass(frozen=True, slots=True)
class Scale:
    """What a count is worth.

    Attributes:
        counts_per_force, counts_per_torque: per unit.
        force, torque: N and N·m in one unit.

    Raises:
        ValueError: no sensor's count is worth that.
    """

    counts_per_force: float
    counts_per_torque: float
    force: float = 1.0
    torque: float = 1.0

    def __post_init__(self) -> None:
        for name in ("counts_per_force", "counts_per_torque", "force", "torque"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} is {getattr(self, name)}, not above zero")
        for name, unit in (("force", "N"), ("torque", "N·m")):
            worth = getattr(self, name) / getattr(self, f"counts_per_{name}")
            if not LEAST_COUNT <= worth <= MOST_COUNT:
                raise ValueError(
                    f"a count would be worth {worth:.3g} {unit}, and is so in no sensor "
                    f"({LEAST_COUNT:g} to {MOST_COUNT:g})"
                )

    @override
    def __str__(self) -> str:
        force, torque = self.factors[[0, 3]].tolist()
        return f"{force:.6g} N and {torque:.6g} N·m a count"

    @property
    def factors(self) -> Vector:
        """SI value of one count of each axis (6,), in N and N·m."""
        force = self.force / self.counts_per_force
        torque = self.torque / self.counts_per_torque
        return vector([force] * 3 + [torque] * 3)
