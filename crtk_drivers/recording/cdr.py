"""Values as ROS 2 messages in bytes: CDR, little-endian, as every ROS 2 middleware writes it (XCDR1).

Four bytes say so (0, 1, 0, 0); what follows is aligned from there: numbers to their size, the first of a
sequence too, and an empty sequence is its count alone. A text is its size with the closing zero, the bytes
and the zero. Padding is zero. Sources: OMG DDS-XTypes 1.3, 7.4.3; and what Fast CDR writes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from crtk_drivers.errors import RecordingError
from crtk_drivers.samples import JointState, Pose, Text, Twist, Vector, Wrench, vector
from crtk_drivers.state import OperatingState, Status

Recordable = JointState | Pose | Twist | Wrench | Status | Text
"""What can be recorded."""

TYPE_NAMES: Mapping[type, str] = MappingProxyType(
    {
        JointState: "sensor_msgs/msg/JointState",
        Pose: "geometry_msgs/msg/PoseStamped",
        Twist: "geometry_msgs/msg/TwistStamped",
        Wrench: "geometry_msgs/msg/WrenchStamped",
        Status: "crtk_msgs/msg/OperatingState",
        Text: "crtk_msgs/msg/StringStamped",
    }
)
"""The ROS type of each."""

_LITTLE_ENDIAN: Final = b"\x00\x01\x00\x00"
_SECOND: Final = 1_000_000_000
_STAMP = struct.Struct("<4siI")
_BODY_OF_TEXT: Final = 8
"""Where the frame begins, from behind the first four bytes: after the stamp."""
_COUNT = struct.Struct("<I")
_SLACK: Final = 12
"""Bytes behind a message, at most: Fast CDR reckons with padding for empty sequences, and leaves it out."""

_POSE = struct.Struct("<7d")
_TWO_VECTORS = struct.Struct("<6d")
_KEPT: Final = 1024
"""Frames and names of joints whose bytes are remembered."""


@dataclass(frozen=True, slots=True)
class Stamped:
    """What a message holds: a value, its stamp in ns since the epoch (0: not valid), and its frame."""

    value: Recordable
    stamp_ns: int
    frame_id: str


def encode(value: object, stamp_ns: int, frame_id: str = "") -> bytes:
    """Return a value as a message of its type.

    Args:
        value: a `Recordable`; of a `Status` the message holds state, is_homed and is_busy.
        stamp_ns: since the epoch; 0 marks data that is not valid.
        frame_id: of a value that does not name its own.

    Raises:
        RecordingError: a value of another type, a stamp that no message can hold, a text with a zero in it.
    """
    body = _ENCODE.get(type(value))
    if body is None:
        raise RecordingError(f"a {type(value).__name__} cannot be recorded")
    try:
        stamp = _STAMP.pack(_LITTLE_ENDIAN, *divmod(stamp_ns, _SECOND))
        return stamp + body(value, getattr(value, "frame_id", "") or frame_id)
    except struct.error as error:
        raise RecordingError(f"a {type(value).__name__} cannot be recorded: {error}") from error


def decode(type_name: str, data: bytes) -> Stamped:
    """Return what a message holds.

    Args:
        type_name: one of `TYPE_NAMES`.
        data: the message.

    Raises:
        RecordingError: another type, or bytes that are no such message.
    """
    body = _DECODE.get(type_name)
    if body is None:
        raise RecordingError(f"messages of type {type_name} cannot be read here")
    try:
        fields = _Fields(data)
        stamp_ns = fields.stamp()
        frame = fields.text()
        value = body(fields, frame)
        fields.end()
    except (struct.error, ValueError) as error:
        raise RecordingError(f"this is no {type_name}: {error}") from error
    return Stamped(value, stamp_ns, frame)


# ------------------------------------------------------------------------------------------- encoding


def _text(text: str) -> bytes:
    raw = text.encode("utf-8", "backslashreplace")
    if b"\0" in raw:
        raise RecordingError(f"{text[:40]!r} has a zero in it, which no text of a message can have")
    return _COUNT.pack(len(raw) + 1) + raw + b"\0"


def _padding(size: int, to: int) -> bytes:
    return bytes(-size % to)


@lru_cache(_KEPT)
def _frame(frame_id: str, align: int) -> bytes:
    """Return a frame with the padding behind it."""
    raw = _text(frame_id)
    return raw + _padding(_BODY_OF_TEXT + len(raw), align)


@lru_cache(_KEPT)
def _frame_and_names(frame_id: str, names: tuple[str, ...]) -> bytes:
    raw = _frame(frame_id, 4) + _COUNT.pack(len(names))
    for name in names:
        raw += _padding(_BODY_OF_TEXT + len(raw), 4) + _text(name)
    return raw + _padding(_BODY_OF_TEXT + len(raw), 4)


def _joints(value: JointState, frame_id: str) -> bytes:
    parts = [_frame_and_names(frame_id, value.name)]
    size = _BODY_OF_TEXT + len(parts[0])
    for numbers in (value.position, value.velocity, value.effort):
        count = numbers.size
        parts.append(_COUNT.pack(count))
        size += 4
        if count:
            parts += (_padding(size, 8), numbers.tobytes())
            size += -size % 8 + 8 * count
    return b"".join(parts)


def _pose(value: Pose, frame_id: str) -> bytes:
    numbers = (*value.position.tolist(), *value.orientation.tolist())
    return _frame(frame_id, 8) + _POSE.pack(*numbers)


def _twist(value: Twist, frame_id: str) -> bytes:
    numbers = (*value.linear.tolist(), *value.angular.tolist())
    return _frame(frame_id, 8) + _TWO_VECTORS.pack(*numbers)


def _wrench(value: Wrench, frame_id: str) -> bytes:
    numbers = (*value.force.tolist(), *value.torque.tolist())
    return _frame(frame_id, 8) + _TWO_VECTORS.pack(*numbers)


def _status(value: Status, frame_id: str) -> bytes:
    flags = bytes((value.is_homed, value.is_busy))
    return _frame(frame_id, 4) + _text(value.state.value) + flags


def _stamped_text(value: Text, frame_id: str) -> bytes:
    return _frame(frame_id, 4) + _text(value.value)


_ENCODE: Mapping[type, Callable[[Any, str], bytes]] = MappingProxyType(
    {
        JointState: _joints,
        Pose: _pose,
        Twist: _twist,
        Wrench: _wrench,
        Status: _status,
        Text: _stamped_text,
    }
)

# ------------------------------------------------------------------------------------------- decoding


class _Fields:
    """The fields of a message, one after the other.

    Raises:
        ValueError, struct.error: the bytes are no such message.
    """

    def __init__(self, data: bytes) -> None:
        if data[:4] != _LITTLE_ENDIAN:
            raise ValueError(f"it begins with {data[:4].hex(' ') or 'nothing'}, not 00 01 00 00")
        self._data = memoryview(data)[4:]
        self._at = 0

    def _align(self, to: int) -> None:
        self._at += -self._at % to

    def _take(self, size: int) -> memoryview:
        end = self._at + size
        if end > len(self._data):
            raise ValueError(f"it ends {end - len(self._data)} bytes too early")
        taken = self._data[self._at : end]
        self._at = end
        return taken

    def stamp(self) -> int:
        seconds, nanoseconds = struct.unpack("<iI", self._take(8))
        return int(seconds * _SECOND + nanoseconds)

    def count(self) -> int:
        self._align(4)
        (count,) = _COUNT.unpack(self._take(4))
        return int(count)

    def text(self) -> str:
        raw = bytes(self._take(self.count()))
        if not raw.endswith(b"\0") or raw.find(b"\0") != len(raw) - 1:
            raise ValueError("a text does not end with its one zero")
        return raw[:-1].decode()

    def texts(self) -> tuple[str, ...]:
        return tuple(self.text() for _ in range(self.count()))

    def numbers(self, count: int) -> Vector:
        if not count:
            return vector(())
        self._align(8)
        return vector(np.frombuffer(self._take(8 * count), "<f8"))

    def flag(self) -> bool:
        value = self._take(1)[0]
        if value > 1:
            raise ValueError(f"{value} is neither true nor false")
        return value == 1

    def end(self) -> None:
        left = len(self._data) - self._at
        if left > _SLACK:
            raise ValueError(f"{left} bytes are left over")


def _joints_of(fields: _Fields, frame_id: str) -> JointState:
    name = fields.texts()
    position, velocity, effort = (fields.numbers(fields.count()) for _ in range(3))
    return JointState(position, velocity, effort, name)


def _pose_of(fields: _Fields, frame_id: str) -> Pose:
    return Pose(fields.numbers(3), fields.numbers(4), frame_id)


def _twist_of(fields: _Fields, frame_id: str) -> Twist:
    return Twist(fields.numbers(3), fields.numbers(3), frame_id)


def _wrench_of(fields: _Fields, frame_id: str) -> Wrench:
    return Wrench(fields.numbers(3), fields.numbers(3), frame_id)


def _status_of(fields: _Fields, frame_id: str) -> Status:
    return Status(OperatingState(fields.text()), fields.flag(), fields.flag())


def _text_of(fields: _Fields, frame_id: str) -> Text:
    return Text(fields.text())


_DECODE: Mapping[str, Callable[[_Fields, str], Recordable]] = MappingProxyType(
    {
        TYPE_NAMES[JointState]: _joints_of,
        TYPE_NAMES[Pose]: _pose_of,
        TYPE_NAMES[Twist]: _twist_of,
        TYPE_NAMES[Wrench]: _wrench_of,
        TYPE_NAMES[Status]: _status_of,
        TYPE_NAMES[Text]: _text_of,
    }
)
