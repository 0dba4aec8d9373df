"""Whether what a drive holds and reports can be true of its joint: units that are wrong show here.

Before a drive is given anything, what it holds is compared with the limits that are configured. A large
factor between them is a unit that somebody got wrong; whoever wants so low a limit says so. Slow rates of
moves are no sign of anything where something else shows the unit: this driver wrote them as a share of a
move. No I/O but what the drive holds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final, NamedTuple

from crtk_driver_canopen.modes import OpMode, Way
from crtk_driver_canopen.objects import OBJECTS
from crtk_driver_canopen.rate_units import motor_turns
from crtk_driver_canopen.sdo import WRITE_ONLY, Sdo, SdoAborted
from crtk_driver_canopen.unit_table import Quantity, keys_text
from crtk_driver_canopen.units import JointUnits, UnitObjects
from crtk_drivers.errors import ConfigError

if TYPE_CHECKING:
    from crtk_driver_canopen.joint_config import JointConfig

FACTOR: Final = 20.0
"""How many times a value may be off the limit of its joint."""

_SHOWN: Final = 500.0
"""Up to how many times the limit the sharpest ramp of a drive shows that the unit is right."""

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
    for doubt in _doubts(sdo, joint, units, drive, moves=moves):
        # A torque says nothing of what a joint is given that takes no efforts.
        matters = doubt.quantity is not Quantity.EFFORT or Way.EFFORTS in joint.ways
        if matters and joint.plausibility == "refuse":
            raise ConfigError(
                doubt.text,
                where=f"joints.{name}",
                remedy=f"Compare with the drive's manual, and give the unit: {keys_text(doubt.quantity)}; or "
                "correct the gear, or the limit. A program that was killed leaves its limits of speed in a "
                "drive until that is switched off. If all of this is right, as with a limit that is meant to "
                "be so low: `plausibility: note`.",
            )
        yield f"{doubt.text}; if that is not so: {keys_text(doubt.quantity)}"


class _Doubt(NamedTuple):
    """What is not plausible, in words."""

    quantity: Quantity
    text: str


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
_RAMPS: Final = ("profile_acceleration", "profile_deceleration")
_SHARPEST: Final = ("quick_stop_deceleration", "max_acceleration", "max_deceleration")
"""What no driver writes: a share of a move is none of these."""


def _held(
    joint: JointConfig, units: JointUnits, drive: UnitObjects, *, moves: bool
) -> Iterator[_Held]:
    """Yield what can be judged: bounds that the drive has from its maker, and rates that are used."""
    speed, sharpness = joint.velocity, joint.acceleration
    velocity, acceleration = abs(units.velocity), units.acceleration_step
    yield _Held(Quantity.VELOCITY, "max_profile_velocity", velocity, speed, "s", _LEAST, _ANY)
    turns = motor_turns(joint, drive.gear)
    if turns is not None:
        one = 1.0 / (60.0 * turns)
        yield _Held(Quantity.POSITION, "max_motor_speed", one, speed, "s", _LEAST, _ANY)
    if moves:
        yield _Held(Quantity.VELOCITY, "profile_velocity", velocity, speed, "s", 0.0, FACTOR)
    if math.isnan(acceleration):
        return
    if moves or OpMode.PV in joint.op_modes:
        least = 0.0 if moves else _LEAST
        for entry in _RAMPS:
            yield _Held(Quantity.ACCELERATION, entry, acceleration, sharpness, "s²", least, FACTOR)
        for entry in _SHARPEST:
            yield _Held(Quantity.ACCELERATION, entry, acceleration, sharpness, "s²", _LEAST, _ANY)
    if joint.homing is not None and joint.homing.acceleration is not None:
        wanted, entry = joint.homing.acceleration, "homing_acceleration"
        yield _Held(Quantity.ACCELERATION, entry, acceleration, wanted, "s²", _LEAST, FACTOR)


def _read(sdo: Sdo, entry: str) -> int | None:
    """Return what a drive holds; None: nothing that can be judged, or it can only be written."""
    try:
        held = sdo.find(OBJECTS[entry])
    except SdoAborted as error:
        if error.code not in WRITE_ONLY:
            raise
        return None
    return held if held and held < _UNLIMITED else None


def _doubts(
    sdo: Sdo, joint: JointConfig, units: JointUnits, drive: UnitObjects, *, moves: bool
) -> Iterator[_Doubt]:
    unit = "rad" if joint.kind == "revolute" else "m"
    rows = [
        (each, held, held * each.one / each.limit)
        for each in _held(joint, units, drive, moves=moves)
        if (held := _read(sdo, each.entry)) is not None
    ]
    is_shown = any(
        each.entry in _SHARPEST and _LEAST <= factor <= _SHOWN for each, _, factor in rows
    )
    for each, held, factor in rows:
        if each.least <= factor <= each.most or (
            is_shown and each.entry in _RAMPS and factor < each.least
        ):
            continue
        of = f"{unit}/{each.per}"
        yield _Doubt(
            each.quantity,
            f"{OBJECTS[each.entry].on_axis(sdo.axis)} is {held}, which is {held * each.one:.4g} {of} in the "
            f"unit that is used; the joint's limit is {each.limit:.4g} {of}: {_times(factor)}",
        )
    rated = _TORQUE * abs(units.effort)
    if joint.effort and not math.isnan(rated):
        factor, of = rated / joint.effort, "N·m" if joint.kind == "revolute" else "N"
        if not _LEAST <= factor <= FACTOR:
            yield _Doubt(
                Quantity.EFFORT,
                f"the rated torque of the motor (6076h) is {rated:.4g} {of} at the joint, which is limited "
                f"to {joint.effort:.4g} {of}: {_times(factor)}",
            )


def _times(factor: float) -> str:
    return f"{factor:.3g} times it" if factor >= 1.0 else f"a {1.0 / factor:.3g}th of it"
