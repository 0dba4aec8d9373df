"""What a gripper tells of itself: its parameters, and the models as data. Pure: no I/O.

Source: parameter list of the firmware; SCHUNK's driver library (module_types.json). A PROFINET module has
big-endian numbers, here as in its process image.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, NamedTuple

from crtk_driver_schunk.gripper.image import Order

__all__ = ["ASKED", "MODELS", "Described", "Parameter", "describe"]

PROFINET: Final = 1
FIELDBUSES: Mapping[int, str] = MappingProxyType(
    {PROFINET: "PROFINET", 2: "EtherNet/IP", 3: "EtherCAT", 7: "Modbus RTU"}
)


class Parameter(NamedTuple):
    """Instance, and the size of its value in bytes; one byte comes alone, or with another in a register."""

    instance: int
    size: int


ASKED: Mapping[str, Parameter] = MappingProxyType(
    {
        "fieldbus": Parameter(0x1130, 1),
        "model": Parameter(0x0500, 1),
        "lower": Parameter(0x0600, 4),
        "upper": Parameter(0x0608, 4),
        "speed": Parameter(0x0630, 4),
        "max_force": Parameter(0x0660, 4),
        "serial": Parameter(0x1000, 16),
        "firmware": Parameter(0x1118, 22),
    }
)
"""What is asked for when it is connected, by name: positions in mm, speed in mm/s, force in N."""

_FAMILIES: Final = (
    (6, "EGU", (50, 60, 70, 80), ("N_B", "M_B")),
    (14, "EGK", (25, 40, 50), ("N_B", "M_B")),
    (20, "EGU", (50, 60, 70, 80), ("N_SD", "M_SD")),
    (28, "EZU", (30, 35, 40), ("N_B", "M_B", "N_SD", "M_SD")),
)
MODELS: Mapping[int, str] = MappingProxyType(
    {
        first + len(sizes) * group + at: f"{family} {size} {suffix.replace('_', '-')}"
        for first, family, sizes, suffixes in _FAMILIES
        for group, suffix in enumerate(suffixes)
        for at, size in enumerate(sizes)
    }
)
"""By module type. M has a brake, N has none."""


@dataclass(frozen=True, slots=True)
class Described:
    """What a gripper says it is.

    Attributes:
        order: of its bytes.
        model, fieldbus, serial, firmware: for people.
        lower, upper: of its positions, in m.
        speed: the greatest, in m/s.
        max_force: in N.
    """

    order: Order
    model: str
    fieldbus: str
    lower: float
    upper: float
    speed: float
    max_force: float
    serial: str
    firmware: str

    @property
    def has_brake(self) -> bool:
        """Whether it keeps grip and position without power."""
        return " M-" in self.model


def describe(told: Mapping[str, bytes]) -> Described:
    """Return what the values of `ASKED` say.

    Raises:
        ValueError: a value has another size, or is no number.
    """
    for name, (instance, size) in ASKED.items():
        if len(told[name]) < size:
            raise ValueError(f"{len(told[name])} bytes as parameter {instance:#06x}, not {size}")
    bus, kind = told["fieldbus"][0], told["model"][0]
    order: Order = ">" if bus == PROFINET else "<"
    numbers = {
        name: struct.unpack(f"{order}f", told[name][:4])[0]
        for name in ("lower", "upper", "speed", "max_force")
    }
    lower, upper, speed, force = numbers.values()
    if not (-1e4 < lower < upper < 1e4 and 0.0 < speed < 1e4 and 0.0 < force < 1e5):
        raise ValueError(f"a range of {lower:g} to {upper:g} mm, {speed:g} mm/s and {force:g} N")
    return Described(
        order,
        MODELS.get(kind, f"module type {kind}"),
        FIELDBUSES.get(bus, f"fieldbus {bus}"),
        1e-3 * lower,
        1e-3 * upper,
        1e-3 * speed,
        force,
        _text(told["serial"]),
        _text(told["firmware"]),
    )


def _text(value: bytes) -> str:
    return value.split(b"\0")[0].decode("ascii", "replace").strip()
