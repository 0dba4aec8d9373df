"""Registers and bits that Modbus clients and programs share, by address."""

from math import pi

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_sim_backends.ur.messages import RuntimeExceptionMessage
from crtk_sim_backends.ur.signals.port_map import COILS, REGISTERS, PortError
from rigs.ur_controller import Bench

OUT = "actual_digital_output_bits"


@pytest.fixture(scope="module")
def shared():
    return Bench()


@pytest.fixture
def bench():
    return Bench()


def signed(word):
    return word - 65536 if word > 32767 else word


def read(bench, first, count=1):
    values = [bench.controller.port_map.registers[first + i] for i in range(count)]
    return values[0] if count == 1 else values


@pytest.mark.parametrize("table", [REGISTERS, COILS])
def test_no_address_is_given_twice(table):
    addresses = [address for ports in table for address in ports.addresses]
    assert len(addresses) == len(set(addresses))


@given(address=st.integers(-1, 70000))
def test_every_address_is_a_word_or_none(shared, address):
    registers = shared.controller.port_map.registers
    if any(address in ports.addresses for ports in REGISTERS):
        assert 0 <= registers[address] < 65536
    else:
        with pytest.raises(PortError, match=str(address)):
            registers[address]


def test_joint_angles_are_within_a_turn_and_turns_are_counted(bench):
    bench.run("movej([0.5, -1.0, 0.25, -3.0, 4.0, -6.0], t=5)")
    angles, turns = read(bench, 270, 6), read(bench, 320, 6)
    assert turns == [0, 65535, 0, 65535, 0, 65535]
    found = [
        (angle / 1000 + signed(turn) * 2 * pi) for angle, turn in zip(angles, turns, strict=True)
    ]
    assert found == pytest.approx([0.5, -1.0, 0.25, -3.0, 4.0, -6.0], abs=0.001)


def test_pose_speed_and_offset_of_the_tcp(bench):
    bench.run("set_tcp(p[0.01, 0, -0.123, 0.1, 0, 0])")
    pose = [signed(word) for word in read(bench, 400, 6)]
    assert pose[:3] == [round(x * 1e4) for x in bench["actual_TCP_pose"][:3]]
    assert pose[3:] == [round(x * 1e3) for x in bench["actual_TCP_pose"][3:]]
    assert [signed(word) for word in read(bench, 420, 6)] == [10, 0, -123, 100, 0, 0]
    bench.start("speedl([0, 0.1, 0, 0, 0, 0], 1.0, 1.0)")
    bench.seconds(0.5)
    assert signed(read(bench, 411)) == pytest.approx(100, abs=2)
    assert any(read(bench, 280, 6))


def test_states(bench):
    assert read(bench, 256, 3) == [*bench.controller.version[:2], 7]
    assert read(bench, 260, 6) == [1, 0, 0, 0, 0, 0]
    assert read(bench, 310, 6) == [253] * 6
    assert read(bench, 300, 6) == [28] * 6
    bench.controller.protective_stop()
    bench.ticks(1)
    assert read(bench, 260, 7) == [1, 1, 0, 0, 0, 1, 3]
    bench.controller.emergency_stop()
    bench.ticks(1)
    assert bench.controller.port_map.bits[262] == 1
    assert read(bench, 266) == 7


def test_digital_signals(bench):
    registers, bits = bench.controller.port_map.registers, bench.controller.port_map.bits
    bench.controller.signals.set_digital_inputs(1 << 2 | 1 << 9 | 1 << 17)
    assert (registers[0], registers[30], registers[21]) == (1 << 2 | 1 << 9, 1 << 1, 1 << 1)
    assert [address for address in range(16) if bits[address]] == [2, 9]
    assert bits[129] == 1
    registers[1] = 1 << 0 | 1 << 8 | 1 << 15
    assert bench[OUT] == 1 << 0 | 1 << 16
    registers[2] = 1 << 7
    registers[3] = 1 << 0
    assert bench[OUT] == 1 << 7 | 1 << 16
    assert (registers[1], registers[2], registers[3]) == (1 << 7 | 1 << 8, 0, 0)
    registers[22] = 0b10
    assert bench[OUT] == 1 << 7 | 1 << 17
    registers[31] = 0xFF
    registers[33] = 0x0F
    registers[32] = 0x01
    assert registers[31] == 0xF1
    bits[16 + 7] = 0
    bits[136 + 7] = 0
    bits[32 + 3] = 1
    bits[32 + 4] = 0
    bits[48 + 9] = 1
    assert bench[OUT] == 0x7100 | 1 << 3
    assert registers[1] == 1 << 3


def test_analog_signals(bench):
    registers = bench.controller.port_map.registers
    registers[19] = 1
    registers[18] = 65535
    assert bench["standard_analog_output1"] == 10.0
    assert registers[18] == 65535
    registers[16] = 32768
    assert bench["standard_analog_output0"] == pytest.approx(0.012, abs=1e-6)
    registers[11] = 1
    bench.controller.signals.set_analog_input("tool_analog_input1", 5.0)
    assert (registers[10], registers[11]) == (32768, 1)
    registers[20] = 24
    assert bench["tool_output_voltage"] == 24


@pytest.mark.parametrize(("address", "value"), [(5, 2), (20, 5), (128, 65536), (128, -1)])
def test_values_that_a_register_does_not_take(bench, address, value):
    with pytest.raises(ValueError, match=str(value)):
        bench.controller.port_map.registers[address] = value


@pytest.mark.parametrize("address", [0, 4, 26, 258, 270, 400])
def test_read_only_registers(bench, address):
    with pytest.raises(PortError, match="read only"):
        bench.controller.port_map.registers[address] = 0


def test_the_time_is_latched(bench):
    registers = bench.controller.port_map.registers
    bench.seconds(1.25)
    registers[2048] = 1
    bench.seconds(0.5)
    assert read(bench, 2049, 5) == [250, 1, 0, 0, 0]
    bench.controller.port_map.split_time = ((3 * 24 + 5) * 60 + 7) * 60_000 + 4_321
    assert read(bench, 2049, 5) == [321, 4, 7, 5, 3]


def test_programs_share_the_general_purpose_registers(bench):
    bench.controller.port_map.registers[255] = 65000
    bench.run(
        "write_port_register(128, -2)\n"
        "write_port_register(129, 65535)\n"
        "write_output_integer_register(0, read_port_register(255))\n"
        "write_output_integer_register(1, read_port_register(258))\n"
        "write_port_bit(16, True)\n"
        "write_output_boolean_register(0, read_port_bit(16))\n"
        "write_output_boolean_register(1, read_port_bit(260))\n"
    )
    assert read(bench, 128, 2) == [65534, 65535]
    assert bench["output_int_register_0"] == 65000 - 65536
    assert bench["output_int_register_1"] == 7
    assert bench["output_bit_registers0_to_31"] == 0b11
    assert bench[OUT] == 1


@pytest.mark.parametrize(
    "call",
    [
        "read_port_register(34)",
        "write_port_register(270, 1)",
        "write_port_register(128, 70000)",
        "write_port_register(20, 7)",
        "read_port_bit(1000)",
        "write_port_bit(0, True)",
    ],
)
def test_a_port_that_cannot_be_ends_the_program(bench, call):
    bench.run(call)
    (message,) = bench.of_type(RuntimeExceptionMessage)
    assert call.partition("(")[0] in message.text


def test_boolean_registers_are_those_of_rtde(bench):
    bits = bench.controller.port_map.bits
    bits[300 + 33] = 1
    bits[300 + 127] = 1
    assert bench["input_bit_registers32_to_63"] == 0b10
    assert bench["input_bit_register_127"] is True
    bench.run(
        "write_output_boolean_register(64, read_input_boolean_register(33))\n"
        "write_output_boolean_register(5, True)\n"
    )
    assert [a for a in range(500, 628) if bits[a]] == [505, 564]
