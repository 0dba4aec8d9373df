"""URScript sockets: the program on the simulated robot connects to a server of the test."""

import socket
import struct

import pytest

from crtk_sim_backends.ur import SIM
from rigs.ur_clients import PrimaryClient
from rigs.waiting import LONG


@pytest.fixture(scope="module")
def sim():
    with SIM.spawn() as running:
        yield running


@pytest.fixture
def server():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(LONG)
        yield listener


def start(sim, server, *lines):
    """Upload a program that first connects to the server as "s"."""
    port = server.getsockname()[1]
    body = "\n".join(f"  {line}" for line in lines)
    text = f'def talk():\n  textmsg("open ", socket_open("127.0.0.1", {port}, "s"))\n{body}\nend\n'
    primary = PrimaryClient(sim.host)
    primary.send(text.encode())
    return primary


def accept(server):
    peer, _ = server.accept()
    peer.settimeout(LONG)
    return peer


def read(peer, size):
    data = b""
    while len(data) < size:
        data += peer.recv(size - len(data))
    return data


def test_what_a_program_sends_arrives(sim, server):
    lines = (
        'socket_send_int(-2, "s")',
        'socket_send_byte(300, "s")',
        'socket_send_string("text", "s")',
        'socket_send_line("line", "s")',
        'socket_set_var("speed", 7, "s")',
    )
    expected = struct.pack(">iB", -2, 300 & 255) + b"textline\nSET speed 7\n"
    with start(sim, server, *lines), accept(server) as peer:
        assert read(peer, len(expected)) == expected
        assert peer.recv(1) == b""  # closed with the end of the program


def test_it_connects_from_the_address_of_the_robot(sim, server):
    with start(sim, server, "sleep(10)") as primary:
        peer, address = server.accept()
        peer.close()
        assert address[0] == sim.host
        assert primary.message(0) == b"open True"  # none is left for the next client


@pytest.mark.parametrize("address", ["127.0.0.1", "localhost"])
def test_a_program_finds_its_own_controller_at_the_local_address(sim, address):
    text = f'def p():\n socket_open("{address}", 29999)\n textmsg(socket_read_line())\nend\n'
    with PrimaryClient(sim.host) as primary:
        primary.send(text.encode())
        assert primary.message(0) == b"Connected: Universal Robots Dashboard Server"


@pytest.mark.parametrize(
    ("call", "sent", "result"),
    [
        ("socket_read_binary_integer(2, {s})", struct.pack(">ii", 5, -6), "[2,5,-6]"),
        ("socket_read_byte_list(3, {s})", b"\x01\x02\xff", "[3,1,2,255]"),
        ("socket_read_ascii_float(2, {s})", b" (1.5, -2)", "[2,1.5,-2.0]"),
        ("socket_read_line({s})", b"first\r\nsecond\n", "first"),
        ("socket_read_string({s}, prefix={a}, suffix={b})", b"xx<text>yy", "text"),
        ("socket_get_var({v}, {s})", b"speed 42\n", "42"),
    ],
)
def test_what_a_program_reads(sim, server, call, sent, result):
    names = {"s": '"s"', "a": '"<"', "b": '">"', "v": '"speed"'}
    lines = f"textmsg({call.format(**names)})", "sleep(10)"  # it is there while all is sent
    with start(sim, server, *lines) as primary, accept(server) as peer:
        for byte in sent:
            peer.send(bytes([byte]))
        assert primary.message(0) == b"open True"
        text = primary.message(0).decode()
        assert text.replace(".0", "") == result.replace(".0", "")


@pytest.mark.parametrize(
    ("call", "result"),
    [
        ('socket_read_binary_integer(2, "s", 0.1)', "[0,-1,-1]"),
        ('socket_read_byte_list(1, "s", 0.1)', "[0,-1]"),
        ('socket_read_line("s", 0.1)', ""),
        ('socket_read_byte_list(2, "other", 0.1)', "[0,-1,-1]"),
        ('socket_read_binary_integer(1, "other", 0.1)', "[0,-1]"),
        ('socket_send_int(1, "other")', "False"),
    ],
)
def test_what_does_not_come_fails_after_its_timeout(sim, server, call, result):
    with start(sim, server, f"textmsg({call})") as primary, accept(server):
        assert primary.message(0) == b"open True"
        assert primary.message(0).decode() == result


@pytest.mark.parametrize("closed", [False, True])
def test_bytes_that_come_are_returned_though_others_do_not(sim, server, closed):
    """Robotiq's URCap reads three digits of a number that may have one, and looks how many there are."""
    lines = (
        'socket_read_byte_list(1, "s", 20)',  # or its time begins before they are sent
        'textmsg(socket_read_byte_list(3, "s", 0.3))',
        'textmsg(socket_read_byte_list(3, "s", 0.1))',
    )
    with start(sim, server, *lines) as primary, accept(server) as peer:
        peer.sendall(b"!42")
        if closed:
            peer.shutdown(socket.SHUT_WR)
        assert primary.message(0) == b"open True"
        assert primary.message(0).decode() == "[2,52,50,-1]"
        assert primary.message(0).decode() == "[0,-1,-1,-1]"


def test_a_connection_that_is_refused_is_reported_and_blocks_nothing(sim, server):
    server.close()
    port = 1
    with PrimaryClient(sim.host) as primary:
        primary.send(f'def talk():\n  textmsg(socket_open("127.0.0.1", {port}))\nend\n'.encode())
        assert primary.message(0) == b"False"
        primary.send(b'def talk():\n  textmsg(socket_open("no.such.name", 1))\nend\n')
        assert primary.message(0) == b"False"


def test_stopping_the_program_closes_its_sockets(sim, server):
    with start(sim, server, "while True:", "  sync()", "end") as primary, accept(server) as peer:
        assert primary.message(0) == b"open True"
        primary.send(b"stop program\n")
        assert peer.recv(1) == b""


def test_who_sends_faster_than_a_message_a_period_does_not_end_the_program(server):
    """In one control period the program took them all, until it "used too much time"."""
    count = 3000
    lines = (
        "n = 0",
        f"while n < {count}:",
        '  x = socket_read_binary_integer(1, "s")',
        "  n = n + x[0]",
        "end",
        'textmsg("read ", n)',
    )
    with (
        SIM.spawn(speed=4.0) as sim,  # its periods are as long on its own clock
        start(sim, server, *lines) as primary,
        accept(server) as peer,
    ):
        began = sim.control.status()["time"]
        peer.sendall(struct.pack(">i", 7) * (2 * count))
        assert primary.message(0) == b"open True"
        assert primary.message(0, 30.0) == f"read {count}".encode()
        assert sim.control.status()["time"] - began > count * 0.002 * 0.9


ENDING = """def ending():
  socket_open("127.0.0.1", {port}, "orders")
  socket_open("127.0.0.1", {port}, "commands")
  global going = True
  mover = 0
  thread take_orders():
    while going:
      x = socket_read_binary_integer(1, "orders", 0)
      if x[0] > 0:
        set_tcp(p[0, 0, x[1] / 1000, 0, 0, 0])
      end
    end
  end
  taker = run take_orders()
  sync()
  socket_send_int(1, "commands")
  x = socket_read_binary_integer(1, "commands", 0)
  going = False
  join mover
  kill taker
  stopj(4.0)
  socket_close("orders")
  socket_close("commands")
end
"""
"""As UR's external control program ends: what was sent to a thread before the end is carried out."""


def test_what_a_thread_was_sent_before_the_end_of_the_program_is_not_lost(sim, server):
    port = server.getsockname()[1]
    for millimetres in range(101, 106):
        with PrimaryClient(sim.host) as primary:
            primary.send(ENDING.format(port=port).encode())
            with accept(server) as orders, accept(server) as commands:
                read(commands, 4)
                orders.sendall(struct.pack(">i", millimetres))
                commands.sendall(struct.pack(">i", 1))
                assert commands.recv(1) == b""
                assert sim.control.outputs("tcp_offset")["tcp_offset"][2] == millimetres / 1000
