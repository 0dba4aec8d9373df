"""What OpenIGTLink messages say, and their bodies as bytes: big-endian, in the units of the wire. Pure.

Sources: OpenIGTLink, Documents/Protocol (transform, position, qtdata, tdata, sensor, ndarray, string, status,
query, capability) and Source/igtlutil. Of STT_TDATA and STT_QTDATA the page has a byte too many.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from crtk_drivers.geometry.quaternions import matrix_from_quaternion, quaternion_from_matrix
from crtk_drivers.kit import BadData
from crtk_drivers.samples import Array, Vector, vector

NAME: Final = 20
"""Bytes of the name of a device, or of a tool."""
COORDINATES: Final = 32
"""Bytes of the name of a coordinate system."""
TYPE: Final = 12
"""Bytes of the name of a type; longer ones are cut: GET_TRANSFOR."""
ASCII: Final = 3
"""Of the character sets of IANA; 106 is UTF-8."""
UTF8: Final = 106
MOST_DIMENSIONS: Final = 8


class TooLong(ValueError):
    """A name that has no room in its field."""


@dataclass(frozen=True, slots=True, eq=False)
class Transform:
    """TRANSFORM: a homogeneous matrix (4, 4)."""

    matrix: Array


@dataclass(frozen=True, slots=True, eq=False)
class Position:
    """POSITION: (3,), and a quaternion (4,) x, y, z, w; None where none was sent."""

    position: Vector
    orientation: Vector | None


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """One tool of TDATA and QTDATA.

    Attributes:
        name: of it.
        matrix: homogeneous, (4, 4).
        kind: 1 tracker, 2 6D, 3 3D, 4 5D.
    """

    name: str
    matrix: Array
    kind: int = 2


@dataclass(frozen=True, slots=True, eq=False)
class TrackingData:
    """TDATA: several tools at once, with matrices."""

    tools: tuple[Tracked, ...]


@dataclass(frozen=True, slots=True, eq=False)
class QuaternionTrackingData:
    """QTDATA: the same with quaternions."""

    tools: tuple[Tracked, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Sensor:
    """SENSOR: numbers (n,), their unit (64 bits; 0: none), and a status."""

    values: Vector
    unit: int = 0
    status: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class NdArray:
    """NDARRAY: numbers of any shape."""

    values: np.ndarray[Any, Any]


@dataclass(frozen=True, slots=True)
class String:
    """STRING: words."""

    text: str


@dataclass(frozen=True, slots=True)
class StatusBody:
    """STATUS: how something is, see `STATUS`."""

    code: int
    name: str = ""
    text: str = ""
    sub_code: int = 0


@dataclass(frozen=True, slots=True)
class Start:
    """STT_TDATA, STT_QTDATA: send so often, in ms, in a coordinate system."""

    resolution: int = 0
    coordinates: str = ""


@dataclass(frozen=True, slots=True)
class Reply:
    """RTS_: whether what was asked for (STT_, STP_) is done."""

    done: bool


@dataclass(frozen=True, slots=True)
class Capability:
    """CAPABILITY: the types that a program knows."""

    types: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Empty:
    """No body: GET_, STP_, some STT_, and the answer of who has no data."""


Body = (
    Transform
    | Position
    | TrackingData
    | QuaternionTrackingData
    | Sensor
    | NdArray
    | String
    | StatusBody
    | Start
    | Reply
    | Capability
    | Empty
)

STATUS: Final[Mapping[str, int]] = MappingProxyType(
    {
        "ok": 1,
        "unknown error": 2,
        "not found": 4,
        "access denied": 5,
        "busy": 6,
        "time out": 7,
        "checksum error": 9,
        "configuration error": 10,
        "unknown instruction": 12,
        "not ready": 13,
        "manual mode": 14,
        "disabled": 15,
        "hardware failure": 18,
        "exiting": 19,
    }
)
"""Codes of STATUS that are used here."""

_TWELVE: Final = struct.Struct(">12f")
_THREE: Final = struct.Struct(">3f")
_FOUR: Final = struct.Struct(">4f")
_TOOL: Final = struct.Struct(f">{NAME}sBB12f")
_QUATERNION_TOOL: Final = struct.Struct(f">{NAME}sBB7f")
_SENSOR: Final = struct.Struct(">BBQ")
_TEXT: Final = struct.Struct(">HH")
_STATUS: Final = struct.Struct(f">Hq{NAME}s")
_START: Final = struct.Struct(f">i{COORDINATES}s")

_SCALARS: Final[Mapping[int, str]] = MappingProxyType(
    {2: ">i1", 3: ">u1", 4: ">i2", 5: ">u2", 6: ">i4", 7: ">u4", 10: ">f4", 11: ">f8", 13: ">c16"}
)
_DOUBLE: Final = 11


def field_of(text: str, size: int) -> bytes:
    """Return a name as it fills a field.

    Raises:
        TooLong: it has more bytes than the field.
    """
    raw = text.encode("ascii", "replace")
    if len(raw) > size:
        raise TooLong(f"{text!r} has {len(raw)} bytes, and {size} are the most")
    return raw.ljust(size, b"\0")


def text_of(raw: bytes) -> str:
    """Return the name in a field: up to the first zero."""
    return raw.partition(b"\0")[0].decode("ascii", "replace").rstrip()


# ------------------------------------------------------------------------------------------- encoding


def _columns(matrix: Array) -> list[float]:
    numbers: list[float] = matrix[:3, :4].T.ravel().tolist()
    return numbers


def _transform(body: Transform) -> bytes:
    return _TWELVE.pack(*_columns(body.matrix))


def _position(body: Position) -> bytes:
    raw = _THREE.pack(*body.position.tolist())
    return raw if body.orientation is None else raw + _FOUR.pack(*body.orientation.tolist())


def _tracking(body: TrackingData) -> bytes:
    return b"".join(
        _TOOL.pack(field_of(tool.name, NAME), tool.kind, 0, *_columns(tool.matrix))
        for tool in body.tools
    )


def _quaternion_tracking(body: QuaternionTrackingData) -> bytes:
    return b"".join(
        _QUATERNION_TOOL.pack(
            field_of(tool.name, NAME),
            tool.kind,
            0,
            *tool.matrix[:3, 3].tolist(),
            *quaternion_from_matrix(tool.matrix[:3, :3]).tolist(),
        )
        for tool in body.tools
    )


def _sensor(body: Sensor) -> bytes:
    count = body.values.size
    return _SENSOR.pack(count, body.status, body.unit) + body.values.astype(">f8").tobytes()


def _ndarray(body: NdArray) -> bytes:
    shape = body.values.shape
    head = struct.pack(f">BB{len(shape)}H", _DOUBLE, len(shape), *shape)
    return head + body.values.astype(">f8").tobytes()


def _string(body: String) -> bytes:
    raw = body.text.encode()[:0xFFFF]
    return _TEXT.pack(ASCII if raw.isascii() else UTF8, len(raw)) + raw


def _status(body: StatusBody) -> bytes:
    head = _STATUS.pack(body.code, body.sub_code, field_of(body.name, NAME))
    return head + body.text.encode("ascii", "replace") + b"\0"


def _start(body: Start) -> bytes:
    return _START.pack(body.resolution, field_of(body.coordinates, COORDINATES))


def _capability(body: Capability) -> bytes:
    return b"".join(field_of(each[:TYPE], TYPE) for each in body.types)


_ENCODE: Final[Mapping[type, Callable[[Any], bytes]]] = MappingProxyType(
    {
        Transform: _transform,
        Position: _position,
        TrackingData: _tracking,
        QuaternionTrackingData: _quaternion_tracking,
        Sensor: _sensor,
        NdArray: _ndarray,
        String: _string,
        StatusBody: _status,
        Start: _start,
        Reply: lambda body: bytes((not body.done,)),
        Capability: _capability,
        Empty: lambda body: b"",
    }
)


def encode_body(body: Body) -> bytes:
    """Return a body as bytes.

    Raises:
        TooLong: a name in it has no room.
        struct.error, OverflowError: a number in it has none.
    """
    return _ENCODE[type(body)](body)


# ------------------------------------------------------------------------------------------- decoding


def _matrix(numbers: tuple[float, ...]) -> Array:
    a, b, c, d, e, f, g, h, i, x, y, z = numbers
    return np.array(((a, d, g, x), (b, e, h, y), (c, f, i, z), (0.0, 0.0, 0.0, 1.0)))


def _transform_of(data: bytes) -> Body:
    return Transform(_matrix(_TWELVE.unpack(data)))


def _position_of(data: bytes) -> Body:
    position = vector(_THREE.unpack_from(data))
    rest = data[_THREE.size :]
    if len(rest) == _FOUR.size:
        return Position(position, vector(_FOUR.unpack(rest)))
    if len(rest) == 12:  # the last component of the quaternion is left out
        x, y, z = _THREE.unpack(rest)
        return Position(
            position, vector((x, y, z, math.sqrt(max(0.0, 1.0 - x * x - y * y - z * z))))
        )
    if rest:
        raise BadData(f"{len(rest)} bytes behind a position")
    return Position(position, None)


def _tracking_of(data: bytes) -> Body:
    return TrackingData(
        tuple(
            Tracked(text_of(name), _matrix(tuple(numbers)), kind)
            for name, kind, _, *numbers in _TOOL.iter_unpack(data)
        )
    )


def _quaternion_tracking_of(data: bytes) -> Body:
    tools = []
    for name, kind, _, x, y, z, *quaternion in _QUATERNION_TOOL.iter_unpack(data):
        norm = math.hypot(*quaternion)
        if not abs(norm - 1.0) < 0.01:
            raise BadData(f"a quaternion of length {norm:g}")
        matrix = np.eye(4)
        matrix[:3, :3] = matrix_from_quaternion(vector([each / norm for each in quaternion]))
        matrix[:3, 3] = x, y, z
        tools.append(Tracked(text_of(name), matrix, kind))
    return QuaternionTrackingData(tuple(tools))


def _sensor_of(data: bytes) -> Body:
    count, status, unit = _SENSOR.unpack_from(data)
    if len(data) != _SENSOR.size + 8 * count:
        raise BadData(f"{len(data)} bytes for {count} numbers")
    return Sensor(vector(np.frombuffer(data, ">f8", count, _SENSOR.size)), unit, status)


def _ndarray_of(data: bytes) -> Body:
    kind, dimensions = struct.unpack_from(">BB", data)
    if kind not in _SCALARS or not 0 < dimensions <= MOST_DIMENSIONS:
        raise BadData(f"an array of type {kind} and {dimensions} dimensions")
    shape = struct.unpack_from(f">{dimensions}H", data, 2)
    dtype, begin = np.dtype(_SCALARS[kind]), 2 + 2 * dimensions
    if len(data) - begin != math.prod(shape) * dtype.itemsize:
        raise BadData(f"{len(data) - begin} bytes for an array of shape {shape}")
    return NdArray(np.frombuffer(data, dtype, offset=begin).reshape(shape))


def _string_of(data: bytes) -> Body:
    coding, size = _TEXT.unpack_from(data)
    raw = data[_TEXT.size :]
    if len(raw) != size:
        raise BadData(f"{len(raw)} bytes for a text of {size}")
    return String(raw.decode("utf-8" if coding == UTF8 else "ascii", "replace"))


def _status_of(data: bytes) -> Body:
    code, sub_code, name = _STATUS.unpack_from(data)
    text = data[_STATUS.size :].partition(b"\0")[0].decode("ascii", "replace")
    return StatusBody(code, text_of(name), text, sub_code)


def _start_of(data: bytes) -> Body:
    resolution, coordinates = _START.unpack(data)
    return Start(resolution, text_of(coordinates))


def _capability_of(data: bytes) -> Body:
    return Capability(tuple(text_of(name) for (name,) in struct.iter_unpack(f"{TYPE}s", data)))


_DECODE: Final[Mapping[str, Callable[[bytes], Body]]] = MappingProxyType(
    {
        "TRANSFORM": _transform_of,
        "POSITION": _position_of,
        "TDATA": _tracking_of,
        "QTDATA": _quaternion_tracking_of,
        "SENSOR": _sensor_of,
        "NDARRAY": _ndarray_of,
        "STRING": _string_of,
        "STATUS": _status_of,
        "CAPABILITY": _capability_of,
        "STT_TDATA": _start_of,
        "STT_QTDATA": _start_of,
    }
)

QUERIES: Final = ("GET_", "STT_", "STP_")


NAMES: Final[Mapping[type, str]] = MappingProxyType(
    {
        Transform: "TRANSFORM",
        Position: "POSITION",
        TrackingData: "TDATA",
        QuaternionTrackingData: "QTDATA",
        Sensor: "SENSOR",
        NdArray: "NDARRAY",
        String: "STRING",
        StatusBody: "STATUS",
        Capability: "CAPABILITY",
    }
)
"""The type of each body that has one of its own."""


def is_known(kind: str) -> bool:
    """Whether messages of a type are read here."""
    return kind in _DECODE or kind[:4] in (*QUERIES, "RTS_")


def decode_body(kind: str, data: bytes) -> Body:
    """Return what a body of a type says.

    Raises:
        BadData: it is none.
    """
    if not data:
        return Empty()
    if kind.startswith("RTS_"):
        return Reply(data[0] == 0)
    decode = _DECODE.get(kind)
    if decode is None:
        if kind[:4] in QUERIES:
            return Empty()
        raise BadData(f"{kind} is not known here")
    try:
        return decode(data)
    except (struct.error, ValueError) as error:
        if isinstance(error, BadData):
            raise
        raise BadData(f"{len(data)} bytes are no {kind}: {error}") from error
