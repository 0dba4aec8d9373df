"""What the primary interface tells: of an arm once, its software, type and calibration; of programs always.

A packet is ``i32 size | u8 type | body``, big endian. A robot state (type 16) is a row of sub-packages
``u32 size | u8 type | body``; a robot message (type 20) begins with ``u64 time | i8 source | i8 type``.

Source: UR Client Interface, "RobotState" and "RobotMessage"; the same numbers are in
Universal_Robots_Client_Library (`primary/robot_state`).
"""

from __future__ import annotations

import math
import socket
import struct
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from crtk_driver_ur.calibration import Calibration
from crtk_drivers.errors import ConnectionFailed, ProtocolError
from crtk_drivers.kit import BadData, FrameDecoder

__all__ = [
    "PORTS",
    "MessageReader",
    "PacketReader",
    "PrimaryError",
    "RobotInfo",
    "read_robot_info",
]

PORTS: Final = (30011, 30001)
"""The read-only port, which is open in local control too; and the other, where that is missing."""

MAX_PACKET: Final = 1 << 20

_HEADER: Final = struct.Struct(">iB")
_STATE, _MESSAGE = 16, 20
_KINEMATICS, _CONFIGURATION = 5, 6
_VERSION: Final = 3
_ERROR, _EXCEPTION = 6, 10
_MESSAGE_HEAD: Final = struct.Struct(">Qbb")
_ERROR_HEAD: Final = struct.Struct(">iiiII")
_EXCEPTION_HEAD: Final = struct.Struct(">ii")
_WARNING: Final = 2
_DH: Final = struct.Struct(">6I24d")
_LIMITS: Final = struct.Struct(">24d")
_ROBOT_TYPE: Final = struct.Struct(">4i")
_ROBOT_TYPE_AT: Final = (12 + 12 + 5 + 24) * 8
"""Behind the limits, speeds, defaults and lengths of the configuration."""


class PrimaryError(BadData):
    """Bytes that are no packets of the primary interface."""


@dataclass(frozen=True, slots=True)
class RobotInfo:
    """What was told so far; None what was not."""

    version: str | None = None
    calibration: Calibration | None = None
    robot_type: int | None = None
    limits: JointLimits | None = None


@dataclass(frozen=True, slots=True)
class JointLimits:
    """Of the safety configuration: range, rad, and speed, rad/s, of each joint."""

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    speed: tuple[float, ...]


def _packets() -> FrameDecoder[tuple[int, bytes]]:
    """Return a decoder of packets into their types and bodies."""
    return FrameDecoder(_packet_size, lambda packet: (packet[4], packet[_HEADER.size :]))


def _packet_size(data: bytes) -> int:
    if len(data) < _HEADER.size:
        return 0
    size: int = _HEADER.unpack_from(data)[0]
    if not _HEADER.size <= size <= MAX_PACKET:
        raise PrimaryError(f"a packet claims {size} bytes")
    return size


class PacketReader:
    """Bytes in, and what `RobotInfo` has of them out."""

    def __init__(self) -> None:
        self._packets = _packets()
        self._version: str | None = None
        self._calibration: Calibration | None = None
        self._robot_type: int | None = None
        self._limits: JointLimits | None = None

    @property
    def info(self) -> RobotInfo:
        """What was told so far."""
        return RobotInfo(self._version, self._calibration, self._robot_type, self._limits)

    @property
    def complete(self) -> bool:
        """Whether everything was told."""
        return None not in (self._version, self._calibration, self._robot_type)

    def feed(self, data: bytes) -> None:
        """Take bytes.

        Raises:
            PrimaryError: they are no packets.
        """
        try:
            for kind, body in self._packets.feed(data):
                self._take(kind, body)
        except (struct.error, IndexError) as error:
            raise PrimaryError(f"a packet is too short: {error}") from error

    def _take(self, kind: int, body: bytes) -> None:
        if kind == _STATE:
            for part, content in _subpackages(body):
                if part == _KINEMATICS:
                    self._calibration = _calibration(content)
                elif part == _CONFIGURATION:
                    self._limits = _limits(content)
                    self._robot_type = _ROBOT_TYPE.unpack_from(content, _ROBOT_TYPE_AT)[2]
        elif kind == _MESSAGE and body[9] == _VERSION:
            self._version = _version(body[10:])


class MessageReader:
    """Bytes in, and what a program did wrong out, in words."""

    def __init__(self) -> None:
        self._packets = _packets()

    def feed(self, data: bytes) -> list[str]:
        """Return the runtime exceptions, and the entries of the log that are warnings or worse.

        Raises:
            PrimaryError: they are no packets.
        """
        try:
            found = [
                _complaint(body) for kind, body in self._packets.feed(data) if kind == _MESSAGE
            ]
        except struct.error as error:
            raise PrimaryError(f"a packet is too short: {error}") from error
        return [text for text in found if text]


def _complaint(body: bytes) -> str:
    """Return what a message complains about; empty if it does not."""
    _, _, kind = _MESSAGE_HEAD.unpack_from(body)
    content = body[_MESSAGE_HEAD.size :]
    if kind == _EXCEPTION:
        line, column = _EXCEPTION_HEAD.unpack_from(content)
        return f"{_text(content[_EXCEPTION_HEAD.size :])} (line {line}, column {column})"
    if kind == _ERROR:
        code, argument, level, _, _ = _ERROR_HEAD.unpack_from(content)
        if level >= _WARNING:
            return f"C{code}A{argument} {_text(content[_ERROR_HEAD.size :])}".strip()
    return ""


def _text(data: bytes) -> str:
    return data.decode("utf-8", "replace").strip("\0 ")


def _subpackages(body: bytes) -> Iterator[tuple[int, bytes]]:
    while body:
        size, kind = _HEADER.unpack_from(body)
        if not _HEADER.size <= size <= len(body):
            raise PrimaryError(f"a part of {size} bytes in {len(body)}")
        yield kind, body[_HEADER.size : size]
        body = body[size:]


def _calibration(content: bytes) -> Calibration:
    values = _DH.unpack_from(content)
    lengths: Sequence[float] = values[6:]
    if not all(map(math.isfinite, lengths)):
        raise PrimaryError("a calibration that is not finite")
    theta, a, d, alpha = (tuple(lengths[i : i + 6]) for i in (0, 6, 12, 18))
    found = {"checksum": values[:6], "theta": theta, "a": a, "d": d, "alpha": alpha}
    return Calibration.model_validate(found)


def _limits(content: bytes) -> JointLimits:
    """Return range and speed of the joints: six pairs of least and largest, six of speed and acceleration."""
    values = _LIMITS.unpack_from(content)
    if not all(map(math.isfinite, values)):
        raise PrimaryError("limits of joints that are not finite")
    return JointLimits(values[0:12:2], values[1:12:2], values[12:24:2])


def _version(content: bytes) -> str:
    name_end = 1 + content[0]
    major, minor, bugfix, build = struct.unpack_from(">BBii", content, name_end)
    return f"{major}.{minor}.{bugfix}.{build}"


def read_robot_info(host: str, deadline: float, ports: Sequence[int] = PORTS) -> RobotInfo:
    """Connect, and return what the controller tells of itself; on the first port that is open.

    Args:
        host: address or name of the controller.
        deadline: on the monotonic clock.
        ports: to be tried in this order.

    Raises:
        ConnectionFailed: unreachable, or it does not tell everything in time.
        ProtocolError: what it sends is not the primary interface.
    """
    where = f"primary interface {host}"
    reader = PacketReader()
    try:
        with _connected(host, ports, deadline) as peer:
            while not reader.complete:
                peer.settimeout(max(0.001, deadline - time.monotonic()))
                data = peer.recv(65536)
                if not data:
                    raise ConnectionResetError("it closed the connection")
                reader.feed(data)
                if time.monotonic() > deadline and not reader.complete:
                    raise TimeoutError("it does not tell everything in time")
    except OSError as error:
        raise ConnectionFailed(
            f"cannot be read: {error}",
            where=where,
            remedy="Check the address, and that the controller has finished starting; PolyScope 5 "
            "can switch the interface off under Settings, Security, Services.",
        ) from error
    except PrimaryError as error:
        raise ProtocolError(
            str(error), where=where, remedy="Check that this is a UR controller."
        ) from error
    return reader.info


def _connected(host: str, ports: Sequence[int], deadline: float) -> socket.socket:
    problem: OSError = ConnectionRefusedError("no port")
    for left, port in zip(range(len(ports), 0, -1), ports, strict=True):
        share = (deadline - time.monotonic()) / left  # a firewall may keep the first from answering
        try:
            return socket.create_connection((host, port), max(0.001, share))
        except OSError as error:
            problem = error
    raise problem
