"""What the driver and its control process say to each other: values in, bytes out, and back.

The two sit at the ends of a SOCK_SEQPACKET socket pair, so one frame is one packet. Motion commands and
heartbeats are fixed structures, because they are sent hundreds of times a second; requests, replies
and events are JSON. Both ends are the same program on the same machine: the byte order is native.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import IntEnum, StrEnum
from typing import Any, NamedTuple, TypeAlias

from crtk_driver_ur.control_requests import CallError, Reply, Request

MAX_FRAME = 32768
"""Longest frame in bytes."""


class FrameError(ValueError):
    """Bytes that are no frame, or a frame with values that no command may have."""


class MotionKind(IntEnum):
    """What the arm is told to do, or is doing; NONE is at rest under the control program."""

    NONE = 0
    SERVO_JOINT = 1
    SPEED_JOINT = 2
    SPEED_CARTESIAN = 3
    MOVE_JOINT = 4
    MOVE_LINEAR = 5
    STOP = 6
    FREEDRIVE = 7
    TEACH_MODE = 8


class MotionCommand(NamedTuple):
    """One motion command.

    | kind            | values                      | first                | second               |
    |-----------------|-----------------------------|----------------------|----------------------|
    | SERVO_JOINT     | joint angles, rad           | –                    | –                    |
    | SPEED_JOINT     | joint speeds, rad/s         | acceleration, rad/s² | valid for, s         |
    | SPEED_CARTESIAN | twist in base axes, m/s     | acceleration, m/s²   | valid for, s         |
    | MOVE_JOINT      | joint angles, rad           | speed, rad/s         | acceleration, rad/s² |
    | MOVE_LINEAR     | pose: m, rotation vector    | speed, m/s           | acceleration, m/s²   |
    | STOP            | –                           | –                    | –                    |
    | FREEDRIVE       | –                           | –                    | –                    |
    | TEACH_MODE      | –                           | –                    | –                    |
    """

    sequence: int
    kind: MotionKind
    values: tuple[float, ...] = (0.0,) * 6
    first: float = 0.0
    second: float = 0.0


class Alive(NamedTuple):
    """The driver lives; sent when there is nothing else to say."""


class Heartbeat(NamedTuple):
    """The state of the control process, sent at least ten times a second unless it is in a call."""

    sequence: int
    """Of the motion command in force."""
    motion: MotionKind
    connected: bool
    """The control interface is up."""
    program_running: bool
    """The control program runs on the controller, so the arm obeys."""
    settling: bool
    """The motion is being brought to rest before the next one."""
    progress: int
    """Of a move: the library's progress number."""
    longest_call: float
    """Longest library call since the previous heartbeat, in seconds."""


class Calling(NamedTuple):
    """A library call that may block begins; silence for `allowed` seconds is no sign of death."""

    call: str
    allowed: float


class EventKind(StrEnum):
    """What can happen without having been asked for.

    INTERRUPTED: a move ended before its goal, or a command was replaced before it began.
    STOPPED: the arm stands after a stop, or after a speed that expired.
    """

    MOVE_DONE = "move_done"
    STOPPED = "stopped"
    INTERRUPTED = "interrupted"
    MOTION_FAILED = "motion_failed"
    SPEED_EXPIRED = "speed_expired"
    DRIVER_SILENT = "driver_silent"
    PROGRAM_STOPPED = "program_stopped"
    CONNECTION_LOST = "connection_lost"
    BAD_FRAME = "bad_frame"
    PROCESS_DIED = "process_died"


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened; `sequence` is that of the motion command it concerns, or 0."""

    kind: EventKind
    sequence: int = 0
    error: CallError = field(default_factory=lambda: CallError("", ""))


Frame: TypeAlias = MotionCommand | Alive | Request | Heartbeat | Calling | Reply | Event


class _Tag(IntEnum):
    MOTION = 1
    ALIVE = 2
    REQUEST = 3
    HEARTBEAT = 4
    CALLING = 5
    REPLY = 6
    EVENT = 7


_MOTION = struct.Struct("=BBI8d")
_HEARTBEAT = struct.Struct("=BBIBid")
_CONNECTED, _PROGRAM_RUNNING, _SETTLING = 1, 2, 4
_TEXT_TAGS = {Request: _Tag.REQUEST, Calling: _Tag.CALLING, Reply: _Tag.REPLY, Event: _Tag.EVENT}


def encode(frame: Frame) -> bytes:
    """Return the packet for one frame.

    Raises:
        FrameError: a motion command without six values, or a frame that is too long.
    """
    if isinstance(frame, MotionCommand):
        try:
            return _MOTION.pack(
                _Tag.MOTION, frame.kind, frame.sequence, *frame.values, frame.first, frame.second
            )
        except struct.error as error:
            raise FrameError(f"{frame.kind.name}: {error}") from None
    if isinstance(frame, Heartbeat):
        flags = (
            _CONNECTED * frame.connected
            | _PROGRAM_RUNNING * frame.program_running
            | _SETTLING * frame.settling
        )
        return _HEARTBEAT.pack(
            _Tag.HEARTBEAT,
            frame.motion,
            frame.sequence,
            flags,
            frame.progress,
            frame.longest_call,
        )
    if isinstance(frame, Alive):
        return bytes((_Tag.ALIVE,))
    content = frame._asdict() if isinstance(frame, Request | Calling) else asdict(frame)
    data = bytes((_TEXT_TAGS[type(frame)],)) + json.dumps(content).encode()
    if len(data) > MAX_FRAME:
        raise FrameError(f"a frame of {len(data)} bytes is longer than {MAX_FRAME}")
    return data


def decode(data: bytes) -> Frame:
    """Return the frame of one packet.

    Raises:
        FrameError: not a frame, or a motion command with a value that is not finite.
    """
    try:
        return _DECODERS[_Tag(data[0])](data)
    except FrameError:
        raise
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, struct.error) as error:
        raise FrameError(f"no frame: {data[:40]!r} ({error})") from error


def _motion(data: bytes) -> MotionCommand:
    _, kind, sequence, *numbers = _MOTION.unpack(data)
    if not all(map(math.isfinite, numbers)):
        raise FrameError(f"{MotionKind(kind).name} with a value that is not finite: {numbers}")
    first, second = numbers[6:]
    return MotionCommand(sequence, MotionKind(kind), tuple(numbers[:6]), first, second)


def _heartbeat(data: bytes) -> Heartbeat:
    _, motion, sequence, flags, progress, longest = _HEARTBEAT.unpack(data)
    return Heartbeat(
        sequence,
        MotionKind(motion),
        bool(flags & _CONNECTED),
        bool(flags & _PROGRAM_RUNNING),
        bool(flags & _SETTLING),
        progress,
        longest,
    )


def _alive(data: bytes) -> Alive:
    return Alive()


def _request(data: bytes) -> Request:
    content = _content(data, {"sequence": int, "name": str, "arguments": dict})
    return Request(**content)


def _calling(data: bytes) -> Calling:
    content = json.loads(data[1:])
    return Calling(str(content["call"]), float(content["allowed"]))


def _reply(data: bytes) -> Reply:
    content = json.loads(data[1:])
    error = content.pop("error")
    return Reply(**content, error=None if error is None else CallError(**error))


def _event(data: bytes) -> Event:
    content = json.loads(data[1:])
    return Event(
        EventKind(content["kind"]), int(content["sequence"]), CallError(**content["error"])
    )


def _content(data: bytes, kinds: Mapping[str, type]) -> dict[str, Any]:
    content = json.loads(data[1:])
    for name, kind in kinds.items():
        if not isinstance(content[name], kind):
            raise FrameError(f"{name} is {content[name]!r}, not {kind.__name__}")
    return {name: content[name] for name in kinds}


_DECODERS: Mapping[_Tag, Callable[[bytes], Frame]] = {
    _Tag.MOTION: _motion,
    _Tag.ALIVE: _alive,
    _Tag.REQUEST: _request,
    _Tag.HEARTBEAT: _heartbeat,
    _Tag.CALLING: _calling,
    _Tag.REPLY: _reply,
    _Tag.EVENT: _event,
}


def six(values: Sequence[float]) -> tuple[float, ...]:
    """Return `values` as six plain floats.

    Raises:
        FrameError: not six, or one of them not finite.
    """
    numbers = tuple(map(float, values))
    if len(numbers) != 6 or not all(map(math.isfinite, numbers)):
        raise FrameError(f"six finite numbers are needed, not {list(values)}")
    return numbers
