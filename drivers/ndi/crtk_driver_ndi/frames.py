"""What TX, BX and BX2 say of the tools: where each is, how well it was seen, in which frame. Pure.

Positions are in mm, as on the wire. Sources: Combined API guides, commands TX, BX and BX2; the general binary
format as in NDI's Python sample (capi/gbf.py).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache, partial
from types import MappingProxyType
from typing import Final, NamedTuple

from crtk_driver_ndi.codec import Reply
from crtk_drivers.kit import BadData

__all__ = [
    "PARSERS",
    "PORT_STATUS",
    "STRAY_PARSERS",
    "SYSTEM_STATUS",
    "TOOL_STATUS",
    "Frame",
    "Parsers",
    "Stray",
    "ToolSeen",
    "told",
]

Values = tuple[float, float, float, float, float, float, float, float]
"""q0 (the scalar), qx, qy, qz, x, y, z in mm, error: mm RMS for Polaris, an indicator for Aurora."""

PORT_STATUS: Final[Mapping[int, str]] = MappingProxyType(
    {
        6: "out of volume",
        7: "partly out of volume",
        8: "algorithm limit",
        9: "infrared interference",
        12: "processing exception",
        14: "fell behind",
        15: "out of sync",
    }
)
"""Bits of the port status that say something of the pose."""

SYSTEM_STATUS: Final[Mapping[int, str]] = MappingProxyType(
    {
        0: "out of sync",
        1: "too much infrared light",
        2: "damaged system memory",
        3: "recoverable exception",
        4: "hardware failure",
        5: "changed hardware",
        6: "a tool was plugged in",
        7: "a tool was unplugged",
        8: "diagnostics are pending",
    }
)
"""Bits of the system status."""

TOOL_STATUS: Final[Mapping[int, str]] = MappingProxyType(
    {
        3: "seen in part",
        5: "averaged",
        9: "out of volume",
        13: "too few markers",
        14: "infrared interference",
        17: "bad fit",
        18: "buffer overflow",
        19: "algorithm limit",
        20: "cannot keep up",
        21: "out of sync",
        22: "processing exception",
        31: "missing",
        32: "tracking is not enabled",
        33: "unplugged",
    }
)
"""Low byte of the status of a 6D item in BX2; 0 is well."""

_MISSING_BIT: Final = 1 << 8
_STRAY: Final = 0xFFFF

_HANDLE: Final = struct.Struct("<BB")
_TRANSFORM: Final = struct.Struct("<8f")
_STATUS_AND_FRAME: Final = struct.Struct("<II")
_POINT: Final = struct.Struct("<3f")
_GBF: Final = struct.Struct("<HH")
_COMPONENT: Final = struct.Struct("<HIHI")
_FRAME_ITEM: Final = struct.Struct("<BBHIII")
_TOOL_ITEM: Final = struct.Struct("<HH")
_MARKER: Final = struct.Struct("<BBH")
_MARKER_STATUS_MISSING: Final = 1
_OUTSIDE: Final = frozenset({4, 5})
"""Of a marker: out of volume, and the same but used for the pose."""


class ToolSeen(NamedTuple):
    """A tool in one frame.

    Attributes:
        handle: its port handle.
        values: its transform; None where it is missing, disabled or unplugged.
        told: what is to be said of its quality, in words; empty if it is well.
        buttons: its switches, True where pressed.
        number: of the frame.
    """

    handle: int
    values: Values | None
    told: tuple[str, ...]
    buttons: tuple[bool, ...]
    number: int


class Stray(NamedTuple):
    """A marker that belongs to no tool: x, y, z in mm."""

    x: float
    y: float
    z: float
    out_of_volume: bool


@dataclass(slots=True)
class Frame:
    """What one reply says.

    Attributes:
        tools: by port handle.
        strays: markers without a tool.
        system: the system status, see `SYSTEM_STATUS`; 0 in BX2, which does not have it.
        number: of the newest frame in it; -1 if it has none: nothing is new.
        nanoseconds: when it was taken, on the device's clock since the epoch; 0 if it does not say.
        alerts: kind (1 fault, 2 alert, 4 event) and code.
    """

    tools: dict[int, ToolSeen] = field(default_factory=dict)
    strays: list[Stray] = field(default_factory=list)
    system: int = 0
    number: int = -1
    nanoseconds: int = 0
    alerts: list[tuple[int, int]] = field(default_factory=list)

    def add(self, tool: ToolSeen) -> None:
        """Take a tool of this frame."""
        self.tools[tool.handle] = tool
        self.number = max(self.number, tool.number)


def told(bits: int, table: Mapping[int, str]) -> tuple[str, ...]:
    """Return the words of the bits that are set and that a table has."""
    return tuple(words for bit, words in table.items() if bits >> bit & 1)


@lru_cache(maxsize=256)
def _port(status: int) -> tuple[tuple[str, ...], tuple[bool, ...]]:
    """Return what a port status says of the pose, and the switches."""
    return told(status, PORT_STATUS), tuple(bool(status >> bit & 1) for bit in (1, 2, 3))


@lru_cache(maxsize=256)
def _of_tool_status(status: int) -> tuple[str, ...]:
    code = status & 0xFF
    return (TOOL_STATUS.get(code, f"status {code}"),) if code else ()


# ------------------------------------------------------------------------------------------------- TX

_WITHOUT_POSE: Final = {"MISSING": True, "DISABLED": False, "UNOCCUPIED": False}
"""Words instead of a transform; whether status and frame follow."""


def parse_tx(reply: Reply) -> Frame:
    """Return the frame of a TX reply, asked for with 0001, 0800 or 1000.

    Raises:
        ValueError: it is none.
    """
    frame = Frame()
    text = reply.text
    count = int(text[:2], 16)
    *lines, rest = text[2:].split("\n")
    lines = [line for line in lines if line]
    if len(lines) != count:
        raise BadData(f"{len(lines)} lines for {count} tools")
    for line in lines:
        frame.add(_tx_tool(line))
    frame.system = int(rest[-4:], 16)
    if strays := rest[:-4]:
        frame.strays = _tx_strays(strays)
    return frame


def _tx_tool(line: str) -> ToolSeen:
    handle, rest = int(line[:2], 16), line[2:]
    for word, has_status in _WITHOUT_POSE.items():
        if rest.startswith(word):
            if not has_status:
                return ToolSeen(handle, None, (word.lower(),), (), -1)
            words, buttons, number = _tx_status(rest[len(word) :])
            return ToolSeen(handle, None, (word.lower(), *words), buttons, number)
    turned = [int(rest[at : at + 6]) / 1e4 for at in range(0, 24, 6)]
    moved = [int(rest[at : at + 7]) / 100.0 for at in range(24, 45, 7)]
    q0, qx, qy, qz = turned
    x, y, z = moved
    words, buttons, number = _tx_status(rest[51:])
    values = (q0, qx, qy, qz, x, y, z, int(rest[45:51]) / 1e4)
    return ToolSeen(handle, values, words, buttons, number)


def _tx_status(text: str) -> tuple[tuple[str, ...], tuple[bool, ...], int]:
    """Port status and frame; an Aurora may say more behind them."""
    words, buttons = _port(int(text[:8], 16))
    return words, buttons, int(text[8:16], 16)


def _tx_strays(text: str) -> list[Stray]:
    count = int(text[:2], 16)
    digits = -(-count // 4)
    outside = int(text[2 : 2 + digits] or "0", 16)
    points = text[2 + digits :]
    if len(points) != 21 * count:
        raise BadData(f"{len(points)} characters for {count} stray markers")
    found = []
    for index in range(count):
        x, y, z = (int(points[at : at + 7]) / 100.0 for at in range(21 * index, 21 * index + 21, 7))
        found.append(Stray(x, y, z, bool(outside >> index & 1)))
    return found


# ------------------------------------------------------------------------------------------------- BX

_TRACKED: Final = 1
_MISSING: Final = 2
_DISABLED: Final = 4


def parse_bx(reply: Reply, strays: bool = False) -> Frame:
    """Return the frame of a BX reply, asked for with 0001 or 0801; with `strays` also 1000.

    Raises:
        ValueError: it is none.
    """
    body, frame = reply.body, Frame()
    if not body:
        raise BadData("no tools")
    at = 1
    try:
        for _ in range(body[0]):
            handle, state = _HANDLE.unpack_from(body, at)
            at += _HANDLE.size
            values: Values | None = None
            if state == _DISABLED:
                frame.add(ToolSeen(handle, None, ("disabled",), (), -1))
                continue
            if state == _TRACKED:
                values = _TRANSFORM.unpack_from(body, at)
                at += _TRANSFORM.size
            elif state != _MISSING:
                raise BadData(f"state {state} of handle {handle:02X}")
            status, number = _STATUS_AND_FRAME.unpack_from(body, at)
            at += _STATUS_AND_FRAME.size
            words, buttons = _port(status)
            missing = () if values is not None else ("missing",)
            frame.add(ToolSeen(handle, values, missing + words, buttons, number))
        if strays:
            at = _bx_strays(body, at, frame)
        (frame.system,) = struct.unpack_from("<H", body, at)
    except (struct.error, IndexError) as error:
        raise BadData("a BX reply that ends too early") from error
    if at + 2 != len(body):
        raise BadData(f"{len(body) - at - 2} bytes behind the end of a BX reply")
    return frame


def _bx_strays(body: bytes, at: int, frame: Frame) -> int:
    count = body[at]
    mask = -(-count // 8)
    outside = int.from_bytes(body[at + 1 : at + 1 + mask], "little")
    at += 1 + mask
    for index in range(count):
        x, y, z = _POINT.unpack_from(body, at)
        frame.strays.append(Stray(x, y, z, bool(outside >> index & 1)))
        at += _POINT.size
    return at


# ------------------------------------------------------------------------------------------------ BX2


def parse_bx2(reply: Reply) -> Frame:
    """Return the frame of a BX2 reply. One without tools has no new frame.

    Raises:
        ValueError: it is none.
    """
    frame = Frame()
    try:
        _components(reply.body, 0, len(reply.body), frame, _OUTER)
    except struct.error as error:
        raise BadData("a BX2 reply that ends too early") from error
    return frame


_Reader = Callable[[bytes, int, int, int, Frame], None]
"""Reads the items of a component: body, where they begin and end, how many, into which frame."""


def _components(
    body: bytes, at: int, end: int, frame: Frame, readers: Mapping[int, _Reader]
) -> None:
    """Read the components of a GBF container; those of unknown types are skipped by their size."""
    _, count = _GBF.unpack_from(body, at)
    at += _GBF.size
    for _ in range(count):
        kind, size, _, items = _COMPONENT.unpack_from(body, at)
        if not _COMPONENT.size <= size <= end - at:
            raise BadData(f"a component of {size} bytes where {end - at} are left")
        reader = readers.get(kind)
        if reader is not None:
            reader(body, at + _COMPONENT.size, at + size, items, frame)
        at += size


def _frames(body: bytes, at: int, end: int, items: int, frame: Frame) -> None:
    """Read the frames. A device that sends several at once (an active and a passive one) has one time."""
    if not items:
        return
    _, _, _, number, seconds, nanoseconds = _FRAME_ITEM.unpack_from(body, at)
    at += _FRAME_ITEM.size
    inner = Frame()
    _components(body, at, end, inner, _INNER)
    if not inner.tools and not inner.strays:
        return
    for tool in inner.tools.values():
        frame.add(tool._replace(number=number))
    frame.strays += inner.strays
    frame.number = max(frame.number, number)
    frame.nanoseconds = seconds * 1_000_000_000 + nanoseconds
    frame.alerts += inner.alerts


def _tools(body: bytes, at: int, end: int, items: int, frame: Frame) -> None:
    for _ in range(items):
        handle, status = _TOOL_ITEM.unpack_from(body, at)
        at += _TOOL_ITEM.size
        values: Values | None = None
        if not status & _MISSING_BIT:
            values = _TRANSFORM.unpack_from(body, at)
            at += _TRANSFORM.size
        if at > end:
            raise BadData("tools that are longer than their component")
        before = frame.tools.get(handle)
        buttons = before.buttons if before is not None else ()
        frame.tools[handle] = ToolSeen(handle, values, _of_tool_status(status), buttons, -1)


def _markers(body: bytes, at: int, end: int, items: int, frame: Frame) -> None:
    for _ in range(items):
        handle, count = _TOOL_ITEM.unpack_from(body, at)
        at += _TOOL_ITEM.size
        for _ in range(count):
            status, _, _ = _MARKER.unpack_from(body, at)
            at += _MARKER.size
            if status == _MARKER_STATUS_MISSING:
                continue
            x, y, z = _POINT.unpack_from(body, at)
            at += _POINT.size
            if handle == _STRAY:
                frame.strays.append(Stray(x, y, z, status in _OUTSIDE))
        if at > end:
            raise BadData("markers that are longer than their component")


def _buttons(body: bytes, at: int, end: int, items: int, frame: Frame) -> None:
    for _ in range(items):
        handle, count = _TOOL_ITEM.unpack_from(body, at)
        at += _TOOL_ITEM.size
        if at + count > end:
            raise BadData("buttons that are longer than their component")
        pressed = tuple(bool(value) for value in body[at : at + count])
        at += count
        tool = frame.tools.get(handle, ToolSeen(handle, None, ("missing",), (), -1))
        frame.tools[handle] = tool._replace(buttons=pressed)


def _alerts(body: bytes, at: int, end: int, items: int, frame: Frame) -> None:
    for kind, _, code in struct.iter_unpack("<BBH", body[at : min(end, at + 4 * items)]):
        frame.alerts.append((kind, code))


_INNER: Final[Mapping[int, _Reader]] = {2: _tools, 3: _markers, 4: _buttons, 0x12: _alerts}
_OUTER: Final[Mapping[int, _Reader]] = {1: _frames, 0x12: _alerts}

Parsers = Mapping[str, tuple[str, Callable[[Reply], Frame]]]
"""By the name of the command: how frames are asked for, and what reads the answer."""

PARSERS: Final[Parsers] = MappingProxyType(
    {
        "BX2": ("BX2:--6d=tools --1d=buttons", parse_bx2),
        "BX": ("BX:0801", parse_bx),
        "TX": ("TX:0801", parse_tx),
    }
)
"""How the tools are asked for, with what is out of volume, and how the answer is read; the best first."""

STRAY_PARSERS: Final[Parsers] = MappingProxyType(
    {
        "BX2": ("BX2:--6d=tools --3d=strays --1d=buttons", parse_bx2),
        "BX": ("BX:1801", partial(parse_bx, strays=True)),
        "TX": ("TX:1801", parse_tx),
    }
)
"""The same, with markers that belong to no tool."""
