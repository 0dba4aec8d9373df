"""Layouts of the primary packets, against bytes that UR's own controller sent.

The bytes are from a state of URSim 5.8 (UR5e) and from messages of 5.24, as published with
Universal_Robots_Client_Library (tests/test_primary_parser.cpp; the size of its runtime exception,
which its parser does not read, is put right here).
"""

from __future__ import annotations

import struct

import pytest

from crtk_sim_backends.ur.messages import (
    ErrorMessage,
    KeyMessage,
    PopupMessage,
    ReportLevel,
    RuntimeExceptionMessage,
    SafetyModeMessage,
    TextMessage,
)
from crtk_sim_backends.ur.models import MODELS
from crtk_sim_backends.ur.ports.primary import (
    RobotStateEncoder,
    hardware_info_message,
    robot_message,
    version_message,
)
from crtk_sim_backends.ur.signals.variables import OUTPUTS, initial_image
from rigs.ur_clients import subpackages

PARTS_OF_URSIM_5_8 = [
    (0, 47),
    (1, 251),
    (4, 101),
    (5, 225),
    (9, 53),
    (3, 75),
    (2, 37),
    (6, 445),
    (7, 61),
    (8, 9),
    (10, 43),
    (11, 26),
    (12, 8),
]
ROBOT_MODE = "00000005f87d1740" + "01010100000000" + "0700" + "3fef0a3d70a3d70a" + "00" * 8
ROBOT_MODE += "3ff0000000000000" + "00"
FIRST_JOINT = "bff99c779a6b50b0" * 2 + "00" * 8 + "a3a879380000000041cc000000000000fd"
MASTERBOARD = "00" * 8 + "0101" + "00" * 16 + "0000" + "3f70624de0000000" * 2
MASTERBOARD += "41c00000" + "42400000" + "00" * 8 + "010000"
TOOL = "0101" + "00" * 29 + "fd"
LIMITS = ("c0195799282c2f63" + "40195799282c2f63") * 6
SPEEDS = ("400abb94edddc6b1" + "4044000000000000") * 6
DEFAULTS = "3ff0c152382d73653ff657184ae744873fd00000000000003ff33333333333333fd0000000000000"
BOARDS = "00000006000000040000000100000003"
ADDITIONAL = "00010001"
TOOL_COMMUNICATION = "000001c20000000000000000013fc0000040600000"
TOOL_MODES = "000101"

VERSION = "00000037140000000000000000fe030955"
VERSION += "52436f6e74726f6c05180000000000000000"
KEY = "00000032140000000000000000fe07000000000000000013"
KEY += b"PROGRAM_XXX_STARTEDtextmsg".hex()
EXCEPTION = "0000003b140000000000000000fd0a0000000300000001"
EXCEPTION += b"compile_error_name_not_found:txtmsg:".hex()


def parts(packet: bytes) -> list[tuple[int, int]]:
    size, kind = struct.unpack_from(">IB", packet)
    assert (size, kind) == (len(packet), 16)
    return [(number, 5 + len(body)) for number, body in subpackages(packet[5:]).items()]


def state(model: str, version: tuple[int, int, int, int], **image: object) -> bytes:
    outputs = initial_image(OUTPUTS) | image
    return RobotStateEncoder(MODELS[model], version).packet(outputs)


@pytest.mark.parametrize(
    ("model", "version", "expected"),
    [
        ("ur5e", (5, 8, 0, 0), PARTS_OF_URSIM_5_8),
        ("ur5e", (5, 12, 4, 0), [*PARTS_OF_URSIM_5_8, (13, 7)]),
        ("ur20", (5, 26, 0, 0), [*PARTS_OF_URSIM_5_8, (13, 7)]),
        ("ur5e", (10, 14, 0, 0), [*PARTS_OF_URSIM_5_8, (13, 7)]),
        ("ur5", (3, 15, 8, 0), [*PARTS_OF_URSIM_5_8[:9], (8, 8), (10, 43)]),
    ],
)
def test_parts_of_a_state_by_version(
    model: str, version: tuple[int, int, int, int], expected: list[tuple[int, int]]
) -> None:
    assert parts(state(model, version)) == expected


def test_a_state_is_byte_for_byte_that_of_ursim() -> None:
    joint = struct.unpack(">3d4fB", bytes.fromhex(FIRST_JOINT))
    body = subpackages(
        state(
            "ur5e",
            (5, 8, 0, 0),
            timestamp=0x5F87D1740 / 1e6,
            robot_mode=7,
            target_speed_fraction=0.97,
            speed_scaling=0.0,
            actual_q=(joint[0],) * 6,
            target_q=(joint[1],) * 6,
            actual_current=(joint[3],) * 6,
            actual_joint_voltage=(joint[4],) * 6,
            joint_temperatures=(joint[5],) * 6,
            joint_mode=(253,) * 6,
            analog_io_types=0b0011,
            standard_analog_output0=struct.unpack(">d", bytes.fromhex("3f70624de0000000"))[0],
            standard_analog_output1=struct.unpack(">d", bytes.fromhex("3f70624de0000000"))[0],
            actual_main_voltage=48.0,
            tool_analog_input_types=0b11,
            tool_temperature=0.0,
            tool_digital_output0_mode=1,
            tool_digital_output1_mode=1,
        )[5:]
    )
    assert body[0].hex() == ROBOT_MODE
    assert body[1].hex() == FIRST_JOINT * 6
    assert body[3][:63].hex() == MASTERBOARD
    assert body[3][67:].hex() == "010101"
    assert body[2][:18].hex() == TOOL[:36]
    assert body[2][-1:].hex() == TOOL[-2:]
    assert body[6][:96].hex() == LIMITS
    speeds = struct.unpack(">12d", bytes.fromhex(SPEEDS))
    assert struct.unpack(">12d", body[6][96:192]) == pytest.approx(speeds, rel=1e-15)
    assert body[6][192:232].hex() == DEFAULTS
    assert body[6][-16:].hex() == BOARDS
    assert body[8].hex() == ADDITIONAL
    assert body[11].hex() == TOOL_COMMUNICATION
    assert body[12].hex() == TOOL_MODES


def test_messages_are_byte_for_byte_those_of_the_controller() -> None:
    version = version_message((5, 24, 0, 0), 0.0)
    assert version[:-20].hex() == VERSION
    assert len(version) == 0x37
    assert robot_message(KeyMessage("PROGRAM_XXX_STARTED", "textmsg"), 0.0).hex() == KEY
    exception = RuntimeExceptionMessage(3, 1, "compile_error_name_not_found:txtmsg:")
    assert robot_message(exception, 0.0).hex() == EXCEPTION


def test_the_hardware_is_told_by_software_that_knows_the_message() -> None:
    """Layout and first versions: Universal_Robots_Client_Library, hardware_info_message.h."""
    head = "0000001b" + "14" + "00" * 8 + "fe" + "12"
    body = "00000002" + "0000" + "0005" + "0000" + "0001"
    for version in ((5, 26, 0, 0), (10, 14, 0, 0)):
        assert hardware_info_message(MODELS["ur10e"], version, 0.0).hex() == head + body
    for version in ((3, 15, 8, 0), (5, 25, 9, 0), (10, 13, 9, 0)):
        assert hardware_info_message(MODELS["ur10e"], version, 0.0) == b""


@pytest.mark.parametrize(
    ("message", "kind", "body"),
    [
        (TextMessage("hello"), 0, b"hello"),
        (
            PopupMessage("title", "text", warning=True, blocking=True),
            2,
            b"\0\0\0\0\0\1\0\1\5titletext",
        ),
        (SafetyModeMessage(3), 5, bytes(8) + b"\3" + bytes(8)),
        (
            ErrorMessage(209, 1, ReportLevel.VIOLATION, "stop"),
            6,
            struct.pack(">iiiII", 209, 1, 3, 0, 0) + b"stop",
        ),
    ],
)
def test_messages_have_the_layout_of_the_client_interface(
    message: object, kind: int, body: bytes
) -> None:
    packet = robot_message(message, 2.5)  # type: ignore[arg-type]
    assert packet[:5] == struct.pack(">IB", len(packet), 20)
    assert struct.unpack(">Qb", packet[5:14])[0] == 2_500_000
    assert packet[14] == kind
    assert packet[15:] == body


@pytest.mark.parametrize(
    ("version", "size"), [((3, 0, 0, 0), 38), ((3, 4, 0, 0), 46), ((3, 15, 0, 0), 47)]
)
def test_the_robot_mode_grew_with_the_software(
    version: tuple[int, int, int, int], size: int
) -> None:
    """Clients tell the versions of CB3 software by these sizes."""
    assert parts(state("ur5", version))[0] == (0, size)
