"""What the kit gives any simulator: ports, serial lines, faults, control door, page; over real wires."""

import os
import select
import socket
import termios
import threading
import time
import tty
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import pytest

from crtk_sim_backends.control import ControlClient, ControlRefused
from crtk_sim_backends.kit import (
    FaultKind,
    LineSession,
    LoopServer,
    Options,
    Parameter,
    SimStartError,
    TcpDoor,
    UdpDoor,
)
from rigs.waiting import LONG


class Lamp:
    """Repeats what it is told; a fault of its own puts it out."""

    kinds = {  # noqa: RUF012
        "dark": FaultKind("dark", "it is out", lasting=True),
        "dim": FaultKind("dim", "it is dimmed", {"share": Parameter(float)}, lasting=True),
    }

    def __init__(self):
        self.lit = True
        self.outages = 0
        self.ticks = 0
        self.sessions = []

    def session(self, end):
        self.sessions.append(LineSession(self.obey, end))
        return self.sessions[-1]

    def begin(self, fault):
        self.lit = False
        self.outages += 1

    def end(self, fault):
        self.lit = True

    def status(self):
        return {"lit": self.lit, "ticks": self.ticks, "share": 0.5}

    def tick(self):
        self.ticks += 1

    def obey(self, line):
        return None if line == "hush" else f"{line} {self.lit}"


@contextmanager
def running(**options):
    with ExitStack() as stack:
        lamp = Lamp()
        made = LoopServer(
            Options(**options),
            None,
            lamp,
            title="Lamp",
            tcp={"lamp": TcpDoor(0, lambda: lamp.session(b"\n"), most=2)},
            udp={"datagrams": UdpDoor(0, lambda: lamp.session(b"\n"))},
            ttys={"line": lambda: lamp.session(b"\r")},
            gauges=lambda: [
                {"title": "Light", "unit": "lx", "rate": "", "digits": 1, "gauges": []}
            ],
        )
        made.every(0.01, lamp.tick)
        made.lamp = lamp
        thread = threading.Thread(target=made.run)
        thread.start()
        stack.callback(made.close)
        stack.callback(thread.join, LONG)
        stack.callback(made.stop)
        yield made


@pytest.fixture
def server():
    with running() as made:
        yield made


@pytest.fixture
def control(server):
    with ControlClient(server.host, server.ports["control"]) as client:
        yield client


@pytest.fixture
def peer(server):
    with socket.create_connection((server.host, server.ports["lamp"]), LONG) as made:
        yield made


@pytest.fixture
def line(server):
    fd = os.open(server.ttys["line"], os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd)
    yield fd
    os.close(fd)


def take(peer, size):
    data = b""
    while len(data) < size:
        piece = peer.recv(size - len(data))
        assert piece, data
        data += piece
    return data


def take_line(fd, size):
    data = b""
    end = time.monotonic() + LONG
    while len(data) < size and select.select([fd], [], [], max(0.0, end - time.monotonic()))[0]:
        data += os.read(fd, size)
    return data


def let_pass(control, ticks):
    begin, end = control.status()["ticks"], time.monotonic() + LONG
    while control.status()["ticks"] < begin + ticks:
        assert time.monotonic() < end


def test_lines_are_answered_however_they_are_cut(peer):
    peer.sendall(b"one\nhush\r\nt")
    assert take(peer, 9) == b"one True\n"
    peer.sendall(b"wo\n")
    assert take(peer, 9) == b"two True\n"


def test_a_line_without_an_end_is_forgotten(peer):
    peer.sendall(b"x" * 5000)
    peer.sendall(b"\nnow\n")
    answer = b""
    while b"now True\n" not in answer:
        answer += take(peer, 1)
    assert len(answer) < 5000


def test_more_clients_than_there_may_be_are_sent_away(server, peer):
    address = server.host, server.ports["lamp"]
    with socket.create_connection(address, LONG) as second:
        second.sendall(b"a\n")
        assert take(second, 7) == b"a True\n"
        with socket.create_connection(address, LONG) as third:
            assert third.recv(1) == b""


def test_what_is_sent_to_all_reaches_all(server, peer, line):
    peer.sendall(b"a\n")
    take(peer, 7)
    os.write(line, b"b\r")
    assert take_line(line, 7) == b"b True\r"
    server.send("lamp", b"tick\n")
    server.send("line", b"tock\r")
    assert take(peer, 5) == b"tick\n"
    assert take_line(line, 5) == b"tock\r"


def test_what_is_sent_to_one_reaches_that_one_alone(server, peer):
    with socket.create_connection((server.host, server.ports["lamp"]), LONG) as other:
        for each, name in ((peer, b"a\n"), (other, b"b\n")):
            each.sendall(name)
            take(each, 7)
        server.send("lamp", b"one\n", server.lamp.sessions[-1])
        server.send("lamp", b"all\n")
        assert take(other, 8) == b"one\nall\n"
        assert take(peer, 4) == b"all\n"


def test_a_call_comes_once_when_its_time_has_come(server):
    called, began = [], time.monotonic()
    server.after(0.05, lambda: called.append(time.monotonic() - began))
    end = began + LONG
    while not called:
        assert time.monotonic() < end
    assert called[0] >= 0.05


def test_a_fault_of_the_device_begins_and_ends(control, peer):
    control.inject("dark")
    peer.sendall(b"a\n")
    assert take(peer, 8) == b"a False\n"
    assert control.status()["faults"] == [{"kind": "dark"}]
    control.clear()
    peer.sendall(b"a\n")
    assert take(peer, 7) == b"a True\n"


def test_an_unknown_fault_is_refused(control):
    with pytest.raises(ControlRefused, match="did you mean 'dark'"):
        control.inject("darkk")
    with pytest.raises(ControlRefused, match="unknown port 'lamb'"):
        control.inject("silence", port="lamb")


def test_disconnect_closes_connections_and_takes_none_until_it_is_cleared(server, control, peer):
    peer.sendall(b"a\n")
    take(peer, 7)
    control.inject("disconnect", port="lamp")
    assert peer.recv(1) == b""
    address = server.host, server.ports["lamp"]
    with socket.create_connection(address, LONG) as other:
        assert other.recv(1) == b""
    control.clear("disconnect")
    with socket.create_connection(address, LONG) as other:
        other.sendall(b"a\n")
        assert take(other, 7) == b"a True\n"


def test_silence_holds_everything_back_until_it_is_cleared(control, peer):
    peer.sendall(b"a\n")
    take(peer, 7)
    control.inject("silence")
    peer.sendall(b"b\n")
    assert not select.select([peer], [], [], 0.1)[0]
    control.clear("silence")
    assert take(peer, 7) == b"b True\n"


def test_no_answer_is_for_new_connections(server, control, peer):
    peer.sendall(b"a\n")
    take(peer, 7)
    control.inject("no_answer")
    with socket.create_connection((server.host, server.ports["lamp"]), LONG) as mute:
        mute.sendall(b"b\n")
        peer.sendall(b"b\n")
        assert take(peer, 7) == b"b True\n"
        assert not select.select([mute], [], [], 0.05)[0]


def test_delayed_data_arrives_late_and_in_order(control, peer):
    peer.sendall(b"a\n")
    take(peer, 7)
    control.inject("delay", seconds=0.1, direction="out")
    began = time.monotonic()
    peer.sendall(b"b\nc\n")
    assert take(peer, 14) == b"b True\nc True\n"
    assert time.monotonic() - began >= 0.1


def test_a_simulator_knows_the_rate_that_the_client_of_its_line_has_set(server, line):
    attributes = termios.tcgetattr(line)
    for speed, rate in ((termios.B9600, 9600), (termios.B115200, 115200)):
        attributes[4] = attributes[5] = speed
        termios.tcsetattr(line, termios.TCSANOW, attributes)
        assert server.baud("line") == rate


def test_a_serial_line_is_unplugged_and_found_again(server, control, line):
    os.write(line, b"a\r")
    assert take_line(line, 7) == b"a True\r"
    before = len(server.lamp.sessions)
    control.inject("disconnect", port="line")
    assert not Path(server.ttys["line"]).exists()
    control.clear()
    assert len(server.lamp.sessions) == before + 1, "the old one is closed, and of no use"
    again = os.open(server.ttys["line"], os.O_RDWR | os.O_NOCTTY)
    try:
        tty.setraw(again)
        os.write(again, b"b\r")
        assert take_line(again, 7) == b"b True\r"
    finally:
        os.close(again)


def test_a_silent_serial_line_loses_what_crosses_it(control, line):
    control.inject("silence", port="line")
    os.write(line, b"a\r")
    assert control.status()["connections"]["line"] == 1
    let_pass(control, ticks=20)  # the system hands it over when it likes
    control.clear()
    os.write(line, b"b\r")
    assert take_line(line, 7) == b"b True\r"


def test_status_and_page_tell_of_the_device(control):
    assert control.status()["lit"] is True
    scene, live = control.call("scene"), control.call("live")
    assert scene["title"] == "Lamp"
    kinds = [each["kind"] for each in scene["buttons"]]
    assert "dark" in kinds
    assert "silence" in kinds
    assert "dim" not in kinds  # a button has no value for its share
    assert ["lit", "True", ""] in live["sections"]["State"]
    assert [each["title"] for each in live["gauges"]] == ["Light"]


def test_time_passes_at_the_rate_of_the_ticks(control):
    began = time.monotonic()
    let_pass(control, ticks=20)
    assert time.monotonic() - began > 0.1


def test_a_fault_file_is_played(tmp_path):
    path = tmp_path / "faults.yaml"
    path.write_text("- {at: 0.0, kind: dark, duration: 0.1}\n")
    with (
        running(faults=str(path)) as server,
        closing(ControlClient(server.host, server.ports["control"])) as c,
    ):
        end = time.monotonic() + LONG
        while not ((status := c.status())["lit"] and server.lamp.outages):
            assert time.monotonic() < end
        assert status["time"] >= 0.1


def test_a_wrong_fault_file_is_told_and_leaves_nothing_open(tmp_path):
    path = tmp_path / "faults.yaml"
    path.write_text("- {at: 0.0, kind: bright}\n")
    with pytest.raises(SimStartError, match=r"line 1: unknown kind of fault 'bright'"):
        LoopServer(Options(faults=str(path)), None, Lamp(), title="Lamp")


def test_a_port_in_use_is_told_with_a_way_out(server):
    taken = TcpDoor(server.ports["lamp"], lambda: LineSession(lambda line: None))
    with pytest.raises(SimStartError, match="cannot bind the lamp port"):
        LoopServer(Options(host=server.host), None, Lamp(), title="Lamp", tcp={"lamp": taken})
