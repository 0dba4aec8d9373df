"""Reads MCAP files of other programs: from the beginning to the end, or to where they are cut off or damaged.

Of each chunk the checksum is verified, if it has one. Chunks that are compressed take the library of their
compression: lz4, zstandard. Source: mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import BinaryIO, Final

from crtk_drivers.errors import RecordingError
from crtk_drivers.recording.mcap_format import MAGIC, MESSAGE, RECORD, Fields, Opcode
from crtk_drivers.recording.mcap_reader import Attachment, Message, is_latched

LARGEST: Final = 1 << 30
"""Bytes of a chunk that are unpacked at most."""

_KEPT: Final = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA, Opcode.ATTACHMENT})


class Foreign:
    """A recording by another program. It has what `Recording` has, and is read anew each time.

    Args:
        path: of the file.

    Attributes:
        path: as given.
        is_complete: it was read to its end.
        damage: why not; empty if it was.
        topics: type of the messages, by topic.
        counts: of messages, by topic.
        latched, metadata, attachments: as of `Recording`.

    Raises:
        RecordingError: it cannot be read, or holds nothing that can.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damage = ""
        self.latched: frozenset[str] = frozenset()
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, tuple[str, str]] = {}
        self.metadata: list[tuple[str, dict[str, str]]] = []
        self.attachments: list[Attachment] = []
        counts: Counter[str] = Counter()
        for message in self._read(keeps=True):
            counts[message.topic] += 1
        self.topics: Mapping[str, str] = dict(self._channels.values())
        self.counts: Mapping[str, int] = {topic: counts[topic] for topic in self.topics}
        self.is_complete = not self.damage
        if self.damage and not counts:
            raise RecordingError(
                f"holds nothing that can be read: {self.damage}", where=str(self.path)
            )

    def messages(self, *topics: str) -> Iterator[Message]:
        """Yield the messages of some topics, or of all, as they are in the file, up to where it is sound.

        Raises:
            RecordingError: there is no such topic.
        """
        for topic in topics:
            if topic not in self.topics:
                raise RecordingError(
                    f"has no {topic}",
                    where=str(self.path),
                    remedy=f"It has: {', '.join(self.topics) or 'nothing'}.",
                )
        for message in self._read():
            if not topics or message.topic in topics:
                yield message

    def _read(self, keeps: bool = False) -> Iterator[Message]:
        try:
            with self.path.open("rb") as file:
                yield from self._records(file, keeps)
        except OSError as error:
            raise RecordingError(
                f"cannot be read: {error.strerror or error}", where=str(self.path)
            ) from error

    def _records(self, file: BinaryIO, keeps: bool) -> Iterator[Message]:
        size = file.seek(0, 2)
        file.seek(0)
        if file.read(len(MAGIC)) != MAGIC:
            raise RecordingError("is no MCAP file", where=str(self.path))
        at = len(MAGIC)
        while True:
            head = file.read(RECORD.size)
            opcode, length = RECORD.unpack(head) if len(head) == RECORD.size else (0, size)
            if at + RECORD.size + length > size:
                self.damage = f"it is cut off at byte {at} of {size}"
                return
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                return
            try:
                if opcode in _KEPT or opcode in (Opcode.CHUNK, Opcode.MESSAGE):
                    yield from self._record(opcode, file.read(length), keeps)
                else:
                    file.seek(length, 1)
            except RecordingError as error:
                if error.remedy:  # what can be done about is no damage
                    raise
                self.damage = f"it is damaged at byte {at}: {error.message}"
                return
            at += RECORD.size + length

    def _record(self, opcode: int, content: bytes, keeps: bool) -> Iterator[Message]:
        if opcode == Opcode.MESSAGE:
            yield self._message(content)
        elif opcode == Opcode.CHUNK:
            for inner, part in _inside(self._unpacked(content)):
                if inner == Opcode.CHUNK:
                    raise RecordingError("a chunk is in a chunk")
                yield from self._record(inner, part, keeps)
        elif opcode == Opcode.SCHEMA:
            fields = Fields(content)
            number = fields.u16()
            self._schemas[number] = fields.text()
        elif opcode == Opcode.CHANNEL:
            fields = Fields(content)
            number, schema = fields.u16(), fields.u16()
            topic = fields.text()
            self._channels[number] = topic, self._schemas.get(schema, "")
            fields.text()  # how its messages are encoded
            if is_latched(fields.texts()):
                self.latched |= {topic}
        elif opcode == Opcode.METADATA and keeps:
            fields = Fields(content)
            self.metadata.append((fields.text(), fields.texts()))
        elif opcode == Opcode.ATTACHMENT and keeps:
            fields = Fields(content)
            fields.raw(16)
            kept = Attachment(fields.text(), fields.text(), fields.raw(fields.u64()))
            self.attachments.append(kept)

    def _message(self, content: bytes) -> Message:
        try:
            channel, sequence, log_time, publish_time = MESSAGE.unpack_from(content)
            topic, type_name = self._channels[channel]
        except (struct.error, KeyError) as error:
            raise RecordingError("a message is of no channel that is known") from error
        data = content[MESSAGE.size :]
        return Message(topic, type_name, sequence, log_time, publish_time, data)

    def _unpacked(self, content: bytes) -> bytes:
        fields = Fields(content)
        fields.raw(16)
        size, crc, compression = fields.u64(), fields.u32(), fields.text()
        packed = fields.raw(fields.u64())
        if size > LARGEST:
            raise RecordingError(f"a chunk of {size} bytes is larger than any is made")
        unpack = _unpacker(compression, size, str(self.path))
        try:
            found = unpack(packed)
        except Exception as error:  # each library has its own
            raise RecordingError(f"a chunk cannot be unpacked: {error}") from error
        if len(found) != size or (crc and zlib.crc32(found) != crc):
            raise RecordingError("the checksum of a chunk is wrong")
        return found


def _unpacker(compression: str, size: int, where: str) -> Callable[[bytes], bytes]:
    libraries = {"lz4": "lz4.frame", "zstd": "zstandard"}
    if not compression:
        return lambda packed: packed
    if compression not in libraries:
        raise RecordingError(f"a chunk is packed by {compression!r}, which is not known")
    try:
        library = import_module(libraries[compression])
    except ImportError as error:
        package = libraries[compression].partition(".")[0]
        raise RecordingError(
            f"is compressed ({compression})", where=where, remedy=f"pip install {package}"
        ) from error
    if compression == "zstd":
        # `decompress` makes as much as the packed data say that they hold.
        unpack = library.ZstdDecompressor().stream_reader
        return lambda packed: bytes(unpack(packed).read(size + 1))
    return lambda packed: bytes(library.LZ4FrameDecompressor().decompress(packed, size + 1))


def _inside(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the records of a chunk."""
    at = 0
    while at < len(content):
        if at + RECORD.size > len(content):
            raise RecordingError("a chunk ends within a record")
        opcode, size = RECORD.unpack_from(content, at)
        at += RECORD.size
        if at + size > len(content):
            raise RecordingError("a chunk ends within a record")
        yield opcode, content[at : at + size]
        at += size
