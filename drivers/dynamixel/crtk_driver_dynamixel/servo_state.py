"""What is known of the registers of one servo, and how several are written at once. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

from crtk_driver_dynamixel.control_tables import ControlTable, Item
from crtk_driver_dynamixel.joints import ChainServo
from crtk_driver_dynamixel.models import Family
from crtk_driver_dynamixel.units import read_number, write_number

Values = Mapping[str, int]
"""Numbers by the name of their register, signs put right."""

KEPT: Final = (
    "velocity_i_gain",
    "velocity_p_gain",
    "position_d_gain",
    "position_i_gain",
    "position_p_gain",
    "feedforward_2nd_gain",
    "feedforward_1st_gain",
    "profile_acceleration",
    "profile_velocity",
)
"""RAM that a change of the operating mode and a reboot reset (e-manual, "Operating Mode(11)")."""

_FOUND: Final = (
    "return_delay_time",
    "drive_mode",
    "operating_mode",
    "control_mode",
    "cw_angle_limit",
    "ccw_angle_limit",
    "secondary_id",
    "homing_offset",
    "status_return_level",
    "temperature_limit",
    "pwm_limit",
    "max_torque",
    "current_limit",
    "velocity_limit",
    "max_position_limit",
    "min_position_limit",
    "startup_configuration",
    "torque_enable",
    "hardware_error_status",
    "bus_watchdog",
    "torque_control_mode_enable",
    *KEPT,
)
"""What is read of a servo when it is found."""


def position_limits(values: Values, family: Family) -> tuple[int, int]:
    """Return the least and greatest count that a servo takes as a goal in position mode."""
    return (
        values.get("min_position_limit", values.get("cw_angle_limit", family.lowest)),
        values.get("max_position_limit", values.get("ccw_angle_limit", family.highest)),
    )


def encoder_turn(values: Values, family: Family) -> tuple[int, int]:
    """Return the first and last count of the turn that a servo knows in position mode.

    With torque, after a change to position mode and after a start it counts within this turn, wherever it
    counted before (e-manual of the X series, "Present Position(132)"). A homing offset moves the turn.
    """
    first = family.lowest + family.homing_in_force(values.get("homing_offset", 0))
    return first, first + family.counts - 1


@dataclass(slots=True)
class ServoState:
    """One servo as it was found.

    Attributes:
        servo: its place in the chain.
        table: of its model and firmware.
        firmware: version.
        values: what its registers hold, as far as they are known.
    """

    servo: ChainServo
    table: ControlTable
    firmware: int
    values: dict[str, int] = field(default_factory=dict)

    def has(self, name: str) -> bool:
        """Whether it has such a register."""
        return name in self.table

    def blocks(self, names: Iterable[str] | None = None) -> list[tuple[int, int, list[Item]]]:
        """Return address, length and items of what is read of it: EEPROM, then RAM.

        Args:
            names: of the registers; None: all that matter when it is found.
        """
        items = [self.table[name] for name in names or _FOUND if name in self.table]
        found = []
        for eeprom in (True, False):
            part = sorted((i for i in items if i.eeprom is eeprom), key=lambda item: item.address)
            if part:
                first, end = part[0].address, max(item.end for item in part)
                found.append((first, end - first, part))
        return found

    def take(self, data: bytes, address: int, items: Iterable[Item]) -> None:
        """Keep what a block that begins at `address` says of `items`."""
        for item in items:
            self.values[item.name] = read_number(data, item, item.address - address)


def runs(table: ControlTable, values: Values) -> list[tuple[int, bytes]]:
    """Return (address, data) of as few writes as these registers need: neighbours go together."""
    found: list[tuple[int, bytes]] = []
    end = -1
    for item in sorted((table[name] for name in values), key=lambda item: item.address):
        data = write_number(values[item.name], item)
        if item.address == end:
            address, earlier = found[-1]
            found[-1] = (address, earlier + data)
        else:
            found.append((item.address, data))
        end = item.end
    return found
