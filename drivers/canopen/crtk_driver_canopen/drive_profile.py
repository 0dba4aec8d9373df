"""What drives of one make do otherwise than CiA 402 says: a table for each make, chosen by name or by 1018h.

A table is a TOML file, of this package (`drive_profiles`) or of the user; ``crtk-driver canopen profile``
writes a first one from an EDS.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Final, Literal

from pydantic import Field, field_validator

from crtk_driver_canopen.identity import Identity
from crtk_driver_canopen.modes import MODES, OpMode
from crtk_driver_canopen.objects import OBJECTS, Entry, ObjectType, parse_object
from crtk_drivers.config import Settings, from_file, load

AUTO: Final = "auto"
NONE: Final = "none"

LONGEST_NAME: Final = 80
"""Characters of the name of a make."""

_FOLDER: Final = Path(__file__).parent / "drive_profiles"
_U32: Final = 0xFFFFFFFF
_CODES: Final = re.compile(r"(?P<first>[0-9a-f]{4})(-(?P<last>[0-9a-f]{4}))?", re.IGNORECASE)

ModeText = Literal["pp", "pv", "tq", "hm", "ip", "csp", "csv", "cst"]
TypeText = Literal["i8", "i16", "i32", "u8", "u16", "u32"]


class IdentityRow(Settings):
    """By which a drive is known (1018h)."""

    vendor: int = Field(default=0, ge=0, le=_U32, description="Vendor id (1018h:1); 0: not told.")
    products: tuple[int, ...] = Field(default=(), description="Product codes (1018h:2).")
    product_mask: int = Field(
        default=_U32, ge=0, le=_U32, description="Bits of the product code that count."
    )
    names: tuple[str, ...] = Field(
        default=(),
        description="What its device name (1008h) begins with, whatever its product code.",
    )


class ObjectRow(Settings):
    """An object of the maker's own that stands for one of CiA 402."""

    object: str = Field(max_length=200, description="INDEX[:SUB] in hexadecimal.")
    type: TypeText = Field(default="u32", description="Its type.")
    factor: float = Field(
        default=1.0, gt=0.0, le=1e9, description="What one unit of it is in those of the standard."
    )

    @field_validator("object")
    @classmethod
    def _an_object(cls, text: str) -> str:
        parse_object(text)
        return text

    def entry(self, name: str) -> Entry:
        """The object, with its type."""
        index, sub = parse_object(self.object)
        return Entry(index, sub, ObjectType[self.type.upper()], name)


class MotorRow(Settings):
    """Objects of the maker's own from which the rated torque follows, in any unit of 6076h."""

    current: ObjectRow = Field(description="Rated current; factor: A for one unit.")
    constant: ObjectRow = Field(description="Torque constant; factor: N·m/A for one unit.")


class VelocityRow(Settings):
    """What one unit of a velocity is."""

    one: float = Field(gt=0.0, le=1e9, description="How many of `unit` it is.")
    unit: Literal["counts/s", "turns/s", "turns/min"] = Field(
        description="Counts of positions (6064h), or turns of the motor."
    )


class AccelerationRow(Settings):
    """What one unit of an acceleration is."""

    one: float = Field(gt=0.0, le=1e9, description="How many of `unit` it is.")
    unit: Literal["counts/s^2", "turns/s^2", "turns/min/s"] = Field(
        description="Counts of positions (6064h), or turns of the motor."
    )


class ErrorRow(Settings):
    """Error codes (603Fh, and of emergency messages) that mean one thing."""

    codes: str = Field(description="One code or a range, in hexadecimal: 7320 or 1080-1083.")
    text: str = Field(min_length=1, max_length=200, description="What it means.")
    home_lost: bool = Field(
        default=False, description="The drive does not know its position any more."
    )

    @field_validator("codes")
    @classmethod
    def _a_range(cls, text: str) -> str:
        match = _CODES.fullmatch(text)
        if match is None or int(match["first"], 16) > int(match["last"] or match["first"], 16):
            raise ValueError(f"{text!r} is no code or range of codes: 7320, or 1080-1083")
        return text

    def holds(self, code: int) -> bool:
        """Whether a code is one of them."""
        first, _, last = self.codes.partition("-")
        return int(first, 16) <= code <= int(last or first, 16)


class DriveProfile(Settings):
    """What the drives of one make do otherwise; the defaults are those of CiA 402."""

    name: str = Field(
        default="CiA 402", min_length=1, max_length=LONGEST_NAME, description="Of the make."
    )
    identity: IdentityRow = Field(default=IdentityRow(), description="By which it is known.")
    modes: tuple[ModeText, ...] = Field(
        default=(), description="Modes that the drive has although 6502h does not name them."
    )
    home_position: ObjectRow | None = Field(
        default=None,
        description="What it counts at the home point, where that is not the home offset (607Ch).",
    )
    increments: ObjectRow | None = Field(
        default=None,
        description="From which the counts of a turn of the motor follow, where there is no 608Fh.",
    )
    velocity_unit: int | None = Field(
        default=None, ge=0, le=_U32, description="Unit of velocities where there is no 60A9h."
    )
    velocity: VelocityRow | None = Field(
        default=None,
        description="What one unit of commanded velocities (60FFh, 6081h, 6099h) is, where there is no "
        "60A9h.",
    )
    measured_velocity: VelocityRow | None = Field(
        default=None,
        description="What one unit of the measured velocity (606Ch) is, where it is another.",
    )
    acceleration: AccelerationRow | None = Field(
        default=None,
        description="What one unit of accelerations (6083h, 6084h, 609Ah) is, where there is no 60AAh.",
    )
    ramp_time: float | None = Field(
        default=None,
        gt=0.0,
        le=1.0,
        description="s for one unit of 6083h and 6084h, where they are the times of ramps.",
    )
    rated_torque_unit: float = Field(
        default=1e-3, gt=0.0, le=1.0, description="N·m for one unit of the rated torque (6076h)."
    )
    motor: MotorRow | None = Field(
        default=None, description="From which its rated torque follows, whatever 6076h counts in."
    )
    errors: tuple[ErrorRow, ...] = Field(default=(), description="Its error codes.")
    notes: tuple[str, ...] = Field(
        default=(), description="What else is odd about it, for people who read this file."
    )

    @property
    def more_modes(self) -> frozenset[OpMode]:
        """Modes that it has besides those of 6502h."""
        return frozenset(mode for mode in MODES if mode.name.lower() in self.modes)

    @property
    def home_entry(self) -> Entry:
        """The object that takes what the drive counts at the home point."""
        if self.home_position is None:
            return OBJECTS["home_offset"]
        return self.home_position.entry("home position")

    def error(self, code: int) -> ErrorRow | None:
        """Return what an error code means to this make; None where it has no meaning of its own."""
        return next((row for row in self.errors if row.holds(code)), None)

    def is_of(self, identity: Identity) -> bool:
        """Whether a node is one of these drives."""
        row = self.identity
        product = identity.product
        if not row.vendor or identity.vendor != row.vendor:
            return False
        return identity.name.startswith(row.names or ("\0",)) or (
            product is not None
            and any((product ^ each) & row.product_mask == 0 for each in row.products)
        )


PLAIN: Final = DriveProfile()
"""A drive that does what CiA 402 says."""


@cache
def built_in() -> Mapping[str, DriveProfile]:
    """Return the profiles of this package, by name of their file."""
    return {path.stem: load(DriveProfile, from_file(path)) for path in _FOLDER.glob("*.toml")}


def named(name: str) -> DriveProfile | None:
    """Return a profile by what a configuration says; None for ``auto``.

    Args:
        name: ``auto``, ``none``, one of this package, or the path of a TOML file.

    Raises:
        ConfigError: the file cannot be read, or is wrong, with its line.
    """
    if name == AUTO:
        return None
    if name == NONE:
        return PLAIN
    known = built_in().get(name)
    return load(DriveProfile, from_file(name)) if known is None else known


def of_identity(identity: Identity) -> DriveProfile:
    """Return the profile of a node by who it is; that of CiA 402 where none is known."""
    return next((each for each in built_in().values() if each.is_of(identity)), PLAIN)


def kin(identity: Identity) -> str:
    """Return the name of a profile for other products of a node's maker; empty if there is none."""
    return next(
        (
            name
            for name, each in built_in().items()
            if each.identity.vendor and each.identity.vendor == identity.vendor
        ),
        "",
    )
