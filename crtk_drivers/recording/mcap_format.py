"""What a recording is in bytes: the part of MCAP that is written and read here, and what its end says.

    magic, header, seal
    [schemas, channels, seal] [metadata or attachment, seal] [chunk, its message indexes, seal] ...
    data end, summary, footer, magic

A **seal** is a record of our own (MCAP keeps 0x80 to 0xFF for that, and readers pass over it): the CRC of
all bytes of the file before it. Each write ends with one. So a file that was cut off, which has no CRC at
its end, is still known to be whole up to its last seal. Chunks are not compressed, and channels stand
before them: what a file holds can be told without opening a chunk.

Source: mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final

from crtk_drivers.errors import RecordingError

MAGIC: Final = b"\x89MCAP0\r\n"
PROFILE: Final = "ros2"
SCHEMA_ENCODING: Final = "ros2msg"
MESSAGE_ENCODING: Final = "cdr"


class Opcode(IntEnum):
    """The first byte of a record."""

    HEADER = 0x01
    FOOTER = 0x02
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    MESSAGE_INDEX = 0x07
    CHUNK_INDEX = 0x08
    ATTACHMENT = 0x09
    ATTACHMENT_INDEX = 0x0A
    STATISTICS = 0x0B
    METADATA = 0x0C
    METADATA_INDEX = 0x0D
    SUMMARY_OFFSET = 0x0E
    DATA_END = 0x0F
    SEAL = 0x80


RECORD = struct.Struct("<BQ")
"""What every record begins with: opcode and size of its content."""

MESSAGE = struct.Struct("<HIQQ")
"""What the content of a message begins with: channel, sequence, log time, publish time."""

SEAL = struct.Struct("<BQI")
_CHUNK = struct.Struct("<QQQI")
_FOOTER = struct.Struct("<QQI")
_U16 = struct.Struct("<H")
_U32 = struct.Struct("<I")
_U64 = struct.Struct("<Q")

ENDING_SIZE: Final = RECORD.size + _FOOTER.size + len(MAGIC)
"""Bytes of the footer and the magic behind it."""


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic, and the type of its messages. Its schema has the same number.

    `definition` is empty where the type is not known; `texts` go with the channel.
    """

    number: int
    topic: str
    type_name: str
    definition: str
    texts: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Chunk:
    """Where a chunk is, and what is in it.

    Attributes:
        offset, size: of its record in the file.
        content_size: of the messages in it.
        start, end: earliest and latest log time.
        indexes: offset in the file of the message index of each channel.
        indexes_size: of all of these.
    """

    offset: int
    size: int
    content_size: int
    start: int
    end: int
    indexes: Mapping[int, int]
    indexes_size: int


@dataclass(frozen=True, slots=True)
class Block:
    """Where metadata or an attachment is; `content` is what its index says of it beyond that."""

    name: str
    offset: int
    size: int
    content: bytes


@dataclass(slots=True)
class Index:
    """What a file holds; from it the end of the file is made."""

    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[Chunk] = field(default_factory=list)
    metadata: list[Block] = field(default_factory=list)
    attachments: list[Block] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)

    def ending(self, offset: int, crc: int) -> bytes:
        """Return all that comes behind the data.

        Args:
            offset: where the data end.
            crc: of all bytes until there.
        """
        data_end = record(Opcode.DATA_END, _U32.pack(crc))
        start = offset + len(data_end)
        groups = [(opcode, b"".join(records)) for opcode, records in self._groups()]
        summary, offsets = b"", b""
        for opcode, records in groups:
            if records:
                place = struct.pack("<BQQ", opcode, start + len(summary), len(records))
                offsets += record(Opcode.SUMMARY_OFFSET, place)
                summary += records
        footer = _FOOTER.pack(start, start + len(summary), 0)
        head = RECORD.pack(Opcode.FOOTER, len(footer))
        checked = summary + offsets + head + footer[:-4]
        return data_end + checked + _U32.pack(zlib.crc32(checked)) + MAGIC

    def _groups(self) -> Iterator[tuple[Opcode, Iterator[bytes]]]:
        yield Opcode.SCHEMA, (schema_record(channel) for channel in self.channels.values())
        yield Opcode.CHANNEL, (channel_record(channel) for channel in self.channels.values())
        yield Opcode.STATISTICS, iter((self._statistics(),))
        yield Opcode.CHUNK_INDEX, map(_chunk_index, self.chunks)
        yield (
            Opcode.ATTACHMENT_INDEX,
            (_block_index(Opcode.ATTACHMENT_INDEX, block) for block in self.attachments),
        )
        yield (
            Opcode.METADATA_INDEX,
            (_block_index(Opcode.METADATA_INDEX, block) for block in self.metadata),
        )

    def _statistics(self) -> bytes:
        numbers = struct.pack(
            "<QHIIIIQQ",
            self.counts.total(),
            len(self.channels),
            len(self.channels),
            len(self.attachments),
            len(self.metadata),
            len(self.chunks),
            min((chunk.start for chunk in self.chunks), default=0),
            max((chunk.end for chunk in self.chunks), default=0),
        )
        return record(Opcode.STATISTICS, numbers, _numbers_by_channel(self.counts))


# -------------------------------------------------------------------------------------------- records


def record(opcode: Opcode, *parts: bytes) -> bytes:
    """Return a record with this content."""
    return b"".join((RECORD.pack(opcode, sum(map(len, parts))), *parts))


def header_record(library: str) -> bytes:
    """Return the first record of a file."""
    return record(Opcode.HEADER, _text(PROFILE), _text(library))


def schema_record(channel: Channel) -> bytes:
    """Return the definition of a channel's messages."""
    encoding = SCHEMA_ENCODING if channel.definition else ""
    parts = map(_text, (channel.type_name, encoding, channel.definition))
    return record(Opcode.SCHEMA, _U16.pack(channel.number), *parts)


def channel_record(channel: Channel) -> bytes:
    """Return the channel without its schema."""
    numbers = struct.pack("<HH", channel.number, channel.number)
    names = _text(channel.topic) + _text(MESSAGE_ENCODING)
    return record(Opcode.CHANNEL, numbers, names, _texts(channel.texts))


def metadata_record(name: str, texts: Mapping[str, str]) -> bytes:
    """Return texts by name."""
    return record(Opcode.METADATA, _text(name), _texts(texts))


def attachment_record(name: str, media_type: str, data: bytes, time_ns: int) -> bytes:
    """Return a file that goes with the recording."""
    content = b"".join(
        (_U64.pack(time_ns) * 2, _text(name), _text(media_type), _U64.pack(len(data)), data)
    )
    return record(Opcode.ATTACHMENT, content, _U32.pack(zlib.crc32(content)))


def chunk_record(start: int, end: int, messages: bytes) -> bytes:
    """Return a chunk of message records."""
    head = _CHUNK.pack(start, end, len(messages), zlib.crc32(messages))
    return record(Opcode.CHUNK, head, _U32.pack(0), _U64.pack(len(messages)), messages)


def message_indexes(
    offset: int, places: Mapping[int, list[tuple[int, int]]]
) -> tuple[bytes, dict[int, int]]:
    """Return the records behind a chunk, telling where each channel's messages are, and their offsets.

    Args:
        offset: in the file, of the first.
        places: log time and offset in the chunk of every message, by channel.
    """
    records, offsets = b"", {}
    for number, found in places.items():
        offsets[number] = offset + len(records)
        flat = [value for place in found for value in place]
        content = struct.pack(f"<HI{len(flat)}Q", number, 8 * len(flat), *flat)
        records += record(Opcode.MESSAGE_INDEX, content)
    return records, offsets


def seal(crc: int) -> bytes:
    """Return the record that closes a write; `crc` is of all bytes of the file before it."""
    return SEAL.pack(Opcode.SEAL, SEAL.size - RECORD.size, crc)


def metadata_block(content: bytes, offset: int) -> Block:
    """Return what is indexed of a metadata record.

    Raises:
        RecordingError: it is none.
    """
    return Block(Fields(content).text(), offset, RECORD.size + len(content), b"")


def attachment_block(content: bytes, offset: int) -> Block:
    """Return what is indexed of an attachment record.

    Raises:
        RecordingError: it is none.
    """
    fields = Fields(content)
    times = fields.raw(16)
    name, media_type = fields.text(), fields.text()
    what = times + _U64.pack(fields.u64()) + _text(name) + _text(media_type)
    return Block(name, offset, RECORD.size + len(content), what)


def _block_index(opcode: Opcode, block: Block) -> bytes:
    place = struct.pack("<QQ", block.offset, block.size)
    return record(opcode, place, block.content or _text(block.name))


def _chunk_index(chunk: Chunk) -> bytes:
    return record(
        Opcode.CHUNK_INDEX,
        struct.pack("<QQQQ", chunk.start, chunk.end, chunk.offset, chunk.size),
        _numbers_by_channel(chunk.indexes),
        _U64.pack(chunk.indexes_size),
        _text(""),
        _U64.pack(chunk.content_size) * 2,
    )


def _numbers_by_channel(numbers: Mapping[int, int]) -> bytes:
    pairs = b"".join(struct.pack("<HQ", number, value) for number, value in numbers.items())
    return _U32.pack(len(pairs)) + pairs


def _texts(texts: Mapping[str, str]) -> bytes:
    content = b"".join(_text(part) for pair in texts.items() for part in pair)
    return _U32.pack(len(content)) + content


def _text(text: str) -> bytes:
    raw = text.encode("utf-8", "backslashreplace")
    return _U32.pack(len(raw)) + raw


class Fields:
    """The fields of a record's content, one after the other.

    Raises:
        RecordingError: they are not what they should be.
    """

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._at = 0

    def raw(self, size: int) -> bytes:
        """Take `size` bytes."""
        end = self._at + size
        if end > len(self._content):
            raise RecordingError("a record ends too early")
        taken = self._content[self._at : end]
        self._at = end
        return taken

    def u16(self) -> int:
        """Take an unsigned number of two bytes."""
        return int.from_bytes(self.raw(2), "little")

    def u32(self) -> int:
        """Take an unsigned number of four bytes."""
        return int.from_bytes(self.raw(4), "little")

    def u64(self) -> int:
        """Take an unsigned number of eight bytes."""
        return int.from_bytes(self.raw(8), "little")

    def text(self) -> str:
        """Take a text."""
        try:
            return self.raw(self.u32()).decode()
        except UnicodeDecodeError as error:
            raise RecordingError(f"a text in a record is none: {error}") from error

    def texts(self) -> dict[str, str]:
        """Take texts by name."""
        inner = Fields(self.raw(self.u32()))
        found = {}
        while not inner.is_over:
            name = inner.text()
            found[name] = inner.text()
        return found

    @property
    def is_over(self) -> bool:
        """Whether all has been taken."""
        return self._at == len(self._content)
