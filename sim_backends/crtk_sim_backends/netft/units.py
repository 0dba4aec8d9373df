"""Units of the sensor boxes: codes, names and factors, and what a count is worth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple


class Unit(NamedTuple):
    """One unit: its name on the web page, and how much of the SI unit one of it is."""

    name: str
    factor: float


FORCE: Final[Mapping[int, Unit]] = {
    1: Unit("lbf", 4.4482216152605),
    2: Unit("N", 1.0),
    3: Unit("klbf", 4448.2216152605),
    4: Unit("kN", 1000.0),
    5: Unit("kgf", 9.80665),
    6: Unit("gf", 0.00980665),
}
"""By code (ATI 9620-05-NET FT, TCP interface)."""

TORQUE: Final[Mapping[int, Unit]] = {
    1: Unit("lbf-in", 0.1129848290276167),
    2: Unit("lbf-ft", 1.3558179483314004),
    3: Unit("Nm", 1.0),
    4: Unit("Nmm", 0.001),
    5: Unit("kgf-cm", 0.0980665),
    6: Unit("kNm", 1000.0),
}
DISTANCE: Final[Mapping[int, Unit]] = {
    1: Unit("in", 0.0254),
    2: Unit("ft", 0.3048),
    3: Unit("mm", 0.001),
    4: Unit("cm", 0.01),
    5: Unit("m", 1.0),
}
ANGLE: Final[Mapping[int, Unit]] = {
    1: Unit("degrees", 0.017453292519943295),
    2: Unit("radians", 1.0),
}


def code_of(units: Mapping[int, Unit], name: str) -> int:
    """Code of the unit with a name."""
    return next(code for code, unit in units.items() if unit.name == name)
