"""Commands and replies on the wire. Made from the Combined API guide, apart from any driver's."""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

LONGEST: Final = 2048
"""Bytes of a command."""


def _shifted(byte: int) -> int:
    for _ in range(8):
        carry, byte = byte & 1, byte >> 1
        byte ^= 0xA001 * carry
    return byte


_SHIFTED: Final = [_shifted(byte) for byte in range(256)]


def check(data: bytes) -> int:
    """Return CRC-16/ARC."""
    crc = 0
    for byte in data:
        crc = crc >> 8 ^ _SHIFTED[(crc ^ byte) & 0xFF]
    return crc


class Command(NamedTuple):
    """What a client asks for. `damaged`: its check is wrong."""

    name: str
    arguments: str
    damaged: bool = False


def parse(line: bytes) -> Command:
    """Return the command of a line, without its end: ``NAME arguments``, or ``NAME:argumentsCCCC``."""
    text = line.decode("ascii", "replace")
    name, colon, rest = text.partition(":")
    if not colon:
        name, _, rest = text.partition(" ")
        return Command(name.upper(), rest)
    body, digits = text[:-4], text[-4:]
    damaged = len(rest) < 4 or digits.upper() != f"{check(body.encode('ascii', 'replace')):04X}"
    return Command(name.upper(), rest[:-4], damaged)


def words(text: str) -> bytes:
    """Return a reply of text."""
    data = text.encode("ascii")
    return data + b"%04X\r" % check(data)


def error(code: int) -> bytes:
    """Return an error."""
    return words(f"ERROR{code:02X}")


def binary(body: bytes, long: bool = False) -> bytes:
    """Return a binary reply; a long one has no checks."""
    if long:
        return struct.pack("<HI", 0xA5C8, len(body)) + body
    head = struct.pack("<HH", 0xA5C4, len(body))
    return head + struct.pack("<H", check(head)) + body + struct.pack("<H", check(body))
