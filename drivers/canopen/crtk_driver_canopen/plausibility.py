"""Whether what a drive holds and reports can be true of its joint: units that are wrong show here.

Before a drive is given anything, what it holds is compared with the limits that are configured. A factor of
hundreds between them is a unit that somebody got wrong, not a choice. Rates of moves are judged from above
only: a slow share of a move, that this driver wrote, is no sign of anything. No I/O but what the drive holds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final, NamedTuple

from crtk_driver_canopen.modes import OpMode
from crtk_driver_canopen.objects import OBJECTS
from crtk_driver_canopen.sdo import Sdo
from crtk_driver_canopen.unit_codes import TURN
from crtk_driver_canopen.unit_table import Quantity, keys_text
from crtk_driver_canopen.units import JointUnits, UnitObjects
from crtk_drivers.errors import ConfigError

if TYPE_CHECKING:
    from crtk_driver_canopen.config import JointConfig

FACTOR: Final = 20.0
"""How many times a value may be off the limit of its joint."""

_UNLIMITED: Final = 0x7FFFFFFF
"""From here on a value of 32 bits stands for none."""

_TORQUE: Final = 1000
"""Units of 6071h in the rated torque."""


def check_plausible(
    sdo: Sdo, name: str, joint: JointConfig, units: JointUnits, drive: UnitObjects, *, moves: bool
) -> Iterator[str]:
    """Yield what is not plausible of a drive, in words, where that is only to be noted.

    Args:
        sdo: of its axis.
        name: of the joint.
        joint: its configuration.
        units: of the joint.
        drive: what it tells of its units.
        moves: the drives plan moves themselves.

    Raises:
        ConfigError: it is off by more than `FACTOR`, with both numbers, and what to do.
        SdoAborted, SdoSilent, ProtocolError: an object could not be read.
    """
    for quantity, text in _doubts(sdo, joint, units, drive, moves=moves):
        if joint.plausibility == "refuse":
            raise ConfigError(
                text,
                where=f"joints.{name}",
                remedy=f"Compare with the drive's manual, and give the unit: {keys_text(quantity)}; or "
                "correct the gear, or the limit. What an earlier configuration wrote, a drive holds until "
                "it is switched off. If all of this is right: `plausibility: note`.",
            )
        yield text


class _Held(NamedTuple):
    """A value that a drive holds, and between which multiples of a limit it must be."""

    quantity: Quantity
    entry: str
    one: float
    limit: float
    per: str
    least: float
    most: float


_LEAST: Final = 1.0 / FACTOR
_ANY: Final = math.inf


def _held(
    joint: JointConfig, units: JointUnits, drive: UnitObjects, *, moves: bool
) -> Iterator[_Held]:
    """Yield what can be judged: bounds that the drive has from its maker, and rates that are used."""
    speed, sharpness = joint.velocity, joint.acceleration
    velocity, acceleration = abs(units.velocity), units.acceleration_step
    yield _Held(Quantity.VELOCITY, "max_profile_velocity", velocity, speed, "s", _LEAST, _ANY)
    if joint.scale is None:
        turns = (joint.gear or drive.gear or 1.0) / (joint.feed or TURN)
        one = 1.0 / (60.0 * turns)
        yield _Held(Quantity.POSITION, "max_motor_speed", one, speed, "s", _LEAST, _ANY)
    if moves:
        yield _Held(Quantity.VELOCITY, "profile_velocity", velocity, speed, "s", 0.0, FACTOR)
    if math.isnan(acceleration):
        return
    if moves or OpMode.PV in joint.op_modes:
        least = 0.0 if moves else _LEAST
        for entry in ("profile_acceleration", "profile_deceleration"):
            yield _Held(Quantity.ACCELERATION, entry, acceleration, sharpness, "s²", least, FACTOR)
        for entry in ("quick_stop_deceleration", "max_acceleration", "max_deceleration"):
            yield _Held(Quantity.ACCELERATION, entry, acceleration, sharpness, "s²", _LEAST, _ANY)
    if joint.homing is not None and joint.homing.acceleration is not None:
        wanted, entry = joint.homing.acceleration, "homing_acceleration"
        yield _Held(Quantity.ACCELERATION, entry, acceleration, wanted, "s²", _LEAST, FACTOR)


def _doubts(
    sdo: Sdo, joint: JointConfig, units: JointUnits, drive: UnitObjects, *, moves: bool
) -> Iterator[tuple[Quantity, str]]:
    unit = "rad" if joint.kind == "revolute" else "m"
    for each in _held(joint, units, drive, moves=moves):
        entry = OBJECTS[each.entry]
        held = sdo.find(entry)
        if not held or held >= _UNLIMITED:
            continue
        value = held * each.one
        if not each.least * each.limit <= value <= each.most * each.limit:
            of = f"{unit}/{each.per}"
            yield (
                each.quantity,
                f"{entry.on_axis(sdo.axis)} is {held}, which is {value:.4g} {of} in the unit that is used; "
                f"the joint's limit is {each.limit:.4g} {of}: {_times(value, each.limit)}",
            )
    rated = _TORQUE * abs(units.effort)
    if joint.effort and not math.isnan(rated) and not _alike(rated, joint.effort):
        of = "N·m" if joint.kind == "revolute" else "N"
        yield (
            Quantity.EFFORT,
            f"the rated torque of the motor (6076h) is {rated:.4g} {of} at the joint, which is limited to "
            f"{joint.effort:.4g} {of}: {_times(rated, joint.effort)}",
        )


def _alike(one: float, other: float) -> bool:
    return other / FACTOR <= one <= FACTOR * other


def _times(value: float, limit: float) -> str:
    factor = value / limit
    return f"{factor:.3g} times it" if factor >= 1.0 else f"a {1.0 / factor:.3g}th of it"
