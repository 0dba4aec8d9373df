"""The tool's serial line on TCP port 54321, with an echo and the simulated DYNAMIXEL bus behind it."""

import contextlib
import socket
import struct
import threading

import pytest
import serial

from crtk_sim_backends import dynamixel
from crtk_sim_backends.ur import SIM, ConfigError, SimConfig, SimStartError
from rigs.dynamixel_packets import crc
from rigs.ur_clients import TcpClient
from rigs.waiting import LONG, eventually

TOOL = 54321


class Echo:
    """A device on a stream socket that answers everything with itself."""

    def __init__(self, family, address):
        self._listener = socket.socket(family, socket.SOCK_STREAM)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._listener.bind(address)
        self._listener.listen()
        self.address = self._listener.getsockname()
        self.heard = bytearray()
        self._peer = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        with contextlib.suppress(OSError):
            while True:
                self._peer, _ = self._listener.accept()
                while data := self._peer.recv(4096):
                    self.heard += data
                    self._peer.sendall(data)

    def close(self):
        for sock in (self._listener, self._peer):
            if sock is not None:
                with contextlib.suppress(OSError):
                    sock.shutdown(socket.SHUT_RDWR)
                sock.close()
        self._thread.join(LONG)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()


def run_script(sim, body):
    """Run a secondary program and wait until it has come to its end."""
    done = "write_output_integer_register(9, read_output_integer_register(9) + 1)"
    before = sim.control.outputs("output_int_register_9")["output_int_register_9"]
    with TcpClient(sim.host, "secondary", LONG) as port:
        port.send(f"sec tool():\n{body}\n{done}\nend\n".encode())
        eventually(
            lambda: sim.control.outputs("output_int_register_9")["output_int_register_9"] > before,
        )


def line_of(sim):
    eventually(lambda: not sim.control.status()["connections"]["tool"])  # one at a time
    return serial.serial_for_url(f"socket://{sim.host}:{TOOL}", timeout=LONG)


@pytest.fixture(scope="module")
def echo():
    with Echo(socket.AF_INET, ("127.0.0.1", 0)) as device:
        yield device


@pytest.fixture(scope="module")
def sim(echo):
    device = "tcp://{}:{}".format(*echo.address)
    with SIM.spawn(tool_device=device, tool_communication=True) as running:
        yield running


def test_bytes_go_to_the_tool_and_back(sim):
    with line_of(sim) as line:
        message = bytes(range(256)) * 4
        line.write(message)
        assert line.read(len(message)) == message


def test_the_line_has_one_client_at_a_time(sim):
    with line_of(sim) as first:
        first.write(b"first")
        assert first.read(5) == b"first"
        with TcpClient(sim.host, TOOL, LONG) as second:
            assert second.closed_by_peer()
        first.write(b"still")
        assert first.read(5) == b"still"
    with line_of(sim) as next_one:
        next_one.write(b"next")
        assert next_one.read(4) == b"next"


def test_without_supply_the_tool_is_silent(sim, echo):
    with line_of(sim) as line:
        run_script(sim, "set_tool_voltage(0)")
        del echo.heard[:]
        line.write(b"lost")
        clients = lambda: sim.control.status()["connections"]["tool"]  # noqa: E731
        eventually(lambda: any(client["bytes_in"] for client in clients()))
        line.timeout = 0.1
        assert line.read(4) == b""
        run_script(sim, "set_tool_voltage(12)")
        line.timeout = LONG
        line.write(b"heard")
        assert line.read(5) == b"heard"
        assert echo.heard == b"heard"


def test_a_program_switches_the_line_off_and_on(sim):
    with TcpClient(sim.host, TOOL, LONG) as client:
        run_script(sim, "set_tool_communication(False, 115200, 0, 1, 1.5, 3.5)")
        assert client.closed_by_peer()
    with TcpClient(sim.host, TOOL, LONG) as refused:
        assert refused.closed_by_peer()
    run_script(sim, "set_tool_communication(True, 1000000, 0, 1, 1.5, 3.5)")
    with line_of(sim) as line:
        line.write(b"again")
        assert line.read(5) == b"again"


def test_faults_of_the_wire_concern_the_tool_too(sim):
    with line_of(sim) as line:
        sim.control.inject("drop", port="tool", direction="in", every=1)
        line.write(b"lost")
        clients = lambda: sim.control.status()["connections"]["tool"]  # noqa: E731
        eventually(lambda: any(client["bytes_in"] for client in clients()))
        sim.control.clear("drop")
        line.write(b"kept")
        assert line.read(4) == b"kept"


def test_a_device_that_went_away_is_found_again(tmp_path):
    path = str(tmp_path / "gripper")
    with Echo(socket.AF_UNIX, path) as first:
        sim = SIM.spawn(tool_device=f"unix://{path}", tool_communication=True)
        with sim, line_of(sim) as line:
            line.write(b"one")
            assert line.read(3) == b"one"
            first.close()
            (tmp_path / "gripper").unlink()
            line.timeout = 0.05
            with Echo(socket.AF_UNIX, path):

                def answered():
                    line.write(b"?")
                    return line.read(1)

                eventually(answered)


def ping(number):
    """DYNAMIXEL protocol 2.0 Ping."""
    body = b"\xff\xff\xfd\x00" + struct.pack("<BHB", number, 3, 1)
    return body + crc(body)


def test_the_simulated_dynamixel_bus_is_a_gripper():
    with dynamixel.SIM.spawn(servos="7:xl330-m288", baud=57600) as bus:
        (path,) = bus.ttys.values()
        with SIM.spawn(tool_device=path) as sim:
            run_script(
                sim, "set_tool_voltage(12)\nset_tool_communication(True, 57600, 0, 1, 1.5, 3.5)"
            )
            with line_of(sim) as line:
                line.write(ping(7))
                status = line.read(14)
                assert status[:9] == b"\xff\xff\xfd\x00\x07\x07\x00\x55\x00"
                assert status[9:11] == struct.pack("<H", 1200)  # model number of the XL330-M288
                run_script(sim, "set_tool_communication(True, 115200, 0, 1, 1.5, 3.5)")
                line.write(ping(7))  # at a rate that the servo does not have
                line.timeout = 0.2
                assert line.read(14) == b""


def test_without_a_device_nobody_answers():
    with SIM.spawn(tool_communication=True) as sim, line_of(sim) as line:
        line.write(b"anybody?")
        line.timeout = 0.1
        assert line.read(1) == b""


@pytest.mark.parametrize("address", ["gripper", "tcp://host", "http://host:1", "unix://gripper"])
def test_an_address_that_is_none_is_refused(address):
    with pytest.raises(ConfigError, match="tool_device must be"):
        SimConfig(tool_device=address)


@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:1", "unix:///nowhere/gripper", "/dev/nowhere"]
)
def test_a_device_that_is_not_there_is_refused(address):
    with pytest.raises(SimStartError, match=f"tool_device: cannot connect to {address}"):
        SIM.spawn(tool_device=address)


def test_a_cb3_arm_has_no_such_line():
    with pytest.raises(ConfigError, match="CB3"):
        SimConfig(model="ur5", tool_device="/dev/null")
    with SIM.spawn(model="ur5") as sim:
        assert "tool" not in sim.ports
