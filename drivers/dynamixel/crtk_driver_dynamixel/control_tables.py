"""Control tables: which register of a servo lies where, by model number and firmware.

    table = control_table(1020, firmware=50)
    table["present_position"]        # Item(name='present_position', address=132, size=4, ...)

The tables of protocol 2.0 are the ``.model`` files of dynamixel-sdk 4 (package ``dynamixel_easy_sdk``), with
what they lack or have wrong put right by `CORRECTIONS`; those of protocol 1.0 are ours, from the e-manual.
Names are those of the e-manual in snake_case. Raw integers only: see `crtk_driver_dynamixel.units` for SI.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import Final

from typing_extensions import override

from crtk_drivers.errors import ConfigError, MissingExtra


class Coding(StrEnum):
    """How the bytes of an item stand for a number; little-endian all of them."""

    UNSIGNED = "unsigned"
    TWOS_COMPLEMENT = "twos_complement"
    SIGN_BIT_10 = "sign_bit_10"
    """0 to 1023, and bit 10 is the sign (AX, MX with protocol 1.0, XL-320)."""
    OFFSET_2048 = "offset_2048"
    """2048 stands for zero (current of MX with protocol 1.0)."""


@dataclass(frozen=True, slots=True)
class Item:
    """One item of a control table.

    Attributes:
        address: of its first byte.
        size: in bytes: 1, 2 or 4.
        writable: false if the servo refuses writes.
        eeprom: survives power-off; written only while torque is off, and only so many times.
    """

    name: str
    address: int
    size: int
    coding: Coding = Coding.UNSIGNED
    writable: bool = True
    eeprom: bool = False

    @property
    def end(self) -> int:
        """Address of the byte behind it."""
        return self.address + self.size

    @property
    def signed(self) -> bool:
        """Whether it can be below zero."""
        return self.coding is not Coding.UNSIGNED

    @property
    def range(self) -> tuple[int, int]:
        """Least and greatest number that its bytes can say."""
        if self.coding is Coding.SIGN_BIT_10:
            return -1023, 1023
        if self.coding is Coding.OFFSET_2048:
            return -2048, 2047
        bits = 8 * self.size
        if self.coding is Coding.TWOS_COMPLEMENT:
            return -(1 << (bits - 1)), (1 << (bits - 1)) - 1
        return 0, (1 << bits) - 1


@dataclass(frozen=True, slots=True)
class IndirectBlock:
    """Consecutive indirect registers: `count` addresses of two bytes, and as many bytes of data."""

    address: int
    data: int
    count: int


@dataclass(frozen=True, slots=True, eq=False)
class ControlTable(Mapping[str, Item]):
    """The items of one model and firmware, by name.

    Attributes:
        model: its name, for example ``xm430-w350``.
        number: its model number.
        protocol: 1 or 2.
        firmware: the firmware from which on this table is right; 0 if every firmware has it.
        indirect: blocks of indirect addressing; none if the model has none.
    """

    model: str
    number: int
    protocol: int
    firmware: int
    items_by_name: Mapping[str, Item]
    indirect: tuple[IndirectBlock, ...] = ()

    @override
    def __getitem__(self, name: str) -> Item:
        return self.items_by_name[name]

    @override
    def __iter__(self) -> Iterator[str]:
        return iter(self.items_by_name)

    @override
    def __len__(self) -> int:
        return len(self.items_by_name)

    def item(self, name: str) -> Item:
        """Return an item.

        Raises:
            ConfigError: this model has no such item.
        """
        if name not in self.items_by_name:
            raise ConfigError(
                f"{self.model} (model number {self.number}) has no item {name!r}",
                remedy="See the control table of this model in the e-manual; names are in snake_case.",
            )
        return self.items_by_name[name]

    def first(self, names: Sequence[str]) -> Item | None:
        """Return the first of `names` that this model has, None if it has none of them."""
        return next((self.items_by_name[n] for n in names if n in self.items_by_name), None)

    def block(self, names: Sequence[str]) -> tuple[int, int]:
        """Return address and length of the smallest block that holds all of `names`.

        Raises:
            ConfigError: this model lacks one of them.
        """
        items = [self.item(name) for name in names]
        address = min(item.address for item in items)
        return address, max(item.end for item in items) - address


POSITION: Final = ("present_position",)
VELOCITY: Final = ("present_velocity", "present_speed")
EFFORT: Final = ("present_current", "current", "present_load")
"""What is measured, by the names that models have for it, the better one first."""
VOLTAGE: Final = ("present_input_voltage", "present_voltage")


_CODINGS: Final[Mapping[Coding, frozenset[str]]] = MappingProxyType(
    {
        Coding.TWOS_COMPLEMENT: frozenset(
            {
                "bus_watchdog",  # reads -1 when it has tripped (X series, Bus Watchdog (98))
                "current_offset",
                "goal_current",
                "goal_position",
                "goal_pwm",
                "goal_velocity",
                "homing_offset",
                "max_position_limit",
                "min_position_limit",
                "multi_turn_offset",
                "position_trajectory",
                "present_current",
                "present_load",
                "present_position",
                "present_pwm",
                "present_velocity",
                "pwm_offset",
                "velocity_offset",
                "velocity_trajectory",
            }
        ),
        Coding.SIGN_BIT_10: frozenset({"present_speed", "moving_speed", "goal_torque"}),
        Coding.OFFSET_2048: frozenset({"current"}),
    }
)
"""Every other item is unsigned."""

_READ_ONLY: Final = re.compile(
    r"model_(number|information)|firmware_version|registered_instruction|hardware_error_status"
    r"|realtime_tick|moving|moving_status|present_(?!velocity_lpf).*|current"
    r"|(position|velocity)_trajectory|backup_ready|controller_state|error_code.*"
)

_FIRST_IN_RAM: Final[Mapping[str, int]] = MappingProxyType(
    {"xl320": 24, "x": 64, "2x": 64, "mx": 64, "p": 512, "h": 512, "m": 512, "rh": 512, "y": 512}
)
"""First address that is not EEPROM, by how the file's name begins (the longest that fits counts)."""

_ALIASES: Final[Mapping[str, str]] = MappingProxyType(
    {"baud_rate_bus": "baud_rate", "secondary_shadow_id": "secondary_id"}
)
"""One name for what models call by two."""

_NOT_ITEMS: Final = re.compile(r"indirect_(address|data)_(write|read)")
"""The SDK's names for its own division of the indirect registers."""

_INDIRECT_BLOCKS: Final[Mapping[tuple[int, int], tuple[IndirectBlock, ...]]] = MappingProxyType(
    {
        (168, 224): (IndirectBlock(168, 224, 28), IndirectBlock(578, 634, 28)),
        (168, 208): (IndirectBlock(168, 208, 20),),
        (168, 634): (IndirectBlock(168, 634, 128),),
        (256, 634): (IndirectBlock(256, 634, 128),),
    }
)
"""By the addresses of the first indirect address and data. An X330 with a firmware below 52 has its data at
224 by the SDK and at 208 by the e-manual: its factory value of indirect address 1 tells which."""


@dataclass(frozen=True, slots=True)
class Correction:
    """What a ``.model`` file lacks, or has wrong.

    Attributes:
        files: which ones, as a regular expression for the whole name without suffix.
        since: the first firmware that it holds for.
        items: to add, or to put in the place of those of the same name.
        indirect: instead of what `_INDIRECT_BLOCKS` says.
    """

    files: str
    since: int = 0
    items: tuple[Item, ...] = ()
    indirect: tuple[IndirectBlock, ...] | None = None


_STARTUP = Item("startup_configuration", 60, 1, eeprom=True)
_BACKUP = Item("backup_ready", 147, 1, writable=False)

CORRECTIONS: Final = (
    # e-manual, X series: Startup Configuration (60) and Backup Ready (147) since firmware 45 (X330: 46).
    Correction(r"x[mhdw](430|540)_.*|x[lc]430_.*|2x.*", 45, (_STARTUP, _BACKUP)),
    Correction(r"x[lc]330_.*", 46, (_STARTUP, _BACKUP)),
    # A block of 28 from 224 on, as in the other X models, would run beyond what this family has.
    Correction(r"x[lc]330_[a-z0-9]+", indirect=(IndirectBlock(168, 224, 20),)),
)

_MORE_NUMBERS: Final[Mapping[int, str]] = MappingProxyType({1280: "xw430_t200"})
"""Model numbers that ``dynamixel.model`` lacks although their file is there (e-manual, XW430-T200)."""


def control_table(
    number: int, firmware: int | None = None, *, protocol: int | None = None
) -> ControlTable:
    """Return the control table of a servo.

    Args:
        number: its model number, as a ping tells it.
        firmware: its firmware version; the newest that is known if None.
        protocol: 1 or 2, for models that speak both; by default that of the model.

    Raises:
        ConfigError: no such model, or it does not speak that protocol.
        MissingExtra: dynamixel-sdk is not installed.
    """
    if number in PROTOCOL_1:
        table = _protocol_1_table(number)
    else:
        table = _sdk_table(number, 255 if firmware is None else firmware)
    if protocol in (None, table.protocol):
        return table
    if protocol == 1 and re.match(r"x[mhdwlc](430|540)|2x|mx", table.model):
        # Protocol 1.0 has addresses of one byte.
        items = {name: item for name, item in table.items() if item.end <= 256}
        blocks = tuple(block for block in table.indirect if block.data + block.count <= 256)
        return replace(table, protocol=1, items_by_name=MappingProxyType(items), indirect=blocks)
    raise ConfigError(
        f"{table.model} does not speak protocol {protocol}",
        remedy=f"Leave the key protocol out, or set it to {table.protocol}.",
    )


@cache
def model_files() -> Mapping[int, str]:
    """Return the model numbers of protocol 2.0 and the name of each ``.model`` file without suffix.

    Raises:
        MissingExtra: dynamixel-sdk is not installed.
    """
    numbers = dict(_MORE_NUMBERS)
    for line in (_folder() / "dynamixel.model").read_text("utf-8-sig").splitlines():
        number, _, file = line.partition("\t")
        if number.strip().isdecimal():
            numbers[int(number)] = file.strip().removesuffix(".model")
    return MappingProxyType(dict(sorted(numbers.items())))


def _folder() -> Path:
    spec = find_spec("dynamixel_easy_sdk")  # importing it would import pyserial and the whole SDK
    if spec is None or not spec.submodule_search_locations:
        raise MissingExtra("dynamixel-sdk", "dynamixel")
    return Path(next(iter(spec.submodule_search_locations))) / "control_table"


@cache
def _sdk_table(number: int, firmware: int) -> ControlTable:
    stem = model_files().get(number)
    if stem is None:
        known = sorted({*model_files(), *PROTOCOL_1}, key=lambda other: abs(other - number))[:5]
        raise ConfigError(
            f"model number {number} is not known",
            remedy=f"Known numbers near by: {', '.join(map(str, sorted(known)))}. If the servo is newer than "
            "the installed dynamixel-sdk, update that: pip install -U dynamixel-sdk. If several servos "
            "have this id, their answers collide: connect them one at a time.",
        )
    since, file = max((version, path) for version, path in _versions(stem) if version <= firmware)
    first_in_ram = _FIRST_IN_RAM[max((p for p in _FIRST_IN_RAM if stem.startswith(p)), key=len)]
    items = {item.name: item for item in _read_items(file, first_in_ram, stem == "xl320")}
    indirect: tuple[IndirectBlock, ...] = ()
    if "indirect_data_1" in items:
        key = (items["indirect_address_1"].address, items["indirect_data_1"].address)
        indirect = _INDIRECT_BLOCKS[key]
    for correction in CORRECTIONS:
        if firmware >= correction.since and re.fullmatch(correction.files, file.stem):
            items |= {item.name: item for item in correction.items}
            since = max(since, correction.since)
            indirect = indirect if correction.indirect is None else correction.indirect
    ordered = dict(sorted(items.items(), key=lambda pair: pair[1].address))
    model = stem.replace("_", "-").replace("xl320", "xl-320")
    return ControlTable(model, number, 2, since, MappingProxyType(ordered), indirect)


def _versions(stem: str) -> Iterator[tuple[int, Path]]:
    """Yield the files of a model, each with the first firmware that it is for."""
    yield 0, _folder() / f"{stem}.model"
    for path in _folder().glob(f"{stem}_fw*.model"):
        version = path.stem.rpartition("_fw")[2]
        if version.isdecimal():
            yield int(version), path


def _read_items(path: Path, first_in_ram: int, is_older: bool) -> Iterator[Item]:
    _, _, table = path.read_text("utf-8-sig").partition("[control table]")
    for line in table.splitlines():
        fields = [field.strip() for field in line.split("\t")]
        if len(fields) >= 3 and fields[0].isdecimal():
            name = snake_case(fields[2])
            if not _NOT_ITEMS.fullmatch(name):
                yield _item(name, int(fields[0]), int(fields[1]), first_in_ram, is_older)


def _item(name: str, address: int, size: int, first_in_ram: int, is_older: bool) -> Item:
    """Return an item; in older tables a load has its sign in bit 10, as a speed has."""
    codings = (coding for coding, names in _CODINGS.items() if name in names)
    coding = next(codings, Coding.UNSIGNED)
    if is_older and name == "present_load":
        coding = Coding.SIGN_BIT_10
    writable = not _READ_ONLY.fullmatch(name)
    return Item(name, address, size, coding, writable, address < first_in_ram)


def snake_case(name: str) -> str:
    """Return a name of the e-manual as it is called here: ``Goal PWM`` is ``goal_pwm``."""
    text = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
    return _ALIASES.get(text, text)


# e-manual, AX-12A and MX-28 (protocol 1.0), Control Table: name, address, size.
_COMMON: Final = (
    ("model_number", 0, 2),
    ("firmware_version", 2, 1),
    ("id", 3, 1),
    ("baud_rate", 4, 1),
    ("return_delay_time", 5, 1),
    ("cw_angle_limit", 6, 2),
    ("ccw_angle_limit", 8, 2),
    ("temperature_limit", 11, 1),
    ("min_voltage_limit", 12, 1),
    ("max_voltage_limit", 13, 1),
    ("max_torque", 14, 2),
    ("status_return_level", 16, 1),
    ("alarm_led", 17, 1),
    ("shutdown", 18, 1),
    ("torque_enable", 24, 1),
    ("led", 25, 1),
    ("goal_position", 30, 2),
    ("moving_speed", 32, 2),
    ("torque_limit", 34, 2),
    ("present_position", 36, 2),
    ("present_speed", 38, 2),
    ("present_load", 40, 2),
    ("present_voltage", 42, 1),
    ("present_temperature", 43, 1),
    ("registered_instruction", 44, 1),
    ("moving", 46, 1),
    ("lock", 47, 1),
    ("punch", 48, 2),
)
_COMPLIANCE: Final = (
    ("cw_compliance_margin", 26, 1),
    ("ccw_compliance_margin", 27, 1),
    ("cw_compliance_slope", 28, 1),
    ("ccw_compliance_slope", 29, 1),
)
_GAINS: Final = (
    ("multi_turn_offset", 20, 2),
    ("resolution_divider", 22, 1),
    ("d_gain", 26, 1),
    ("i_gain", 27, 1),
    ("p_gain", 28, 1),
    ("realtime_tick", 50, 2),
    ("goal_acceleration", 73, 1),
)
_TORQUE_CONTROL: Final = (
    ("current", 68, 2),
    ("torque_control_mode_enable", 70, 1),
    ("goal_torque", 71, 2),
)
_AX: Final = (*_COMMON, *_COMPLIANCE)
_MX: Final = (*_COMMON, *_GAINS)
_MX_TORQUE: Final = (*_MX, *_TORQUE_CONTROL)

PROTOCOL_1: Final[Mapping[int, tuple[str, tuple[tuple[str, int, int], ...]]]] = MappingProxyType(
    {
        10: ("rx-10", _AX),
        12: ("ax-12a", _AX),
        18: ("ax-18a", _AX),
        24: ("rx-24f", _AX),
        28: ("rx-28", _AX),
        29: ("mx-28-1.0", _MX),
        64: ("rx-64", _AX),
        300: ("ax-12w", _AX),
        310: ("mx-64-1.0", _MX_TORQUE),
        320: ("mx-106-1.0", (*_MX_TORQUE, ("drive_mode", 10, 1))),
        360: ("mx-12w-1.0", _MX),
    }
)
"""Models of protocol 1.0 by model number: name and items."""


@cache
def _protocol_1_table(number: int) -> ControlTable:
    model, rows = PROTOCOL_1[number]
    items = {row[0]: _item(*row, first_in_ram=24, is_older=True) for row in rows}
    if "multi_turn_offset" not in items:  # one turn at most: no sign
        for name in ("goal_position", "present_position"):
            items[name] = replace(items[name], coding=Coding.UNSIGNED)
    ordered = dict(sorted(items.items(), key=lambda pair: pair[1].address))
    return ControlTable(model, number, 1, 0, MappingProxyType(ordered))
