"""The Modbus server of the simulated controller, asked by pymodbus' unmodified client and by hand."""

import os
import socket
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus import ExceptionResponse
from pymodbus.client import ModbusTcpClient

from crtk_sim_backends.ur import SIM, ConfigError, SimConfig, SimStartError
from crtk_sim_backends.ur.ports.modbus_server import ModbusSession
from rigs.ur_clients import TcpClient, own_address
from rigs.ur_controller import Bench
from rigs.waiting import LONG, eventually

UNPRIVILEGED = Path("/proc/sys/net/ipv4/ip_unprivileged_port_start")
ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3


@pytest.fixture(scope="module")
def sim():
    with SIM.spawn(modbus=True, modbus_port=0, wiring="digital_out_1=digital_in_5") as running:
        yield running


@pytest.fixture
def client(sim):
    with ModbusTcpClient(sim.host, port=sim.ports["modbus"], timeout=LONG) as connected:
        yield connected


@pytest.fixture
def raw(sim):
    with TcpClient(sim.host, sim.ports["modbus"], LONG) as connected:
        yield connected


def ask(raw, message, unit=1, transaction=7):
    """Send a message in a frame of its own and return the answer's."""
    raw.send(struct.pack(">HHHB", transaction, 0, len(message) + 1, unit) + message)
    number, protocol, size, echo = struct.unpack(">HHHB", raw.read(7))
    assert (number, protocol, echo) == (transaction, 0, unit)
    return raw.read(size - 1)


def test_a_client_reads_the_state(client):
    answer = client.read_holding_registers(256, count=3)
    assert answer.registers == [5, 12, 7]
    assert client.read_input_registers(310, count=6).registers == [253] * 6
    assert client.read_discrete_inputs(260, count=6).bits[:6] == [True] + [False] * 5
    assert client.read_coils(260, count=1).bits[0]


def test_outputs_are_set_and_come_back_over_a_wire(sim, client):
    assert client.write_coil(17, True).bits == [True]
    eventually(lambda: client.read_discrete_inputs(5, count=1).bits[0])
    assert client.read_holding_registers(1, count=1).registers == [0b10]
    assert sim.control.outputs("actual_digital_input_bits")["actual_digital_input_bits"] == 1 << 5
    assert client.write_register(3, 0b10).registers == [0b10]  # the mask that switches off
    assert client.read_coils(16, count=8).bits == [False] * 8
    client.write_coils(16, [True, False, True])
    assert client.read_holding_registers(1, count=1).registers == [0b101]
    client.write_register(1, 0)


def test_general_purpose_registers_are_the_programs_too(sim, client):
    client.write_registers(130, [1, 2, 65535])
    with TcpClient(sim.host, "primary", LONG) as port:
        port.send(b"sec copy():\n  write_port_register(140, read_port_register(132) - 1)\nend\n")
        eventually(lambda: client.read_holding_registers(140, count=1).registers == [65534])
    assert client.read_holding_registers(128, count=5).registers == [0, 0, 1, 2, 65535]


def test_any_unit_is_answered_and_clients_share_the_server(sim, client):
    with ModbusTcpClient(sim.host, port=sim.ports["modbus"], timeout=LONG) as other:
        other.write_register(200, 4321, device_id=255)
        assert client.read_holding_registers(200, count=1, device_id=9).registers == [4321]


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        (lambda c: c.read_holding_registers(34, count=1), ILLEGAL_ADDRESS),
        (lambda c: c.read_holding_registers(254, count=6), ILLEGAL_ADDRESS),
        (lambda c: c.read_coils(160, count=1), ILLEGAL_ADDRESS),
        (lambda c: c.write_register(270, 0), ILLEGAL_ADDRESS),
        (lambda c: c.write_coil(0, True), ILLEGAL_ADDRESS),
        (lambda c: c.write_register(20, 5), ILLEGAL_VALUE),
        (
            lambda c: c.readwrite_registers(read_address=128, read_count=1, values=[1]),
            ILLEGAL_FUNCTION,
        ),
        (lambda c: c.mask_write_register(address=128), ILLEGAL_FUNCTION),
        (lambda c: c.read_exception_status(), ILLEGAL_FUNCTION),
    ],
)
def test_a_request_that_cannot_be_is_answered_with_its_exception(client, request_, code):
    answer = request_(client)
    assert isinstance(answer, ExceptionResponse)
    assert answer.exception_code == code


def test_a_refused_write_changes_nothing(client):
    client.write_registers(18, [0, 1])
    answer = client.write_registers(18, [65535, 7])  # the value is fine, the domain is not
    assert answer.exception_code == ILLEGAL_VALUE
    answer = client.write_registers(20, [24, 1])  # the second is read only
    assert answer.exception_code == ILLEGAL_ADDRESS
    assert client.read_holding_registers(18, count=3).registers == [0, 1, 0]


def test_messages_of_a_wrong_length_or_count_are_refused(raw):
    assert ask(raw, b"\x03\x00\x80\x00\x00") == bytes([0x83, ILLEGAL_VALUE])
    assert ask(raw, b"\x03\x00\x80\x00\x7e") == bytes([0x83, ILLEGAL_VALUE])
    assert ask(raw, b"\x03\x00\x80") == bytes([0x83, ILLEGAL_VALUE])
    assert ask(raw, b"\x10\x00\x80\x00\x02\x02\x00\x01") == bytes([0x90, ILLEGAL_VALUE])
    assert ask(raw, b"\x03\x00\x80\x00\x01")[:2] == b"\x03\x02"  # and it goes on


def test_requests_may_come_in_pieces_and_in_lumps(raw):
    frame = struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, 256, 1)
    for i in range(len(frame)):
        raw.send(frame[i : i + 1])
    answer = struct.pack(">HHHBBBH", 1, 0, 5, 1, 3, 2, 5)
    assert raw.read(len(answer)) == answer
    raw.send(frame * 20)
    assert raw.read(20 * len(answer)) == 20 * answer


def test_what_is_no_modbus_ends_the_connection(raw):
    raw.send(b"GET / HTTP/1.1\r\n" + b"x" * 300)
    assert raw.closed_by_peer()


@given(data=st.binary(max_size=600))
def test_no_bytes_can_hurt_the_server(data):
    session = ModbusSession(Bench().controller.port_map)
    session.receive(data)
    if not session.ended:
        assert len(session._buffer) < 260


def test_faults_of_the_wire_concern_the_server_too(sim, client):
    sim.control.inject("silence", port="modbus")
    with TcpClient(sim.host, sim.ports["modbus"], LONG) as waiting:
        waiting.send(struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, 256, 1))
        assert waiting.silent_for(0.05)
        sim.control.clear("silence")
        assert waiting.read(11)
    sim.control.inject("disconnect", port="modbus")
    eventually(lambda: not sim.control.status()["connections"]["modbus"])


def test_it_is_off_unless_it_is_asked_for(sim):
    with SIM.spawn() as other:
        assert "modbus" not in other.ports
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection((other.host, 502), LONG)


@pytest.mark.skipif(
    os.geteuid() == 0 or int(UNPRIVILEGED.read_text()) <= 502, reason="port 502 may be bound here"
)
def test_the_port_of_a_robot_needs_privilege():
    with pytest.raises(SimStartError, match=r":502: .*modbus_port"):
        SIM.spawn(modbus=True)


def test_a_port_in_use_is_refused_with_its_number(sim):
    host = own_address()
    with socket.create_server((host, 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(SimStartError, match=f"modbus port .*:{port}.*in use"):
            SIM.spawn(host=host, modbus=True, modbus_port=port)
    with pytest.raises(ConfigError, match="modbus_port"):
        SimConfig(modbus_port=70000)


@pytest.mark.parametrize("on", [False, True])
def test_libraries_are_loaded_only_where_they_are_used(on):
    code = (
        "import sys; from crtk_sim_backends.ur import SIM, SimConfig;"
        f"SIM.serve(SimConfig(modbus={on}, modbus_port=0), None).close();"
        "print('pymodbus' in sys.modules, 'serial' in sys.modules)"
    )
    child = subprocess.run(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, timeout=LONG, check=True
    )
    assert child.stdout.split() == [str(on), "False"]
