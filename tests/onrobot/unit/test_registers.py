"""Register maps: the bytes of commands, identities, and what is asked when."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_onrobot.config import OnRobotConfig
from crtk_driver_onrobot.models import IDENTITY, MODELS, Fingers
from crtk_driver_onrobot.registers import Identity, Registers, order, stop_order
from crtk_drivers.config import from_values, load
from crtk_drivers.errors import ConfigError
from crtk_drivers.kit import modbus_frames
from crtk_drivers.kit.modbus_frames import Rtu, crc

ORDERS = {
    ("rg2", "outside"): ("0190 0258 0010", "0002 0008"),
    ("2fg7", "outside"): ("0258 0028 0064 0001", "0003 0003"),
    ("2fg7", "inside"): ("0258 0028 0064 0002", "0003 0003"),
    ("3fg15", "outside"): ("00A7 0258 0000 0001", "0003 0004"),
    ("3fg15", "inside"): ("00A7 0258 0001 0001", "0003 0004"),
}
"""60 mm with 40 N at full speed, and a stop (its register, and what is written)."""


def fingers(model: str, grip: str = "outside") -> Fingers:
    tool = load(OnRobotConfig, from_values({"model": model, "grip": grip})).tool
    assert isinstance(tool, Fingers)
    return tool


@pytest.mark.parametrize(("key", "expected"), ORDERS.items(), ids=lambda x: "-".join(x))
def test_orders_are_those_of_the_tables(key: tuple[str, str], expected: tuple[str, str]) -> None:
    tool = fingers(*key)
    command = order(tool, 0.06, 40.0, 1.0)
    assert (command.address, command.block) == (0, bytes.fromhex(expected[0]))
    halt = stop_order(tool)
    assert halt.address.to_bytes(2, "big") + halt.block == bytes.fromhex(expected[1])


def test_the_frame_that_sends_an_rg2_to_60_mm() -> None:
    frame = Rtu(65).ask(Registers(fingers("rg2")).write(order(fingers("rg2"), 0.06, 40.0, 1.0)))
    body = bytes.fromhex("41 10 0000 0003 06 0190 0258 0010")
    assert frame == body + crc(body)


def identity(code: int, serial: str = "RG2-123") -> bytes:
    words = bytearray(2 * IDENTITY.size)
    words[:2] = code.to_bytes(2, "big")
    words[8:12] = bytes.fromhex("01020037")
    words[18 : 18 + len(serial)] = serial.encode()
    return bytes(words)


def test_an_identity() -> None:
    found = Identity.parse(identity(0x20))
    assert (found.code, found.firmware, found.serial) == (0x20, "1.2.55", "RG2-123")
    assert found.title == "RG2 RG2-123"
    assert "0x63" in Identity.parse(identity(0x63)).title


@given(st.binary(min_size=2 * IDENTITY.size, max_size=2 * IDENTITY.size))
def test_any_identity_can_be_told(data: bytes) -> None:
    assert Identity.parse(data).title


def answered(registers: Registers, data: bytes) -> object:
    question = registers.read()
    return registers.status(question, question.head + data)


@pytest.mark.parametrize("model", MODELS)
def test_who_is_there_is_asked_first_and_now_and_then(model: str) -> None:
    now = [0.0]
    tool = load(OnRobotConfig, from_values({"model": model})).tool
    registers = Registers(tool, lambda: now[0])
    assert answered(registers, identity(MODELS[model].code)) is None
    assert registers.read() == modbus_frames.read(*tool.details)
    assert answered(registers, bytes(2 * tool.details.size)) is None
    assert registers.read() == modbus_frames.read(*tool.status)
    assert answered(registers, bytes(2 * tool.status.size)) is not None
    now[0] = 1.5
    assert registers.read() == modbus_frames.read(*IDENTITY)


@pytest.mark.parametrize("model", MODELS)
def test_no_two_answers_are_alike(model: str) -> None:
    """On a line they are told apart by their sizes."""
    tool = load(OnRobotConfig, from_values({"model": model})).tool
    registers = Registers(tool)
    sizes = [modbus_frames.read(*span).size for span in (IDENTITY, tool.details, tool.status)]
    sizes += [registers.probe(turn).size for turn in range(12)]
    assert len(set(sizes)) == len(sizes)


@pytest.mark.parametrize("model", MODELS)
def test_a_probe_tells_nothing(model: str) -> None:
    registers = Registers(MODELS[model].map)
    question = registers.probe(3)
    assert registers.status(question, question.head + bytes(question.size - 2)) is None


def test_negative_widths_and_forces() -> None:
    registers = Registers(fingers("2fg7"))
    answered(registers, identity(0xC0))
    answered(registers, bytes.fromhex("FFF6 02DA 0000 0000"))
    question = registers.read()
    words = bytes.fromhex("0001 00C8 0064 FFF6 02DA 0000 0000 FFD8")
    status = registers.status(question, question.head + words)
    assert status is not None
    tool = fingers("2fg7")
    assert tool.effort is not None
    assert tool.range is not None
    assert status.value(tool.opening) == pytest.approx(0.02)
    assert status.value(tool.effort) == -40.0
    assert status.value(tool.range[0]) == pytest.approx(-0.001)


@pytest.mark.parametrize(
    "values",
    [
        {"model": "rg4"},
        {"model": "rg2", "force": 41.0},
        {"model": "rg6", "force": 10.0},
        {"model": "rg2", "force": float("nan")},
        {"model": "2fg7", "speed": 1.5},
        {"model": "vg10", "vacuum": 80.0},
        {"model": "vg10", "vacuum": 95_000.0},
        {"grip": "both"},
    ],
)
def test_a_configuration_that_cannot_be_is_refused(values: dict[str, object]) -> None:
    with pytest.raises(ConfigError):
        load(OnRobotConfig, from_values(values))
