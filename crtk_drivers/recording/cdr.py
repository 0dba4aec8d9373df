"""Values as ROS 2 messages in bytes: CDR as every ROS 2 middleware writes it (XCDR1). No ROS here.

Of four bytes two say so (0, 1: little-endian; 0, 0: big-endian, which is only read); what follows is aligned
from there: numbers to their size, the first of a sequence too, and an empty sequence is its count alone. A
text is its size with the closing zero, the bytes and the zero. Padding is zero. Sources: OMG DDS-XTypes 1.3,
7.4.3; and what Fast CDR writes.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from crtk_drivers.samples import (
    EMPTY,
    CartesianServo,
    Flag,
    JointServo,
    JointState,
    Joy,
    Matrix,
    Number,
    Numbers,
    Pose,
    Poses,
    Text,
    Twist,
    Value,
    Vector,
    Wrench,
    frozen,
)
from crtk_drivers.state import OperatingState, Status

TYPE_NAMES: Mapping[type, str] = MappingProxyType(
    {
        JointState: "sensor_msgs/msg/JointState",
        Pose: "geometry_msgs/msg/PoseStamped",
        Poses: "geometry_msgs/msg/PoseArray",
        Twist: "geometry_msgs/msg/TwistStamped",
        Wrench: "geometry_msgs/msg/WrenchStamped",
        Status: "crtk_msgs/msg/OperatingState",
        Text: "crtk_msgs/msg/StringStamped",
        Joy: "sensor_msgs/msg/Joy",
    }
)
"""The ROS type of each value that can be recorded."""

_ARRAY: Final = "std_msgs/msg/Float64MultiArray"
_LITTLE_ENDIAN: Final = b"\x00\x01\x00\x00"
_ORDERS: Mapping[bytes, str] = MappingProxyType({b"\x00\x01": "<", b"\x00\x00": ">"})
_SECOND: Final = 1_000_000_000
_STAMP = struct.Struct("<4siI")
_BODY_OF_TEXT: Final = 8
"""Where the frame begins, from behind the first four bytes: after the stamp."""
_COUNT = struct.Struct("<I")
SLACK: Final = 12
"""Bytes behind a message, at most: Fast CDR reckons with padding for empty sequences, and leaves it out."""

_POSE = struct.Struct("<7d")
_TWO_VECTORS = struct.Struct("<6d")
_SERVO = struct.Struct("<26d")
_NO_LAYOUT: Final = _LITTLE_ENDIAN + bytes(8)
"""The beginning of a Float64MultiArray without dimensions, up to its data."""
_TRANSFORM_STAMP = struct.Struct("<4sIiI")
_BODY_OF_TRANSFORM: Final = 12
"""Where the frames of a transform begin: after their count and the stamp."""
MOST_NAMES: Final = 4096
"""Names that a message may have: who reads more is kept from everything else meanwhile."""
_KEPT: Final = 1024
"""Frames and names of joints whose bytes are remembered."""


class Malformed(ValueError):
    """Bytes that are no message of the type that they should be."""


@dataclass(frozen=True, slots=True)
class Stamped:
    """What a message holds: a value, its stamp in ns since the epoch (0: not valid), and its frame."""

    value: Value | Status
    stamp_ns: int
    frame_id: str


def encode(value: object, stamp_ns: int, frame_id: str = "") -> bytes:
    """Return a value as a message of its type.

    Args:
        value: a `Value`, or a `Status`, of which the message holds state, is_homed and is_busy.
        stamp_ns: since the epoch; 0 marks data that is not valid, as that of a `Joy` that is not. Numbers,
            flags and matrices have none.
        frame_id: what the message names; the one of the value is not looked at.

    Raises:
        ValueError: a value of another type, or what no message can hold: a stamp, vectors of another size.
    """
    kind = type(value)
    bare = _BARE.get(kind)
    body = _ENCODE.get(kind)
    try:
        if bare is not None:
            return bare(value)
        if body is not None:
            if isinstance(value, Joy) and not value.is_valid:
                stamp_ns = 0
            stamp = _STAMP.pack(_LITTLE_ENDIAN, *divmod(stamp_ns, _SECOND))
            return stamp + body(value, frame_id)
    except struct.error as error:
        raise ValueError(f"a {kind.__name__} cannot be a message: {error}") from error
    raise ValueError(f"a {kind.__name__} cannot be a message")


def encode_transform(pose: Pose, stamp_ns: int, frame_id: str, child: str) -> bytes:
    """Return a pose as a tf2_msgs/TFMessage of one transform, from `frame_id` to the frame `child`.

    Raises:
        ValueError: see `encode`.
    """
    numbers = (*pose.position.tolist(), *pose.orientation.tolist())
    try:
        stamp = _TRANSFORM_STAMP.pack(_LITTLE_ENDIAN, 1, *divmod(stamp_ns, _SECOND))
        return stamp + _frames(frame_id, child) + _POSE.pack(*numbers)
    except struct.error as error:
        raise ValueError(f"a transform cannot be a message: {error}") from error


def encode_text(text: str) -> bytes:
    """Return a text as a std_msgs/String, which has no stamp."""
    return _LITTLE_ENDIAN + _text(text)


NOTHING: Final = _LITTLE_ENDIAN + b"\0"
"""A std_msgs/Empty."""

TEXT_TYPE: Final = "std_msgs/msg/String"


def decode(type_name: str, data: bytes, *, is_exact: bool = True) -> Stamped:
    """Return what a message holds. A stamp that is none (10^9 ns or more) is 0.

    Args:
        type_name: one of `READABLE`.
        data: the message, which may be anything.
        is_exact: refuse a message that goes on behind its last field.

    Raises:
        Malformed: bytes that are no such message.
        ValueError: another type, or a message whose vectors do not fit together.
    """
    bare, body = _READ_BARE.get(type_name), _DECODE.get(type_name)
    stamp_ns, frame = 0, ""
    value: Value | Status
    try:
        fields = Fields(data)
        if bare is not None:
            value = bare(fields)
        elif body is not None:
            stamp_ns, frame = fields.stamp(), fields.text()
            value = body(fields, frame)
        else:
            raise ValueError(f"messages of type {type_name} cannot be read here")
        if is_exact:
            fields.end()
    except Malformed as error:
        raise Malformed(f"this is no {type_name}: {error}") from error
    return Stamped(value, stamp_ns, frame)


def decode_matrix(data: bytes) -> Matrix:
    """Return what a Float64MultiArray holds, laid out as it says; one row if it has not two dimensions.

    Raises:
        Malformed: bytes that are no such message.
        ValueError: numbers that its layout has no room for, or too few.
    """
    try:
        fields = Fields(data)
        sizes, numbers = fields.layout(), fields.sequence()
        fields.end()
    except Malformed as error:
        raise Malformed(f"this is no {_ARRAY}: {error}") from error
    return Matrix(numbers.reshape(sizes) if len(sizes) == 2 else np.atleast_2d(numbers))


def stamp_of(data: bytes) -> int:
    """Return the stamp in ns of a message with a header; see `decode`.

    Raises:
        Malformed: it ends before.
    """
    return Fields(data).stamp()


def last_word_of(data: bytes, words: Collection[str]) -> str:
    """Return which of `words` stands last in a message that cannot be read; empty if none does.

    Only a whole word counts: no letter, digit or underscore may be next to it.
    """
    alternatives = "|".join(map(re.escape, words))
    found = re.findall(rf"\b(?:{alternatives})\b".encode(), data)
    return found[-1].decode() if found else ""


# ------------------------------------------------------------------------------------------- encoding


def _text(text: str) -> bytes:
    raw = text.encode("utf-8", "backslashreplace").replace(b"\0", b"\\0")
    return _COUNT.pack(len(raw) + 1) + raw + b"\0"


def _padding(size: int, to: int) -> bytes:
    return bytes(-size % to)


@lru_cache(_KEPT)
def _frame(frame_id: str, align: int) -> bytes:
    """Return a frame with the padding behind it."""
    raw = _text(frame_id)
    return raw + _padding(_BODY_OF_TEXT + len(raw), align)


@lru_cache(_KEPT)
def _frames(frame_id: str, child: str) -> bytes:
    raw = _text(frame_id)
    raw += _padding(_BODY_OF_TRANSFORM + len(raw), 4) + _text(child)
    return raw + _padding(_BODY_OF_TRANSFORM + len(raw), 8)


@lru_cache(_KEPT)
def _frame_and_names(frame_id: str, names: tuple[str, ...]) -> bytes:
    raw = _frame(frame_id, 4) + _COUNT.pack(len(names))
    for name in names:
        raw += _padding(_BODY_OF_TEXT + len(raw), 4) + _text(name)
    return raw + _padding(_BODY_OF_TEXT + len(raw), 4)


def _joints(value: JointState | JointServo, frame_id: str) -> bytes:
    parts = [_frame_and_names(frame_id, tuple(value.name))]
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


def _poses(value: Poses, frame_id: str) -> bytes:
    head = _frame(frame_id, 4) + _COUNT.pack(len(value.poses))
    if not value.poses:
        return head
    return head + _padding(_BODY_OF_TEXT + len(head), 8) + value.vector.tobytes()


def _twist(value: Twist, frame_id: str) -> bytes:
    numbers = (*value.linear.tolist(), *value.angular.tolist())
    return _frame(frame_id, 8) + _TWO_VECTORS.pack(*numbers)


def _wrench(value: Wrench, frame_id: str) -> bytes:
    numbers = (*value.force.tolist(), *value.torque.tolist())
    return _frame(frame_id, 8) + _TWO_VECTORS.pack(*numbers)


def _status(value: Status, frame_id: str) -> bytes:
    flags = bytes((bool(value.is_homed), bool(value.is_busy)))
    return _frame(frame_id, 4) + _text(value.state.value) + flags


def _stamped_text(value: Text, frame_id: str) -> bytes:
    return _frame(frame_id, 4) + _text(value.value)


def _joint_servo(value: JointServo, frame_id: str) -> bytes:
    return _joints(value, frame_id) + _COUNT.pack(len(value.modes)) + bytes(value.modes)


def _cartesian_servo(value: CartesianServo, frame_id: str) -> bytes:
    task, pose, twist, wrench = value.task, value.pose, value.twist, value.wrench
    parts = (
        *(task.position, task.orientation, pose.position, pose.orientation),
        *(twist.linear, twist.angular, wrench.force, wrench.torque),
    )
    numbers = _SERVO.pack(*(number for part in parts for number in part.tolist()))
    return _frame(frame_id, 8) + numbers + bytes(value.modes)


def _joy(value: Joy, frame_id: str) -> bytes:
    return (
        _frame(frame_id, 4)
        + struct.pack(f"<I{len(value.axes)}f", len(value.axes), *value.axes)
        + struct.pack(f"<I{len(value.buttons)}i", len(value.buttons), *value.buttons)
    )


def _number(value: Number) -> bytes:
    return _LITTLE_ENDIAN + struct.pack("<d", value.value)


def _flag(value: Flag) -> bytes:
    return _LITTLE_ENDIAN + bytes((bool(value.value),))


def _numbers(value: Numbers) -> bytes:
    return _NO_LAYOUT + _sequence(len(_NO_LAYOUT) - 4, value.values)


def _matrix(value: Matrix) -> bytes:
    layout = _layout(*value.values.shape)
    return layout + _sequence(len(layout) - 4, value.values.ravel().tolist())


def _sequence(at: int, numbers: Sequence[float]) -> bytes:
    """Return numbers with their count, which is at `at`."""
    padding = _padding(at + 4, 8) if len(numbers) else b""
    return _COUNT.pack(len(numbers)) + padding + struct.pack(f"<{len(numbers)}d", *numbers)


@lru_cache(_KEPT)
def _layout(rows: int, columns: int) -> bytes:
    """Return the beginning of a Float64MultiArray up to its data."""
    raw = _COUNT.pack(2)
    for label, size, stride in (("rows", rows, rows * columns), ("columns", columns, columns)):
        raw += _padding(len(raw), 4) + _text(label)
        raw += _padding(len(raw), 4) + struct.pack("<II", size, stride)
    return _LITTLE_ENDIAN + raw + _COUNT.pack(0)


_ENCODE: Mapping[type, Callable[[Any, str], bytes]] = MappingProxyType(
    {
        JointState: _joints,
        Pose: _pose,
        Poses: _poses,
        Twist: _twist,
        Wrench: _wrench,
        Status: _status,
        Text: _stamped_text,
        Joy: _joy,
        JointServo: _joint_servo,
        CartesianServo: _cartesian_servo,
    }
)
"""What follows the stamp."""

_BARE: Mapping[type, Callable[[Any], bytes]] = MappingProxyType(
    {Number: _number, Flag: _flag, Numbers: _numbers, Matrix: _matrix}
)
"""Messages without a header."""

# ------------------------------------------------------------------------------------------- decoding


class Fields:
    """The fields of a message, one after the other.

    Raises:
        Malformed: the bytes are no such message.
    """

    def __init__(self, data: bytes) -> None:
        order = _ORDERS.get(data[:2])
        if order is None or len(data) < 4:
            raise Malformed(f"it begins with {data[:4].hex(' ') or 'nothing'}, not 00 01 00 00")
        self._order = order
        self._data = data[4:]
        self._at = 0

    def _take(self, size: int, align: int = 1) -> bytes:
        begin = self._at + -self._at % align
        self._at = end = begin + size
        if end > len(self._data):
            raise Malformed(f"it ends {end - len(self._data)} bytes too early")
        return self._data[begin:end]

    def stamp(self) -> int:
        """A stamp in ns since the epoch; one that is none (10^9 ns or more) is 0."""
        seconds, nanoseconds = struct.unpack(self._order + "iI", self._take(8, 4))
        return int(seconds * _SECOND + nanoseconds) if nanoseconds < _SECOND else 0

    def count(self) -> int:
        """An uint32."""
        (count,) = struct.unpack(self._order + "I", self._take(4, 4))
        return int(count)

    def short(self) -> int:
        """An uint16."""
        (value,) = struct.unpack(self._order + "H", self._take(2, 2))
        return int(value)

    def duration(self) -> float:
        """A duration in s."""
        seconds, nanoseconds = struct.unpack(self._order + "iI", self._take(8, 4))
        return float(seconds + 1e-9 * nanoseconds)

    def text(self) -> str:
        """A string."""
        raw = self.raw_text().removesuffix(b"\0")  # which some writers leave out
        if b"\0" in raw:
            raise Malformed("a text has a zero in it")
        try:
            return raw.decode()
        except UnicodeDecodeError as error:
            raise Malformed(f"a text is not UTF-8: {error.reason}") from error

    def raw_text(self) -> bytes:
        """The bytes of a string, which may be no text."""
        return self._take(self.count())

    def texts(self) -> tuple[str, ...]:
        """A sequence of strings."""
        return tuple(self.text() for _ in range(self.few("names")))

    def few(self, what: str, most: int = MOST_NAMES) -> int:
        """The length of a sequence of things that are made one by one."""
        count = self.count()
        if count > most:
            raise Malformed(f"{count} {what} are more than {most}")
        return count

    def layout(self) -> tuple[int, ...]:
        """Return the sizes of a Float64MultiArray."""
        sizes = []
        for _ in range(self.few("dimensions")):
            self.text()  # its label
            sizes.append(self.count())
            self.count()  # its stride
        self.count()  # data_offset
        return tuple(sizes)

    def numbers(self, count: int) -> Vector:
        """So many float64 (count,)."""
        if not count:
            return EMPTY
        taken = np.frombuffer(self._take(8 * count, 8), self._order + "f8")
        return frozen(taken.astype(np.float64))

    def sequence(self) -> Vector:
        """A sequence of float64 (n,)."""
        return self.numbers(self.count())

    def words(self, code: str, what: str) -> tuple[float, ...]:
        """A sequence of float32 (``f``) or int32 (``i``)."""
        count = self.few(what)
        return struct.unpack(
            f"{self._order}{count}{code}", self._take(4 * count, 4 if count else 1)
        )

    def bytes(self, count: int) -> tuple[int, ...]:
        """So many uint8."""
        return tuple(self._take(count))

    def flag(self) -> bool:
        """A bool."""
        value = self._take(1)[0]
        if value > 1:
            raise Malformed(f"{value} is neither true nor false")
        return value == 1

    def end(self, slack: int = SLACK) -> None:
        """Nothing may follow but so many bytes of padding."""
        left = len(self._data) - self._at
        if left > slack:
            raise Malformed(f"{left} bytes are left over")


def _joints_of(fields: Fields, frame_id: str) -> JointState:
    name = fields.texts()
    return JointState(fields.sequence(), fields.sequence(), fields.sequence(), name)


def _pose_of(fields: Fields, frame_id: str) -> Pose:
    return Pose(fields.numbers(3), fields.numbers(4), frame_id)


def _poses_of(fields: Fields, frame_id: str) -> Poses:
    count = fields.few("poses")
    return Poses(tuple(_pose_of(fields, frame_id) for _ in range(count)), frame_id)


def _twist_of(fields: Fields, frame_id: str) -> Twist:
    return Twist(fields.numbers(3), fields.numbers(3), frame_id)


def _wrench_of(fields: Fields, frame_id: str) -> Wrench:
    return Wrench(fields.numbers(3), fields.numbers(3), frame_id)


def _joy_of(fields: Fields, frame_id: str) -> Joy:
    axes, buttons = fields.words("f", "axes"), fields.words("i", "buttons")
    return Joy(axes, tuple(map(int, buttons)))


def _status_of(fields: Fields, frame_id: str) -> Status:
    text = fields.text()
    try:
        state = OperatingState(text)
    except ValueError as error:
        raise Malformed(str(error)) from error
    return Status(state, fields.flag(), fields.flag())


def _text_of(fields: Fields, frame_id: str) -> Text:
    return Text(fields.text())


def _joint_servo_of(fields: Fields, frame_id: str) -> JointServo:
    joints = _joints_of(fields, frame_id)
    modes = fields.bytes(fields.count())
    return JointServo(modes, joints.position, joints.velocity, joints.effort, joints.name)


def _cartesian_servo_of(fields: Fields, frame_id: str) -> CartesianServo:
    task = _pose_of(fields, "")
    pose = _pose_of(fields, "")
    twist, wrench = _twist_of(fields, ""), _wrench_of(fields, "")
    return CartesianServo(fields.bytes(6), pose, twist, wrench, task, frame_id)


def _number_of(fields: Fields) -> Number:
    return Number(float(fields.numbers(1)[0]))


def _flag_of(fields: Fields) -> Flag:
    return Flag(fields.flag())


def _numbers_of(fields: Fields) -> Numbers:
    fields.layout()
    return Numbers(tuple(fields.sequence().tolist()))


_DECODE: Mapping[str, Callable[[Fields, str], Value | Status]] = MappingProxyType(
    {
        TYPE_NAMES[JointState]: _joints_of,
        TYPE_NAMES[Pose]: _pose_of,
        TYPE_NAMES[Poses]: _poses_of,
        TYPE_NAMES[Twist]: _twist_of,
        TYPE_NAMES[Wrench]: _wrench_of,
        TYPE_NAMES[Status]: _status_of,
        TYPE_NAMES[Text]: _text_of,
        TYPE_NAMES[Joy]: _joy_of,
        "crtk_msgs/msg/JointServo": _joint_servo_of,
        "crtk_msgs/msg/CartesianServo": _cartesian_servo_of,
    }
)
"""What follows the header."""

_READ_BARE: Mapping[str, Callable[[Fields], Value]] = MappingProxyType(
    {
        "std_msgs/msg/Float64": _number_of,
        "std_msgs/msg/Bool": _flag_of,
        _ARRAY: _numbers_of,
        TEXT_TYPE: lambda fields: Text(fields.text()),
    }
)
"""Messages without a header."""

READABLE: Final = frozenset((*_DECODE, *_READ_BARE))
"""The types that `decode` reads; of a Float64MultiArray the numbers, without their layout."""
