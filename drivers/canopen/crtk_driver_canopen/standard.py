"""Which objects CiA 402 makes mandatory in which mode, and what stands in for one that a drive lacks: data.

The standards differ: DSP 402 V2.0 (2002) and CiA 402-2 (IEC 61800-7-201). An object counts as mandatory only
where all of them say so, for a drive that follows any of them is legal.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from typing import Final, NamedTuple

from crtk_driver_canopen.modes import MODES, OpMode, mode_text
from crtk_driver_canopen.objects import OBJECTS, Entry

EVERY: Final = frozenset(MODES)
"""In each mode of operation."""

_NONE: Final[frozenset[OpMode]] = frozenset()
_M: Final = OpMode


class Category(StrEnum):
    """Of an object in a mode."""

    MANDATORY = "mandatory"
    CONDITIONAL = "mandatory for a drive with more than one mode"
    OPTIONAL = "optional"


class Row(NamedTuple):
    """An object that the driver uses where it is there.

    At connect a drive is asked for the rows that are used in its modes, that are configured, or that are
    measured. The check of an EDS (`crtk_driver_canopen.eds_profile`) asks for all of them.

    Attributes:
        name: of `crtk_driver_canopen.objects.OBJECTS`.
        mandatory: modes in which the standards make it mandatory, of those in which it is needed.
        needed: modes in which nothing stands in for it: a drive without it is refused.
        used: modes in which a drive is asked for it at connect, and its lack is reported.
        without: what happens where it is missing, and not needed.
        conditional: it is mandatory only for a drive with more than one mode.
    """

    name: str
    mandatory: frozenset[OpMode] = _NONE
    needed: frozenset[OpMode] = _NONE
    used: frozenset[OpMode] = _NONE
    without: str = ""
    conditional: bool = False

    @property
    def entry(self) -> Entry:
        """The object."""
        return OBJECTS[self.name]

    def category(self, mode: OpMode) -> Category:
        """Return what it is in a mode."""
        if self.conditional:
            return Category.CONDITIONAL
        return Category.MANDATORY if mode in self.mandatory else Category.OPTIONAL

    def refused(self, modes: Iterable[OpMode]) -> str:
        """Return in which of some modes a drive without it cannot be used, in words; empty if in all."""
        lost = sorted(mode for mode in modes if mode in self.needed)
        return ", ".join(f"{mode_text(mode)} ({self.category(mode)})" for mode in lost)


def _in(*modes: OpMode) -> frozenset[OpMode]:
    return frozenset(modes)


_PP, _PV, _HM, _IP, _CSP = map(_in, (_M.PP, _M.PV, _M.HM, _M.IP, _M.CSP))
_CYCLIC: Final = _in(_M.IP, _M.CSP, _M.CSV, _M.CST)
_VELOCITY: Final = _in(_M.PV, _M.CSV)
_TORQUE: Final = _in(_M.TQ, _M.CST)

ROWS: Final = (
    Row("controlword", EVERY, EVERY, EVERY),
    Row("statusword", EVERY, EVERY, EVERY),
    Row(
        "mode_of_operation",
        without="it is used in the one mode that it has (6061h, 6502h)",
        conditional=True,
    ),
    Row(
        "mode_of_operation_display",
        without="that it is in its mode is not read back, and it is used in one mode alone",
        conditional=True,
    ),
    Row("position_actual", _PP | _HM | _IP | _CSP, EVERY, EVERY),
    Row("target_position", _PP | _CSP, _PP | _CSP, _PP | _CSP),
    Row("target_velocity", _VELOCITY, _VELOCITY, _VELOCITY),
    Row("target_torque", _TORQUE, _TORQUE, _TORQUE),
    Row("interpolation_position", _NONE, _IP, _IP),
    Row("profile_velocity", _PP, _PP, _PP),
    Row("profile_acceleration", _PP, _PP, _PP | _PV, "its ramps are its own"),
    Row("profile_deceleration", _NONE, _NONE, _PP | _PV, "it slows down as it speeds up (6083h)"),
    Row("homing_method", _HM, _HM, _HM),
    Row("homing_speed_switch", _HM, _HM, without="its speed towards the switch is its own"),
    Row("homing_speed_zero", _HM, _HM, without="its speed towards the index is its own"),
    Row("homing_acceleration", without="its acceleration in homing is its own"),
    Row("velocity_actual", without="its velocity is not measured"),
    Row("torque_actual", without="its effort is not measured"),
    Row(
        "consumer_heartbeat_time",
        without="nothing stops it when it does not hear us: it is refused",
    ),
    Row("producer_heartbeat_time", used=EVERY, without="only its PDOs tell that it is there"),
    Row(
        "abort_connection_option",
        without="what it does when it does not hear us is its own: give `abort_option: null` if it stops",
    ),
    Row("error_behaviour", without="it goes pre-operational when it does not hear us (CiA 301)"),
    Row("quick_stop_option", used=EVERY, without="what a quick stop does is its own"),
    Row(
        "halt_option",
        used=_PP | _HM,
        without="how it halts is its own, and `halt_option` is refused",
    ),
    Row("fault_reaction_option", used=EVERY, without="what it does in a fault is its own"),
    Row(
        "following_error_window",
        used=_PP | _IP | _CSP,
        without="it does not watch its following error: only this program does",
    ),
    Row("position_window", used=_PP, without="when it tells that a target is reached is its own"),
    Row(
        "min_position_limit",
        used=EVERY,
        without="it keeps no range of its own: only this program does",
    ),
    Row("max_profile_velocity", used=EVERY, without="it keeps no greatest velocity by 607Fh"),
    Row("max_motor_speed", used=EVERY, without="it keeps no greatest speed of the motor"),
    Row("encoder_increments", without="give `increments`, or `counts_per_turn` of each joint"),
    Row("gear_motor_revolutions", without="give `gear` of each joint"),
    Row("home_offset", without="give `home_position`, or no `homing.position`"),
    Row("motor_rated_torque", without="give `rated_torque` of each joint that takes efforts"),
    Row(
        "interpolation_period_value",
        used=_CYCLIC,
        without="in cyclic modes it takes the period as it comes",
    ),
    Row(
        "si_unit_velocity",
        without="velocities are counts a second, unless `velocity_unit` says another",
    ),
    Row("supported_drive_modes", without="the first change of mode tells whether it has it"),
)
"""DSP 402 V2.0 and CiA 402-2 (categories of the objects), CiA 301 (heartbeats), and what the driver does."""
