"""Reads a recording, finished or cut off, and completes one that was cut off."""

from __future__ import annotations

import fcntl
import os
import re
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from crtk_drivers.errors import RecordingError
from crtk_drivers.recording import cdr
from crtk_drivers.recording.mcap_format import RECORD, Block, Fields, message_indexes, seal
from crtk_drivers.recording.scan import messages_in, messages_of, scan

__all__ = ["Attachment", "Message", "Recording", "mend"]


_LATCHED: Final = re.compile(r"durability: (transient_local|1)\b")


class BeingWritten(RecordingError):
    """A recording that somebody still writes."""


class MayNotBeMended(RecordingError):
    """A recording that may be read, and not written."""


@dataclass(frozen=True, slots=True)
class Message:
    """One message of a recording; times are ns since the epoch.

    Attributes:
        topic, type_name: of its channel.
        sequence: how many came before it on its topic.
        log_time: when it was recorded.
        publish_time: when it was measured or sent.
        data: its bytes, in CDR.
    """

    topic: str
    type_name: str
    sequence: int
    log_time: int
    publish_time: int
    data: bytes

    def decoded(self) -> cdr.Stamped:
        """Return its value.

        Raises:
            RecordingError: it is of another type than those that are recorded here.
        """
        try:
            return cdr.decode(self.type_name, self.data)
        except ValueError as error:
            raise RecordingError(f"a message on {self.topic}: {error}") from error


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file that goes with a recording."""

    name: str
    media_type: str
    data: bytes


class Recording:
    """A recording, checked: every byte up to where it was cut off, if it was.

    Args:
        path: of the file. One that is still being written is read as far as it goes.

    Attributes:
        is_complete: it was finished. If not, `mend` completes it; it can be read all the same.
        topics: type of the messages, by topic.
        counts: of messages, by topic.
        latched: topics whose newest message holds until the next one.

    Raises:
        RecordingError: it cannot be read, is none, or is damaged.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        try:
            with self.path.open("rb") as file:
                found = scan(file, self.path)
        except OSError as error:
            raise _unreadable(self.path, error) from error
        self._index = found.index
        self.is_complete = found.is_complete
        channels = self._index.channels
        self.topics: Mapping[str, str] = {c.topic: c.type_name for c in channels.values()}
        self.counts: Mapping[str, int] = {
            channel.topic: self._index.counts[number] for number, channel in channels.items()
        }
        self.latched = frozenset(c.topic for c in channels.values() if is_latched(c.texts))

    def messages(self, *topics: str) -> Iterator[Message]:
        """Yield the messages of some topics, or of all, as they came.

        Raises:
            RecordingError: there is no such topic, or the file has changed.
        """
        for topic in topics:
            if topic not in self.topics:
                raise RecordingError(
                    f"has no {topic}",
                    where=str(self.path),
                    remedy=f"It has: {', '.join(self.topics) or 'nothing'}.",
                )
        channels = self._index.channels
        wanted = {n for n, channel in channels.items() if not topics or channel.topic in topics}
        for chunk in self._index.chunks:
            content = messages_of(self._content(chunk.offset, chunk.size))
            for _, number, sequence, log_time, publish_time, data in messages_in(content):
                if number in wanted:
                    channel = channels[number]
                    yield Message(
                        channel.topic, channel.type_name, sequence, log_time, publish_time, data
                    )

    @property
    def metadata(self) -> list[tuple[str, dict[str, str]]]:
        """Every piece of metadata, by name; a name may come again."""
        return [(block.name, self._texts(block)) for block in self._index.metadata]

    @property
    def attachments(self) -> list[Attachment]:
        """Every file that goes with the recording."""
        return [self._attachment(block) for block in self._index.attachments]

    def _texts(self, block: Block) -> dict[str, str]:
        fields = Fields(self._content(block.offset, block.size))
        fields.text()
        return fields.texts()

    def _attachment(self, block: Block) -> Attachment:
        fields = Fields(self._content(block.offset, block.size))
        fields.raw(16)
        return Attachment(fields.text(), fields.text(), fields.raw(fields.u64()))

    def _content(self, offset: int, size: int) -> bytes:
        try:
            with self.path.open("rb") as file:
                file.seek(offset)
                return file.read(size)[RECORD.size :]
        except OSError as error:
            raise _unreadable(self.path, error) from error


def is_latched(texts: Mapping[str, str]) -> bool:
    """Whether what goes with a channel says so, as `ros2 bag` writes it."""
    return _LATCHED.search(texts.get("offered_qos_profiles", "")) is not None


def mend(path: str | Path) -> bool:
    """Complete a recording that was cut off, in place; return False if it was complete.

    Nothing that is whole is lost: what was begun behind it is taken off, and an end is written.

    Raises:
        RecordingError: it is still being written, cannot be read or written, is none, or is damaged. Then
            nothing has changed.
    """
    path = Path(path)
    try:
        with path.open("r+b") as file:
            _lock(file.fileno(), path)
            found = scan(file, path)
            if found.is_complete:
                return False
            rest, index = b"", found.index
            if found.bare:
                rest, offsets = message_indexes(found.end, found.bare)
                index.chunks[-1] = replace(
                    index.chunks[-1], indexes=offsets, indexes_size=len(rest)
                )
                rest += seal(zlib.crc32(rest, found.crc))
            ending = index.ending(found.end + len(rest), zlib.crc32(rest, found.crc))
            file.seek(found.end)
            file.write(rest + ending)
            file.truncate()
            file.flush()
            os.fsync(file.fileno())
    except PermissionError as error:
        raise MayNotBeMended("may not be written", where=str(path)) from error
    except OSError as error:
        raise _unreadable(path, error) from error
    return True


def _lock(descriptor: int, path: Path) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise BeingWritten(
            "is still being written", where=str(path), remedy="End the recording first."
        ) from error


def _unreadable(path: Path, error: OSError) -> RecordingError:
    return RecordingError(f"cannot be read: {error.strerror or error}", where=str(path))
