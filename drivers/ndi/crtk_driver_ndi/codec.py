"""The framing of NDI's Combined API: commands and replies with their checks, and what an error says. Pure.

Sources: NDI Combined API guides (Polaris Vega, Aurora V2), chapters "Command syntax" and "Error codes"; the
long binary reply as in NDI's own Python sample (capi/reply.py).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from crtk_driver_ndi.crc import crc16
from crtk_drivers.kit import BadData, FrameDecoder

__all__ = [
    "ERRORS",
    "LONGEST_BINARY",
    "LONGEST_TEXT",
    "Reply",
    "command",
    "error_text",
    "reply_decoder",
]

LONGEST_TEXT: Final = 1 << 16
LONGEST_BINARY: Final = 1 << 20
"""Bytes of a reply beyond which it is none: a frame of every marker and tool is some kilobytes."""

SHORT: Final = b"\xc4\xa5"
LONG: Final = b"\xc8\xa5"
_SHORT_HEADER: Final = struct.Struct("<HHH")
_LONG_HEADER: Final = struct.Struct("<HI")

ERRORS: Final[Mapping[int, str]] = MappingProxyType(
    {
        0x01: "unknown command",
        0x02: "command too long",
        0x03: "command too short",
        0x04: "the command arrived damaged (CRC)",
        0x05: "time-out while the command was carried out",
        0x06: "communication settings that it cannot use",
        0x07: "wrong number of parameters",
        0x08: "no such port handle",
        0x09: "unknown tracking priority",
        0x0A: "no such LED",
        0x0B: "no such LED state",
        0x0C: "not possible in the present mode (set-up or tracking)",
        0x0D: "no tool at this port handle",
        0x0E: "the port handle is not initialised",
        0x0F: "the port handle is not enabled",
        0x10: "the system is not initialised",
        0x11: "tracking could not be stopped",
        0x12: "tracking could not be started",
        0x13: "the port handle could not be initialised",
        0x14: "sensor or field generator parameters could not be set",
        0x15: "the system could not be initialised",
        0x16: "diagnostic mode could not be started",
        0x17: "diagnostic mode could not be stopped",
        0x19: "the firmware has a wrong version",
        0x1A: "internal error",
        0x1C: "the wireless tool could not be lit",
        0x1E: "the tool's memory could not be read",
        0x1F: "the tool's memory could not be written",
        0x21: "the test of the tool's current failed",
        0x22: "a wavelength that it does not have",
        0x23: "a parameter is out of range",
        0x24: "no such volume",
        0x25: "features that it does not have",
        0x28: "too many tools are enabled",
        0x2A: "its memory is used up",
        0x2B: "the port handle was not allocated",
        0x2C: "the port handle is empty",
        0x2D: "all port handles are in use",
        0x2E: "the parts of the system have different firmware",
        0x2F: "no port has this description",
        0x30: "a port handle is assigned to this tool already",
        0x32: "an operation that it does not have",
        0x33: "it has no such feature",
        0x34: "it has no such parameter",
        0x35: "a value of the wrong type",
        0x36: "a value out of range",
        0x37: "an index out of range",
        0x38: "a value of the wrong size",
        0x39: "no permission",
        0x3B: "a file is missing",
        0x3C: "a file could not be written",
        0x3D: "a file could not be read",
        0x40: "the tool definition is not valid",
        0x41: "the system's own characterisation is not valid",
        0x42: "no such device",
        0xF1: "too much infrared light, or the environment disturbs it",
        0xF4: "its memory could not be erased",
        0xF5: "its memory could not be written",
        0xF6: "its memory could not be read",
    }
)
"""Combined API guide, "Error code definitions"."""


def error_text(code: int) -> str:
    """Return what an error says: ``ERROR0C: not possible in the present mode``."""
    return f"ERROR{code:02X}: {ERRORS.get(code, 'of no known meaning')}"


@dataclass(frozen=True, slots=True)
class Reply:
    """One reply: words, or the body of a binary one."""

    text: str = ""
    body: bytes = b""

    @property
    def error(self) -> int | None:
        """The code of ERRORxx; None if it is none. A WARNINGxx is a success."""
        return self._code("ERROR")

    @property
    def warning(self) -> int | None:
        """The code of WARNINGxx; None if it is none."""
        return self._code("WARNING")

    @property
    def is_reset(self) -> bool:
        """Whether the system says that it was reset, by a break, a command, or its power."""
        return self.text == "RESET"

    def _code(self, word: str) -> int | None:
        digits = self.text.removeprefix(word)
        if len(digits) == len(self.text):
            return None
        try:
            return int(digits, 16)
        except ValueError:
            return None


def command(text: str) -> bytes:
    """Return a command, as ``INIT:`` or ``TSTART:80``, with its check and its end."""
    data = text.encode("ascii")
    return b"%s%04X\r" % (data, crc16(data))


def reply_decoder() -> FrameDecoder[Reply]:
    """Return what turns bytes, cut anywhere, into replies. What fails its check is BadData."""
    return FrameDecoder(_size, _parse, strict=True)


def _size(buffer: bytes) -> int:
    start = buffer[:2]
    if start == SHORT:
        if len(buffer) < _SHORT_HEADER.size:
            return 0
        _, length, check = _SHORT_HEADER.unpack_from(buffer)
        if crc16(buffer[:4]) != check:
            raise BadData("a reply whose header fails its check")
        return _SHORT_HEADER.size + int(length) + 2
    if start == LONG:
        if len(buffer) < _LONG_HEADER.size:
            return 0
        _, length = _LONG_HEADER.unpack_from(buffer)
        if length > LONGEST_BINARY:
            raise BadData(f"a reply of {length} bytes")
        return _LONG_HEADER.size + int(length)
    if start in (SHORT[:1], LONG[:1]):
        return 0
    end = buffer.find(b"\r", 0, LONGEST_TEXT + 1)
    if end < 0 and len(buffer) > LONGEST_TEXT:
        raise BadData(f"{len(buffer)} bytes without an end")
    return end + 1


def _parse(frame: bytes) -> Reply:
    if frame[:2] == LONG:
        return Reply(body=frame[_LONG_HEADER.size :])
    if frame[:2] == SHORT:
        body, check = frame[_SHORT_HEADER.size : -2], int.from_bytes(frame[-2:], "little")
        if crc16(body) != check:
            raise BadData("a binary reply that fails its check")
        return Reply(body=body)
    text, digits = frame[:-5], frame[-5:-1]
    if len(digits) < 4 or crc16(text) != int(digits, 16):
        raise BadData(f"a reply that fails its check: {frame[:40]!r}")
    return Reply(text.decode("ascii"))
