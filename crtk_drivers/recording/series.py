"""The files of one recording: one, or a next one whenever the last is large or old enough.

Each can be read without the others: it begins with the metadata, the attachments, and what holds of each
latched topic and of what was measured meanwhile.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

from crtk_drivers.errors import RecordingError
from crtk_drivers.recording.mcap_writer import McapWriter

MOST_FILES: Final = 100_000

LATCHED_TEXTS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "offered_qos_profiles": (
            "- history: keep_last\n  depth: 1\n  reliability: reliable\n  durability: transient_local\n"
            "  deadline:\n    sec: 9223372036\n    nsec: 854775807\n"
            "  lifespan:\n    sec: 9223372036\n    nsec: 854775807\n"
            "  liveliness: automatic\n"
            "  liveliness_lease_duration:\n    sec: 9223372036\n    nsec: 854775807\n"
            "  avoid_ros_namespace_conventions: false\n"
        )
    }
)
"""What goes with the channel of a latched topic, as `ros2 bag` writes it (rosbag2_transport, qos.cpp)."""


class Raw(NamedTuple):
    """A message that is to be recorded.

    Attributes:
        topic: full name.
        type_name: of the message.
        data: its bytes, in CDR.
        log_time: ns since the epoch, when it came.
        publish_time: ns since the epoch, when it was measured or sent.
        is_latched: it holds until the next one, and is repeated in each file.
        definition: of its type; None: as we know it.
        about: what it tells of, where several publishers of a topic each tell of their own: it holds until
            all of that has been told anew.
    """

    topic: str
    type_name: str
    data: bytes
    log_time: int
    publish_time: int
    is_latched: bool = False
    definition: str | None = None
    about: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Split:
    """When the next file begins: after so many bytes, or so many seconds; 0: never."""

    size: int = 0
    seconds: float = 0.0


ONE_FILE: Final = Split()


class Series:
    """The files of a recording. All methods belong to one thread; `finish` ends it.

    Args:
        path: of the first file; the next ones are ``<name>_1.mcap`` and so on beside it.
        metadata: texts by name, by name; at the beginning of each file.
        attachments: files that go with it, by name; at the beginning of each file.
        split: when the next file begins.
        keep_free: bytes of its disk that messages leave to others; 0: none.

    Attributes:
        paths: of the files that were made.

    Raises:
        RecordingError: there is such a file, or it cannot be written.
    """

    def __init__(
        self,
        path: str | Path,
        metadata: Mapping[str, Mapping[str, str]] = MappingProxyType({}),
        attachments: Mapping[str, bytes] = MappingProxyType({}),
        split: Split = ONE_FILE,
        keep_free: int = 0,
    ) -> None:
        self._first = Path(path)
        self._metadata = metadata
        self._attachments = attachments
        self._split = split
        self._keep_free = keep_free
        self._latched: dict[str, tuple[Raw, ...]] = {}
        self._held: dict[str, tuple[str, Mapping[str, str]]] = {}
        self._unwritten: set[str] = set()
        self._lost_before = self._size_before = 0
        self._numbers = itertools.count(1)
        self._writer = self._begun(self._first)
        self.paths = [self._first]
        self._began = time.monotonic()

    @property
    def lost(self) -> int:
        """Messages that could not be written."""
        return self._lost_before + self._writer.lost

    @property
    def size(self) -> int:
        """Bytes in all files."""
        return self._size_before + self._writer.size

    def message(self, raw: Raw) -> None:
        """Add a message; it is in the file after the next `flush`.

        Raises:
            RecordingError: those before could not be written; this one is kept.
        """
        if raw.is_latched:
            self._latched[raw.topic] = _holding(raw, self._latched.get(raw.topic, ()))
        self._writer.message(self.channel(raw), raw.data, raw.log_time, raw.publish_time)

    def channel(self, raw: Raw) -> int:
        """Return the number of the channel of a message.

        Raises:
            RecordingError: it cannot be written, or has another type.
        """
        return _channel(self._writer, raw)

    def flush(self) -> None:
        """Write the messages that have come, and begin the next file if it is time for that.

        Raises:
            RecordingError: that was not possible; what could not be written is counted in `lost`.
        """
        self._writer.flush()
        is_large = 0 < self._split.size <= self._writer.size
        is_old = 0.0 < self._split.seconds <= time.monotonic() - self._began
        if is_large or is_old:
            self._begin_next()

    def hold(self, key: str, name: str, texts: Mapping[str, str], at_once: bool = False) -> None:
        """Keep metadata that holds until it is told anew.

        The first of a key is written now, what holds at the beginning of each next file, and the newest at
        the end of each file.

        Args:
            key: of what it tells.
            name: of the metadata.
            texts: by name.
            at_once: write it now: what is in the file does not hold any more.

        Raises:
            RecordingError: it could not be written now; it is tried again at the end of the file.
        """
        is_first = key not in self._held
        self._held[key] = name, texts
        self._unwritten.add(key)
        if is_first or at_once:
            self._writer.metadata(name, texts)
            self._unwritten.discard(key)

    def finish(self, last: Mapping[str, Mapping[str, str]] = MappingProxyType({})) -> None:
        """Write the rest and the end, and close the file. A second time does nothing.

        Args:
            last: metadata that the recording ends with: texts by name, by name.

        Raises:
            RecordingError: that was not possible; what was written before can be read, and mended.
        """
        self._end(self._writer, last)

    def _begin_next(self) -> None:
        """Finish the present file once the next one stands; else go on in it."""
        self._began = time.monotonic()  # also if it fails: it is tried again as late
        path = self._free_path()
        writer = self._begun(path)
        before, self._writer = self._writer, writer
        self._lost_before += before.lost
        self._size_before += before.size
        self.paths.append(path)
        self._end(before)

    def _end(
        self, writer: McapWriter, last: Mapping[str, Mapping[str, str]] = MappingProxyType({})
    ) -> None:
        try:
            for key in sorted(self._unwritten):
                writer.metadata(*self._held[key])
            for name, texts in last.items():
                writer.metadata(name, texts)
        finally:
            self._unwritten.clear()
            writer.finish()

    def _free_path(self) -> Path:
        for number in itertools.islice(self._numbers, MOST_FILES):
            path = self._first.with_stem(f"{self._first.stem}_{number}")
            if not path.exists():
                return path
        raise RecordingError("has too many files beside it", where=str(self._first))

    def _begun(self, path: Path) -> McapWriter:
        writer = McapWriter(path, self._keep_free)
        try:
            for name, texts in (*self._metadata.items(), *self._held.values()):
                writer.metadata(name, texts)
            for name, data in self._attachments.items():
                writer.attachment(name, data)
            now = time.time_ns()
            for raw in itertools.chain.from_iterable(self._latched.values()):
                writer.message(_channel(writer, raw), raw.data, now, raw.publish_time)
            writer.flush()
        except RecordingError:
            with suppress(RecordingError):
                writer.finish()
            raise
        return writer


def _holding(newest: Raw, before: tuple[Raw, ...]) -> tuple[Raw, ...]:
    """Return what holds of a latched topic once `newest` has come, in the order in which it came."""
    found, told = [newest], newest.about
    for raw in reversed(before):
        if not raw.about <= told:
            found.append(raw)
            told |= raw.about
    return tuple(reversed(found))


def _channel(writer: McapWriter, raw: Raw) -> int:
    texts = LATCHED_TEXTS if raw.is_latched else {}
    return writer.channel(raw.topic, raw.type_name, raw.definition, texts)
