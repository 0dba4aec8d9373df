"""Packets of the primary (30001, 30011) and secondary (30002, 30012) ports.

Source: UR "Client Interface". A packet is ``i32 size, u8 type, body``, big endian. Robot states
(type 16) hold sub-packages of the same shape; robot messages (type 20) begin with
``u64 timestamp (us), i8 source, i8 message type``.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from math import pi
from typing import Any, Final

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
from crtk_sim_backends.ur.safety import RobotMode, RuntimeState, SafetyMode
from crtk_sim_backends.ur.variables import Version

STATE_PERIOD: Final = 0.1  # s

ROBOT_STATE: Final = 16
ROBOT_MESSAGE: Final = 20

_SOURCE_VERSION: Final = -2
_SOURCE_CONTROLLER: Final = -3
_VERSION_MESSAGE: Final = 3
_ANGLE: Final = 2 * pi
_EMERGENCY_STOPS: Final = (SafetyMode.SYSTEM_EMERGENCY_STOP, SafetyMode.ROBOT_EMERGENCY_STOP)


def _frame(kind: int, body: bytes) -> bytes:
    return struct.pack(">IB", 5 + len(body), kind) + body


def _message(source: int, kind: int, time: float, body: bytes) -> bytes:
    return _frame(ROBOT_MESSAGE, struct.pack(">Qbb", int(time * 1e6), source, kind) + body)


def _short(text: str) -> bytes:
    """Text behind its length in one byte; what is longer is cut."""
    data = text.encode()[:255]
    return bytes([len(data)]) + data


def version_message(version: Version, time: float) -> bytes:
    """Build the version message, the first thing a client gets."""
    major, minor, bugfix, build = version
    numbers = struct.pack(">BBii", major, minor, bugfix, build)
    body = _short("URControl") + numbers + b"01-01-2025, 00:00:00"
    return _message(_SOURCE_VERSION, _VERSION_MESSAGE, time, body)


def robot_message(message: Message, time: float) -> bytes:
    """Encode one message of the controller."""
    match message:
        case TextMessage(text):
            return _message(_SOURCE_CONTROLLER, 0, time, text.encode())
        case PopupMessage(title, text, warning, error):
            head = struct.pack(">IB???", 0, 0, warning, error, False)
            return _message(_SOURCE_CONTROLLER, 2, time, head + _short(title) + text.encode())
        case SafetyModeMessage(mode):
            return _message(_SOURCE_CONTROLLER, 5, time, struct.pack(">iiBII", 0, 0, mode, 0, 0))
        case ErrorMessage(code, argument, level, text):
            head = struct.pack(">iiiII", code, argument, level, 0, 0)
            return _message(_SOURCE_CONTROLLER, 6, time, head + text.encode())
        case KeyMessage(title, text):
            head = struct.pack(">ii", 0, 0)
            return _message(_SOURCE_CONTROLLER, 7, time, head + _short(title) + text.encode())
        case RuntimeExceptionMessage(line, column, text):
            head = struct.pack(">ii", line, column)
            return _message(_SOURCE_CONTROLLER, 10, time, head + text.encode())


class RobotStateEncoder:
    """Builds the robot state packet of one arm and software version."""

    def __init__(self, model: RobotModel, version: Version) -> None:
        dh = struct.pack(">24d", *_ZERO6, *model.a, *model.d, *ALPHA)
        self._kinematics = _frame(5, struct.pack(">6I", *(1,) * 6) + dh + struct.pack(">I", 0))
        self._configuration = _frame(6, _configuration(model, version))
        self._newest = version[:2] >= (5, 4)

    def packet(self, outputs: Mapping[str, Any]) -> bytes:
        """Build the packet with all sub-packages.

        Args:
            outputs: process image by RTDE variable name.
        """
        subpackages = (
            _frame(0, _robot_mode(outputs)),
            _frame(1, _joints(outputs)),
            _frame(2, _tool(outputs)),
            _frame(3, self._masterboard(outputs)),
            _frame(4, struct.pack(">12d", *outputs["actual_TCP_pose"], *outputs["tcp_offset"])),
            self._kinematics,
            self._configuration,
            _frame(7, struct.pack(">7d", *outputs["actual_TCP_force"], 1.0)),
            _frame(8, bytes(4)),
        )
        return _frame(ROBOT_STATE, b"".join(subpackages))

    def _masterboard(self, outputs: Mapping[str, Any]) -> bytes:
        analog_types = outputs["analog_io_types"]
        safety = outputs["safety_mode"]
        body = struct.pack(
            ">IIbbddbbddffffBBB",
            outputs["actual_digital_input_bits"] & 0xFFFFFFFF,
            outputs["actual_digital_output_bits"] & 0xFFFFFFFF,
            analog_types & 1,
            analog_types >> 1 & 1,
            outputs["standard_analog_input0"],
            outputs["standard_analog_input1"],
            analog_types >> 2 & 1,
            analog_types >> 3 & 1,
            outputs["standard_analog_output0"],
            outputs["standard_analog_output1"],
            30.0,  # temperature of the board, degC
            outputs["actual_main_voltage"],
            outputs["actual_robot_current"],
            outputs["io_current"],
            safety,
            safety == SafetyMode.REDUCED,
            0,  # no Euromap 67
        )
        return body + struct.pack(">IBB", 0, 0, 0) + (b"\0" if self._newest else b"")


_ZERO6: Final = (0.0,) * 6


def _robot_mode(outputs: Mapping[str, Any]) -> bytes:
    mode, safety = outputs["robot_mode"], outputs["safety_mode"]
    state = outputs["runtime_state"]
    return struct.pack(
        ">Q7?bBdddB",
        int(outputs["timestamp"] * 1e6),
        True,
        True,
        mode >= RobotMode.POWER_ON,
        safety in _EMERGENCY_STOPS,
        safety == SafetyMode.PROTECTIVE_STOP,
        state == RuntimeState.PLAYING,
        state == RuntimeState.PAUSED,
        mode,
        0,  # position control
        outputs["target_speed_fraction"],
        outputs["speed_scaling"],
        1.0,
        0,
    )


_JOINT_COLUMNS: Final = (
    "actual_q",
    "target_q",
    "actual_qd",
    "actual_current",
    "actual_joint_voltage",
    "joint_temperatures",
)


def _joints(outputs: Mapping[str, Any]) -> bytes:
    columns = [outputs[name] for name in _JOINT_COLUMNS]
    return b"".join(
        struct.pack(">3d4fB", *row[:6], row[5], row[6])
        for row in zip(*columns, outputs["joint_mode"], strict=True)
    )


def _tool(outputs: Mapping[str, Any]) -> bytes:
    types = outputs["tool_analog_input_types"]
    return struct.pack(
        ">bbddfBffB",
        types & 1,
        types >> 1 & 1,
        outputs["tool_analog_input0"],
        outputs["tool_analog_input1"],
        48.0,
        outputs["tool_output_voltage"],
        outputs["tool_output_current"],
        outputs["tool_temperature"],
        outputs["tool_mode"],
    )


def _configuration(model: RobotModel, version: Version) -> bytes:
    limits = [
        bound for limit in model.position for bound in (-min(limit, _ANGLE), min(limit, _ANGLE))
    ]
    speeds = [value for speed in model.velocity for value in (speed, model.acceleration)]
    defaults = (1.05, 1.4, 0.25, 1.2, 0.5)  # joint v and a, tool v and a, equivalent radius
    masterboard = 2 if model.is_cb3 else 3
    controller_box = 2 if model.is_cb3 else 3
    return (
        struct.pack(">12d12d5d", *limits, *speeds, *defaults)
        + struct.pack(">24d", *model.a, *model.d, *ALPHA, *_ZERO6)
        + struct.pack(">4i", masterboard, controller_box, model.robot_type, 1)
    )


def encode_messages(messages: Iterable[Message], time: float) -> bytes:
    """Encode messages one after the other."""
    return b"".join(robot_message(message, time) for message in messages)
