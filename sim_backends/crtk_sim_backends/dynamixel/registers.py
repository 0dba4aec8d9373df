"""Control tables: which register lies where, who may write it, its factory value and its bounds.

Sources: the e-manual's control tables of the X series, MX(2.0), P series, AX-12A and MX-28/64 (1.0). The
tables are rows of plain data; a model adds its own values (`crtk_sim_backends.dynamixel.models`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any, Final


class Access(Enum):
    """Who may write a register, and when."""

    READ = "r"
    RAM = "w"
    EEPROM = "e"
    """Only while torque is off; survives power-off."""
    LOCKED = "l"
    """In RAM, but only while torque is off."""


@dataclass(frozen=True, slots=True)
class Register:
    """One register.

    Attributes:
        low, high: the values that a write may have.
        end: address of the byte behind it.
        fixed: nobody may write it; locked: not while torque is on.
        shapes: it is one of those that say what a servo is: settings, and how much it answers.
    """

    address: int
    size: int
    name: str
    access: Access
    default: int
    low: int
    high: int
    signed: bool = False
    end: int = field(init=False)
    fixed: bool = field(init=False)
    locked: bool = field(init=False)
    shapes: bool = field(init=False)

    def __post_init__(self) -> None:
        derived = {
            "end": self.address + self.size,
            "fixed": self.access is Access.READ,
            "locked": self.access in (Access.EEPROM, Access.LOCKED),
            "shapes": self.access is Access.EEPROM or self.name == "status_return_level",
        }
        for name, value in derived.items():
            object.__setattr__(self, name, value)

    def encode(self, value: int) -> bytes:
        """Bytes of a value."""
        return value.to_bytes(self.size, "little", signed=value < 0)

    def decode(self, data: bytes | bytearray) -> int:
        """Value of bytes."""
        return int.from_bytes(data, "little", signed=self.signed)


@dataclass(frozen=True, slots=True)
class Block:
    """Indirect addressing: `count` addresses of two bytes each, and as many bytes of data."""

    address: int
    data: int
    count: int


class Table:
    """All registers of one model and firmware, by name and by address."""

    def __init__(self, registers: Iterable[Register], blocks: tuple[Block, ...] = ()) -> None:
        self.blocks = blocks
        self.by_name = {register.name: register for register in registers}
        ends = [register.address + register.size for register in self.by_name.values()]
        self.size = max([*ends, *(block.data + block.count for block in blocks)])
        self.indirect_from = min((block.data for block in blocks), default=self.size)
        self.at: list[Register | None] = [None] * self.size
        for register in self.by_name.values():
            for address in range(register.address, register.address + register.size):
                self.at[address] = register

    def __getitem__(self, name: str) -> Register:
        return self.by_name[name]

    def __contains__(self, name: str) -> bool:
        return name in self.by_name

    def __iter__(self) -> Iterator[Register]:
        return iter(self.by_name.values())


Row = tuple[Any, ...]

# address, size ("i": signed), name, access, factory value, low, high. Without bounds: all values.
_EEPROM: Final[tuple[Row, ...]] = (
    (0, "2", "model_number", "r", 0),
    (2, "4", "model_information", "r", 0),
    (6, "1", "firmware_version", "r", 0),
    (7, "1", "id", "e", 1, 0, 252),
    (8, "1", "baud_rate", "e", 1, 0, 7),
    (9, "1", "return_delay_time", "e", 250, 0, 254),
    (10, "1", "drive_mode", "e", 0, 0, 13),
    (11, "1", "operating_mode", "e", 3, 0, 16),
    (12, "1", "secondary_id", "e", 255, 0, 255),
    (13, "1", "protocol_type", "e", 2, 1, 2),
    (20, "4i", "homing_offset", "e", 0, -1_044_479, 1_044_479),
    (24, "4", "moving_threshold", "e", 10, 0, 1023),
    (31, "1", "temperature_limit", "e", 80, 0, 100),
    (32, "2", "max_voltage_limit", "e", 160),
    (34, "2", "min_voltage_limit", "e", 95),
    (36, "2", "pwm_limit", "e", 885, 0, 885),
    (38, "2", "current_limit", "e", 0),
    (40, "4", "acceleration_limit", "e", 32767, 0, 32767),
    (44, "4", "velocity_limit", "e", 200, 0, 1023),
    (48, "4i", "max_position_limit", "e", 4095, 0, 4095),
    (52, "4i", "min_position_limit", "e", 0, 0, 4095),
    (60, "1", "startup_configuration", "e", 0, 0, 3),
    (62, "1", "pwm_slope", "e", 140, 1, 255),
    (63, "1", "shutdown", "e", 0x34, 0, 63),
)

_RAM: Final[tuple[Row, ...]] = (
    (64, "1", "torque_enable", "w", 0, 0, 1),
    (65, "1", "led", "w", 0, 0, 1),
    (68, "1", "status_return_level", "w", 2, 0, 2),
    (69, "1", "registered_instruction", "r", 0),
    (70, "1", "hardware_error_status", "r", 0),
    (76, "2", "velocity_i_gain", "w", 1920, 0, 16383),
    (78, "2", "velocity_p_gain", "w", 100, 0, 16383),
    (80, "2", "position_d_gain", "w", 0, 0, 16383),
    (82, "2", "position_i_gain", "w", 0, 0, 16383),
    (84, "2", "position_p_gain", "w", 800, 0, 16383),
    (88, "2", "feedforward_2nd_gain", "w", 0, 0, 16383),
    (90, "2", "feedforward_1st_gain", "w", 0, 0, 16383),
    (98, "1i", "bus_watchdog", "w", 0, 0, 127),
    (100, "2i", "goal_pwm", "w", 885),
    (102, "2i", "goal_current", "w", 0),
    (104, "4i", "goal_velocity", "w", 0),
    (108, "4", "profile_acceleration", "w", 0, 0, 32767),
    (112, "4", "profile_velocity", "w", 0, 0, 32767),
    (116, "4i", "goal_position", "w", 0),
    (120, "2", "realtime_tick", "r", 0),
    (122, "1", "moving", "r", 0),
    (123, "1", "moving_status", "r", 0),
    (124, "2i", "present_pwm", "r", 0),
    (126, "2i", "present_current", "r", 0),
    (128, "4i", "present_velocity", "r", 0),
    (132, "4i", "present_position", "r", 0),
    (136, "4i", "velocity_trajectory", "r", 0),
    (140, "4i", "position_trajectory", "r", 0),
    (144, "2", "present_input_voltage", "r", 0),
    (146, "1", "present_temperature", "r", 0),
    (147, "1", "backup_ready", "r", 0),
)

_LED_RGB: Final[tuple[Row, ...]] = (
    (513, "1", "led_red", "w", 0, 0, 255),
    (514, "1", "led_green", "w", 0, 0, 255),
    (515, "1", "led_blue", "w", 0, 0, 255),
)

_EXTERNAL_PORTS: Final[tuple[Row, ...]] = (
    *((56 + n, "1", f"external_port_mode_{n + 1}", "e", 3, 0, 3) for n in range(3)),
    *((152 + 2 * n, "2", f"external_port_data_{n + 1}", "w", 0, 0, 4095) for n in range(3)),
)

_AX: Final[tuple[Row, ...]] = (
    (0, "2", "model_number", "r", 0),
    (2, "1", "firmware_version", "r", 0),
    (3, "1", "id", "e", 1, 0, 253),
    (4, "1", "baud_rate", "e", 1, 0, 254),
    (5, "1", "return_delay_time", "e", 250, 0, 254),
    (6, "2", "cw_angle_limit", "e", 0, 0, 1023),
    (8, "2", "ccw_angle_limit", "e", 1023, 0, 1023),
    (11, "1", "temperature_limit", "e", 70, 0, 150),
    (12, "1", "min_voltage_limit", "e", 60, 50, 250),
    (13, "1", "max_voltage_limit", "e", 140, 50, 250),
    (14, "2", "max_torque", "e", 1023, 0, 1023),
    (16, "1", "status_return_level", "e", 2, 0, 2),
    (17, "1", "alarm_led", "e", 0x24, 0, 127),
    (18, "1", "shutdown", "e", 0x24, 0, 127),
    (24, "1", "torque_enable", "w", 0, 0, 1),
    (25, "1", "led", "w", 0, 0, 1),
    (26, "1", "cw_compliance_margin", "w", 1, 0, 255),
    (27, "1", "ccw_compliance_margin", "w", 1, 0, 255),
    (28, "1", "cw_compliance_slope", "w", 32, 1, 254),
    (29, "1", "ccw_compliance_slope", "w", 32, 1, 254),
    (30, "2", "goal_position", "w", 0, 0, 1023),
    (32, "2", "moving_speed", "w", 0, 0, 2047),
    (34, "2", "torque_limit", "w", 1023, 0, 1023),
    (36, "2", "present_position", "r", 0),
    (38, "2", "present_speed", "r", 0),
    (40, "2", "present_load", "r", 0),
    (42, "1", "present_voltage", "r", 0),
    (43, "1", "present_temperature", "r", 0),
    (44, "1", "registered", "r", 0),
    (46, "1", "moving", "r", 0),
    (47, "1", "lock", "w", 0, 0, 1),
    (48, "2", "punch", "w", 32, 0, 1023),
)

_MX_CHANGES: Final[tuple[Row, ...]] = (
    (6, "2", "cw_angle_limit", "e", 0, 0, 4095),
    (8, "2", "ccw_angle_limit", "e", 4095, 0, 4095),
    (11, "1", "temperature_limit", "e", 80, 0, 99),
    (20, "2i", "multi_turn_offset", "e", 0, -24576, 24576),
    (22, "1", "resolution_divider", "e", 1, 1, 4),
    (26, "1", "d_gain", "w", 0, 0, 254),
    (27, "1", "i_gain", "w", 0, 0, 254),
    (28, "1", "p_gain", "w", 32, 0, 254),
    (30, "2i", "goal_position", "w", 0, -28672, 28672),
    (36, "2i", "present_position", "r", 0),
    (50, "2", "realtime_tick", "r", 0),
    (73, "1", "goal_acceleration", "w", 0, 0, 254),
)

_MX_TORQUE: Final[tuple[Row, ...]] = (
    (68, "2", "current", "r", 2048),
    (70, "1", "torque_control_mode_enable", "w", 0, 0, 1),
    (71, "2", "goal_torque", "w", 0, 0, 2047),
)

_XL320: Final[tuple[Row, ...]] = (
    (0, "2", "model_number", "r", 0),
    (2, "1", "firmware_version", "r", 0),
    (3, "1", "id", "e", 1, 0, 252),
    (4, "1", "baud_rate", "e", 3, 0, 3),
    (5, "1", "return_delay_time", "e", 250, 0, 254),
    (6, "2", "cw_angle_limit", "e", 0, 0, 1023),
    (8, "2", "ccw_angle_limit", "e", 1023, 0, 1023),
    (11, "1", "control_mode", "e", 2, 1, 2),
    (12, "1", "temperature_limit", "e", 65, 0, 150),
    (13, "1", "min_voltage_limit", "e", 60, 50, 250),
    (14, "1", "max_voltage_limit", "e", 90, 50, 250),
    (15, "2", "max_torque", "e", 1023, 0, 1023),
    (17, "1", "status_return_level", "e", 2, 0, 2),
    (18, "1", "shutdown", "e", 3, 0, 7),
    (24, "1", "torque_enable", "w", 0, 0, 1),
    (25, "1", "led", "w", 0, 0, 7),
    (27, "1", "d_gain", "w", 0, 0, 254),
    (28, "1", "i_gain", "w", 0, 0, 254),
    (29, "1", "p_gain", "w", 32, 0, 254),
    (30, "2", "goal_position", "w", 0, 0, 1023),
    (32, "2", "moving_speed", "w", 0, 0, 2047),
    (35, "2", "torque_limit", "w", 1023, 0, 1023),
    (37, "2", "present_position", "r", 0),
    (39, "2", "present_speed", "r", 0),
    (41, "2", "present_load", "r", 0),
    (45, "1", "present_voltage", "r", 0),
    (46, "1", "present_temperature", "r", 0),
    (47, "1", "registered_instruction", "r", 0),
    (49, "1", "moving", "r", 0),
    (50, "1", "hardware_error_status", "r", 0),
    (51, "2", "punch", "w", 32, 0, 1023),
)

_COMPLIANCE: Final = tuple(row[2] for row in _AX if "_compliance_" in row[2])  # no MX has them
_NO_CURRENT: Final = frozenset({"current_limit", "goal_current", "present_current"})
_SINCE_BACKUP: Final = frozenset({"startup_configuration", "backup_ready"})


class Series(Enum):
    """Families of servos that share a control table."""

    X = "X"
    X330 = "X330"
    X540 = "X540"
    X2 = "2X"
    MX = "MX(2.0)"
    P = "P"
    AX = "AX"
    MX_LEGACY = "MX(1.0)"
    XL320 = "XL-320"


LEGACY: Final = frozenset({Series.AX, Series.MX_LEGACY})
"""Those that speak protocol 1.0 only."""
OLDER: Final = LEGACY | {Series.XL320}
"""Those with the registers of the older servos."""

RAM_OFFSET: Final = {Series.P: 448}
"""By how much the RAM registers lie behind those of the X series."""

BACKUP_SINCE: Final = {Series.X: 45, Series.X540: 45, Series.X2: 45, Series.X330: 46, Series.P: 12}
"""First firmware with Startup Configuration, Backup Ready and the backup instruction."""

FAST_READ_SINCE: Final = {Series.X: 45, Series.X540: 45, Series.X330: 46, Series.P: 12}
"""First firmware with fast sync and fast bulk read; a series that is not here never has them."""


def make_table(
    series: Series,
    firmware: int,
    *,
    has_current: bool = True,
    values: Mapping[str, tuple[int, int, int]] | None = None,
) -> Table:
    """Build the control table of a servo.

    Args:
        series: its family.
        firmware: version of its firmware.
        has_current: it measures current; otherwise it has a load in its place.
        values: factory value, low and high of single registers of the model.
    """
    registers = {row[2]: _register(row) for row in _rows(series)}
    if series is Series.MX_LEGACY:
        missing = set(_COMPLIANCE) | (set() if has_current else {row[2] for row in _MX_TORQUE})
        for name in missing:
            del registers[name]
    if series not in OLDER:
        since = BACKUP_SINCE.get(series)
        missing = set() if since is not None and firmware >= since else set(_SINCE_BACKUP)
        if series is not Series.X330:
            missing.add("pwm_slope")
        if series not in (Series.MX, Series.P):
            missing.add("acceleration_limit")
        if not has_current:
            missing |= _NO_CURRENT
            load = replace(registers["present_current"], name="present_load")
            registers[load.name] = load
        for name in missing:
            registers.pop(name, None)
    for name, (default, low, high) in (values or {}).items():
        if name in registers:
            registers[name] = replace(registers[name], default=default, low=low, high=high)
    blocks = _blocks(series, firmware)
    for block in blocks:
        _add_block(registers, block, blocks)
    return Table(registers.values(), blocks)


def _rows(series: Series) -> Iterator[Row]:
    if series is Series.XL320:
        yield from _XL320
        return
    if series in LEGACY:
        yield from _AX
        if series is Series.MX_LEGACY:
            yield from _MX_CHANGES
            yield from _MX_TORQUE
        return
    offset = RAM_OFFSET.get(series, 0)
    yield from _EEPROM
    for address, *rest in _RAM:
        if series is Series.P and rest[1] == "led":
            yield from _LED_RGB
        elif series is Series.P and rest[1] == "backup_ready":
            yield (878, *rest)
        else:
            yield (address + offset, *rest)
    if series is Series.X540:
        yield from _EXTERNAL_PORTS


def _register(row: Row) -> Register:
    address, size, name, access, default, *bounds = row
    count, signed = int(size[0]), size.endswith("i")
    bits = 8 * count
    whole = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signed else (0, (1 << bits) - 1)
    low, high = bounds or whole
    return Register(address, count, name, Access(access), default, low, high, signed)


def _blocks(series: Series, firmware: int) -> tuple[Block, ...]:
    if series in OLDER:
        return ()
    if series is Series.P:
        return (Block(168, 634, 128),)
    if series is Series.X330:
        # The SDK's files have the data of older firmware at 224; the e-manual says 208 for all.
        return (Block(168, 208 if firmware >= 52 else 224, 20),)
    return (Block(168, 224, 28), Block(578, 634, 28))


def _add_block(registers: dict[str, Register], block: Block, blocks: tuple[Block, ...]) -> None:
    last = max(other.data + other.count for other in blocks) - 1
    start = 1 + sum(other.count for other in blocks if other.address < block.address)
    for n in range(block.count):
        name = f"indirect_address_{start + n}"
        own = block.data + n
        registers[name] = Register(
            block.address + 2 * n, 2, name, Access.LOCKED, own, 64, max(last, own)
        )
