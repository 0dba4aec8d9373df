"""Commands for people: who is on the bus, objects of a node read and written, what an EDS says of a drive."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final

from pydantic import Field
from rich.console import Console
from rich.table import Table

from crtk_driver_canopen import eds
from crtk_driver_canopen.bus import BusAddress, CanLink
from crtk_driver_canopen.candump import CandumpLog
from crtk_driver_canopen.config import CanopenConfig
from crtk_driver_canopen.eds_profile import first_profile, oddities
from crtk_driver_canopen.emcy import error_text
from crtk_driver_canopen.heartbeat import nmt_text
from crtk_driver_canopen.master import Master
from crtk_driver_canopen.modes import MODES, status_text
from crtk_driver_canopen.objects import OBJECTS, Entry, ObjectType, parse_object
from crtk_driver_canopen.scanning import Axis, Found, answering, survey
from crtk_drivers.config import Settings
from crtk_drivers.errors import ConfigError
from crtk_drivers.errors.wording import worded
from crtk_drivers.plugins import Tool

_OUT = Console(highlight=False)


def bus_address(config: CanopenConfig) -> BusAddress:
    """Return the bus of a configuration."""
    bus = config.bus
    return BusAddress(bus.interface, bus.channel, bus.bitrate, bus.options)


@contextmanager
def opened_master(config: CanopenConfig) -> Iterator[Master]:
    """Open the bus of a configuration, send nothing, and close it at the end.

    Raises:
        ConfigError, ConnectionFailed: see `crtk_driver_canopen.bus.CanLink.open`.
    """
    with ExitStack() as stack:
        record = None
        if config.candump:
            log = stack.enter_context(CandumpLog(Path(config.candump), config.bus.channel))
            record = log.put
        link = CanLink(bus_address(config), record)
        stack.callback(link.close)
        link.open()
        yield Master(link, sdo_timeout=config.sdo_timeout)


class ScanOptions(Settings):
    """Options of `scan`."""

    first: int = Field(default=1, ge=1, le=127, description="First node id that is asked.")
    last: int = Field(default=127, ge=1, le=127, description="Last node id that is asked.")
    seconds: float = Field(
        default=0.3, gt=0.0, le=60.0, description="Time to wait for the last answer, in s."
    )


def scan(config: CanopenConfig, options: ScanOptions) -> int:
    """Print every node that answers, with its identity, modes and state. Nothing is changed."""
    with opened_master(config) as master:
        nodes = answering(master.link, options.seconds, range(options.first, options.last + 1))
        found = survey(master, nodes)
        where = master.link.where
    if not found:
        _OUT.print(
            f"{where}: no node answers. Check power, wiring, termination and bit rate.",
            markup=False,
        )
        return 1
    _OUT.print(_overview(found))
    return 0


def _overview(found: list[Found]) -> Table:
    table = Table("node", "device", "identity", "network", "axis", "modes", "state", box=None)
    for each in found:
        who = each.identity
        identity = f"{_hex(who.vendor)} {_hex(who.product)} {_hex(who.revision)} {who.serial or ''}"
        first = [str(each.node), who.name or f"profile {who.profile}", identity, nmt_text(each.nmt)]
        rows = [_axis(axis) for axis in each.axes] or [["", "", each.trouble or "no drive"]]
        for number, row in enumerate(rows):
            table.add_row(*(first if number == 0 else [""] * len(first)), *row)
    return table


def _axis(axis: Axis) -> list[str]:
    modes = " ".join(mode.name.lower() for mode in MODES if mode in axis.modes)
    state = status_text(axis.statusword, axis.mode or 0)
    if axis.error:
        state += f"; {axis.error_text} (0x{axis.error:04x})"
    return [str(axis.number), modes, state]


def _hex(value: int | None) -> str:
    return "-" if value is None else f"0x{value:x}"


class ProfileOptions(Settings):
    """Options of `profile`."""

    eds: str = Field(min_length=1, max_length=4096, description="EDS or DCF file of the drive.")
    output: str = Field(
        default="",
        max_length=4096,
        description="Where to write the profile (.toml); shown if empty.",
    )


def profile(config: CanopenConfig, options: ProfileOptions) -> int:
    """Say what is odd about the drive of an EDS, and write a first profile of it. The bus is not needed.

    Raises:
        ConfigError: the EDS cannot be read, or the profile not be written; an existing file is left.
    """
    sheet = eds.load(options.eds, 1)  # whatever its node id, for COB-IDs
    odd = oddities(sheet)
    text = first_profile(sheet, odd)
    for each in [*sheet.repairs, *odd]:
        _OUT.print(f"- {worded(each)}", markup=False, soft_wrap=True)
    if not options.output:
        _OUT.print(f"\n{text}", markup=False, soft_wrap=True)
        return 0
    path = Path(options.output)
    if path.suffix != ".toml":
        raise ConfigError(
            f"{path} is no name of a profile", where="--output", remedy="Give a name with .toml."
        )
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be written: {error.strerror}",
            where="--output",
            remedy="Give the name of a new file in a folder that is there.",
        ) from error
    _OUT.print(
        f"{path} is written: read it, complete it, and give `profile: {path}` of the joint.",
        markup=False,
        soft_wrap=True,
    )
    return 0


class SdoOptions(Settings):
    """Options of `sdo`."""

    node: int = Field(ge=1, le=127, description="Id of the node.")
    object: str = Field(
        min_length=1,
        max_length=200,
        description="INDEX[:SUB] in hexadecimal, or a name: 6064, 1018:4, 'position actual'.",
    )
    value: str | None = Field(
        default=None,
        max_length=4096,
        description="Write this: a number, 0x..., text, or bytes in hexadecimal; read if null.",
    )
    type: str = Field(
        default="",
        max_length=8,
        description="u8, i16, u32, f32, text, bytes, ...; that of the EDS or of CiA 402 if empty.",
    )
    axis: int = Field(default=0, ge=0, le=7, description="Axis of a node with several.")
    eds: str = Field(
        default="",
        max_length=4096,
        description="EDS or DCF file of the node; that of its joint in the configuration if empty.",
    )


def sdo(config: CanopenConfig, options: SdoOptions) -> int:
    """Read or write one object of a node, and print it."""
    entry = find_entry(config, options)
    data = None if options.value is None else parse_value(entry, options.value)
    with opened_master(config) as master:
        channel = master.sdo(options.node)
        began = time.monotonic()
        if data is not None:
            channel.download(entry.index, entry.sub, data)
        found = channel.upload(entry.index, entry.sub)
        took = time.monotonic() - began
    _OUT.print(f"{entry} = {value_text(entry, found)}   ({took * 1e3:.1f} ms)", markup=False)
    return 0


def find_entry(config: CanopenConfig, options: SdoOptions) -> Entry:
    """Return the object that is meant, with its type.

    Raises:
        ConfigError: there is no such object or type, or the EDS cannot be read.
    """
    path = options.eds or next(
        (joint.eds for joint in config.joints.values() if joint.node == options.node), ""
    )
    try:
        if path:
            entry = eds.load(path, options.node).find(options.object)
        else:
            index, sub = parse_object(options.object)
            entry = _STANDARD.get((index, sub), Entry(index, sub, ObjectType.BYTES, ""))
        kind = ObjectType[options.type.upper()] if options.type else entry.type
    except KeyError as error:
        names = ", ".join(each.name.lower() for each in ObjectType)
        raise ConfigError(
            f"there is no type {options.type!r}", where="--type", remedy=f"Give one of {names}."
        ) from error
    except ValueError as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(str(error), where="object") from error
    return Entry(entry.index, entry.sub, kind, entry.name).on_axis(options.axis)


_STANDARD: Final = {(entry.index, entry.sub): entry for entry in OBJECTS.values()}


def parse_value(entry: Entry, text: str) -> bytes:
    """Return the bytes of a value that is given as text.

    Raises:
        ConfigError: it is none of the object's type, or does not fit into it.
    """
    try:
        if entry.type is ObjectType.TEXT:
            return entry.type.pack(text)
        if not entry.type.format:
            return bytes.fromhex(text)
        if entry.type in (ObjectType.F32, ObjectType.F64):
            return entry.type.pack(float(text))
        return entry.type.pack(int(text, 0))
    except ValueError as error:
        raise ConfigError(
            f"{text!r} is no value for {entry} ({entry.type.name.lower()}): {error}",
            where="value",
            remedy="Bytes are given in hexadecimal; --type says how else to read it.",
        ) from error


def value_text(entry: Entry, data: bytes) -> str:
    """Return the value of an object for people; its bytes where they are not of its type."""
    try:
        value = entry.type.unpack(data)
    except ValueError:
        return data.hex(" ")
    if isinstance(value, bytes):
        number = f" ({int.from_bytes(value, 'little')})" if 0 < len(value) <= 8 else ""
        return f"{value.hex(' ')}{number}"
    if not isinstance(value, int):
        return repr(value)
    plain = f"{value} (0x{value & ((1 << entry.type.bits) - 1):0{entry.type.bits // 4}x})"
    words = {0x6041: lambda: status_text(value, 0), 0x603F: lambda: error_text(value)}
    meaning = words.get(entry.index)
    return f"{plain}: {meaning()}" if meaning else plain


def _nothing_needed(config: CanopenConfig) -> None:
    """A bus can be looked at without joints."""


TOOLS: Final = (
    Tool(
        "scan",
        "list the nodes on the bus with identity, modes and state",
        scan,
        ScanOptions,
        check_real=_nothing_needed,
    ),
    Tool(
        "sdo",
        "read or write an object of a node, by number or name",
        sdo,
        SdoOptions,
        arguments=("node", "object", "value"),
        check_real=_nothing_needed,
    ),
    Tool(
        "profile",
        "say what is odd about the drive of an EDS, and write a first profile of it",
        profile,
        ProfileOptions,
        arguments=("eds",),
        check_real=_nothing_needed,
    ),
)
