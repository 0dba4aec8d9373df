"""What a drive is given to guard by itself: how it stops, and its own limits of position and speed.

The limits are a second line behind those of this program. Those of speed are lowered, never raised, and a
drive that does not take a limit is used without it, with a note.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Final, NamedTuple

from crtk_driver_canopen.lowered_limits import LoweredLimits
from crtk_driver_canopen.objects import OBJECTS, parse_object
from crtk_driver_canopen.rate_units import motor_turns
from crtk_driver_canopen.sdo import WRITE_ONLY, ObjectIgnored, Sdo, SdoAborted
from crtk_driver_canopen.statemachine import option_text
from crtk_driver_canopen.units import JointUnits, UnitObjects
from crtk_drivers.errors import DeviceError

if TYPE_CHECKING:
    from crtk_driver_canopen.joint_config import JointConfig

HEADROOM: Final = 1.2
"""A drive's own limit of speed for that of the joint: control loops go a little beyond their setpoint."""

_I32: Final = (-(2**31), 2**31 - 1)
_U32: Final = 2**32 - 1


class _Option(NamedTuple):
    """An option code: its key in the configuration, and whether it must not let the motor coast."""

    key: str
    entry: str
    must_brake: bool
    use: str


def _options(joint: JointConfig, *, halts: bool) -> tuple[_Option, ...]:
    at_loss = joint.abort_option == 3
    use = "at the loss of the connection, and in a fault of another joint"
    return (
        _Option("quick_stop_option", "quick_stop_option", at_loss, use),
        _Option("shutdown_option", "shutdown_option", False, ""),
        _Option("disable_option", "disable_operation_option", False, ""),
        _Option(
            "halt_option", "halt_option", halts, "when a move of its own, or homing, is stopped"
        ),
        _Option("fault_option", "fault_reaction_option", False, ""),
    )


def ensure_options(
    sdo: Sdo, name: str, joint: JointConfig, notes: list[str], *, halts: bool
) -> None:
    """Give a drive the option codes that are configured, and judge those that it has.

    Args:
        name: of the joint.
        halts: whether the driver uses halt, for moves of the drive's own and for homing.
        notes: what is not as it should be, in words.

    Raises:
        DeviceError: it has no such object, or would let the motor coast where it is to stop.
        ObjectIgnored, SdoAborted, SdoSilent, ProtocolError: it does not take one.
    """
    for option in _options(joint, halts=halts):
        entry, wanted = OBJECTS[option.entry], getattr(joint, option.key)
        code = sdo.find(entry)
        if wanted is not None:
            if code is None:
                raise DeviceError(
                    f"{entry.on_axis(sdo.axis)}: the drive has no such object",
                    where=sdo.where,
                    remedy=f"Leave `joints.{name}.{option.key}` out.",
                )
            sdo.ensure(entry, wanted)
            code = wanted
        if code != 0:
            continue
        text = f"{entry.on_axis(sdo.axis)} is 0 ({option_text(entry.index, 0)})"
        if option.must_brake and wanted is None:
            raise DeviceError(
                f"{text}: {option.use} the motor would coast",
                where=sdo.where,
                remedy=f"Give `joints.{name}.{option.key}`: 2 for the quick stop ramp, or 0 if it may coast.",
            )
        if option.must_brake or option.key == "fault_option":
            notes.append(f"{text}: the motor coasts")


def ensure_error_behaviour(sdo: Sdo, behaviour: int) -> None:
    """Make a node do `behaviour` (1029) when it does not hear us: 0 pre-operational, 1 nothing, 2 stopped.

    A node without that object goes pre-operational (CiA 301, 7.5.2.32).

    Raises:
        DeviceError: it has no such object, and another behaviour is wanted.
        ObjectIgnored, SdoAborted, SdoSilent, ProtocolError: it does not take it.
    """
    entry = OBJECTS["error_behaviour"]
    if sdo.find(entry) is not None:
        sdo.ensure(entry, behaviour)
    elif behaviour:
        raise DeviceError(
            f"{entry}: the node has no such object, and goes pre-operational when it does not hear us",
            where=sdo.where,
            remedy="Set `heartbeat.error_behaviour` to 0.",
        )


class PositionLimits(NamedTuple):
    """Software position limits (607D), in counts."""

    least: int
    greatest: int

    def hold(self, position: int) -> bool:
        """Whether a position is within them."""
        return self.least <= position <= self.greatest

    def widened(self, position: int) -> PositionLimits:
        """Return limits that hold a position too: a drive may move when its target is beyond its limits."""
        return PositionLimits(min(self.least, position), max(self.greatest, position))


def position_limits(joint: JointConfig, units: JointUnits) -> PositionLimits:
    """Return the range of a joint in counts, one count wider than it is."""
    ends = sorted((limit - units.offset) / units.position for limit in (joint.lower, joint.upper))
    least, greatest = math.floor(ends[0]) - 1, math.ceil(ends[1]) + 1
    return PositionLimits(max(least, _I32[0]), min(greatest, _I32[1]))


def _is_left(joint: JointConfig, entry: str) -> bool:
    """Whether an object is not the driver's to write."""
    wanted = OBJECTS[entry]
    given = {parse_object(text) for text in joint.parameters}
    return joint.drive_limits == "keep" or (wanted.index, wanted.sub) in given


def write_position_limits(
    sdo: Sdo, joint: JointConfig, limits: PositionLimits, notes: list[str]
) -> bool:
    """Give a drive its position limits (607D), and read them back; return whether it holds them.

    A drive with a home offset (607C) is left as it is: drives differ in whether it shifts their limits.

    Raises:
        SdoSilent, ProtocolError, BusLost: it does not answer as it should.
    """
    least, greatest = OBJECTS["min_position_limit"], OBJECTS["max_position_limit"]
    if _is_left(joint, "min_position_limit") or _is_left(joint, "max_position_limit"):
        return False
    now = _limit(sdo, "max_position_limit", notes)
    if now is None or _limit(sdo, "min_position_limit", notes) is None:
        return False
    if sdo.find(OBJECTS["home_offset"]):
        notes.append(
            "its own position limits (607Dh) are left as they are: it has a home offset (607Ch), and drives "
            "differ in whether that shifts them"
        )
        return False
    writes = [(least, limits.least), (greatest, limits.greatest)]
    if limits.least > now:
        writes.reverse()  # the lower one is never to be above the upper one

    def write() -> None:
        for entry, value in writes:
            sdo.ensure(entry, value)

    return _noted(notes, write)


def write_speed_limits(
    sdo: Sdo,
    joint: JointConfig,
    units: JointUnits,
    drive: UnitObjects,
    lowered: LoweredLimits,
    notes: list[str],
) -> None:
    """Lower a drive's limits of speed (607F, and 6080 in turns of the motor a minute) to that of the joint.

    Args:
        lowered: takes note of what the drive held before.

    Raises:
        SdoSilent, ProtocolError, BusLost: it does not answer as it should.
    """
    speeds = {"max_profile_velocity": joint.velocity / abs(units.velocity)}
    turns = motor_turns(joint, drive.gear)
    if turns is not None:
        speeds["max_motor_speed"] = 60.0 * turns * joint.velocity
    for name, needed in speeds.items():
        entry = OBJECTS[name]
        found = None if _is_left(joint, name) else _limit(sdo, name, notes)
        if found is None:
            continue
        wanted = min(max(1, math.ceil(HEADROOM * needed)), _U32)
        if not found or found > wanted:
            # Before it is written: the drive may take it, and its answer be lost.
            lowered.note(joint.node, sdo.axis, entry, found, wanted)
            _noted(notes, partial(sdo.ensure, entry, wanted))
        elif found < needed:
            own = f"{entry.on_axis(sdo.axis)} is {found}"
            notes.append(f"{own}: less than the joint's velocity needs ({needed:.0f})")


def _limit(sdo: Sdo, name: str, notes: list[str]) -> int | None:
    """Return a limit of the second line; None: the drive has none, or it cannot be read, which is noted."""
    try:
        return sdo.find(OBJECTS[name])
    except SdoAborted as error:
        if error.code not in WRITE_ONLY:
            raise
        notes.append(f"{OBJECTS[name].on_axis(sdo.axis)} can only be written, and is left as it is")
        return None


def _noted(notes: list[str], write: Callable[[], object]) -> bool:
    """Write a limit of the second line; where the drive does not take it, that is noted."""
    try:
        write()
    except (ObjectIgnored, SdoAborted) as error:
        notes.append(error.message)
        return False
    return True


def note_following_error(sdo: Sdo, notes: list[str]) -> None:
    """Note a drive that does not itself watch how far it is behind (6065)."""
    window = sdo.find(OBJECTS["following_error_window"])
    if window == _U32:
        notes.append("it does not watch its own following error (6065h is FFFFFFFFh)")
