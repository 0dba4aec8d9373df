"""EDS and DCF files (CiA 306), read with the canopen library after a pass that repairs what it trips over.

Many files in the field are not quite what CiA 306 says: a [DummyUsage] with entries left out, a [DeviceInfo]
with empty values, keys in other cases, sections twice, objects without a type. `repair` makes of them what
the library reads, and tells with the line what it changed; what cannot be read is refused with file and line.
"""

from __future__ import annotations

import io
import itertools
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from crtk_driver_canopen.objects import OBJECTS, Entry, ObjectType, object_type, parse_object
from crtk_drivers.config.capped_file import read_capped
from crtk_drivers.errors import ConfigError, MissingExtra
from crtk_drivers.errors.near_names import near_names

try:
    from canopen.objectdictionary import ODArray, ODRecord, ODVariable
    from canopen.objectdictionary.eds import import_eds
except ImportError as error:  # pragma: no cover - the extra is installed where tests run
    raise MissingExtra("canopen", "canopen") from error

MAX_SIZE: Final = 8 * 1024 * 1024
"""Largest file that is read, in bytes."""

MAX_ENTRIES: Final = 254
"""Sub-indices of one object, without 0."""

_NAMES: Final = (
    "ParameterName",
    "ObjectType",
    "DataType",
    "AccessType",
    "DefaultValue",
    "LowLimit",
    "HighLimit",
    "PDOMapping",
    "SubNumber",
    "CompactSubObj",
    "NrOfEntries",
    "ParameterValue",
    "StorageLocation",
    "ObjFlags",
    "Denotation",
    "NodeID",
    "NodeName",
    "Baudrate",
    "NetNumber",
    "VendorName",
    "VendorNumber",
    "ProductName",
    "ProductNumber",
    "RevisionNumber",
    "OrderCode",
    "SimpleBootUpMaster",
    "SimpleBootUpSlave",
    "Granularity",
    "DynamicChannelsSupported",
    "GroupMessaging",
    "NrOfRXPDO",
    "NrOfTXPDO",
    "LSS_Supported",
    "Factor",
    "Unit",
    "Description",
    *(f"BaudRate_{rate}" for rate in (10, 20, 50, 125, 250, 500, 800, 1000)),
)

_KEYS: Final[Mapping[str, str]] = MappingProxyType({name.lower(): name for name in _NAMES})
"""Keys as the library wants them, by how they are read: it tells upper from lower case."""

_SECTIONS: Final[Mapping[str, str]] = MappingProxyType(
    {
        name.lower(): name
        for name in ("FileInfo", "DeviceInfo", "DummyUsage", "Comments", "DeviceComissioning")
    }
    | {"devicecommissioning": "DeviceComissioning"}
)

_TEXTS: Final = frozenset({"VendorName", "ProductName", "OrderCode"})
_OBJECT: Final = re.compile(r"([0-9a-f]{4})(?:sub([0-9a-f]{1,2})|(name))?", re.IGNORECASE)
_DATA_OBJECT: Final = "0x000F"
_KINDS: Final = frozenset({0, 2, 5, 6, 7, 8, 9})
"""Object types (CiA 301, 7.4.3): null, domain, two kinds of definitions, variable, array, record."""


@dataclass(slots=True)
class _Section:
    """One section: where it begins, and its keys."""

    line: int
    keys: dict[str, str] = field(default_factory=dict)


Sections = dict[str, _Section]
Tell = Callable[[int, str], None]


def load(path: str | Path, node: int | None = None) -> DataSheet:
    """Read an EDS or DCF file.

    Args:
        path: of the file.
        node: id that stands for $NODEID; that of the file if None.

    Raises:
        ConfigError: it cannot be read, is too large, or is no such file; with the line where that is known.
    """
    path = Path(path)
    text, repairs = repair(_read(path), str(path))
    try:
        dictionary = import_eds(io.StringIO(text), node)
    except Exception as error:  # the library raises whatever its parser or dictionary trips over
        raise ConfigError(
            f"the canopen library cannot read it: {type(error).__name__}: {error}",
            where=str(path),
            remedy="Check it with a linter for EDS files (dcfchk of dcf-tools).",
        ) from error
    return DataSheet(str(path), dictionary, tuple(repairs))


def _read(path: Path) -> str:
    data = read_capped(path, MAX_SIZE, "an EDS file")
    if b"\0" in data:
        line = data.count(b"\n", 0, data.index(b"\0")) + 1
        raise ConfigError(
            "is not text",
            where=f"{path}:{line}",
            remedy="Give an EDS or DCF file, not its archive.",
        )
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def repair(text: str, where: str) -> tuple[str, list[str]]:
    """Return an EDS as the canopen library reads it, and what was changed.

    Args:
        where: path of the file, for messages.

    Raises:
        ConfigError: it has no objects.
    """
    repairs: list[str] = []

    def tell(line: int, change: str) -> None:
        repairs.append(f"{where}:{line}: {change}")

    sections = _sections(text, tell)
    objects = {name: section for name, section in sections.items() if _OBJECT.fullmatch(name)}
    if not objects:
        raise ConfigError(
            "has no objects such as [1000]",
            where=where,
            remedy="Give an EDS or DCF file. An XDD file must be converted first.",
        )
    result: Sections = {"DeviceInfo": _Section(1)}
    for name, mend in _GENERAL.items():
        if name in sections:
            mend(sections[name], tell)
            result[name] = sections[name]
    result |= _objects(objects, tell)
    return "".join(_written(result)), repairs


def _written(sections: Sections) -> Iterator[str]:
    for name, section in sections.items():
        yield f"[{name}]\n"
        for key, value in section.keys.items():
            yield f"{key}={value}\n"


def _sections(text: str, tell: Tell) -> Sections:
    """Return the sections of an INI file, with names and keys in their usual case."""
    sections: Sections = {}
    current: _Section | None = None
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.split(";", 1)[0].strip()
        if not line or line.startswith("#"):
            continue
        if line.startswith("["):
            name = _section_name(line[1:].partition("]")[0].strip())
            if name in sections:
                tell(number, f"[{name}] is there twice: its keys are taken together")
            current = sections.setdefault(name, _Section(number))
            continue
        key, equals, value = line.partition("=")
        if not equals or not key.strip() or current is None:
            tell(number, f"{line[:40]!r} is no key of a section: left out")
            continue
        key = key.strip()
        current.keys[_KEYS.get(key.lower(), key)] = value.strip()
    return sections


def _section_name(text: str) -> str:
    match = _OBJECT.fullmatch(text)
    if match is None:
        return _SECTIONS.get(text.lower(), text)
    index, sub, name = match.groups()
    return index.upper() + (f"sub{sub.upper()}" if sub else "Name" if name else "")


def _number(text: str) -> int | None:
    try:
        return int(text, 0)
    except ValueError:
        return None


def _mend_dummies(section: _Section, tell: Tell) -> None:
    """The library wants all seven."""
    for number in range(1, 8):
        key = f"Dummy{number:04d}"
        if section.keys.get(key) not in ("0", "1"):
            tell(section.line, f"{key} is not 0 or 1: taken as 0")
            section.keys[key] = "0"


def _mend_numbers(section: _Section, tell: Tell) -> None:
    """Leave out numbers that are none."""
    for key, value in list(section.keys.items()):
        if key in _TEXTS or key not in _KEYS.values():
            continue
        if key != "NodeName" and _number(value) is None:
            tell(section.line, f"{key}={value} is no number: left out")
            del section.keys[key]


def _mend_commissioning(section: _Section, tell: Tell) -> None:
    _mend_numbers(section, tell)
    if "Baudrate" in section.keys:
        section.keys["Baudrate"] = str(_number(section.keys["Baudrate"]))


_GENERAL: Final[Mapping[str, Callable[[_Section, Tell], None]]] = MappingProxyType(
    {
        "DeviceInfo": _mend_numbers,
        "DeviceComissioning": _mend_commissioning,
        "DummyUsage": _mend_dummies,
    }
)
"""Sections beside the objects that the library makes use of, and what is wrong with them in the field."""


def _objects(objects: Sections, tell: Tell) -> Sections:
    """Return the sections of objects, mended, each object before its parts."""
    result: Sections = {}
    for parent, parts in itertools.groupby(sorted(objects, key=_order), lambda name: name[:4]):
        mine = list(parts)
        has_subs = any("sub" in name for name in mine)
        section = objects.get(parent)
        if section is None:
            line = objects[mine[0]].line
            tell(line, f"[{parent}] is missing: taken as a record")
            section = _Section(line, {"ObjectType": "9"})
        _mend_object(parent, section, has_subs, tell)
        result[parent] = section
        for name in mine:
            if name.endswith("Name"):
                if _mend_names(name, objects[name], section, tell):
                    result[name] = objects[name]
            elif name != parent:
                _mend_variable(name, objects[name], tell)
                result[name] = objects[name]
    return result


def _order(name: str) -> tuple[str, int, int]:
    part = name[4:]
    if part.startswith("sub"):
        return name[:4], 1, int(part[3:], 16)
    return name[:4], 2 if part else 0, 0


def _mend_object(name: str, section: _Section, has_subs: bool, tell: Tell) -> None:
    keys = section.keys
    kind = _number(keys.get("ObjectType", ""))
    if kind not in _KINDS and "ObjectType" in keys:
        tell(section.line, f"[{name}] ObjectType={keys['ObjectType']} is unknown: left out")
        del keys["ObjectType"]
    if has_subs and kind not in (8, 9):
        tell(section.line, f"[{name}] has sub-indices: taken as a record")
        keys["ObjectType"] = "9"
        kind = 9
    if "CompactSubObj" in keys and not _number(keys["CompactSubObj"]):
        del keys["CompactSubObj"]
    if kind in (8, 9) and "CompactSubObj" not in keys:
        if not keys.get("ParameterName"):
            keys["ParameterName"] = f"object {name}"
        return
    _mend_variable(name, section, tell)


def _mend_variable(name: str, section: _Section, tell: Tell) -> None:
    keys = section.keys
    if not keys.get("ParameterName"):
        tell(section.line, f"[{name}] has no ParameterName")
        keys["ParameterName"] = f"object {name}"
    if _number(keys.get("DataType", "")) is None:
        tell(section.line, f"[{name}] has no DataType: taken as data")
        keys["DataType"] = _DATA_OBJECT
    if not keys.get("AccessType"):
        tell(section.line, f"[{name}] has no AccessType: taken as rw")
        keys["AccessType"] = "rw"
    if "PDOMapping" in keys and _number(keys["PDOMapping"]) is None:
        tell(section.line, f"[{name}] PDOMapping={keys['PDOMapping']} is no number: left out")
        del keys["PDOMapping"]


def _mend_names(name: str, section: _Section, parent: _Section, tell: Tell) -> bool:
    """Give each of the entries of a compact array a name; return whether the section is of use."""
    count = _number(section.keys.get("NrOfEntries", ""))
    if not count or count > MAX_ENTRIES or "CompactSubObj" not in parent.keys:
        tell(section.line, f"[{name}] names nothing: left out")
        return False
    entries = _number(parent.keys["CompactSubObj"]) or count
    section.keys["NrOfEntries"] = str(min(entries, MAX_ENTRIES))
    for sub in range(1, min(entries, MAX_ENTRIES) + 1):
        section.keys.setdefault(str(sub), f"{parent.keys['ParameterName']}{sub}")
    return True


@dataclass(frozen=True)
class DataSheet:
    """The objects of a device.

    Attributes:
        path: of the file.
        dictionary: the canopen library's `ObjectDictionary`.
        repairs: what was changed so that the library reads it, each with file and line.
    """

    path: str
    dictionary: Any
    repairs: tuple[str, ...] = ()

    def variables(self) -> Iterator[Any]:
        """Yield the library's `ODVariable` of each object with a value, in order."""
        for index in sorted(self.dictionary.indices):
            entry = self.dictionary.indices[index]
            if isinstance(entry, ODVariable):
                yield entry
            elif isinstance(entry, ODRecord | ODArray):
                yield from (entry.subindices[sub] for sub in sorted(entry.subindices))

    def entry(self, index: int, sub: int) -> Entry | None:
        """Return an object by number; None if the device has none."""
        variable = self.dictionary.get_variable(index, sub)
        return None if variable is None else _entry(variable)

    def find(self, text: str) -> Entry:
        """Return an object by number (``6064``, ``1018:4``), by its name here, or by that in `OBJECTS`.

        Raises:
            ValueError: there is none, with what was probably meant.
        """
        wanted = _plain(text)
        names: dict[str, Any] = {}
        for variable in self.variables():
            names.setdefault(_plain(_full_name(variable)), variable)
            names.setdefault(_plain(variable.name), variable)
        if wanted in names:
            return _entry(names[wanted])
        try:
            index, sub = parse_object(text)
        except ValueError:
            close = near_names(wanted, [*names, *OBJECTS])
            hint = f"did you mean {close[0]!r}?" if close else "give INDEX[:SUB] in hexadecimal"
            raise ValueError(f"{text!r} is no object of {self.path}: {hint}") from None
        return self.entry(index, sub) or Entry(index, sub, ObjectType.BYTES, "")

    def values(self) -> list[tuple[Entry, int | float | str | bytes]]:
        """Return what a DCF wants to be written (ParameterValue), in order; none for an EDS."""
        return [
            (_entry(variable), variable.value)
            for variable in self.variables()
            if getattr(variable, "value", None) is not None and variable.writable
        ]


def _full_name(variable: Any) -> str:
    parent = variable.parent
    return (
        f"{parent.name} {variable.name}"
        if isinstance(parent, ODRecord | ODArray)
        else variable.name
    )


def _plain(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")


def _entry(variable: Any) -> Entry:
    return Entry(
        variable.index, variable.subindex, object_type(variable.data_type), _full_name(variable)
    )
