"""OpenIGTLink messages as bytes, and bytes, cut anywhere, as messages. Pure.

The header has 58 bytes: version, type, device, time (32.32), size and CRC-64 of the body. Version 1 is that
of protocols 1 and 2, version 2 of protocol 3: its body has a header of its own and key-value pairs behind the
content. Who reads protocol 2 only loses the stream at a message of version 2. Source: OpenIGTLink,
Documents/Protocol/header.md, v3.md.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Final

from crtk_drivers.errors import MissingExtra
from crtk_drivers.front.openigtlink.bodies import (
    ASCII,
    NAME,
    NAMES,
    TYPE,
    UTF8,
    Body,
    decode_body,
    encode_body,
    field_of,
    is_known,
    text_of,
)
from crtk_drivers.kit import BadData

HEADER: Final = struct.Struct(f">H{TYPE}s{NAME}sQQQ")
_EXTENDED: Final = struct.Struct(">HHII")
_PAIR: Final = struct.Struct(">HHI")

LARGEST: Final = 1 << 20
"""Bytes of a body that is read: commands and queries have a hundredth of it."""
LARGEST_SKIPPED: Final = 1 << 30
"""Bytes of a body that nobody here reads, as of an image; a larger size is that of a stream which is lost."""
MOST_PAIRS: Final = 256

_SECOND: Final = 1_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Message:
    """One message.

    Attributes:
        device: name of what it is about; at most 20 bytes.
        body: what it says.
        kind: its type, where the body does not say it: GET_TRANSFOR, or TRANSFORM without data.
        stamp_ns: when that was so, in ns since the epoch.
        version: of the header, 1 or 2, with which it came, or goes.
        metadata: pairs, which travel with version 2 only.
    """

    device: str
    body: Body
    kind: str = ""
    stamp_ns: int = 0
    version: int = 1
    metadata: Mapping[str, str] = field(default_factory=dict)

    @property
    def type(self) -> str:
        """Its type."""
        return self.kind or NAMES[type(self.body)]


@dataclass(frozen=True, slots=True)
class Damaged:
    """A message that was dropped; the stream goes on behind it.

    Attributes:
        type, device: as its header says.
        why: in words.
        is_checksum: its checksum is wrong.
    """

    type: str
    device: str
    why: str
    is_checksum: bool = False


@cache
def _crc64() -> Any:
    try:
        from fastcrc.crc64 import ecma_182
    except ImportError as error:
        raise MissingExtra("fastcrc", "openigtlink") from error
    return ecma_182


def crc64(data: bytes) -> int:
    """Return the CRC-64 of a body: polynomial 42F0E1EBA9EA3693, start 0, nothing reflected.

    Raises:
        MissingExtra: the library that computes it is not installed.
    """
    return int(_crc64()(data))


def time_of(stamp_ns: int) -> int:
    """Return nanoseconds since the epoch as 32.32 bits of seconds."""
    seconds, rest = divmod(stamp_ns, _SECOND)
    return (seconds & 0xFFFFFFFF) << 32 | (rest << 32) // _SECOND


def stamp_of(time: int) -> int:
    """Return 32.32 bits of seconds as nanoseconds, rounded."""
    return (time >> 32) * _SECOND + ((time & 0xFFFFFFFF) * _SECOND + (1 << 31) >> 32)


def encode(message: Message, version: int | None = None, number: int = 0) -> bytes:
    """Return a message as bytes.

    Args:
        message: to be sent.
        version: of the header; None: that of the message.
        number: of the message, which version 2 has.

    Raises:
        TooLong: a name in it has no room in its field.
        struct.error, OverflowError: a number in it has none.
    """
    version = message.version if version is None else version
    body = encode_body(message.body)
    if version > 1:
        body = _extended(body, message.metadata, number)
    head = HEADER.pack(
        version,
        field_of(message.type[:TYPE], TYPE),
        field_of(message.device, NAME),
        time_of(message.stamp_ns),
        len(body),
        crc64(body),
    )
    return head + body


def _extended(content: bytes, metadata: Mapping[str, str], number: int) -> bytes:
    index, pairs = struct.pack(">H", len(metadata)), b""
    for key, value in metadata.items():
        name, text = key.encode(), value.encode()
        index += _PAIR.pack(len(name), ASCII if text.isascii() else UTF8, len(text))
        pairs += name + text
    head = _EXTENDED.pack(_EXTENDED.size, len(index), len(pairs), number & 0xFFFFFFFF)
    return head + content + index + pairs


def _parts(body: bytes) -> tuple[bytes, dict[str, str]]:
    """Return content and pairs of a body of version 2.

    Raises:
        BadData: its sizes contradict each other.
    """
    try:
        head, index_size, pairs_size, _ = _EXTENDED.unpack_from(body)
        end = len(body) - index_size - pairs_size
        if not _EXTENDED.size <= head <= end:
            raise BadData(f"{head}, {index_size} and {pairs_size} bytes of {len(body)}")
        index, at, metadata = body[end:], end + index_size, {}
        count = struct.unpack_from(">H", index)[0] if index_size else 0
        if count > MOST_PAIRS:
            raise BadData(f"{count} pairs of metadata")
        for each in range(count):
            name, _, text = _PAIR.unpack_from(index, 2 + each * _PAIR.size)
            if at + name + text > len(body):
                raise BadData("metadata that is longer than its message")
            metadata[body[at : at + name].decode("utf-8", "replace")] = body[
                at + name : at + name + text
            ].decode("utf-8", "replace")
            at += name + text
    except struct.error as error:
        raise BadData(f"a body of version 2 that ends too early: {error}") from error
    return body[head:end], metadata


class StreamDecoder:
    """From bytes as they arrive to messages. What nobody here reads is skipped, without being kept.

    Attributes:
        skipped: how many messages of types were skipped that are not known here.
        damaged: how many were dropped.
    """

    def __init__(self) -> None:
        self.skipped = self.damaged = 0
        self._rest = bytearray()
        self._to_skip = 0

    def feed(self, data: bytes) -> list[Message | Damaged]:
        """Return the messages that `data` completes, oldest first, and which were dropped.

        Raises:
            BadData: a header that is none: the connection is of no use any more.
        """
        if self._to_skip:
            gone = min(self._to_skip, len(data))
            self._to_skip -= gone
            data = data[gone:]
        self._rest += data
        found: list[Message | Damaged] = []
        while len(self._rest) >= HEADER.size and not self._to_skip:
            version, kind, device, time, size, crc = HEADER.unpack_from(self._rest)
            name = text_of(kind)
            if version not in (1, 2) or size > LARGEST_SKIPPED:
                raise BadData(f"a header of version {version} with a body of {size} bytes")
            if not is_known(name):
                self.skipped += 1
                self._skip(size)
                continue
            if size > LARGEST:
                raise BadData(f"a {name} of {size} bytes; {LARGEST} are the most")
            end = HEADER.size + size
            if len(self._rest) < end:
                break
            body = bytes(memoryview(self._rest)[HEADER.size : end])
            del self._rest[:end]
            found.append(self._message(version, name, text_of(device), time, crc, body))
        return found

    def _skip(self, size: int) -> None:
        end = HEADER.size + size
        self._to_skip = max(0, end - len(self._rest))
        del self._rest[:end]

    def _message(
        self, version: int, kind: str, device: str, time: int, crc: int, body: bytes
    ) -> Message | Damaged:
        if crc != crc64(body):
            self.damaged += 1
            return Damaged(kind, device, "its checksum is wrong", is_checksum=True)
        metadata: Mapping[str, str] = {}
        try:
            if version > 1:
                body, metadata = _parts(body)
            return Message(device, decode_body(kind, body), kind, stamp_of(time), version, metadata)
        except BadData as error:
            self.damaged += 1
            return Damaged(kind, device, f"{error}")
