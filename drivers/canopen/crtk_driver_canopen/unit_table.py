"""Where the unit of each object comes from, as data: key, what the drive reports, profile, else.

`crtk_driver_canopen.units` looks in this order, and errors and diagnostics name what is written here.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Final, NamedTuple


class Quantity(StrEnum):
    """What objects of a drive count."""

    POSITION = "position"
    VELOCITY = "velocity"
    MEASURED_VELOCITY = "measured velocity"
    ACCELERATION = "acceleration"
    EFFORT = "torque"
    MEASURED_EFFORT = "measured torque"


class UnitSource(NamedTuple):
    """Where one unit comes from; the first that is there counts.

    Attributes:
        objects: that count in it.
        keys: of a joint that give it outright.
        reported: objects by which the drive reports it.
        profile: keys of the profile of its make.
        otherwise: what it is taken for where nobody says.
    """

    objects: str
    keys: tuple[str, ...]
    reported: str
    profile: tuple[str, ...]
    otherwise: str


UNITS: Final[dict[Quantity, UnitSource]] = {
    Quantity.POSITION: UnitSource(
        "6064h, 607Ah, 607Ch, 607Dh",
        ("scale", "counts_per_turn", "gear", "feed"),
        "60A8h, 608Fh, 6091h, 6092h",
        ("increments",),
        "refused",
    ),
    Quantity.VELOCITY: UnitSource(
        "60FFh, 607Fh, 6081h, 6099h",
        ("velocity_scale",),
        "60A9h",
        ("velocity", "velocity_unit"),
        "position units a second, which is noted",
    ),
    Quantity.MEASURED_VELOCITY: UnitSource(
        "606Ch",
        ("measured_velocity_scale",),
        "60A9h",
        ("measured_velocity",),
        "as 60FFh, and compared with the positions of the first moves",
    ),
    Quantity.ACCELERATION: UnitSource(
        "6083h, 6084h, 609Ah",
        ("acceleration_scale", "ramp_time_scale"),
        "60AAh",
        ("acceleration", "ramp_time"),
        "velocity units a second, which is noted; refused beside `velocity_scale`",
    ),
    Quantity.EFFORT: UnitSource(
        "6071h",
        ("effort_scale", "rated_torque"),
        "6076h",
        ("rated_torque_unit",),
        "thousandths of 6076h in mN·m; without 6076h refused where efforts are taken",
    ),
    Quantity.MEASURED_EFFORT: UnitSource("6077h", ("measured_effort_scale",), "", (), "as 6071h"),
}
"""By quantity."""


def keys_text(quantity: Quantity) -> str:
    """Return the keys that give a unit, for a remedy: ``acceleration_scale` or `ramp_time_scale``."""
    return " or ".join(f"`{key}`" for key in UNITS[quantity].keys)
