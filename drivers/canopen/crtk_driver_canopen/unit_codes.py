"""What the words of SI unit objects mean (60A8h, 60A9h, 60AAh): CiA 303-2 as data. No I/O.

A word has a power of ten, a numerator and a denominator, one byte each. CiA 402-2 uses B4h for a turn and B5h
for an increment; C0h for a turn a minute is maxon's, in the 60AAh of an EPOS4.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

TURN: Final = 2.0 * math.pi

ANGLES: Final[Mapping[int, float]] = MappingProxyType(
    {
        0x10: 1.0,
        0x40: TURN / 400.0,
        0x41: TURN / 360.0,
        0x42: TURN / 360.0 / 60.0,
        0x43: TURN / 360.0 / 3600.0,
        0xB4: TURN,
    }
)
"""Radian, gradian, degree, minute and second of arc, turn, in rad."""

LENGTHS: Final[Mapping[int, float]] = MappingProxyType({0x01: 1.0, 0xC1: 0.0254, 0xC2: 0.3048})
"""Metre, inch, foot, in m."""

COUNTS: Final = frozenset({0x00, 0xB5})
"""No unit, and increments: what positions count in."""

_TIMES: Final[Mapping[int, float]] = MappingProxyType(
    {0x03: 1.0, 0x47: 60.0, 0x48: 3600.0, 0x49: 86_400.0}
)
"""Second, minute, hour, day, in s."""

_SQUARE_SECOND: Final = 0x57
_TURNS_A_MINUTE: Final = 0xC0


class Unit(NamedTuple):
    """A unit object taken apart."""

    factor: float
    numerator: int
    denominator: int


class Rate(NamedTuple):
    """A unit of velocity or acceleration: a factor, of what, and for how long."""

    factor: float
    numerator: int
    seconds: float


def unit_of(word: int) -> Unit:
    """Return power of ten, numerator and denominator of a unit object."""
    prefix = word >> 24 & 0xFF
    return Unit(
        10.0 ** (prefix - 256 if prefix > 127 else prefix), word >> 16 & 0xFF, word >> 8 & 0xFF
    )


def _numerator_is_known(numerator: int) -> bool:
    return numerator in ANGLES or numerator in LENGTHS or numerator in COUNTS


def velocity_of(word: int) -> Rate | None:
    """Return what 60A9h says; None where it says nothing that is understood."""
    unit = unit_of(word)
    seconds = _TIMES.get(unit.denominator)
    if seconds is None or not _numerator_is_known(unit.numerator):
        return None
    return Rate(unit.factor, unit.numerator, seconds)


def acceleration_of(word: int) -> Rate | None:
    """Return what 60AAh says, with the square of its time; None where that is not understood.

    Makes write a second squared (57h), or a second alone and mean the same.
    """
    unit = unit_of(word)
    seconds = _TIMES.get(unit.denominator)
    if unit.numerator == _TURNS_A_MINUTE and seconds is not None:
        return Rate(unit.factor, 0xB4, 60.0 * seconds)
    if not _numerator_is_known(unit.numerator):
        return None
    if unit.denominator == _SQUARE_SECOND:
        return Rate(unit.factor, unit.numerator, 1.0)
    return None if seconds is None else Rate(unit.factor, unit.numerator, seconds * seconds)
