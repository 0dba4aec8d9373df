"""Between what drives count in and SI, for one joint and for a whole arm.

Where each unit comes from is a table, `crtk_driver_canopen.unit_table`; none is guessed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from crtk_driver_canopen.drive_profile import PLAIN, DriveProfile
from crtk_driver_canopen.objects import OBJECTS
from crtk_driver_canopen.rate_units import RATES, MakeRate, Transmission
from crtk_driver_canopen.scale_keys import JointRange, JointScale
from crtk_driver_canopen.sdo import Sdo
from crtk_driver_canopen.unit_codes import (
    ANGLES,
    COUNTS,
    LENGTHS,
    TURN,
    acceleration_of,
    unit_of,
    velocity_of,
)
from crtk_driver_canopen.unit_table import UNITS, Quantity, keys_text
from crtk_drivers.errors import CommandRefused, ConfigError, Reason
from crtk_drivers.samples import Vector, vector


@dataclass(frozen=True)
class UnitObjects:
    """What a drive tells of its units; None: it has no such object.

    Attributes:
        encoder: increments for one turn of the motor (608F).
        gear: turns of the motor for one of the shaft (6091).
        feed: position units for one turn of the shaft (6092).
        position_unit: (60A8).
        velocity_unit: (60A9).
        acceleration_unit: (60AA).
        rated_torque: of the motor, in N·m (6076).
        make: what its make has where it has no such object.
    """

    encoder: float | None = None
    gear: float | None = None
    feed: float | None = None
    position_unit: int | None = None
    velocity_unit: int | None = None
    acceleration_unit: int | None = None
    rated_torque: float | None = None
    make: DriveProfile = PLAIN

    @override
    def __str__(self) -> str:
        known = {
            each.name: getattr(self, each.name) for each in fields(self) if each.name != "make"
        }
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

    def rated_torque() -> float | None:
        row = profile.motor
        if row is not None and "rated_torque_unit" not in profile.model_fields_set:
            current = sdo.find(row.current.entry("rated current"))
            constant = sdo.find(row.constant.entry("torque constant"))
            if current and constant:
                return current * row.current.factor * constant * row.constant.factor
        rated = sdo.find(OBJECTS["motor_rated_torque"])
        return rated * profile.rated_torque_unit if rated else None

    velocity_unit = sdo.find(OBJECTS["si_unit_velocity"])
    return UnitObjects(
        encoder=ratio("encoder_increments", "encoder_motor_revolutions") or counts(),
        gear=ratio("gear_motor_revolutions", "gear_shaft_revolutions"),
        feed=ratio("feed", "feed_shaft_revolutions"),
        position_unit=sdo.find(OBJECTS["si_unit_position"]),
        velocity_unit=velocity_unit or profile.velocity_unit,
        acceleration_unit=sdo.find(OBJECTS["si_unit_acceleration"]),
        rated_torque=rated_torque(),
        make=profile,
    )


@dataclass(frozen=True)
class JointUnits:
    """Units of one joint, with its sign in them.

    Attributes:
        position: rad (m) for one position unit of the drive.
        offset: position of the joint where the drive counts 0, in rad (m).
        velocity: rad/s (m/s) for one velocity unit.
        effort: N·m (N) for one unit of torque, a thousandth of the rated one; NaN if that is not known.
        measured_velocity: rad/s (m/s) for one unit of 606C; None: that of `velocity`.
        acceleration: rad/s² (m/s²) for one unit of 6083, 6084 and 609A; NaN: nobody tells it; None: one
            velocity unit a second.
        ramp_time: s for one unit of these objects where they are times; None: they are none.
        measured_effort: N·m (N) for one unit of 6077; None: that of `effort`.
        assumed: why a unit is not sure, because nobody tells it, in words.
    """

    position: float
    offset: float
    velocity: float
    effort: float
    measured_velocity: float | None = None
    acceleration: float | None = None
    ramp_time: float | None = None
    measured_effort: float | None = None
    assumed: Mapping[Quantity, str] = field(default_factory=dict)

    @property
    def acceleration_step(self) -> float:
        """rad/s² (m/s²) for one unit of acceleration, above 0; NaN if nobody tells it."""
        return abs(self.velocity if self.acceleration is None else self.acceleration)


def resolve(name: str, joint: JointScale, drive: UnitObjects) -> JointUnits:
    """Return the units of a joint, from its configuration, what its drive tells, and its make.

    Args:
        name: of the joint.
        joint: its configuration.
        drive: what the drive tells.

    Raises:
        ConfigError: they do not say how far the joint moves for one count, or how fast, or the drive counts
            in a unit that is not understood.
    """
    gear = joint.gear or drive.gear or 1.0
    position = _position(name, joint, drive, gear)
    of_shaft = drive.position_unit is not None and unit_of(drive.position_unit).numerator in ANGLES
    way = Transmission(
        position,
        TURN if joint.kind == "revolute" else joint.feed,
        gear,
        gear / (drive.gear or 1.0),
        of_shaft,
        joint.kind == "prismatic",
    )
    assumed: dict[Quantity, str] = {}
    make = drive.make
    commanded = _rate(
        name, Quantity.VELOCITY, way, joint.velocity_scale, drive.velocity_unit, make.velocity
    )
    if commanded is None:
        assumed[Quantity.VELOCITY] = _nobody(Quantity.VELOCITY, "position units a second")
        commanded = position
    measured = joint.measured_velocity_scale
    if measured is None and make.measured_velocity is not None:
        measured = way.of_make(make.measured_velocity)
    acceleration, ramp_time = _acceleration(name, joint, way, drive, commanded, assumed)
    effort = _effort(joint, drive, gear)
    if joint.scale is not None and joint.gear is None and drive.gear is None:
        if joint.velocity_scale is None and _counts_turns(drive, of_shaft=of_shaft):
            assumed[Quantity.VELOCITY] = _GEARLESS.format(Quantity.VELOCITY)
        if joint.effort_scale is None:
            assumed[Quantity.EFFORT] = _GEARLESS.format(Quantity.EFFORT)
    sign = joint.sign
    return JointUnits(
        sign * position,
        joint.offset,
        sign * commanded,
        sign * effort,
        None if measured is None else sign * measured,
        acceleration,
        ramp_time,
        None if joint.measured_effort_scale is None else sign * joint.measured_effort_scale,
        assumed,
    )


_GEARLESS: Final = "`scale` is given, and nobody tells the gear: its {} is taken as without one"


def _counts_turns(drive: UnitObjects, *, of_shaft: bool) -> bool:
    """Whether velocities are turns of the motor, so that they depend on the gear."""
    if drive.velocity_unit:
        rate = velocity_of(drive.velocity_unit)
        return rate is not None and rate.numerator in ANGLES and not of_shaft
    return drive.make.velocity is not None and RATES[drive.make.velocity.unit][0]


def _nobody(quantity: Quantity, what: str) -> str:
    source = UNITS[quantity]
    return (
        f"nobody tells the unit of {quantity} ({source.objects}): it has no {source.reported}, and is taken "
        f"for {what}"
    )


def _acceleration(
    name: str,
    joint: JointScale,
    way: Transmission,
    drive: UnitObjects,
    velocity: float,
    assumed: dict[Quantity, str],
) -> tuple[float, float | None]:
    """Return rad/s² (m/s²) for one unit of acceleration, NaN if not known, and s where units are times."""
    given, ramp_time, make = joint.acceleration_scale, joint.ramp_time_scale, drive.make
    if given is None and ramp_time is None and not drive.acceleration_unit:
        ramp_time = make.ramp_time
    if ramp_time is not None:
        return math.nan, ramp_time
    try:
        found = _rate(
            name, Quantity.ACCELERATION, way, given, drive.acceleration_unit, make.acceleration
        )
    except ConfigError as error:  # refused where ramps are written: most joints need none
        assumed[Quantity.ACCELERATION] = error.message
        return math.nan, None
    if found is not None:
        return found, None
    if joint.velocity_scale is not None:
        return math.nan, None  # whoever has to give the one has to give the other
    assumed[Quantity.ACCELERATION] = _nobody(Quantity.ACCELERATION, "velocity units a second")
    return velocity, None


def _rate(
    name: str,
    quantity: Quantity,
    way: Transmission,
    given: float | None,
    word: int | None,
    make: MakeRate | None,
) -> float | None:
    """Return rad/s (m/s), or that a second, for one unit: as given, as reported, or of the make.

    Raises:
        ConfigError: the drive reports what is not understood, or does not fit the joint.
    """
    if given is not None:
        return given
    if word:
        decode = velocity_of if quantity is Quantity.VELOCITY else acceleration_of
        rate = decode(word)
        found = None if rate is None else way.reported(rate)
        if found is None:
            raise _not_understood(name, quantity, word)
        return found
    return None if make is None else way.of_make(make)


def _not_understood(name: str, quantity: Quantity, word: int) -> ConfigError:
    source, unit = UNITS[quantity], unit_of(word)
    return ConfigError(
        f"the drive reports a unit of {quantity} that is not understood, or does not fit the joint: "
        f"{source.reported.partition(',')[0]} is 0x{word:08X} ({unit.factor:g} times {unit.numerator:02X}h, "
        f"for {unit.denominator:02X}h)",
        where=f"joints.{name}",
        remedy=f"Give {keys_text(quantity)}: what the drive's manual says of {source.objects}.",
    )


def _effort(joint: JointScale, drive: UnitObjects, gear: float) -> float:
    """Return N·m (N) for one unit of torque; NaN if that is not known."""
    if joint.effort_scale is not None:
        return joint.effort_scale
    rated = drive.rated_torque if joint.rated_torque is None else joint.rated_torque
    effort = math.nan if rated is None else rated / 1000.0 * gear
    if joint.kind == "prismatic":
        effort *= TURN / (joint.feed or math.nan)
    return effort


def _position(name: str, joint: JointScale, drive: UnitObjects, gear: float) -> float:
    """Return rad (m) for one position unit."""
    if joint.scale is not None:
        return joint.scale
    factor = 1.0
    turn = TURN if joint.kind == "revolute" else joint.feed
    if joint.counts_per_turn is None and drive.position_unit:
        unit = unit_of(drive.position_unit)
        if unit.numerator in ANGLES and turn is not None:
            # Of the drive's own shaft, behind the gear that it knows of.
            angle = unit.factor * ANGLES[unit.numerator] / TURN
            return angle * turn * (drive.gear or 1.0) / gear
        if unit.numerator in LENGTHS and joint.kind == "prismatic":
            return unit.factor * LENGTHS[unit.numerator]
        if unit.numerator not in COUNTS and unit.numerator not in ANGLES:
            raise _not_understood(name, Quantity.POSITION, drive.position_unit)
        factor = unit.factor
    if turn is None:
        raise ConfigError(
            "a prismatic joint needs to know how far it moves with one turn",
            where=f"joints.{name}",
            remedy="Give `feed` in m for a turn, or `scale` in m for a count.",
        )
    counts = joint.counts_per_turn or _motor_counts(drive)
    if counts is None:
        told = "the drive does not tell its encoder resolution (608Fh)"
        if drive.encoder is not None:
            told = (
                f"the drive reports {drive.encoder:g} count for a turn of the motor (608Fh): a default, and "
                "no encoder's resolution"
            )
        raise ConfigError(
            told,
            where=f"joints.{name}",
            remedy="Give `counts_per_turn` of the motor and `gear`, or `scale` in rad for a count.",
        )
    return turn / (counts * gear) * factor


_DEFAULT: Final = 1.0
"""Increments of a turn (608F), and position units (6092), that stand for "not set"."""


def _motor_counts(drive: UnitObjects) -> float | None:
    """Return position units for one turn of the motor: feed / gear (CiA 402-2), where a feed is set."""
    if drive.feed is not None and drive.feed > _DEFAULT:
        return drive.feed / (drive.gear or 1.0)
    return drive.encoder if drive.encoder is not None and drive.encoder > _DEFAULT else None


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
        self._measured_velocity = np.array(
            [
                each.velocity if each.measured_velocity is None else each.measured_velocity
                for each in units
            ]
        )
        self._measured_effort = np.array(
            [
                each.effort if each.measured_effort is None else each.measured_effort
                for each in units
            ]
        )

    @property
    def velocity_steps(self) -> tuple[float, ...]:
        """One unit of each velocity as it is measured, in rad/s (m/s)."""
        return tuple(np.abs(self._measured_velocity).tolist())

    def positions(self, counts: Sequence[int]) -> Vector:
        """Return positions (n,) in rad (m)."""
        return vector(np.asarray(counts, dtype=float) * self._position + self._offset)

    def velocities(self, counts: Sequence[int]) -> Vector:
        """Return velocities (n,) in rad/s (m/s)."""
        return vector(np.asarray(counts, dtype=float) * self._measured_velocity)

    def efforts(self, thousandths: Sequence[int]) -> Vector:
        """Return efforts (n,) in N·m (N); NaN where the rated torque is not known."""
        return vector(np.asarray(thousandths, dtype=float) * self._measured_effort)

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
