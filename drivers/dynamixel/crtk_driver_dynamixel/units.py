"""Between the integers of a control table and SI.

Two steps, each pure: bytes to numbers (`read_number`, `write_number`, `record`: two's complement and the
older codings), and numbers to SI for a whole chain at once (`Scaling`: arrays of one value a servo, prepared
once). What a count is worth is told by `crtk_driver_dynamixel.models`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crtk_driver_dynamixel.control_tables import Coding, Item
from crtk_driver_dynamixel.models import Family, Model, OperatingMode
from crtk_drivers.samples import Vector, vector

Counts = NDArray[np.int64]
"""One whole number a servo, as in the control table, signs put right."""

_SIGN_BIT: Final = 1 << 10
_OFFSET: Final = 2048


def read_number(data: bytes | bytearray | memoryview, item: Item, offset: int = 0) -> int:
    """Return the number that the bytes of an item stand for.

    Args:
        data: little-endian, of this item or of a block that holds it.
        offset: of the item in `data`.

    Raises:
        ValueError: fewer bytes than the item has.
    """
    part = bytes(data[offset : offset + item.size])
    if len(part) != item.size:
        raise ValueError(f"{item.name} has {item.size} bytes, of which {len(part)} are there")
    if item.coding is Coding.TWOS_COMPLEMENT:
        return int.from_bytes(part, "little", signed=True)
    return _decoded(int.from_bytes(part, "little"), item.coding)


def write_number(number: int, item: Item) -> bytes:
    """Return the bytes of an item.

    Raises:
        ValueError: the item cannot hold this number.
    """
    least, most = item.range
    if not least <= number <= most:
        raise ValueError(f"{item.name} takes {least} to {most}, not {number}")
    if item.coding is Coding.TWOS_COMPLEMENT:
        return number.to_bytes(item.size, "little", signed=True)
    return _encoded(number, item.coding).to_bytes(item.size, "little")


def _decoded(raw: int, coding: Coding) -> int:
    if coding is Coding.SIGN_BIT_10:
        magnitude = raw & (_SIGN_BIT - 1)
        return -magnitude if raw & _SIGN_BIT else magnitude
    return raw - _OFFSET if coding is Coding.OFFSET_2048 else raw


def _encoded(number: int, coding: Coding) -> int:
    if coding is Coding.SIGN_BIT_10:
        return number if number >= 0 else _SIGN_BIT - number
    return number + _OFFSET if coding is Coding.OFFSET_2048 else number


def decoded(raw: ArrayLike, coding: Coding) -> Counts:
    """Return numbers (n,) from what a field of `record` holds (n,)."""
    values = np.asarray(raw, dtype=np.int64)
    if coding is Coding.SIGN_BIT_10:
        magnitudes = values & (_SIGN_BIT - 1)
        return np.where(values & _SIGN_BIT, -magnitudes, magnitudes)
    return values - _OFFSET if coding is Coding.OFFSET_2048 else values


def encoded(numbers: ArrayLike, coding: Coding) -> Counts:
    """Return what a field of `record` must hold (n,) for numbers (n,)."""
    values = np.asarray(numbers, dtype=np.int64)
    if coding is Coding.SIGN_BIT_10:
        return np.where(values < 0, _SIGN_BIT - values, values)
    return values + _OFFSET if coding is Coding.OFFSET_2048 else values


def record(items: Sequence[Item], address: int, length: int) -> np.dtype[Any]:
    """Return the type of a block of a control table, with a field for each of `items`.

    ``np.frombuffer(data, record(...))["present_position"]`` is the raw value of every servo whose block is
    in `data`, one behind the other; two's complement is put right, other codings by `decoded`.

    Args:
        items: within the block.
        address: of the block's first byte.
        length: of the block in bytes.
    """
    return np.dtype(
        {
            "names": [item.name for item in items],
            "formats": [
                f"<{'i' if item.coding is Coding.TWOS_COMPLEMENT else 'u'}{item.size}"
                for item in items
            ],
            "offsets": [item.address - address for item in items],
            "itemsize": length,
        }
    )


@dataclass(frozen=True, slots=True, eq=False)
class Scale:
    """One quantity of every servo: ``si = (count - zero) * factor + offset``.

    Attributes:
        factor: (n,) SI for one count, with the sign of the direction; NaN where a servo has no such quantity.
        zero: (n,) count at which the quantity is `offset`.
        offset: (n,) SI.
        lowest, highest: (n,) counts that may be written.
    """

    factor: Vector
    zero: Vector
    offset: Vector
    lowest: Vector
    highest: Vector

    def to_si(self, counts: ArrayLike) -> Vector:
        """Return SI values (n,) for counts (n,)."""
        return (np.asarray(counts, dtype=np.float64) - self.zero) * self.factor + self.offset

    def to_counts(self, values: ArrayLike) -> Counts:
        """Return counts (n,) for SI values (n,), rounded, and not beyond what may be written.

        Raises:
            ValueError: a value is not finite, or a servo has no such quantity.
        """
        exact = (np.asarray(values, dtype=np.float64) - self.offset) / self.factor + self.zero
        if not np.isfinite(exact).all():
            raise ValueError(
                f"no counts for {np.asarray(values).tolist()}: not finite, or no such unit"
            )
        return np.rint(np.minimum(np.maximum(exact, self.lowest), self.highest)).astype(np.int64)

    def part(self, places: Sequence[int]) -> Scale:
        """Return the same of some of the servos."""
        index = list(places)
        return Scale(
            vector(self.factor[index]),
            vector(self.zero[index]),
            vector(self.offset[index]),
            vector(self.lowest[index]),
            vector(self.highest[index]),
        )

    def limited(self, lowest: ArrayLike, highest: ArrayLike) -> Scale:
        """Return the same with narrower limits, in counts (n,)."""
        return replace(
            self,
            lowest=vector(np.maximum(self.lowest, np.asarray(lowest, dtype=np.float64))),
            highest=vector(np.minimum(self.highest, np.asarray(highest, dtype=np.float64))),
        )


@dataclass(frozen=True, slots=True)
class Servo:
    """What a servo's counts mean at its joint.

    Attributes:
        sign: 1, or -1 if the joint turns the other way.
        gear: turns of the servo for one turn of the joint.
        offset: position of the joint at the servo's middle count, in rad.
        shift: counts by which calibration found that middle to be off (see `calibration`).
        homing: what its homing offset adds to its counts in position mode, as far as it is known.
        torque_constant: N·m of the servo for one A; NaN for none.
        mode: in which positions are commanded; it decides which counts are allowed.
    """

    model: Model
    sign: int = 1
    gear: float = 1.0
    offset: float = 0.0
    shift: int = 0
    torque_constant: float = math.nan
    mode: OperatingMode = OperatingMode.POSITION
    homing: int = 0

    @property
    def goal_range(self) -> tuple[int, int]:
        """Least and greatest count that a goal position may have in this mode.

        In position mode a homing offset narrows it: counts wrap at the ends of the encoder's turn, which it
        moves, and goals still have to lie within `Family.lowest` and `Family.highest`.
        """
        family = self.model.family
        if self.mode is OperatingMode.POSITION:
            return family.lowest + max(0, self.homing), family.highest + min(0, self.homing)
        return -family.turns, family.turns

    @property
    def goals(self) -> tuple[int, int]:
        """Least and greatest count that it is sent: not the ends beyond which it measures nothing."""
        least, most = self.goal_range
        beside = 1 if self.model.family.has_dead_zone else 0
        return least + beside, most - beside

    def position(self, count: float) -> float:
        """Return the position of the joint at a count, in rad."""
        family = self.model.family
        turned = (count - family.zero - self.shift) * family.position_unit
        return self.sign * turned / self.gear + self.offset

    def count(self, position: float) -> float:
        """Return the count at a position of the joint; neither rounded nor limited."""
        family = self.model.family
        turned = self.sign * (position - self.offset) * self.gear
        return turned / family.position_unit + family.zero + self.shift


_LOAD_UNIT: Final = 0.001
_FULL_COUNT: Final = float(2**31 - 1)


@dataclass(frozen=True, slots=True, eq=False)
class Scaling:
    """All that a cycle converts, prepared once for the servos of a chain, in their order.

    Attributes:
        position: of the joint, rad.
        velocity: of the joint, rad/s.
        acceleration: of the joint, rad/s²; a magnitude.
        current: of the servo, A, positive where it drives its joint up.
        effort: on the joint, N·m; NaN where a servo measures no current or its torque constant is unknown.
        load: of the servo, as part of its greatest (-1 to 1); NaN where it measures current instead.
        pwm: of the servo, as part of the full voltage (-1 to 1).
    """

    position: Scale
    velocity: Scale
    acceleration: Scale
    current: Scale
    effort: Scale
    load: Scale
    pwm: Scale

    def part(self, places: Sequence[int]) -> Scaling:
        """Return the same of some of the servos."""
        return Scaling(*(getattr(self, each.name).part(places) for each in fields(self)))

    @classmethod
    def of(cls, servos: Sequence[Servo]) -> Scaling:
        """Prepare the scales of these servos."""
        families = [servo.model.family for servo in servos]
        sign = np.array([float(servo.sign) for servo in servos])
        gear = np.array([servo.gear for servo in servos])
        ranges = [servo.goals for servo in servos]
        currents = np.array([float(servo.model.current_limit or 2047) for servo in servos])
        unit = np.array([servo.model.current_unit for servo in servos])
        constant = np.array([servo.torque_constant for servo in servos])
        load = np.where(np.isnan(unit), _LOAD_UNIT, np.nan)
        full = np.array([float(family.full_pwm) for family in families])
        speeds = _of(families, "velocity_unit") / gear
        return cls(
            position=Scale(
                vector(sign * _of(families, "position_unit") / gear),
                vector(
                    [
                        family.zero + servo.shift
                        for family, servo in zip(families, servos, strict=True)
                    ]
                ),
                vector([servo.offset for servo in servos]),
                vector([least for least, _ in ranges]),
                vector([most for _, most in ranges]),
            ),
            velocity=_symmetric(sign * speeds, _FULL_COUNT),
            acceleration=_positive(
                _of(families, "acceleration_unit") / gear, _of(families, "highest_profile")
            ),
            current=_symmetric(sign * unit, currents),
            effort=_symmetric(sign * unit * constant * gear, currents),
            load=_symmetric(sign * load, 1000.0),
            pwm=_symmetric(
                np.divide(sign, full, out=np.full_like(full, np.nan), where=full > 0), full
            ),
        )


def _of(families: Sequence[Family], attribute: str) -> Vector:
    return np.array([float(getattr(family, attribute)) for family in families])


def _symmetric(factor: Vector, most: ArrayLike) -> Scale:
    none = vector(np.zeros_like(factor))
    limit = np.broadcast_to(np.asarray(most, dtype=np.float64), factor.shape)
    return Scale(vector(factor), none, none, vector(-limit), vector(limit))


def _positive(factor: Vector, most: Vector) -> Scale:
    return _symmetric(factor, most).limited(np.zeros_like(factor), most)
