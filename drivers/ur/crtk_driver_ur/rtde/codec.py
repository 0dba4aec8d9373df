"""The RTDE protocol without I/O: bytes in, messages out, and requests as bytes.

A package is `u16 size | u8 type | payload`, big endian, the size counting all three. Protocol version 1
is in force until version 2 has been accepted.

Source: RTDE Guide, "Protocol".
"""

from __future__ import annotations

import math
import struct
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from operator import itemgetter
from typing import Any, NamedTuple, TypeAlias

from typing_extensions import override

from crtk_driver_ur.rtde.variables import TYPES

__all__ = [
    "MAX_PACKAGE",
    "ControllerVersion",
    "DataPackage",
    "Malformed",
    "MalformedReason",
    "Message",
    "PackageType",
    "Recipe",
    "RtdeDecoder",
    "RtdeFramingError",
    "SetupReply",
    "StateReply",
    "TextMessage",
    "VersionReply",
]

HEADER = struct.Struct(">HB")
MAX_PACKAGE = 4096
"""Longest package that is accepted; the guide limits the longest, a list of names, to 2048 bytes."""

LARGEST_NUMBER = 1e12
"""Of any output, in SI units: what is larger was damaged on its way."""

Value: TypeAlias = float | int | bool | tuple[float, ...] | tuple[int, ...]
Flat: TypeAlias = tuple[float, ...]
"""The numbers of a package one after the other, vectors not yet put together."""


class PackageType(IntEnum):
    """The type byte of a package."""

    TEXT_MESSAGE = ord("M")
    SETUP_OUTPUTS = ord("O")
    PAUSE = ord("P")
    START = ord("S")
    SETUP_INPUTS = ord("I")
    DATA = ord("U")
    PROTOCOL_VERSION = ord("V")
    CONTROLLER_VERSION = ord("v")


class RtdeFramingError(ValueError):
    """The byte stream has lost its package boundaries: it cannot be read any further."""


class MalformedReason(IntEnum):
    """Why one package was dropped; the next one can still be read."""

    UNKNOWN_TYPE = 1
    WRONG_LENGTH = 2
    UNKNOWN_RECIPE = 3
    NOT_TEXT = 4


@dataclass(frozen=True, slots=True)
class Recipe:
    """Variables of one data package, in order, with their types and the compiled layout.

    Raises:
        ValueError: a type that is not in the table, or lists of different lengths.
    """

    id: int
    names: tuple[str, ...]
    types: tuple[str, ...]
    layout: struct.Struct = field(init=False, repr=False, compare=False)
    _places: tuple[int | slice, ...] = field(init=False, repr=False, compare=False)
    _reals: tuple[tuple[str, int], ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if len(self.names) != len(self.types) or not self.names:
            raise ValueError(f"{len(self.names)} variables with {len(self.types)} types")
        layout = ">"
        places: list[int | slice] = []
        reals: list[tuple[str, int]] = []
        position = 0
        for name, type_name in zip(self.names, self.types, strict=True):
            try:
                code, count = TYPES[type_name]
            except KeyError:
                raise ValueError(f"variable {name} has the unknown type {type_name!r}") from None
            layout += f"{count}{code}"
            if code == "d":
                reals += [(name, position + i) for i in range(count)]
            places.append(position if count == 1 else slice(position, position + count))
            position += count
        object.__setattr__(self, "_reals", tuple(reals))
        object.__setattr__(self, "layout", struct.Struct(layout))
        object.__setattr__(self, "_places", tuple(places))

    def unpack(self, payload: bytes) -> tuple[Value, ...]:
        """Return one value per variable: a number, or a tuple of numbers for a vector."""
        return self.grouping(self.names)(self.layout.unpack(payload))

    def grouping(self, names: Sequence[str]) -> Callable[[Flat], tuple[Any, ...]]:
        """Return what makes of a package's numbers one value per name; None of one that is not in it."""
        places = dict(zip(self.names, self._places, strict=True))
        # The place behind the last is None, and one more makes a tuple of a single value, too.
        group = itemgetter(*(places.get(name, -1) for name in names), -1)
        return lambda flat: group((*flat, None))[:-1]

    def nonsense(self, flat: Flat) -> str:
        """Return the name of the first variable that is not finite, or impossibly large; empty if none is.

        Args:
            flat: the numbers of a package, as `layout` reads them.
        """
        # This is done with each package: the sum finds what is not finite, which comparisons do not.
        if min(flat) > -LARGEST_NUMBER and max(flat) < LARGEST_NUMBER and math.isfinite(sum(flat)):
            return ""
        return next(
            (name for name, place in self._reals if not abs(flat[place]) < LARGEST_NUMBER), ""
        )

    def pack(self, values: Sequence[Value]) -> bytes:
        """Return the payload for one value per variable.

        Raises:
            ValueError: wrong number of values or of items in a vector, or a value out of range.
        """
        flat: list[float] = []
        for value in values:
            flat.extend(value) if isinstance(value, tuple) else flat.append(value)
        try:
            return self.layout.pack(*flat)
        except struct.error as error:
            raise ValueError(f"values do not fit the recipe {self.names}: {error}") from None


class VersionReply(NamedTuple):
    """Answer to the request for a protocol version."""

    accepted: bool


class ControllerVersion(NamedTuple):
    """Version of the controller's software (URControl)."""

    major: int
    minor: int
    bugfix: int
    build: int

    @override
    def __str__(self) -> str:
        return f"{self.major}.{self.minor}.{self.bugfix}.{self.build}"


class SetupReply(NamedTuple):
    """Answer to a recipe: its id (0: refused; None in version 1) and a type for each name."""

    direction: PackageType
    recipe_id: int | None
    types: tuple[str, ...]


class StateReply(NamedTuple):
    """Answer to start or pause."""

    request: PackageType
    accepted: bool


class DataPackage(NamedTuple):
    """One package of process data; decode it with `values`, only if it is wanted."""

    recipe: Recipe
    payload: bytes

    def values(self) -> tuple[Value, ...]:
        """Return one value per variable of the recipe."""
        return self.recipe.unpack(self.payload)

    def flat(self) -> Flat:
        """Return the numbers one after the other."""
        return self.recipe.layout.unpack(self.payload)


class TextMessage(NamedTuple):
    """A message of the controller; level 0 exception, 1 error, 2 warning, 3 info."""

    level: int
    source: str
    message: str


class Malformed(NamedTuple):
    """A package that was dropped because it breaks the protocol."""

    reason: MalformedReason
    type: int
    payload: bytes


Message: TypeAlias = (
    VersionReply
    | ControllerVersion
    | SetupReply
    | StateReply
    | DataPackage
    | TextMessage
    | Malformed
)

_CONTROLLER_VERSION = struct.Struct(">IIII")


class RtdeDecoder:
    """Cuts the bytes from a controller into messages, however they were split.

    Attributes:
        protocol_version: set it to 2 when the controller has accepted version 2.
    """

    def __init__(self) -> None:
        self.protocol_version = 1
        self._buffer = b""
        self._lost = False
        self._recipes: dict[int, Recipe] = {}
        self._malformed: Counter[MalformedReason] = Counter()

    @property
    def malformed(self) -> Mapping[MalformedReason, int]:
        """How many packages were dropped, by reason."""
        return dict(self._malformed)

    def add_recipe(self, recipe: Recipe) -> None:
        """Decode data packages with the id of `recipe` by it; version 1 packages have the id 0."""
        self._recipes[recipe.id] = recipe

    def feed(self, data: bytes) -> list[Message]:
        """Return the messages that are complete with `data`.

        A package that breaks the protocol but not the framing is returned as `Malformed`.

        Raises:
            RtdeFramingError: a size that cannot be; then and for ever after.
        """
        if self._lost:
            raise RtdeFramingError("the stream was given up earlier; connect again")
        buffer = self._buffer + data if self._buffer else data
        messages: list[Message] = []
        start, end = 0, len(buffer)
        while end - start >= HEADER.size:
            size, type_byte = HEADER.unpack_from(buffer, start)
            if not HEADER.size <= size <= MAX_PACKAGE:
                self._lost = True
                self._buffer = b""
                raise RtdeFramingError(
                    f"a package of type {type_byte} claims {size} bytes; "
                    f"between {HEADER.size} and {MAX_PACKAGE} are possible"
                )
            if end - start < size:
                break
            messages.append(self._decode(type_byte, buffer[start + HEADER.size : start + size]))
            start += size
        self._buffer = buffer[start:]
        return messages

    def _decode(self, type_byte: int, payload: bytes) -> Message:
        if type_byte == PackageType.DATA:
            return self._data(payload)
        try:
            kind = PackageType(type_byte)
        except ValueError:
            return self._drop(MalformedReason.UNKNOWN_TYPE, type_byte, payload)
        try:
            return _REPLIES[kind](kind, payload, self.protocol_version)
        except UnicodeDecodeError:
            return self._drop(MalformedReason.NOT_TEXT, type_byte, payload)
        except (struct.error, IndexError):
            return self._drop(MalformedReason.WRONG_LENGTH, type_byte, payload)

    def _data(self, payload: bytes) -> Message:
        if self.protocol_version == 1:
            recipe_id, body = 0, payload
        elif payload:
            recipe_id, body = payload[0], payload[1:]
        else:
            return self._drop(MalformedReason.WRONG_LENGTH, PackageType.DATA, payload)
        recipe = self._recipes.get(recipe_id)
        if recipe is None:
            return self._drop(MalformedReason.UNKNOWN_RECIPE, PackageType.DATA, payload)
        if len(body) != recipe.layout.size:
            return self._drop(MalformedReason.WRONG_LENGTH, PackageType.DATA, payload)
        return DataPackage(recipe, body)

    def _drop(self, reason: MalformedReason, type_byte: int, payload: bytes) -> Malformed:
        self._malformed[reason] += 1
        return Malformed(reason, type_byte, payload)


def _version_reply(kind: PackageType, payload: bytes, version: int) -> Message:
    (accepted,) = struct.unpack(">?", payload)
    return VersionReply(accepted)


def _controller_version(kind: PackageType, payload: bytes, version: int) -> Message:
    return ControllerVersion(*_CONTROLLER_VERSION.unpack(payload))


def _setup_reply(kind: PackageType, payload: bytes, version: int) -> Message:
    if version == 1 and kind is PackageType.SETUP_OUTPUTS:
        return SetupReply(kind, None, _split(payload))
    return SetupReply(kind, payload[0], _split(payload[1:]))


def _state_reply(kind: PackageType, payload: bytes, version: int) -> Message:
    (accepted,) = struct.unpack(">?", payload)
    return StateReply(kind, accepted)


def _text_message(kind: PackageType, payload: bytes, version: int) -> Message:
    if version == 1:
        return TextMessage(payload[0], "", payload[1:].decode())
    message, rest = _counted(payload)
    source, rest = _counted(rest)
    (level,) = struct.unpack(">B", rest)
    return TextMessage(level, source.decode(), message.decode())


def _counted(data: bytes) -> tuple[bytes, bytes]:
    end = 1 + data[0]
    if len(data) < end:
        raise IndexError("text is shorter than its length byte says")
    return data[1:end], data[end:]


def _split(names: bytes) -> tuple[str, ...]:
    return tuple(name.strip() for name in names.decode("ascii").split(",") if name.strip())


_REPLIES = {
    PackageType.PROTOCOL_VERSION: _version_reply,
    PackageType.CONTROLLER_VERSION: _controller_version,
    PackageType.SETUP_OUTPUTS: _setup_reply,
    PackageType.SETUP_INPUTS: _setup_reply,
    PackageType.START: _state_reply,
    PackageType.PAUSE: _state_reply,
    PackageType.TEXT_MESSAGE: _text_message,
}


def encode(kind: PackageType, payload: bytes = b"") -> bytes:
    """Return one package.

    Raises:
        ValueError: the payload is too long for a package.
    """
    size = HEADER.size + len(payload)
    if size > MAX_PACKAGE:
        raise ValueError(f"a package of {size} bytes is longer than {MAX_PACKAGE}")
    return HEADER.pack(size, kind) + payload


def encode_protocol_version(version: int) -> bytes:
    """Ask for protocol version 1 or 2."""
    return encode(PackageType.PROTOCOL_VERSION, struct.pack(">H", version))


def encode_controller_version() -> bytes:
    """Ask for the version of the controller's software."""
    return encode(PackageType.CONTROLLER_VERSION)


def encode_output_setup(names: Sequence[str], frequency: float, protocol_version: int) -> bytes:
    """Ask for `names` to be sent at `frequency` Hz (version 1 has the controller's own rate)."""
    rate = struct.pack(">d", frequency) if protocol_version > 1 else b""
    return encode(PackageType.SETUP_OUTPUTS, rate + ",".join(names).encode("ascii"))


def encode_input_setup(names: Sequence[str]) -> bytes:
    """Claim the input variables `names`."""
    return encode(PackageType.SETUP_INPUTS, ",".join(names).encode("ascii"))


def encode_start() -> bytes:
    """Ask the controller to start sending."""
    return encode(PackageType.START)


def encode_pause() -> bytes:
    """Ask the controller to stop sending."""
    return encode(PackageType.PAUSE)


def encode_data(recipe: Recipe, values: Sequence[Value]) -> bytes:
    """Return one package of input data.

    Raises:
        ValueError: the values do not fit the recipe.
    """
    return encode(PackageType.DATA, bytes((recipe.id,)) + recipe.pack(values))
