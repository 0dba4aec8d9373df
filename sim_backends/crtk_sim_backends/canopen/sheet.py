"""The electronic data sheet of a real drive, read (CiA 306-1): its objects as the file has them.

Files in the field are often not quite what CiA 306 says. What cannot be used of an object is left out and
noted; a file that is no EDS is refused.
"""

from __future__ import annotations

import configparser
import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from crtk_sim_backends.canopen.dictionary import DataType, Kind, Object, OfNode, Variable
from crtk_sim_backends.options import ConfigError

_LARGEST: Final = 8 * 1024 * 1024  # bytes of a file
_MOST_ENTRIES: Final = 254
_OBJECT: Final = re.compile(r"([0-9a-f]{4})(?:sub([0-9a-f]{1,2}))?", re.IGNORECASE)
_NODE: Final = "$nodeid"

_TYPES: Final[Mapping[int, DataType]] = {
    **{kind.number: kind for kind in DataType},
    0x08: DataType.U32,  # REAL32 and REAL64 by their bits
    0x11: DataType.U64,
    0x0B: DataType.OCTETS,  # UNICODE_STRING
}
_FLOATS: Final = {0x08: ("<f", "<I"), 0x11: ("<d", "<Q")}

_ACCESS: Final = {
    "ro": ("ro", "t"),
    "const": ("const", "t"),
    "wo": ("wo", "r"),
    "rw": ("rw", "rt"),
    "rwr": ("rw", "t"),
    "rww": ("rw", "r"),
}
"""Access of an EDS: what it is here, and into which PDOs the object can be mapped."""

_Section = Mapping[str, str]


@dataclass(frozen=True)
class Sheet:
    """What an EDS says of a drive.

    Attributes:
        path: of the file.
        text: of the file.
        objects: by index.
        given: entries (index, sub-index) that have a default in the file; the others have 0.
        identity: vendor, product code and revision of [DeviceInfo]; 0 where it says none.
        notes: what was left out, with the section.
    """

    path: str
    text: str
    objects: Mapping[int, Object]
    given: frozenset[tuple[int, int]]
    identity: tuple[int, int, int]
    notes: tuple[str, ...] = ()

    @property
    def vendor(self) -> int:
        """Vendor-ID of 1018, else of [DeviceInfo]; 0 where it says none."""
        identity = self.objects.get(0x1018)
        told = identity.entries[1].default if identity is not None and 1 in identity.entries else 0
        return told if isinstance(told, int) and told else self.identity[0]


def read_sheet(path: str) -> Sheet:
    """Read the EDS of a drive.

    Raises:
        ConfigError: the file cannot be read, or is no EDS.
    """
    text = _text(Path(path))
    parser = configparser.RawConfigParser(
        strict=False,
        allow_no_value=True,
        delimiters=("=",),
        inline_comment_prefixes=(";",),
        default_section="\0",
    )
    try:
        # an indented line would be taken as the rest of the one before
        parser.read_string("\n".join(line.strip() for line in text.splitlines()))
    except configparser.Error as error:
        raise ConfigError(f"{path}: no EDS file: {error.message}") from error
    return _Reader(path, {name.lower(): _keys(parser[name]) for name in parser.sections()}).sheet(
        text
    )


def _keys(section: Mapping[str, str | None]) -> dict[str, str]:
    return {key: (value or "").strip() for key, value in section.items()}


def _text(path: Path) -> str:
    try:
        with path.open("rb") as file:
            data = file.read(_LARGEST + 1)
    except OSError as error:
        raise ConfigError(f"cannot read the EDS {path}: {error.strerror}") from error
    if len(data) > _LARGEST or b"\0" in data:
        raise ConfigError(f"{path}: no EDS file: it is not text, or longer than {_LARGEST} bytes")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def _number(text: str) -> int | None:
    """Return a number of an EDS: decimal, hexadecimal, or octal with a leading 0."""
    try:
        return int(text, 8 if re.fullmatch(r"0[0-7]+", text) else 0)
    except ValueError:
        return None


class _Reader:
    """Makes objects of the sections of one file."""

    def __init__(self, path: str, sections: Mapping[str, _Section]) -> None:
        self._path = path
        self._sections = sections
        self._given: set[tuple[int, int]] = set()
        self._notes: list[str] = []

    def sheet(self, text: str) -> Sheet:
        names = [match for name in self._sections if (match := _OBJECT.fullmatch(name))]
        indices = sorted({int(match[1], 16) for match in names})
        subs: dict[int, list[int]] = {index: [] for index in indices}
        for match in names:
            if match[2]:
                subs[int(match[1], 16)].append(int(match[2], 16))
        objects = {index: self._object(index, sorted(subs[index])) for index in indices}
        if not objects:
            raise ConfigError(f"{self._path}: no EDS file: it has no objects such as [1000]")
        about = self._sections.get("deviceinfo", {})
        vendor, product, revision = (
            (_number(about.get(key, "")) or 0) & 0xFFFF_FFFF
            for key in ("vendornumber", "productnumber", "revisionnumber")
        )
        return Sheet(
            self._path,
            text,
            objects,
            frozenset(self._given),
            (vendor, product, revision),
            tuple(self._notes),
        )

    def _object(self, index: int, subs: list[int]) -> Object:
        section = self._sections.get(f"{index:04x}", {})
        name = section.get("parametername") or f"object {index:04X}"
        compact = _number(section.get("compactsubobj", "")) or 0
        number = _number(section.get("objecttype", "")) or Kind.VAR.value
        kind = next((kind for kind in Kind if kind.value == number), Kind.VAR)
        if subs or compact:
            kind = kind if kind in (Kind.ARRAY, Kind.RECORD) else Kind.RECORD
            entries = {sub: self._variable(index, sub, self._sub(index, sub)) for sub in subs}
            if compact:
                entries = {**dict(self._compact(index, name, section, compact)), **entries}
            return Object(index, name, kind, entries)
        if kind in (Kind.ARRAY, Kind.RECORD):
            self._note(f"[{index:04X}]", "has no sub-indices")
            return Object(index, name, kind, {})
        return Object(index, name, kind, {0: self._variable(index, 0, section)})

    def _sub(self, index: int, sub: int) -> _Section:
        names = (f"{index:04x}sub{sub:x}", f"{index:04x}sub{sub:02x}")
        return next(self._sections[name] for name in names if name in self._sections)

    def _compact(
        self, index: int, name: str, section: _Section, count: int
    ) -> Iterator[tuple[int, Variable]]:
        """Yield the entries of an array that the file has in one section (CiA 306-1, CompactSubObj)."""
        count = min(count, _MOST_ENTRIES)
        self._given.add((index, 0))
        yield 0, Variable("Highest sub-index supported", DataType.U8, "const", count)
        names = self._sections.get(f"{index:04x}name", {})
        values = self._sections.get(f"{index:04x}value", {})
        for sub in range(1, count + 1):
            own = {"parametername": names.get(str(sub)) or f"{name}{sub}"}
            if str(sub) in values:
                own["defaultvalue"] = values[str(sub)]
            yield sub, self._variable(index, sub, {**section, **own})

    def _variable(self, index: int, sub: int, section: _Section) -> Variable:
        where = f"[{index:04X}sub{sub:X}]" if sub else f"[{index:04X}]"
        number = _number(section.get("datatype", ""))
        kind = _TYPES.get(number or 0)
        if kind is None:
            self._note(where, f"DataType={section.get('datatype', '')} is taken as data")
            kind = DataType.DOMAIN
        access, direction = _ACCESS.get(section.get("accesstype", "").lower(), ("rw", "rt"))
        mappable = bool(_number(section.get("pdomapping", "")))
        low, high = (self._limit(where, key, section, kind) for key in ("lowlimit", "highlimit"))
        return Variable(
            section.get("parametername") or f"object {index:04X}:{sub}",
            kind,
            access,
            self._default(index, sub, where, section, kind, number),
            low,
            high,
            direction if mappable and kind.size else "",
        )

    def _limit(self, where: str, key: str, section: _Section, kind: DataType) -> int | None:
        text = section.get(key, "")
        if not text or not kind.size:
            return None
        value = _fitting(_number(text), kind)
        if value is None:
            self._note(where, f"{key}={text} is left out")
        return value

    def _default(
        self,
        index: int,
        sub: int,
        where: str,
        section: _Section,
        kind: DataType,
        number: int | None,
    ) -> int | bytes | OfNode:
        text = section.get("defaultvalue", "")
        if not text:
            return 0
        value: int | bytes | OfNode | None
        if not kind.size:
            value = text.encode()
        elif number in _FLOATS:
            value = _bits(text, *_FLOATS[number])
        elif _NODE in text.lower():
            parts = [part.strip() for part in text.lower().split("+")]
            numbers = [_number(part) for part in parts if part != _NODE]
            value = OfNode(sum(each for each in numbers if each is not None))
            value = None if None in numbers else value
        else:
            value = _fitting(_number(text), kind)
        if value is None:
            self._note(where, f"DefaultValue={text} is left out")
            return 0
        self._given.add((index, sub))
        return value

    def _note(self, where: str, what: str) -> None:
        self._notes.append(f"{where} {what}")


def _fitting(value: int | None, kind: DataType) -> int | None:
    """Return a number as the type has it, negative ones also by their bits; None if it does not fit."""
    if value is None:
        return None
    low, high = kind.limits
    if high < value < 1 << 8 * kind.size:
        value -= 1 << 8 * kind.size
    return value if low <= value <= high else None


def _bits(text: str, layout: str, as_bits: str) -> int | None:
    try:
        bits: int = struct.unpack(as_bits, struct.pack(layout, float(text)))[0]
    except (ValueError, OverflowError):
        return None
    return bits
