"""The replies to TX, BX and BX2: what is seen, as bytes. Made from the Combined API guide."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Final, NamedTuple

from crtk_sim_backends.ndi.motion import Place

ALSO_OUTSIDE: Final = 0x0800
STRAYS: Final = 0x1000

_CODES: Final = {0: 0, 6: 9, 7: 3, 8: 19, 9: 14, 12: 22, 14: 20, 15: 21}
"""Status of BX2 by the bit of the port status."""


class Seen(NamedTuple):
    """A tool in a frame.

    Attributes:
        handle: its number.
        place: where it is; None if it is missing.
        bit: of the port status that says what is wrong with it; 0 if nothing.
        port: the other bits of the port status.
        enabled: whether it is tracked at all.
    """

    handle: int
    place: Place | None
    bit: int
    port: int
    enabled: bool

    def shown(self, options: int) -> Place | None:
        """Where it is, for a client that has asked so: what is out of the volume is missing by default."""
        return None if self.bit == 6 and not options & ALSO_OUTSIDE else self.place

    @property
    def status(self) -> int:
        """Port status."""
        return self.port | (1 << self.bit if self.bit else 0)


def _number(value: float, scale: float, digits: int) -> str:
    return f"{round(value * scale):+0{digits}d}"


Stray = tuple[float, float, float]
"""A marker of no tool, in mm."""


def tx(
    tools: Sequence[Seen], number: int, system: int, options: int, strays: Sequence[Stray] = ()
) -> str:
    """Return the text of a TX reply."""
    lines = [f"{len(tools):02X}"]
    for tool in tools:
        at = tool.shown(options)
        tail = f"{tool.status:08X}{number:08X}\n"
        if not tool.enabled:
            lines.append(f"{tool.handle:02X}DISABLED\n")
        elif at is None:
            lines.append(f"{tool.handle:02X}MISSING{tail}")
        else:
            turned = "".join(_number(q, 1e4, 6) for q in (at.q0, at.qx, at.qy, at.qz))
            moved = "".join(_number(p, 100.0, 7) for p in (at.x, at.y, at.z))
            lines.append(f"{tool.handle:02X}{turned}{moved}{_number(at.error, 1e4, 6)}{tail}")
    if options & STRAYS:
        inside = "0" * -(-len(strays) // 4)
        points = "".join(_number(each, 100.0, 7) for stray in strays for each in stray)
        lines.append(f"{len(strays):02X}{inside}{points}")
    return "".join(lines) + f"{system:04X}"


def bx(
    tools: Sequence[Seen], number: int, system: int, options: int, strays: Sequence[Stray] = ()
) -> bytes:
    """Return the body of a BX reply."""
    parts = [bytes([len(tools)])]
    for tool in tools:
        at = tool.shown(options)
        if not tool.enabled:
            parts.append(bytes([tool.handle, 4]))
            continue
        parts.append(bytes([tool.handle, 1 if at is not None else 2]))
        if at is not None:
            values = (at.q0, at.qx, at.qy, at.qz, at.x, at.y, at.z, at.error)
            parts.append(struct.pack("<8f", *values))
        parts.append(struct.pack("<II", tool.status, number))
    if options & STRAYS:
        parts.append(bytes([len(strays)]) + bytes(-(-len(strays) // 8)))
        parts += [struct.pack("<3f", *stray) for stray in strays]
    return b"".join(parts) + struct.pack("<H", system)


def _component(kind: int, items: int, data: bytes) -> bytes:
    return struct.pack("<HIHI", kind, 12 + len(data), 0, items) + data


def _gbf(*components: bytes) -> bytes:
    return struct.pack("<HH", 1, len(components)) + b"".join(components)


def bx2(
    tools: Sequence[Seen],
    number: int,
    nanoseconds: int,
    magnetic: bool,
    strange: bool = False,
    strays: Sequence[Stray] = (),
) -> bytes:
    """Return the body of a BX2 reply with 6D and buttons.

    Args:
        tools: seen; none of them makes a reply without a frame: nothing is new.
        number, nanoseconds: of the frame; its time since the epoch.
        magnetic: the tracker is no optical one.
        strange: with a component of a type that nobody knows.
        strays: markers of no tool.
    """
    enabled = [tool for tool in tools if tool.enabled]
    if not enabled:
        return _gbf()
    poses, buttons = b"", b""
    for tool in enabled:
        at = tool.place
        code = _CODES[tool.bit] if at is not None else 0x100 | (_CODES[tool.bit] or 31)
        poses += struct.pack("<HH", tool.handle, code)
        if at is not None:
            values = (at.q0, at.qx, at.qy, at.qz, at.x, at.y, at.z, at.error)
            poses += struct.pack("<8f", *values)
        pressed = [tool.port >> bit & 1 for bit in (1, 2, 3)]
        buttons += struct.pack("<HH3B", tool.handle, 3, *pressed)
    inner = [_component(2, len(enabled), poses), _component(4, len(enabled), buttons)]
    if strays:
        points = b"".join(
            struct.pack("<BBH3f", 0, 0, index, *stray) for index, stray in enumerate(strays)
        )
        head = struct.pack("<HH", 0xFFFF, len(strays))
        inner.append(_component(3, 1, head + points))
    if strange:
        inner.insert(0, _component(0x77, 3, b"strange"))
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    item = struct.pack("<BBHIII", 7 if magnetic else 2, 0, 0, number, seconds, rest) + _gbf(*inner)
    return _gbf(_component(1, 1, item))
