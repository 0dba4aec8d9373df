"""Goes through a recording once, checks every byte of it, and tells how far it is whole.

What is cut off and what is damaged are told apart: of a file that was cut off, all up to the last seal
holds, and a whole chunk right behind it; a checksum that is wrong is an error, wherever it is.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, Final

from crtk_drivers.errors import RecordingError
from crtk_drivers.recording.mcap_format import (
    ENDING_SIZE,
    MAGIC,
    MESSAGE,
    MESSAGE_ENCODING,
    RECORD,
    Channel,
    Chunk,
    Fields,
    Index,
    Opcode,
    attachment_block,
    metadata_block,
)

_PART: Final = 1 << 20
_FOOTER = struct.Struct("<QQI")


@dataclass(slots=True)
class Scan:
    """What was found.

    Attributes:
        index: of what is whole.
        end: of the data that are whole; all behind it can be taken off.
        crc: of all bytes until there.
        bare: message indexes that are missing behind the last chunk, which ends at `end`.
        is_complete: the recording was finished, and its end is whole.
    """

    index: Index = field(default_factory=Index)
    end: int = 0
    crc: int = 0
    bare: dict[int, list[tuple[int, int]]] = field(default_factory=dict)
    is_complete: bool = False


def scan(file: BinaryIO, path: Path) -> Scan:
    """Return what a recording holds, and how far it is whole.

    Raises:
        RecordingError: it is none, was not written by `McapWriter`, or is damaged.
        OSError: it cannot be read.
    """
    return _Scanner(file, path).run()


def messages_in(content: bytes) -> Iterator[tuple[int, int, int, int, int, bytes]]:
    """Yield the messages of a chunk: offset, channel, sequence, log time, publish time, data.

    Raises:
        RecordingError: it holds something else.
    """
    at = 0
    while at < len(content):
        try:
            opcode, size = RECORD.unpack_from(content, at)
            head = MESSAGE.unpack_from(content, at + RECORD.size)
        except struct.error as error:
            raise RecordingError("a chunk ends within a message") from error
        begin = at + RECORD.size
        if opcode != Opcode.MESSAGE or begin + size > len(content) or size < MESSAGE.size:
            raise RecordingError("a chunk holds something that is no message")
        yield (at, *head, content[begin + MESSAGE.size : begin + size])
        at = begin + size


def messages_of(content: bytes) -> bytes:
    """Return the messages of a chunk's record, checked.

    Raises:
        RecordingError: they are damaged, or compressed.
    """
    fields = Fields(content)
    fields.raw(16)
    size, crc = fields.u64(), fields.u32()
    if compression := fields.text():
        raise RecordingError(f"a chunk is compressed ({compression}), as ours are not")
    messages = fields.raw(fields.u64())
    if not fields.is_over or len(messages) != size or zlib.crc32(messages) != crc:
        raise RecordingError("the checksum of a chunk is wrong")
    return messages


class _Scanner:
    def __init__(self, file: BinaryIO, path: Path) -> None:
        self._file = file
        self._path = path
        self._size = file.seek(0, 2)
        file.seek(0)
        self._found = Scan()
        self._crc = 0
        self._schemas: dict[int, tuple[str, str]] = {}
        self._new: Index = Index()
        self._loose: tuple[int, int, dict[int, list[tuple[int, int]]]] | None = None
        """The chunk that no seal is behind yet: where it ends, the CRC until there, and its messages."""

    def run(self) -> Scan:
        if self._file.read(len(MAGIC)) != MAGIC:
            raise RecordingError("is no MCAP file", where=str(self._path))
        self._crc = zlib.crc32(MAGIC)
        at = len(MAGIC)
        try:
            while (step := self._record(at)) is not None:
                at = step
        except RecordingError as error:
            good = self._found.index.counts.total()
            remedy = (
                f"{good} messages before it are whole: copy the first {self._found.end} bytes into a file of "
                "their own, and read that."
            )
            raise RecordingError(
                f"is damaged at byte {at}: {error.message}",
                where=str(self._path),
                remedy=remedy if good else "",
            ) from error
        if not self._found.end:
            raise RecordingError(
                "was cut off before anything was recorded, or not written by crtk-drivers",
                where=str(self._path),
                remedy="Tools of MCAP, such as `mcap recover`, read those of other programs.",
            )
        self._keep_loose()
        return self._found

    def _record(self, at: int) -> int | None:
        """Take the record at a byte; return where the next one is, None if there is none."""
        head = self._file.read(RECORD.size)
        opcode, size = RECORD.unpack(head) if len(head) == RECORD.size else (0, self._size)
        end: int = at + RECORD.size + size
        if end > self._size or (not any(head) and self._is_blank()):
            if at > len(MAGIC) and self._is_finished():
                raise RecordingError("a record is longer than the file")
            return None
        content = self._file.read(size)
        if opcode == Opcode.SEAL:
            self._check(Fields(content).u32(), "all before it")
            self._advance(head, content)
            self._keep(end)
        elif opcode == Opcode.DATA_END:
            self._check(Fields(content).u32(), "all data")
            self._found.is_complete = self._is_ending(end)
            return None
        else:
            self._advance(head, content)
            self._take(opcode, content, at, end)
        return end

    def _check(self, crc: int, what: str) -> None:
        if crc != self._crc:
            raise RecordingError(f"the checksum of {what} is wrong")

    def _advance(self, head: bytes, content: bytes) -> None:
        self._crc = zlib.crc32(content, zlib.crc32(head, self._crc))

    def _take(self, opcode: int, content: bytes, at: int, end: int) -> None:
        if opcode == Opcode.SCHEMA:
            fields = Fields(content)
            number, name, _ = fields.u16(), fields.text(), fields.text()
            self._schemas[number] = name, fields.text()
        elif opcode == Opcode.CHANNEL:
            self._take_channel(Fields(content))
        elif opcode == Opcode.METADATA:
            self._new.metadata.append(metadata_block(content, at))
        elif opcode == Opcode.ATTACHMENT:
            self._new.attachments.append(attachment_block(content, at))
        elif opcode == Opcode.CHUNK:
            self._take_chunk(content, at, end)
        elif opcode == Opcode.MESSAGE_INDEX:
            if not self._new.chunks:
                raise RecordingError("there is a message index without a chunk before it")
            chunk = self._new.chunks[-1]
            indexes = {**chunk.indexes, Fields(content).u16(): at}
            self._new.chunks[-1] = _with_indexes(chunk, indexes, end)
        elif opcode != Opcode.HEADER:
            raise RecordingError(f"no recording of ours has a record of type {opcode:#04x}")

    def _take_channel(self, fields: Fields) -> None:
        number, schema, topic, encoding = fields.u16(), fields.u16(), fields.text(), fields.text()
        if schema not in self._schemas or encoding != MESSAGE_ENCODING:
            raise RecordingError(f"the messages of {topic} are of no type that is known")
        self._new.channels[number] = Channel(
            number, topic, *self._schemas[schema], texts=fields.texts()
        )

    def _take_chunk(self, content: bytes, at: int, end: int) -> None:
        messages = messages_of(content)
        places: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)
        for offset, channel, _, log_time, _, _ in messages_in(messages):
            if channel not in self._found.index.channels:
                raise RecordingError(f"a message is of channel {channel}, which is not there")
            places[channel].append((log_time, offset))
        times = [time for found in places.values() for time, _ in found]
        if not times or self._new.chunks:
            raise RecordingError("a chunk is empty, or not sealed")
        chunk = Chunk(at, end - at, len(messages), min(times), max(times), {}, 0)
        self._new.chunks.append(chunk)
        self._new.counts = Counter({channel: len(found) for channel, found in places.items()})
        if at == self._found.end:
            self._loose = end, self._crc, dict(places)

    def _keep(self, end: int) -> None:
        """All that has come since the seal before is whole."""
        index, new = self._found.index, self._new
        index.channels |= new.channels
        index.chunks += new.chunks
        index.metadata += new.metadata
        index.attachments += new.attachments
        index.counts += new.counts
        self._found.end, self._found.crc = end, self._crc
        self._new, self._loose = Index(), None

    def _keep_loose(self) -> None:
        """Keep the chunk behind the last seal, whose own checksum is right; its indexes may be cut off."""
        if self._loose is None:
            return
        end, crc, places = self._loose
        (chunk,) = self._new.chunks
        self._found.index.chunks.append(_with_indexes(chunk, {}, chunk.offset + chunk.size))
        self._found.index.counts += self._new.counts
        self._found.end, self._found.crc, self._found.bare = end, crc, places

    # ------------------------------------------------------------------------------------ the end

    def _is_blank(self) -> bool:
        """Whether all that follows is zero: space that was taken, but not written before the power went."""
        while part := self._file.read(_PART):
            if part.strip(b"\0"):
                return False
        return True

    def _is_finished(self) -> bool:
        self._file.seek(self._size - len(MAGIC))
        return self._file.read() == MAGIC

    def _is_ending(self, start: int) -> bool:
        """Whether a whole summary begins at a byte, and the file ends with it."""
        rest = self._file.read()
        if len(rest) < ENDING_SIZE or not rest.endswith(MAGIC):
            return False
        footer = rest[-len(MAGIC) - _FOOTER.size : -len(MAGIC)]
        begins, _, crc = _FOOTER.unpack(footer)
        checked = rest[: -len(MAGIC) - 4]
        return bool(begins == start and zlib.crc32(checked) == crc)


def _with_indexes(chunk: Chunk, indexes: dict[int, int], end: int) -> Chunk:
    return Chunk(
        chunk.offset,
        chunk.size,
        chunk.content_size,
        chunk.start,
        chunk.end,
        indexes,
        end - chunk.offset - chunk.size,
    )
