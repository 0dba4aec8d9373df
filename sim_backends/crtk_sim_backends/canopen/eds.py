"""The electronic data sheet of a drive, written from its object dictionary (CiA 306-1)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final

from crtk_sim_backends.canopen.dictionary import DataType, Kind, Object, OfNode, Variable
from crtk_sim_backends.canopen.objects import MOST_PDOS

PUBLISHED: Final = Path(__file__).with_name("drive.eds")  # one axis, personality "standard"

_MANDATORY: Final = (0x1000, 0x1001, 0x1018)
_BAUD_RATES: Final = (10, 20, 50, 125, 250, 500, 800, 1000)


def electronic_data_sheet(
    objects: Iterable[Object], vendor: int, product: int, revision: int, device: str
) -> str:
    """Write the EDS of a node with these objects; the text has no identity of a single node."""
    every = sorted(objects, key=lambda entry: entry.index)
    return "\n".join(_lines(every, vendor, product, revision, device)) + "\n"


def _lines(
    objects: list[Object], vendor: int, product: int, revision: int, device: str
) -> Iterator[str]:
    yield from (
        "[FileInfo]",
        "FileName=drive.eds",
        "FileVersion=1",
        "FileRevision=1",
        "EDSVersion=4.0",
        f"Description={device}, CiA 402 servo drive",
        "CreationTime=12:00AM",
        "CreationDate=01-01-2026",
        "CreatedBy=crtk-drivers",
        "ModificationTime=12:00AM",
        "ModificationDate=01-01-2026",
        "ModifiedBy=crtk-drivers",
        "",
        "[DeviceInfo]",
        "VendorName=CRTK",
        f"VendorNumber=0x{vendor:08X}",
        f"ProductName={device}",
        f"ProductNumber=0x{product:08X}",
        f"RevisionNumber=0x{revision:08X}",
        f"OrderCode={device}",
        *(f"BaudRate_{rate}=1" for rate in _BAUD_RATES),
        "SimpleBootUpMaster=0",
        "SimpleBootUpSlave=1",
        "Granularity=8",
        "DynamicChannelsSupported=0",
        "GroupMessaging=0",
        f"NrOfRXPDO={_pdos(objects, 0x1400)}",
        f"NrOfTXPDO={_pdos(objects, 0x1800)}",
        "LSS_Supported=0",
        "",
        "[DummyUsage]",
        "Dummy0001=0",
        *(f"Dummy{number:04X}=1" for number in range(2, 8)),
        "",
        "[Comments]",
        "Lines=1",
        "Line1=Simulated drive of crtk-drivers; made from its object dictionary",
    )
    yield from _list_of("MandatoryObjects", (o for o in objects if o.index in _MANDATORY))
    yield from _list_of("OptionalObjects", (o for o in objects if _optional(o.index)))
    yield from _list_of("ManufacturerObjects", (o for o in objects if 0x2000 <= o.index <= 0x5FFF))
    for entry in objects:
        yield from _object(entry)


def _pdos(objects: Sequence[Object], base: int) -> int:
    """How many PDOs have their communication parameters from `base` on."""
    return sum(base <= entry.index < base + MOST_PDOS for entry in objects)


def _optional(index: int) -> bool:
    return index not in _MANDATORY and not 0x2000 <= index <= 0x5FFF


def _list_of(section: str, objects: Iterable[Object]) -> Iterator[str]:
    listed = list(objects)
    yield ""
    yield f"[{section}]"
    yield f"SupportedObjects={len(listed)}"
    for number, entry in enumerate(listed, 1):
        yield f"{number}=0x{entry.index:04X}"


def _object(entry: Object) -> Iterator[str]:
    yield ""
    yield f"[{entry.index:04X}]"
    yield f"ParameterName={entry.name}"
    yield f"ObjectType=0x{entry.kind.value:X}"
    if entry.kind in (Kind.VAR, Kind.DOMAIN):
        yield from _variable(entry.entries[0])
        return
    yield f"SubNumber={len(entry.entries)}"
    for sub, variable in sorted(entry.entries.items()):
        yield ""
        yield f"[{entry.index:04X}sub{sub:X}]"
        yield f"ParameterName={variable.name}"
        yield "ObjectType=0x7"
        yield from _variable(variable)


def _variable(variable: Variable) -> Iterator[str]:
    yield f"DataType=0x{variable.type.number:04X}"
    yield f"AccessType={variable.access}"
    if variable.type is not DataType.DOMAIN:
        yield f"DefaultValue={_default(variable)}"
    if variable.low is not None:
        yield f"LowLimit={variable.low}"
    if variable.high is not None:
        yield f"HighLimit={variable.high}"
    yield f"PDOMapping={int(bool(variable.pdo))}"


def _default(variable: Variable) -> str:
    match variable.default:
        case OfNode(offset):
            return f"$NODEID+0x{offset:X}"
        case bytes(text):
            return text.decode()
        case int(number) if number < 0 or variable.type.layout.islower():
            return str(number)
        case number:
            return f"0x{number:0{2 * variable.type.size}X}"
