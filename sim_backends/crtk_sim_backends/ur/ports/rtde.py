"""RTDE server side, protocol versions 1 and 2: bytes in, bytes out, no sockets.

Source: UR "Real-Time Data Exchange (RTDE) Guide"; for properties see `hardware`. Every package is
``u16 size, u8 type, payload``, big endian, the size counting its own three bytes of header.
"""

from __future__ import annotations

import logging
import math
import struct
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Final

from crtk_sim_backends.ur.hardware import properties
from crtk_sim_backends.ur.signals.variables import INPUTS, OUTPUTS, TYPES, Variable
from crtk_sim_backends.ur.versions import Version

if TYPE_CHECKING:
    from crtk_sim_backends.ur.controller import Controller

log = logging.getLogger(__name__)

NOT_FOUND: Final = "NOT_FOUND"
IN_USE: Final = "IN_USE"

_HEADER: Final = struct.Struct(">HB")
_OUTPUT_RECIPE: Final = 1
_LAST_INPUT_RECIPE: Final = 255
_LARGEST_PACKAGE: Final = 0xFFFF

Image = Mapping[str, Any]


class Package(IntEnum):
    """Package types."""

    REQUEST_PROTOCOL_VERSION = 86
    GET_URCONTROL_VERSION = 118
    TEXT_MESSAGE = 77
    DATA_PACKAGE = 85
    CONTROL_PACKAGE_SETUP_OUTPUTS = 79
    CONTROL_PACKAGE_SETUP_INPUTS = 73
    CONTROL_PACKAGE_START = 83
    CONTROL_PACKAGE_PAUSE = 80
    READ_PROPERTIES = 82


class TextLevel(IntEnum):
    """Levels of a text message."""

    EXCEPTION = 0
    ERROR = 1
    WARNING = 2
    INFO = 3


class RtdeError(ValueError):
    """The client's requests cannot be answered any more; the connection has to be closed."""


def encode(kind: Package, payload: bytes) -> bytes:
    """Put the header before a payload.

    Raises:
        RtdeError: when the package is longer than its size can tell.
    """
    size = _HEADER.size + len(payload)
    if size > _LARGEST_PACKAGE:
        raise RtdeError(f"the answer to its {kind.name} has {size} bytes, more than a package")
    return _HEADER.pack(size, kind) + payload


def _format(variables: list[Variable]) -> str:
    """How variables lie one behind the other, without the byte order."""
    return "".join(TYPES[variable.type].format for variable in variables)


def text_message(protocol: int, level: TextLevel, text: str) -> bytes:
    """Build a text message to a client."""
    if protocol == 1:
        return encode(Package.TEXT_MESSAGE, bytes([level]) + text.encode())
    parts = [part.encode()[:255] for part in (text, "RTDE")]
    body = b"".join(bytes([len(part)]) + part for part in parts)
    return encode(Package.TEXT_MESSAGE, body + bytes([level]))


class InputClaims:
    """Which session owns which input variable; a name has at most one owner.

    Args:
        reserved: what no session can have, because a fieldbus has it.
    """

    def __init__(self, reserved: Iterable[str] = ()) -> None:
        self._reserved = frozenset(reserved)
        self._owners: dict[str, RtdeSession] = {}

    def free_for(self, name: str, session: RtdeSession) -> bool:
        """Whether `session` may claim `name`."""
        return name not in self._reserved and self._owners.get(name, session) is session

    def claim(self, names: list[str], session: RtdeSession) -> None:
        """Give `names` to `session`."""
        self._owners.update(dict.fromkeys(names, session))

    def release(self, session: RtdeSession) -> None:
        """Free everything that `session` owns."""
        self._owners = {name: s for name, s in self._owners.items() if s is not session}


@dataclass(frozen=True, slots=True)
class TraceEntry:
    """One input package that was received."""

    number: int
    time_ns: int  # monotonic clock, when its bytes were read
    connection: int
    recipe: int
    values: Mapping[str, Any]


class Trace:
    """The last input packages of all clients."""

    def __init__(self, size: int) -> None:
        self._entries: deque[TraceEntry] = deque(maxlen=size)
        self.count = 0

    def add(self, connection: int, recipe: int, values: Mapping[str, Any]) -> None:
        """Note a package received now."""
        self.count += 1
        self._entries.append(
            TraceEntry(self.count, time.monotonic_ns(), connection, recipe, values)
        )

    def after(self, number: int) -> list[TraceEntry]:
        """Entries numbered above `number`, oldest first."""
        return [entry for entry in self._entries if entry.number > number]


class OutputRecipe:
    """What one client wants to read: packs the process image in one call."""

    def __init__(self, variables: list[Variable], protocol: int) -> None:
        self._variables = variables
        self._lead = (_OUTPUT_RECIPE,) if protocol > 1 else ()
        body = struct.Struct(">" + "B" * len(self._lead) + _format(variables))
        self._pack_body = body.pack
        self._header = _HEADER.pack(_HEADER.size + body.size, Package.DATA_PACKAGE)
        # One expression that names every variable: several times faster than a loop at 500 Hz.
        # The names come from the table of variables, never from the client.
        arguments = ", ".join(
            f"*image[{v.name!r}]" if TYPES[v.type].count > 1 else f"image[{v.name!r}]"
            for v in variables
        )
        source = f"lambda image: pack(*lead, {arguments})"
        self._pack: Callable[[Image], bytes] = eval(
            source, {"pack": self._pack_body, "lead": self._lead}
        )
        self._reported: set[str] = set()

    def package(self, image: Image) -> bytes:
        """Build the data package for the present process image."""
        try:
            return self._header + self._pack(image)
        except struct.error:
            return self._header + self._pack_without_misfits(image)

    def _pack_without_misfits(self, image: Image) -> bytes:
        """Pack with zero in place of values that do not fit their type, and log these."""
        values: list[Any] = list(self._lead)
        for variable in self._variables:
            wire = TYPES[variable.type]
            items = image[variable.name] if wire.count > 1 else (image[variable.name],)
            try:
                struct.pack(">" + wire.format, *items)
            except struct.error as error:
                if variable.name not in self._reported:
                    self._reported.add(variable.name)
                    log.error("output %s holds %r: %s", variable.name, items, error)
                items = (wire.zero,) * wire.count
            values.extend(items)
        return self._pack_body(*values)


class InputRecipe:
    """What one client writes: unpacks a data package into values by name."""

    def __init__(self, variables: list[Variable]) -> None:
        self._struct = struct.Struct(">" + _format(variables))
        self.size = self._struct.size
        self.names = [variable.name for variable in variables]
        self._slices: list[tuple[str, int, int]] = []
        start = 0
        for variable in variables:
            count = TYPES[variable.type].count
            self._slices.append((variable.name, start, count))
            start += count
        self._scalars_only = start == len(variables)

    def unpack(self, data: bytes) -> dict[str, Any]:
        """Values by name; vectors are tuples."""
        values = self._struct.unpack(data)
        if self._scalars_only:
            return dict(zip(self.names, values, strict=True))
        return {
            name: values[start] if count == 1 else values[start : start + count]
            for name, start, count in self._slices
        }


class RtdeSession:
    """One RTDE client.

    Args:
        controller: process images, and where input packages go.
        version: controller software version, decides which variables exist.
        claims: owners of the input variables, shared by all sessions.
        trace: where received input packages are noted.
        number: number of the connection, for the trace.

    Attributes:
        started: whether its packages are sent.
        divider: control periods from one package to the next.
    """

    ended = False

    def __init__(
        self,
        controller: Controller,
        version: Version,
        claims: InputClaims,
        trace: Trace,
        number: int = 0,
    ) -> None:
        self._controller = controller
        self._version = version
        self._claims = claims
        self._trace = trace
        self._number = number
        self._buffer = bytearray()
        self._protocol = 1
        self._properties = properties(version)
        self._outputs: OutputRecipe | None = None
        self.divider = 1
        self._inputs: dict[int, InputRecipe] = {}
        self._complaint = ""  # about the package that is handled now
        self.started = False
        self.packages_in = 0
        self.packages_bad = 0

    def receive(self, data: bytes) -> bytes:
        """Take received bytes, act on the complete packages, and return the replies.

        Raises:
            RtdeError: when the stream cannot be RTDE.
        """
        self._buffer += data
        replies = bytearray()
        start = 0
        while len(self._buffer) - start >= _HEADER.size:
            size, kind = _HEADER.unpack_from(self._buffer, start)
            if size < _HEADER.size:
                raise RtdeError(f"package of {size} bytes, less than its header")
            if len(self._buffer) - start < size:
                break
            payload = bytes(self._buffer[start + _HEADER.size : start + size])
            start += size
            handler = self._HANDLERS.get(kind)
            if handler is None:
                self.packages_bad += 1
                continue
            reply = handler(self, payload)
            if reply is not None:
                replies += encode(Package(kind), reply)
            elif self._complaint:
                replies += text_message(self._protocol, TextLevel.ERROR, self._complaint)
                self._complaint = ""
        del self._buffer[:start]
        return bytes(replies)

    def package(self, tick: int) -> bytes | None:
        """Build the data package due at `tick`; None when none is."""
        if not self.started or self._outputs is None or tick % self.divider:
            return None
        controller = self._controller
        image = controller.outputs
        if controller.spoiled:
            image = {**image, **controller.spoil()}
        return self._outputs.package(image)

    def close(self) -> None:
        """Free the claimed inputs; their values persist."""
        self._claims.release(self)

    def _request_protocol_version(self, payload: bytes) -> bytes:
        accepted = len(payload) == 2 and payload[0] == 0 and payload[1] in (1, 2)
        if accepted:
            self._protocol = payload[1]
        return bytes([accepted])

    def _get_version(self, payload: bytes) -> bytes:
        return struct.pack(">4I", *self._version)

    def _setup_outputs(self, payload: bytes) -> bytes:
        top = round(1.0 / self._controller.dt)
        frequency = float(top)
        if self._protocol > 1:
            if len(payload) < 8:
                return b"\x00"
            (frequency,) = struct.unpack_from(">d", payload)
            payload = payload[8:]
        found, types = self._look_up(payload, OUTPUTS)
        valid = bool(found) and len(found) == len(types) and math.isfinite(frequency)
        valid &= _HEADER.size + 1 + struct.calcsize(">" + _format(found)) <= _LARGEST_PACKAGE
        if valid:
            self._outputs = OutputRecipe(found, self._protocol)
            self.divider = int(top / min(max(frequency, 1.0), top))
        lead = bytes([_OUTPUT_RECIPE if valid else 0]) if self._protocol > 1 else b""
        return lead + ",".join(types).encode()

    def _setup_inputs(self, payload: bytes) -> bytes:
        found, types = self._look_up(payload, INPUTS)
        for index, variable in enumerate(found if len(found) == len(types) else ()):
            if not self._claims.free_for(variable.name, self):
                types[index] = IN_USE
        number = len(self._inputs) + 1
        if not found or not {NOT_FOUND, IN_USE}.isdisjoint(types) or number > _LAST_INPUT_RECIPE:
            number = 0
        else:
            self._inputs[number] = recipe = InputRecipe(found)
            self._claims.claim(recipe.names, self)
        return bytes([number]) + ",".join(types).encode()

    def _read_properties(self, payload: bytes) -> bytes | None:
        if not self._properties:
            self.packages_bad += 1  # of a type that this software does not know
            return None
        names = payload.decode("ascii", "replace").split(",")
        found = [self._properties.get(name.strip(), (NOT_FOUND, 0)) for name in names]
        types = ",".join(wire for wire, _ in found).encode()
        if len(types) > _LARGEST_PACKAGE:
            raise RtdeError(f"asks for {len(names)} properties")
        values = b""
        if all(wire in TYPES for wire, _ in found):
            values = b"".join(struct.pack(">" + TYPES[wire].format, value) for wire, value in found)
        return struct.pack(">H", len(types)) + types + values

    def _look_up(
        self, names: bytes, table: Mapping[str, Variable]
    ) -> tuple[list[Variable], list[str]]:
        """Variables found, and a type or NOT_FOUND for each name of a comma-separated list."""
        found, types = [], []
        for name in names.decode("ascii", "replace").split(","):
            if not (name := name.strip()):
                continue
            variable = table.get(name)
            if variable is None or not variable.since.reached_by(self._version):
                types.append(NOT_FOUND)
            else:
                found.append(variable)
                types.append(variable.type)
        return found, types

    def _start(self, payload: bytes) -> bytes:
        self.started = self._outputs is not None
        return bytes([self.started])

    def _pause(self, payload: bytes) -> bytes:
        self.started = False
        return b"\x01"

    def _data(self, payload: bytes) -> None:
        recipe = self._inputs.get(payload[0]) if payload else None
        if recipe is None or len(payload) - 1 != recipe.size:
            self.packages_bad += 1
            if self.started:  # before that, clients take it for the reply to their request
                self._complaint = f"input package of {len(payload)} bytes fits no recipe"
            return
        self.packages_in += 1
        values = recipe.unpack(payload[1:])
        self._trace.add(self._number, payload[0], values)
        self._controller.write_inputs(values)

    def _text(self, payload: bytes) -> None:
        log.info("message of an RTDE client: %r", payload)

    _HANDLERS: Final[Mapping[int, Callable[[RtdeSession, bytes], bytes | None]]] = {
        Package.REQUEST_PROTOCOL_VERSION: _request_protocol_version,
        Package.GET_URCONTROL_VERSION: _get_version,
        Package.CONTROL_PACKAGE_SETUP_OUTPUTS: _setup_outputs,
        Package.CONTROL_PACKAGE_SETUP_INPUTS: _setup_inputs,
        Package.CONTROL_PACKAGE_START: _start,
        Package.CONTROL_PACKAGE_PAUSE: _pause,
        Package.DATA_PACKAGE: _data,
        Package.TEXT_MESSAGE: _text,
        Package.READ_PROPERTIES: _read_properties,
    }
