"""Writes a recording: an MCAP file that is whole after each write, whenever the process dies.

A file only grows. What a write could not finish is taken off again, so that the next one, when there is
space, goes on where the last whole one ended.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import time
import zlib
from collections import defaultdict
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Final, Self

from crtk_drivers.errors import RecordingError
from crtk_drivers.recording.mcap_format import (
    MAGIC,
    MESSAGE,
    RECORD,
    Channel,
    Chunk,
    Index,
    Opcode,
    attachment_block,
    attachment_record,
    channel_record,
    chunk_record,
    header_record,
    message_indexes,
    metadata_block,
    metadata_record,
    schema_record,
    seal,
)

LARGEST_CHUNK: Final = 1 << 20
"""Bytes of messages that are kept at most: more of them are written without `flush`."""

MOST_CHANNELS: Final = 0xFFFF

_WITH_HEAD: Final = RECORD.size + MESSAGE.size


class McapWriter:
    """A recording that is being written. All methods belong to one thread; `finish` ends it.

    Args:
        path: of the file, which is made.
        keep_free: bytes of its disk that messages leave to others; 0: none.

    Attributes:
        lost: messages that could not be written.

    Raises:
        RecordingError: there is such a file, or it cannot be written.
    """

    def __init__(self, path: str | Path, keep_free: int = 0) -> None:
        self.path = Path(path)
        self._keep_free = keep_free
        self.lost = 0
        self._index = Index()
        self._numbers: dict[str, int] = {}
        self._sequences: defaultdict[int, int] = defaultdict(int)
        self._end, self._crc = 0, 0
        self._new_chunk()
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        try:
            self._file = os.open(self.path, flags, 0o666)
        except FileExistsError as error:
            raise RecordingError(
                "is there already", where=str(path), remedy="Choose another name."
            ) from error
        except OSError as error:
            raise self._failure("cannot be made", error) from error
        with contextlib.suppress(OSError):  # a file system may have no locks
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # nobody mends it meanwhile
        self._is_open = True
        try:
            self._append(MAGIC + header_record(_library()))
        except RecordingError:
            self._close()
            raise

    def channel(
        self,
        topic: str,
        type_name: str,
        text: str | None = None,
        texts: Mapping[str, str] = MappingProxyType({}),
    ) -> int:
        """Return the number of a topic's channel; a new one is written at once.

        Args:
            topic: full name.
            type_name: of its messages.
            text: definition of the type, see `definition`; empty if it is not known. None: as we know it.
            texts: that go with a new channel, by name.

        Raises:
            RecordingError: it cannot be written, has another type already, or its type is not known.
        """
        number = self._numbers.get(topic)
        if number is not None:
            has = self._index.channels[number].type_name
            if has != type_name:
                raise RecordingError(
                    f"{topic} has messages of type {has}, not {type_name}", where=str(self.path)
                )
            return number
        number = len(self._numbers) + 1
        if number > MOST_CHANNELS:
            raise RecordingError(f"more than {MOST_CHANNELS} topics", where=str(self.path))
        known = definition(type_name) if text is None else text
        channel = Channel(number, topic, type_name, known, texts)
        self._append(schema_record(channel) + channel_record(channel))
        self._index.channels[number] = channel
        self._numbers[topic] = number
        return number

    def message(
        self, channel: int, data: bytes, log_time: int, publish_time: int | None = None
    ) -> None:
        """Add a message; it is in the file after the next `flush`.

        Args:
            channel: number, from `channel`.
            data: the message.
            log_time: ns since the epoch, when it was recorded.
            publish_time: when it was measured or sent; None: not known, the same. So is one before the epoch,
                which a file cannot have, and whoever sends a command may tell.

        Raises:
            RecordingError: those before could not be written; this one is kept.
        """
        published = log_time if publish_time is None or publish_time < 0 else publish_time
        sequence = self._sequences[channel]
        head = MESSAGE.pack(channel, sequence & 0xFFFFFFFF, log_time, published)
        self._sequences[channel] = sequence + 1
        if self._size >= LARGEST_CHUNK:
            try:
                self.flush()
            finally:
                self._add(channel, head, data, log_time)
        else:
            self._add(channel, head, data, log_time)

    def _add(self, channel: int, head: bytes, data: bytes, log_time: int) -> None:
        self._places[channel].append((log_time, self._size))
        self._parts += (RECORD.pack(Opcode.MESSAGE, len(head) + len(data)), head, data)
        self._size += _WITH_HEAD + len(data)

    def flush(self) -> None:
        """Write the messages that have come.

        Raises:
            RecordingError: that was not possible; they are lost, and counted in `lost`.
        """
        if not self._size:
            return
        messages, places = b"".join(self._parts), self._places
        self._new_chunk()
        times = [time for found in places.values() for time, _ in found]
        start, end = min(times), max(times)
        chunk = chunk_record(start, end, messages)
        offset = self._end
        indexes, offsets = message_indexes(offset + len(chunk), places)
        try:
            self._leave_room(len(chunk) + len(indexes))
            self._append(chunk + indexes)
        except RecordingError as error:
            self.lost += len(times)
            raise RecordingError(
                f"{len(times)} messages are lost: {error.message}",
                where=error.where,
                remedy=error.remedy,
            ) from error
        self._index.chunks.append(
            Chunk(offset, len(chunk), len(messages), start, end, offsets, len(indexes))
        )
        for number, found in places.items():
            self._index.counts[number] += len(found)

    def metadata(self, name: str, texts: Mapping[str, str]) -> None:
        """Write texts by name.

        Raises:
            RecordingError: that was not possible.
        """
        made = metadata_record(name, texts)
        offset = self._append(made)
        self._index.metadata.append(metadata_block(made[RECORD.size :], offset))

    def attachment(self, name: str, data: bytes, media_type: str = "text/plain") -> None:
        """Write a file that goes with the recording, such as a configuration.

        Raises:
            RecordingError: that was not possible.
        """
        made = attachment_record(name, media_type, data, time.time_ns())
        offset = self._append(made)
        self._index.attachments.append(attachment_block(made[RECORD.size :], offset))

    @property
    def size(self) -> int:
        """Bytes that are in the file, its end left out."""
        return self._end

    def finish(self) -> None:
        """Write the rest and the end, and close the file. A second time does nothing.

        Raises:
            RecordingError: that was not possible; what was written before can be read, and mended.
        """
        if not self._is_open:
            return
        try:
            try:
                self.flush()
            finally:
                self._write(self._index.ending(self._end, self._crc))
                os.fsync(self._file)
        except OSError as error:
            raise self._failure("cannot be completed", error) from error
        finally:
            self._close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.finish()

    # ----------------------------------------------------------------------------------- the file

    def _new_chunk(self) -> None:
        self._parts: list[bytes] = []
        self._places: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)
        self._size = 0

    def _leave_room(self, size: int) -> None:
        if not self._keep_free:
            return
        disk = os.fstatvfs(self._file)
        free = disk.f_bavail * disk.f_frsize
        if free < self._keep_free + size:
            raise RecordingError(
                f"its disk has {free / 1e6:.0f} MB left, and {self._keep_free / 1e6:.0f} MB are kept free",
                where=str(self.path),
                remedy="End the recording, or make room.",
            )

    def _append(self, records: bytes) -> int:
        """Write records and their seal, and return where they are; nothing of them stays if that fails."""
        if not self._is_open:
            raise RecordingError("the recording is finished", where=str(self.path))
        sealed = zlib.crc32(records, self._crc)
        closing = seal(sealed)
        try:
            self._write(records + closing)
        except OSError as error:
            raise self._failure("cannot be written", error) from error
        offset = self._end
        self._end += len(records) + len(closing)
        self._crc = zlib.crc32(closing, sealed)
        return offset

    def _write(self, data: bytes) -> None:
        view, offset = memoryview(data), self._end
        try:
            while view:
                count = os.pwrite(self._file, view, offset)
                view, offset = view[count:], offset + count
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, self._end)
            raise

    def _close(self) -> None:
        self._is_open = False
        os.close(self._file)

    def _failure(self, what: str, error: OSError) -> RecordingError:
        return RecordingError(
            f"{what}: {error.strerror or error}", where=str(self.path), remedy=_REMEDY
        )


_REMEDY: Final = "See whether the disk is full, and whether its folder can be written."


def definition(type_name: str) -> str:
    """Return a type's definition with those of the types in it, as MCAP's encoding "ros2msg" is.

    Raises:
        RecordingError: messages of this type are not recorded.
    """
    try:
        return files("crtk_drivers.recording").joinpath(f"schemas/{type_name}.msg").read_text()
    except OSError as error:
        raise RecordingError(f"messages of type {type_name} cannot be recorded") from error


def _library() -> str:
    try:
        return f"crtk-drivers {version('crtk-drivers')}"
    except PackageNotFoundError:
        return "crtk-drivers"
