"""The simulated models, as data (instruction manuals of 2F-85/140 and Hand-E, specifications)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Model:
    """Stroke in m; speeds in m/s and forces in N that counts 0 and 255 mean."""

    stroke: float
    speeds: tuple[float, float]
    forces: tuple[float, float]


MODELS: Final[Mapping[str, Model]] = {
    "2f-85": Model(0.085, (0.020, 0.150), (20.0, 235.0)),
    "2f-140": Model(0.140, (0.030, 0.250), (10.0, 125.0)),
    "hand-e": Model(0.050, (0.020, 0.150), (20.0, 185.0)),
}
