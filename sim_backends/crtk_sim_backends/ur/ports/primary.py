"""Packets of the primary (30001, 30011) and secondary (30002, 30012) ports.

Source: UR "Client Interface", the chapters for 3.15, 5.12 and 5.23; order and the parts that it does
not describe (9, 10) from a state that URSim 5.8 sent (Universal_Robots_Client_Library, test of the
primary parser). A packet is ``i32 size, u8 type, body``, big endian. Robot states (type 16) hold
sub-packages of the same shape; robot messages (type 20) begin with
``u64 timestamp (us), i8 source, i8 message type``.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import astuple, dataclass
from math import radians
from typing import Any, Final

from crtk_sim_backends.ur.hardware import CONTROL_BOX, TOOL_FLANGE, sends_hardware_info
from crtk_sim_backends.ur.messages import (
    ErrorMessage,
    KeyMessage,
    Message,
    PopupMessage,
    RuntimeExceptionMessage,
    SafetyModeMessage,
    TextMessage,
)
from crtk_sim_backends.ur.models import ALPHA, RobotModel
from crtk_sim_backends.ur.safety.modes import RobotMode, RobotStatus, RuntimeState, SafetyMode
from crtk_sim_backends.ur.signals.tool_line import LineSettings
from crtk_sim_backends.ur.versions import ALWAYS, E_SERIES, Since, Version

STATE_PERIOD: Final = 0.1  # s

ROBOT_STATE: Final = 16
ROBOT_MESSAGE: Final = 20

_SOURCE_INTERFACE: Final = -2
_SOURCE_CONTROLLER: Final = -3
_VERSION_MESSAGE: Final = 3
_HARDWARE_INFO_MESSAGE: Final = 18
_ZERO6: Final = (0.0,) * 6
_EMERGENCY_STOPS: Final = (SafetyMode.SYSTEM_EMERGENCY_STOP, SafetyMode.ROBOT_EMERGENCY_STOP)

Image = Mapping[str, Any]


def _frame(kind: int, body: bytes) -> bytes:
    return struct.pack(">IB", 5 + len(body), kind) + body


def _message(source: int, kind: int, time: float, body: bytes) -> bytes:
    return _frame(ROBOT_MESSAGE, struct.pack(">Qbb", int(time * 1e6), source, kind) + body)


def _short(text: str) -> bytes:
    """Text behind its length in one byte; what is longer is cut."""
    data = text.encode(errors="replace")[:255]
    return bytes([len(data)]) + data


# Robot messages.


def version_message(version: Version, time: float) -> bytes:
    """Build the version message, the first thing a client gets."""
    major, minor, bugfix, build = version
    numbers = struct.pack(">BBii", major, minor, bugfix, build)
    body = _short("URControl") + numbers + b"01-01-2025, 00:00:00"
    return _message(_SOURCE_INTERFACE, _VERSION_MESSAGE, time, body)


def hardware_info_message(model: RobotModel, version: Version, time: float) -> bytes:
    """Build the message about the hardware, sent once; empty for software that does not send it.

    Source: Universal_Robots_Client_Library, `hardware_info_message.h`. It does not tell who the
    source of the message is, nor what is in its two reserved fields: here they are zero.
    """
    if not sends_hardware_info(version):
        return b""
    body = struct.pack(">i4H", model.robot_type, 0, CONTROL_BOX, 0, TOOL_FLANGE)
    return _message(_SOURCE_INTERFACE, _HARDWARE_INFO_MESSAGE, time, body)


def robot_message(message: Message, time: float) -> bytes:
    """Encode one message of the controller."""
    match message:
        case TextMessage(text):
            return _message(_SOURCE_CONTROLLER, 0, time, text.encode(errors="replace"))
        case PopupMessage(title, text, warning, error, blocking):
            head = struct.pack(">IB???", 0, 0, warning, error, blocking)
            return _message(
                _SOURCE_CONTROLLER, 2, time, head + _short(title) + text.encode(errors="replace")
            )
        case SafetyModeMessage(mode):
            return _message(_SOURCE_CONTROLLER, 5, time, struct.pack(">iiBII", 0, 0, mode, 0, 0))
        case ErrorMessage(code, argument, level, text):
            head = struct.pack(">iiiII", code, argument, level, 0, 0)
            return _message(_SOURCE_CONTROLLER, 6, time, head + text.encode(errors="replace"))
        case KeyMessage(title, text):
            head = struct.pack(">ii", 0, 0)
            return _message(
                _SOURCE_INTERFACE, 7, time, head + _short(title) + text.encode(errors="replace")
            )
        case RuntimeExceptionMessage(line, column, text):
            head = struct.pack(">ii", line, column)
            return _message(_SOURCE_CONTROLLER, 10, time, head + text.encode(errors="replace"))


def encode_messages(messages: Iterable[Message], time: float) -> bytes:
    """Encode messages one after the other."""
    return b"".join(robot_message(message, time) for message in messages)


# Robot states.


@dataclass(frozen=True)
class _Source:
    """What a robot state tells about."""

    model: RobotModel
    image: Image
    safety_checksum: int
    manual: bool
    line: LineSettings


@dataclass(frozen=True)
class _Piece:
    """Some fields at the end of a sub-package, and the first software that has them."""

    since: Since
    format: str
    values: Callable[[_Source], Iterable[Any]]


def _robot_mode(source: _Source) -> tuple[Any, ...]:
    image = source.image
    mode, safety = image["robot_mode"], image["safety_mode"]
    return (
        int(image["timestamp"] * 1e6),
        True,  # real robot connected
        True,  # and enabled
        mode >= RobotMode.POWER_ON,
        safety in _EMERGENCY_STOPS,
        safety == SafetyMode.PROTECTIVE_STOP,
        bool(image["robot_status_bits"] & RobotStatus.PROGRAM_RUNNING),
        image["runtime_state"] == RuntimeState.PAUSED,
        mode,
        0,  # position control
        image["target_speed_fraction"],
        image["speed_scaling"],
    )


_JOINT_COLUMNS: Final = (
    "actual_q",
    "target_q",
    "actual_qd",
    "actual_current",
    "actual_joint_voltage",
    "joint_temperatures",
)


def _joints(source: _Source) -> list[Any]:
    columns = [source.image[name] for name in _JOINT_COLUMNS]
    rows = zip(*columns, source.image["joint_mode"], strict=True)
    return [value for row in rows for value in (*row[:6], 0.0, row[6])]


def _masterboard(source: _Source) -> tuple[Any, ...]:
    image = source.image
    analog_types, safety = image["analog_io_types"], image["safety_mode"]
    return (
        image["actual_digital_input_bits"] & 0xFFFFFFFF,
        image["actual_digital_output_bits"] & 0xFFFFFFFF,
        analog_types & 1,
        analog_types >> 1 & 1,
        image["standard_analog_input0"],
        image["standard_analog_input1"],
        analog_types >> 2 & 1,
        analog_types >> 3 & 1,
        image["standard_analog_output0"],
        image["standard_analog_output1"],
        24.0,  # temperature of the board, degC
        image["actual_main_voltage"],
        image["actual_robot_current"],
        image["io_current"],
        safety,
        safety == SafetyMode.REDUCED,
        0,  # no Euromap 67
    )


def _tool(source: _Source) -> tuple[Any, ...]:
    image = source.image
    types = image["tool_analog_input_types"]
    return (
        types & 1,
        types >> 1 & 1,
        image["tool_analog_input0"],
        image["tool_analog_input1"],
        image["actual_main_voltage"],
        image["tool_output_voltage"],
        image["tool_output_current"],
        image["tool_temperature"],
        image["tool_mode"],
    )


def _kinematics(source: _Source) -> tuple[Any, ...]:
    model, own = source.model, source.model.calibration
    if own is None:
        return (*(0xFFFFFFFF,) * 6, *_ZERO6, *model.a, *model.d, *ALPHA, 0)
    return (*own.checksum, *own.theta, *own.a, *own.d, *own.alpha, 0)


def _configuration(source: _Source) -> tuple[Any, ...]:
    model = source.model
    limit = model.safe_position
    limits = (-limit, limit) * 6
    speeds = [value for speed in model.velocity for value in (speed + 0.2, model.acceleration)]
    # Joint speed and acceleration, tool speed and acceleration, equivalent radius.
    defaults = (radians(60.0), radians(80.0), 0.25, 1.2, 0.25)
    boards = (2, 2, model.robot_type, 1) if model.is_cb3 else (6, 4, model.robot_type, 3)
    return (*limits, *speeds, *defaults, *model.a, *model.d, *ALPHA, *_ZERO6, *boards)


_DEXTERITY: Final = 1.0
_NO_LINE: Final = LineSettings()

_TOOL_MODES: Final = (
    "tool_output_mode",
    "tool_digital_output0_mode",
    "tool_digital_output1_mode",
)

_PARTS: Final[tuple[tuple[int, tuple[_Piece, ...]], ...]] = (
    (
        0,
        (
            _Piece(ALWAYS, "Q7?bBdd", _robot_mode),
            _Piece(Since((3, 2)), "d", lambda s: (1.0,)),  # limit of the speed fraction
            _Piece(Since((3, 5)), "B", lambda s: (0,)),
        ),
    ),
    (1, (_Piece(ALWAYS, "3d4fB" * 6, _joints),)),
    (
        4,
        (
            _Piece(ALWAYS, "6d", lambda s: s.image["actual_TCP_pose"]),
            _Piece(Since((3, 2)), "6d", lambda s: s.image["tcp_offset"]),
        ),
    ),
    (5, (_Piece(ALWAYS, "6I24dI", _kinematics),)),
    (9, (_Piece(ALWAYS, "6d", lambda s: _ZERO6),)),  # for calibration, internal
    (
        3,
        (
            _Piece(ALWAYS, "2I2b2d2b2d4f3B", _masterboard),
            _Piece(Since((3, 2)), "I", lambda s: (s.safety_checksum,)),
            # Selector of the operational mode, three-position enabling device.
            _Piece(Since((3, 5)), "2B", lambda s: (not s.manual, 1)),
            _Piece(Since((3, 10), (5, 4)), "B", lambda s: (1,)),
        ),
    ),
    (2, (_Piece(ALWAYS, "2b2dfB2fB", _tool),)),
    (6, (_Piece(ALWAYS, "53d4i", _configuration),)),
    (7, (_Piece(Since((3, 2)), "7d", lambda s: (*s.image["actual_TCP_force"], _DEXTERITY)),)),
    (
        8,
        (
            _Piece(
                Since((3, 2)), "2?", lambda s: (False, True)
            ),  # freedrive button: pressed, enabled
            _Piece(Since((3, 10)), "?", lambda s: (False,)),  # freedrive by an input
            _Piece(E_SERIES, "B", lambda s: (1,)),
        ),
    ),
    (  # safety configuration and the sphere around the elbow, internal
        10,
        (
            _Piece(
                Since((3, 5)),
                "I2B4d",
                lambda s: (s.safety_checksum, 1, 1, *s.image["elbow_position"], 0.13),
            ),
        ),
    ),
    (11, (_Piece(E_SERIES, "?3I2f", lambda s: astuple(s.line)),)),
    (12, (_Piece(Since(None, (5, 2)), "3B", lambda s: [s.image[name] for name in _TOOL_MODES]),)),
    (13, (_Piece(Since(None, (5, 10)), "2B", lambda s: (0, 0)),)),  # singularity: severity, type
)
"""The sub-packages of a robot state, in the order in which they are sent."""


class RobotStateEncoder:
    """Builds the robot state packet of one arm and software version."""

    def __init__(self, model: RobotModel, version: Version) -> None:
        self._model = model
        self._safety_checksum = zlib.crc32(model.name.encode())
        self._parts: list[tuple[int, struct.Struct, list[Callable[[_Source], Iterable[Any]]]]] = []
        for number, pieces in _PARTS:
            present = [piece for piece in pieces if piece.since.reached_by(version)]
            if present:
                body = struct.Struct(">" + "".join(piece.format for piece in present))
                self._parts.append((number, body, [piece.values for piece in present]))

    def packet(self, image: Image, manual: bool = False, line: LineSettings = _NO_LINE) -> bytes:
        """Build the packet with all sub-packages.

        Args:
            image: process image by RTDE variable name.
            manual: whether the robot is in manual mode.
            line: settings of the serial line to the tool.
        """
        source = _Source(self._model, image, self._safety_checksum, manual, line)
        return _frame(
            ROBOT_STATE,
            b"".join(
                _frame(number, body.pack(*[x for values in pieces for x in values(source)]))
                for number, body, pieces in self._parts
            ),
        )
