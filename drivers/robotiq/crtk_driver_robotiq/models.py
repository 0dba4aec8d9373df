"""The grippers as data: instruction manuals of 2F-85/2F-140 and of Hand-E, SDK device profiles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

__all__ = ["MODELS", "Model"]


@dataclass(frozen=True, slots=True)
class Model:
    """One model.

    Attributes:
        title: for people.
        stroke: opening from closed to open, in m.
        angle: through which a finger's knuckle turns meanwhile, in rad; 0: it has none.
        speeds: of the opening that counts 0 and 255 of rSP mean, in m/s.
        forces: of the grip that counts 0 and 255 of rFR mean, in N, as the specification has them. They
            count for hard things, slowly: the manual says that they cannot be converted exactly.
    """

    title: str
    stroke: float
    angle: float
    speeds: tuple[float, float]
    forces: tuple[float, float]


MODELS: Mapping[str, Model] = MappingProxyType(
    {
        "2f-85": Model("2F-85", 0.085, 0.8, (0.020, 0.150), (20.0, 235.0)),
        "2f-140": Model("2F-140", 0.140, 0.7, (0.030, 0.250), (10.0, 125.0)),
        "hand-e": Model("Hand-E", 0.050, 0.0, (0.020, 0.150), (20.0, 185.0)),
    }
)
