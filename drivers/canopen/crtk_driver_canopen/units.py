"""Between what drives count in and SI, for one joint and for a whole arm.

A drive counts positions in increments or in units of its own, velocities in those per second or in what
its unit object (60A9) says, and torques in thousandths of the rated torque (6076). What is not configured
is read from the drive: encoder resolution 608F, gear ratio 6091, feed 6092, SI units 60A8 and 60A9, rated
torque 6076.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from crtk_driver_canopen.drive_profile import PLAIN, DriveProfile
from crtk_driver_canopen.objects import OBJECTS
from crtk_driver_canopen.sdo import Sdo
from crtk_drivers.errors import CommandRefused, ConfigError, Reason
from crtk_drivers.samples import Vector, vector

TURN: Final = 2.0 * math.pi

_ANGLES: Final[Mapping[int, float]] = MappingProxyType(
    {
        0x10: 1.0,
        0x41: TURN / 360.0,
        0x42: TURN / 360.0 / 60.0,
        0x43: TURN / 360.0 / 3600.0,
        0xB4: TURN,
    }
)
"""Radian, degree, minute and second of arc, revolution, in rad (CiA 303-2, notation indices)."""

_METRE: Final = 0x01
_TIMES: Final[Mapping[int, float]] = MappingProxyType({0x03: 1.0, 0x47: 60.0, 0x48: 3600.0})
"""Second, minute, hour, in s."""


@dataclass(frozen=True)
class UnitObjects:
    """What a drive tells of its units; None: it has no such object.

    Attributes:
        encoder: increments for one turn of the motor (608F).
        gear: turns of the motor for one of the shaft (6091).
        feed: position units for one turn of the shaft (6092).
        position_unit: (60A8).
        velocity_unit: (60A9).
        rated_torque: of the motor, in N·m (6076).
    """

    encoder: float | None = None
    gear: float | None = None
    feed: float | None = None
    position_unit: int | None = None
    velocity_unit: int | None = None
    rated_torque: float | None = None

    @override
    def __str__(self) -> str:
        known = {each.name: getattr(self, each.name) for each in fields(self)}
        return ", ".join(
            f"{name.replace('_', ' ')} {value:#x}" if "unit" in name else f"{name} {value:g}"
            for name, value in known.items()
            if value is not None
        )


def read_unit_objects(sdo: Sdo, profile: DriveProfile = PLAIN) -> UnitObjects:
    """Return what a drive tells of its units.

    Args:
        sdo: of its axis.
        profile: of its make: what tells the same where the objects of CiA 402 are not there.

    Raises:
        SdoAborted, SdoSilent, ProtocolError: an object could not be read, for another reason than that the
            drive does not have it.
    """

    def ratio(numerator: str, denominator: str) -> float | None:
        above, below = sdo.find(OBJECTS[numerator]), sdo.find(OBJECTS[denominator])
        return above / (below or 1) if above else None

    def counts() -> float | None:
        row = profile.increments
        told = None if row is None else sdo.find(row.entry("encoder"))
        return None if row is None or not told else told * row.factor

    rated = sdo.find(OBJECTS["motor_rated_torque"])
    velocity_unit = sdo.find(OBJECTS["si_unit_velocity"])
    return UnitObjects(
        encoder=ratio("encoder_increments", "encoder_motor_revolutions") or counts(),
        gear=ratio("gear_motor_revolutions", "gear_shaft_revolutions"),
        feed=ratio("feed", "feed_shaft_revolutions"),
        position_unit=sdo.find(OBJECTS["si_unit_position"]),
        velocity_unit=profile.velocity_unit if velocity_unit is None else velocity_unit,
        rated_torque=rated * profile.rated_torque_unit if rated else None,
    )


class _Unit(NamedTuple):
    """A unit object taken apart: prefix, numerator, denominator."""

    factor: float
    numerator: int
    denominator: int


def _unit(word: int) -> _Unit:
    prefix = word >> 24 & 0xFF
    return _Unit(
        10.0 ** (prefix - 256 if prefix > 127 else prefix), word >> 16 & 0xFF, word >> 8 & 0xFF
    )


class JointScale(Protocol):
    """What the configuration of a joint says of its units; see `crtk_driver_canopen.config.JointConfig`."""

    @property
    def kind(self) -> str: ...  # noqa: D102
    @property
    def scale(self) -> float | None: ...  # noqa: D102
    @property
    def velocity_scale(self) -> float | None: ...  # noqa: D102
    @property
    def counts_per_turn(self) -> float | None: ...  # noqa: D102
    @property
    def gear(self) -> float | None: ...  # noqa: D102
    @property
    def feed(self) -> float | None: ...  # noqa: D102
    @property
    def sign(self) -> int: ...  # noqa: D102
    @property
    def offset(self) -> float: ...  # noqa: D102
    @property
    def rated_torque(self) -> float | None: ...  # noqa: D102


@dataclass(frozen=True)
class JointUnits:
    """Units of one joint, with its sign in them.

    Attributes:
        position: rad (m) for one position unit of the drive.
        offset: position of the joint where the drive counts 0, in rad (m).
        velocity: rad/s (m/s) for one velocity unit.
        effort: N·m (N) for one thousandth of the rated torque; NaN if that is not known.
    """

    position: float
    offset: float
    velocity: float
    effort: float


def resolve(name: str, joint: JointScale, drive: UnitObjects) -> JointUnits:
    """Return the units of a joint, from its configuration and what its drive tells.

    Args:
        name: of the joint.
        joint: its configuration.
        drive: what the drive tells.

    Raises:
        ConfigError: they do not say how far the joint moves for one count.
    """
    gear = joint.gear or drive.gear or 1.0
    position = _position(name, joint, drive, gear)
    velocity = joint.velocity_scale
    if velocity is None:
        velocity = _velocity(joint, drive, gear) or position
    rated = drive.rated_torque if joint.rated_torque is None else joint.rated_torque
    effort = math.nan if rated is None else rated / 1000.0 * gear
    if joint.kind == "prismatic" and joint.feed:
        effort *= TURN / joint.feed
    sign = joint.sign
    return JointUnits(sign * position, joint.offset, sign * velocity, sign * effort)


def _position(name: str, joint: JointScale, drive: UnitObjects, gear: float) -> float:
    """Return rad (m) for one position unit."""
    if joint.scale is not None:
        return joint.scale
    if joint.counts_per_turn is None and drive.position_unit:
        unit = _unit(drive.position_unit)
        if unit.numerator in _ANGLES and joint.kind == "revolute":
            # Of the drive's own shaft, behind the gear that it knows of.
            return unit.factor * _ANGLES[unit.numerator] * (drive.gear or 1.0) / gear
        if unit.numerator == _METRE and joint.kind == "prismatic":
            return unit.factor
    turn = TURN if joint.kind == "revolute" else joint.feed
    if turn is None:
        raise ConfigError(
            "a prismatic joint needs to know how far it moves with one turn",
            where=f"joints.{name}",
            remedy="Give `feed` in m for a turn, or `scale` in m for a count.",
        )
    counts = joint.counts_per_turn or _motor_counts(drive)
    if counts is None:
        raise ConfigError(
            "the drive does not tell its encoder resolution (608Fh)",
            where=f"joints.{name}",
            remedy="Give `counts_per_turn` of the motor and `gear`, or `scale` in rad for a count.",
        )
    return turn / (counts * gear)


def _motor_counts(drive: UnitObjects) -> float | None:
    """Return position units for one turn of the motor: feed / gear (CiA 402-2), where a feed is set."""
    if drive.feed is not None and drive.feed > 1.0:
        return drive.feed / (drive.gear or 1.0)
    return drive.encoder


def _velocity(joint: JointScale, drive: UnitObjects, gear: float) -> float | None:
    """Return rad/s (m/s) for one unit of 60A9; None if it is none that is known, as increments are not."""
    unit = _unit(drive.velocity_unit or 0)
    seconds = _TIMES.get(unit.denominator)
    if seconds is None:
        return None
    if unit.numerator == _METRE and joint.kind == "prismatic":
        return unit.factor / seconds
    angle = _ANGLES.get(unit.numerator)
    if angle is None or (joint.kind == "prismatic" and joint.feed is None):
        return None
    way = angle if joint.kind == "revolute" else angle * (joint.feed or 0.0) / TURN
    # Where positions are in a unit of the shaft, velocities are the shaft's; else they are the motor's.
    physical = drive.position_unit is not None and _unit(drive.position_unit).numerator in _ANGLES
    turns = gear / (drive.gear or 1.0) if physical else gear
    return unit.factor * way / seconds / turns


class JointRange(JointScale, Protocol):
    """What the configuration of a joint says of what it is sent."""

    @property
    def lower(self) -> float: ...  # noqa: D102
    @property
    def upper(self) -> float: ...  # noqa: D102
    @property
    def velocity(self) -> float: ...  # noqa: D102
    @property
    def effort(self) -> float: ...  # noqa: D102


def check_wire(name: str, joint: JointRange, units: JointUnits) -> None:
    """Refuse limits that do not fit into the integers that a drive is sent; what is NaN is not known.

    Raises:
        ConfigError: with the key, and what would fit.
    """
    ends = {
        key: (getattr(joint, key) - units.offset) / units.position for key in ("lower", "upper")
    }
    speed, effort = joint.velocity / units.velocity, joint.effort / units.effort
    rows = (
        *((key, counts, _I32, "target position (607Ah, 32 bits)") for key, counts in ends.items()),
        ("velocity", abs(speed), _I32, "target velocity (60FFh, 32 bits)"),
        (
            "effort",
            abs(effort),
            _I16,
            "target torque (6071h, 16 bits: 32.767 times the rated torque)",
        ),
    )
    for key, counts, (least, greatest), what in rows:
        if math.isinf(counts) or counts < least or counts > greatest:
            raise ConfigError(
                f"{getattr(joint, key):g} would be {counts:.6g} counts: too many for the drive's {what}",
                where=f"joints.{name}.{key}",
                remedy="Correct it, or the units of the joint (scale, counts_per_turn, gear, rated_torque).",
            )


def home_counts(position: float, units: JointUnits) -> int:
    """Return what a drive counts (6064) where its joint is at a position, in rad (m)."""
    return round((position - units.offset) / units.position)


_I32: Final = (-(2.0**31), 2.0**31 - 1)
_I16: Final = (-(2.0**15), 2.0**15 - 1)


def _toward_zero(counts: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.trunc(counts * _WHOLE)


_WHOLE: Final = 1.0 + 1e-12
"""What a quotient of floats may lack to a whole number."""


class GroupUnits:
    """Units of several joints at once; all vectors are in their order.

    Args:
        joints: units by name.
    """

    def __init__(self, joints: Mapping[str, JointUnits]) -> None:
        self.names = tuple(joints)
        units = joints.values()
        self._position = np.array([each.position for each in units])
        self._offset = np.array([each.offset for each in units])
        self._velocity = np.array([each.velocity for each in units])
        self._effort = np.array([each.effort for each in units])

    @property
    def velocity_steps(self) -> tuple[float, ...]:
        """One unit of each velocity, in rad/s (m/s)."""
        return tuple(np.abs(self._velocity).tolist())

    def positions(self, counts: Sequence[int]) -> Vector:
        """Return positions (n,) in rad (m)."""
        return vector(np.asarray(counts, dtype=float) * self._position + self._offset)

    def velocities(self, counts: Sequence[int]) -> Vector:
        """Return velocities (n,) in rad/s (m/s)."""
        return vector(np.asarray(counts, dtype=float) * self._velocity)

    def efforts(self, thousandths: Sequence[int]) -> Vector:
        """Return efforts (n,) in N·m (N); NaN where the rated torque is not known."""
        return vector(np.asarray(thousandths, dtype=float) * self._effort)

    def position_counts(self, positions: Vector) -> list[int]:
        """Return target positions (607A).

        Raises:
            CommandRefused: one does not fit into 32 bits, or is not finite.
        """
        return self._counts(positions - self._offset, self._position, _I32, "position", np.rint)

    def velocity_counts(self, velocities: Vector) -> list[int]:
        """Return target velocities (60FF), rounded towards 0: no limit is left by rounding.

        Raises:
            CommandRefused: one does not fit into 32 bits, or is not finite.
        """
        return self._counts(velocities, self._velocity, _I32, "velocity")

    def effort_counts(self, efforts: Vector) -> list[int]:
        """Return target torques (6071), rounded towards 0.

        Raises:
            CommandRefused: one does not fit into 16 bits, or is not finite, or the rated torque is not known.
        """
        return self._counts(efforts, self._effort, _I16, "effort")

    def _counts(
        self,
        wanted: NDArray[np.float64],
        units: NDArray[np.float64],
        bounds: tuple[float, float],
        what: str,
        rounded: Callable[[NDArray[np.float64]], NDArray[np.float64]] = _toward_zero,
    ) -> list[int]:
        with np.errstate(over="ignore", invalid="ignore"):
            values = wanted / units
            counts = rounded(values)
        good = (counts >= bounds[0]) & (counts <= bounds[1])  # False for NaN as well
        if not good.all():
            at = int(np.argmin(good))
            raise CommandRefused(
                what,
                Reason.OUT_OF_RANGE,
                f"{self.names[at]}: {what} of {values[at]:g} counts does not fit into the drive's object",
                remedy="Check the limits and units of the joint.",
            )
        return [int(count) for count in counts]


def interpolation_period(period: float) -> tuple[int, int]:
    """Return value and exponent of the interpolation time period (60C2) for a period in s.

    Raises:
        ValueError: it cannot be written as 1 to 255 times a power of ten.
    """
    for exponent in range(0, -7, -1):
        value = period * 10.0**-exponent
        rounded = round(value)
        if 1 <= rounded <= 255 and abs(value - rounded) < 1e-6 * value:
            return rounded, exponent
    raise ValueError(
        f"a period of {1e3 * period:g} ms is not 1 to 255 times a power of ten of a second, as the "
        "interpolation time period (60C2h) needs it"
    )
