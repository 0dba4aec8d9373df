"""Every fault of a simulated wire, on every kind of line: over TCP, over UDP, and over a serial line."""

import errno
import os
import select
import socket
import threading
import time
import tty
from contextlib import ExitStack, contextmanager

import pytest

from crtk_sim_backends.control import ControlClient, ControlRefused
from crtk_sim_backends.kit import LineSession, LoopServer, Options, TcpDoor, UdpDoor
from crtk_sim_backends.kit.wire_faults import HOOKS, WIRE_KINDS
from rigs.waiting import LONG

KINDS = ("tcp", "udp", "serial")
QUIET = 0.1
"""Seconds in which nothing comes where nothing is sent."""


class Echo:
    """Repeats each line."""

    kinds = {}  # noqa: RUF012

    def begin(self, fault):
        """It has none of its own."""

    def end(self, fault):
        """It has none of its own."""

    def status(self):
        return {}

    def obey(self, line):
        return line


class Client:
    """One client of a line of any kind."""

    def __init__(self, server, kind):
        self.kind = kind
        if kind == "serial":
            self.fd = os.open(server.ttys["serial"], os.O_RDWR | os.O_NOCTTY)
            tty.setraw(self.fd)
            self.close = lambda: os.close(self.fd)
        else:
            how = socket.SOCK_STREAM if kind == "tcp" else socket.SOCK_DGRAM
            self.socket = socket.socket(socket.AF_INET, how)
            self.socket.connect((server.host, server.ports[kind]))
            self.fd = self.socket.fileno()
            self.close = self.socket.close

    def write(self, data):
        os.write(self.fd, data)

    def piece(self, patience=LONG):
        """Return what comes next, with the time at which it did; nothing if nothing does."""
        came = select.select([self.fd], [], [], patience)[0]
        return (os.read(self.fd, 4096) if came else b""), time.monotonic()

    def take(self, size, patience=LONG):
        data = b""
        while len(data) < size and (piece := self.piece(patience)[0]):
            data += piece
        return data


@contextmanager
def client_of(server, kind):
    made = Client(server, kind)
    try:
        yield made
    finally:
        made.close()


@pytest.fixture(params=KINDS)
def kind(request):
    return request.param


@pytest.fixture
def server():
    with ExitStack() as stack:
        echo = Echo()

        def session():
            return LineSession(echo.obey)

        made = LoopServer(
            Options(),
            None,
            echo,
            title="Echo",
            tcp={"tcp": TcpDoor(0, session)},
            udp={"udp": UdpDoor(0, session)},
            ttys={"serial": session},
        )
        thread = threading.Thread(target=made.run)
        thread.start()
        stack.callback(made.close)
        stack.callback(thread.join, LONG)
        stack.callback(made.stop)
        yield made


@pytest.fixture
def control(server):
    with ControlClient(server.host, server.ports["control"]) as client:
        yield client


@pytest.fixture
def client(server, kind):
    with client_of(server, kind) as made:
        made.write(b"first\n")
        assert made.take(6) == b"first\n"
        yield made


def test_every_kind_of_fault_is_shown_here():
    shown = {name.removeprefix("test_fault_") for name in globals() if "test_fault_" in name}
    assert shown == set(WIRE_KINDS) >= set(HOOKS)


def test_fault_corrupt(control, client):
    control.inject("corrupt", port=client.kind, every=1, direction="out")
    client.write(b"abcdef\n")
    damaged = client.take(7)
    assert len(damaged) == 7
    assert sum(a != b for a, b in zip(damaged, b"abcdef\n", strict=True)) == 1
    control.clear()
    client.write(b"abcdef\n")
    assert client.take(7) == b"abcdef\n"


def test_fault_split(control, client):
    control.inject("split", port=client.kind, size=2, spacing=0.02, direction="out")
    client.write(b"abcdef\n")
    pieces = [client.piece() for _ in range(4)]
    assert [data for data, _ in pieces] == [b"ab", b"cd", b"ef", b"\n"]
    assert pieces[-1][1] - pieces[0][1] > 0.03


def test_fault_delay(control, client):
    control.inject("delay", port=client.kind, seconds=0.1, direction="out")
    began = time.monotonic()
    client.write(b"a\n")
    client.write(b"b\n")
    assert client.take(4) == b"a\nb\n"
    assert time.monotonic() - began >= 0.1


def test_fault_coalesce(control, client):
    control.inject("coalesce", port=client.kind, seconds=0.4, direction="out")
    data, empty = b"", 0
    for line in (b"a\n", b"b\n", b"c\n", b"d\n", b"e\n", b"f\n"):
        client.write(line)
        piece, _ = client.piece(0.03)
        data, empty = data + piece, empty + (not piece)
    while len(data) < 12:
        data += client.piece()[0]
    assert data == b"a\nb\nc\nd\ne\nf\n"
    assert empty >= 3, "it is held back until the next lump"


def test_fault_drop(control, client):
    control.inject("drop", port=client.kind, every=2, direction="out")
    came = b""
    for line in (b"a\n", b"b\n", b"c\n", b"d\n"):
        client.write(line)
        came += client.piece(QUIET)[0]
    assert came == b"a\nc\n"


def test_fault_silence(control, client):
    control.inject("silence", port=client.kind)
    client.write(b"a\n")
    assert client.piece(QUIET)[0] == b""
    control.clear()
    client.write(b"b\n")
    came = client.take(4 if client.kind == "tcp" else 2)
    assert came == (b"a\nb\n" if client.kind == "tcp" else b"b\n"), "TCP keeps it, others lose it"


def test_fault_disconnect(server, control, client):
    control.inject("disconnect", port=client.kind)
    with pytest.raises(OSError) as caught:  # noqa: PT011, PT012 - by the kind of line
        while True:
            client.write(b"a\n")
            if not client.piece(QUIET)[0]:
                raise OSError(errno.EPIPE, "closed")
    assert caught.value.errno in (errno.ECONNREFUSED, errno.EIO, errno.EPIPE, errno.ECONNRESET)
    control.clear()
    with client_of(server, client.kind) as again:
        again.write(b"b\n")
        assert again.take(2) == b"b\n"


def test_fault_no_answer(server, control, kind):
    control.inject("no_answer", port=kind)
    with client_of(server, kind) as mute:
        mute.write(b"a\n")
        assert mute.piece(QUIET)[0] == b""
        server.send(kind, b"unasked\n")
        assert mute.piece(QUIET)[0] == b""
    control.clear()
    with client_of(server, kind) as client:
        client.write(b"b\n")
        assert client.take(2) == b"b\n"


def test_no_answer_spares_earlier_clients(server, control, client):
    control.inject("no_answer", port=client.kind)
    client.write(b"a\n")
    assert client.take(2) == b"a\n"
    server.send(client.kind, b"unasked\n")
    assert client.take(8) == b"unasked\n"


def test_a_fault_of_one_line_is_none_of_another(server, control, client):
    others = [kind for kind in KINDS if kind != client.kind]
    control.inject("drop", port=client.kind)
    for kind in others:
        with client_of(server, kind) as other:
            other.write(b"a\n")
            assert other.take(2) == b"a\n"


def test_a_fault_that_no_line_has_is_refused(control):
    with pytest.raises(ControlRefused, match="unknown kind of fault 'burn'"):
        control.inject("burn")
    with pytest.raises(ControlRefused, match="unknown port 'usb'"):
        control.inject("corrupt", port="usb")
    assert control.status()["faults"] == []


def test_what_is_under_way_is_not_for_the_next_client(server, control):
    control.inject("delay", port="serial", seconds=0.2, direction="out")
    with client_of(server, "serial") as client:
        client.write(b"old\n")
        control.status()
    end = time.monotonic() + LONG
    while control.status()["connections"]["serial"]:
        assert time.monotonic() < end
    control.clear()
    with client_of(server, "serial") as client:
        client.write(b"new\n")
        assert client.take(4) == b"new\n"
        assert client.piece(0.3)[0] == b""


def test_faults_of_both_ways_do_not_wait_for_each_other(control, client, kind):
    """What is under way slowly to the client holds up nothing that is under way to the simulator."""
    control.inject("delay", port=kind, seconds=1.0, direction="out")
    client.write(b"slow\n")
    control.status()  # it is under way
    control.inject("coalesce", port=kind, seconds=0.05, direction="in")
    begun = time.monotonic()
    client.write(b"next\n")
    assert client.take(10) == b"slow\nnext\n"
    assert time.monotonic() - begun < 1.6
