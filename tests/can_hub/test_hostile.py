"""Nonsense at every door: the hub answers as it should, serves the others, and never dies."""

import contextlib
import json
import os
import socket
import tty

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from crtk_sim_backends.can import SIM, frames
from crtk_sim_backends.can.slcan import frame_command, parse_frame
from crtk_sim_backends.can.socketcand import CommandError, frame_message, parse_send
from crtk_sim_backends.control import token
from rigs.can_hub_doors import drain, frame, open_bus, receive
from rigs.examples import examples
from rigs.waiting import LONG, eventually

WIRE = settings(
    max_examples=examples(40),
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)

SOCKETCAND_WORDS = st.sampled_from(
    b"<|>| |< open can0 >|< rawmode >|< send 123 1 ff >|< echo >|< send 123 9 1 2 3 >|open|"
    b"< send -1 1 1 >|< send 1_0 1 1 >|\xff\xff\xff".split(b"|")
)
SLCAN_WORDS = st.sampled_from(
    b"O\r|C\r|L\r|S6\r|S9\r|s1234\r|t1231FF\r|T123456780\r|\r|t8000\r|t1239\r|tttt\r|F\r|V\r|N\r|"
    b"Z1\r|r1238\r|\a\n".split(b"|")
)


def pieces(words):
    return st.lists(st.one_of(words, st.binary(max_size=40)), max_size=12)


@pytest.fixture(scope="module")
def sim():
    with SIM.spawn(socketcand_port=0) as running:
        yield running
        assert running.stop() == 0


@pytest.fixture(scope="module")
def two(sim):
    """Two well-behaved clients."""
    with (
        open_bus(sim, "crtk", name="native-w1") as one,
        open_bus(sim, "crtk", name="native-w2") as other,
    ):
        yield one, other


@pytest.fixture
def witnesses(two):
    """The two, with nothing to be read."""
    for one, other in (two, two[::-1]):
        one.send(frame(0x7EF, b""), timeout=LONG)
        drain(other)
    return two


def still_serves(witnesses):
    """A frame passes, after whatever the nonsense has put onto the bus."""
    one, other = witnesses
    one.send(frame(0x7EE, b"alive"), timeout=LONG)
    while receive(other)[0].arbitration_id != 0x7EE:
        pass
    while one.recv(0.0) is not None:
        pass


@WIRE
@given(packets=st.lists(st.binary(min_size=1, max_size=80), max_size=12))
def test_the_unix_socket_survives_anything(sim, witnesses, packets):
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as client:
        client.connect(sim.paths["crtk"])
        client.settimeout(LONG)
        for packet in packets:
            client.send(packet)
    still_serves(witnesses)


@WIRE
@given(packets=pieces(SOCKETCAND_WORDS))
def test_socketcand_survives_anything(sim, witnesses, packets):
    with socket.create_connection((sim.host, sim.ports["socketcand"]), LONG) as client:
        with contextlib.suppress(ConnectionError):
            for packet in packets:
                client.sendall(packet)
        still_serves(witnesses)


@WIRE
@given(packets=pieces(SLCAN_WORDS))
def test_slcan_survives_anything(sim, witnesses, packets):
    with terminal(sim) as fd:
        for packet in packets:
            os.write(fd, packet)
        still_serves(witnesses)


@WIRE
@given(
    packets=pieces(st.sampled_from([b"{", b"}\n", b'{"do": "status"}\n', b'{"do": 1}\n', b"[]\n"]))
)
def test_the_control_socket_survives_anything(sim, witnesses, packets):
    first = json.dumps({"token": token()}).encode() + b"\n"
    for begin in (b"", first):
        with (
            contextlib.suppress(ConnectionError),  # it is closed at the first line that is none
            socket.create_connection((sim.host, sim.ports["control"]), LONG) as client,
        ):
            for packet in (begin, *packets):
                client.sendall(packet)
    still_serves(witnesses)
    assert sim.control.status()["bitrate"] == 0


@contextlib.contextmanager
def terminal(sim):
    """The adapter's terminal as a program opens it, in raw mode; closed channel before and after."""
    fd = os.open(sim.ttys["slcan"], os.O_RDWR | os.O_NOCTTY)
    try:
        tty.setraw(fd)
        close_channel(fd)
        yield fd
        close_channel(fd)
    finally:
        os.close(fd)


def close_channel(fd):
    """Close it, whatever half a command there was, and read all answers."""
    os.write(fd, b"\r\rC\rZ0\rN\r")
    answers = b""
    while not answers.endswith(b"NA123\r"):
        answers += os.read(fd, 4096)


def ask(fd, command):
    """The answer to an slcan command, up to the carriage return or BEL that ends it."""
    os.write(fd, command + b"\r")
    answer = b""
    while not answer.endswith((b"\r", b"\a")):
        answer += os.read(fd, 1)
    return answer


def test_the_adapter_answers_each_command_as_the_manual_says(sim):
    with terminal(sim) as fd:
        for command, answer in [
            (b"V", b"V1013\r"),
            (b"N", b"NA123\r"),
            (b"F", b"\a"),  # only while open
            (b"t1230", b"\a"),
            (b"C", b"\a"),
            (b"S8", b"\r"),
            (b"S9", b"\a"),
            (b"s031C", b"\r"),
            (b"Z2", b"\a"),
            (b"Z1", b"\r"),
            (b"O", b"\r"),
            (b"O", b"\a"),
            (b"S6", b"\a"),  # only while closed
            (b"F", b"F00\r"),
            (b"t12321122", b"z\r"),
            (b"T123456780", b"Z\r"),
            (b"r1234", b"z\r"),
            (b"R123456784", b"Z\r"),
            (b"t12311122", b"\a"),
            (b"t8000", b"\a"),
            (b"T200000000", b"\a"),
            (b"Q", b"\a"),
            (b"C", b"\r"),
            (b"L", b"\r"),
            (b"t1230", b"\a"),  # it only listens
        ]:
            assert ask(fd, command) == answer, command


def test_time_stamps_are_milliseconds_of_a_minute(sim, witnesses):
    with terminal(sim) as fd:
        assert ask(fd, b"Z1") == ask(fd, b"O") == b"\r"
        witnesses[0].send(frame(0x321, b"\xaa"))
        line = b""
        while not line.endswith(b"\r"):
            line += os.read(fd, 1)
        assert line.startswith(b"t3211AA")
        assert len(line) == len(b"t3211AA0000\r")
        assert int(line[7:11], 16) < 60_000
    receive(witnesses[1])


def talk(client, message):
    client.sendall(message)
    return client.recv(1000)


def test_socketcand_keeps_to_its_protocol(sim):
    with socket.create_connection((sim.host, sim.ports["socketcand"]), LONG) as client:
        assert client.recv(100) == b"< hi >"
        assert talk(client, b"< send 123 1 ff >") == b"< error unknown command >"
        assert talk(client, b"< rawmode >") == b"< error unknown command >"
        assert talk(client, b"< open can1 >") == b"< error could not open bus >"
        assert talk(client, b"< open can0 >") == b"< ok >"
        assert talk(client, b"< echo >") == b"< echo >"
        assert talk(client, b"< nonsense >") == b"< error unknown command >"
        assert talk(client, b"<rawmode>") == b"< ok >"


def test_frames_do_not_run_into_the_answer_that_a_client_waits_for(sim, witnesses):
    """python-can fails to open a busy bus when they do."""
    with socket.create_connection((sim.host, sim.ports["socketcand"]), LONG) as client:
        assert client.recv(100) == b"< hi >"
        assert talk(client, b"< open can0 >") == b"< ok >"
        client.sendall(b"< rawmode >")
        eventually(lambda: sim.control.status()["nodes"]["socketcand"]["listening"])
        witnesses[0].send(frame(0x5, b""))
        receive(witnesses[1])
        assert client.recv(1000) == b"< ok >"
        assert talk(client, b"< echo >").startswith(b"< frame 005 ")


def test_commands_may_come_in_pieces(sim, witnesses):
    with socket.create_connection((sim.host, sim.ports["socketcand"]), LONG) as client:
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for byte in b"< open can0 >< rawmode >< send 123 2 a bc >":
            client.sendall(bytes([byte]))
        (message,) = receive(witnesses[1])
        assert (message.arbitration_id, bytes(message.data)) == (0x123, b"\x0a\xbc")
    receive(witnesses[0])


CAN_IDS = st.one_of(
    st.integers(0, 0x7FF), st.integers(0, 0x1FFFFFFF).map(lambda n: n | frames.EXTENDED)
)


@given(CAN_IDS, st.binary(max_size=8), st.booleans())
def test_slcan_lines_survive_writing_and_reading(can_id, data, remote):
    raw = frames.pack(can_id, data)
    if remote:
        raw = frames.pack(can_id | frames.REMOTE, b"", len(data))
    assert parse_frame(frame_command(raw).decode().rstrip("\r")) == raw


@given(st.lists(st.binary(max_size=6), max_size=12))
def test_what_is_no_socketcand_frame_is_refused(words):
    try:
        raw = parse_send([b"send", *words])
    except CommandError:
        return
    assert frames.fault_of(raw) is None


def test_socketcand_messages():
    assert frame_message(frames.pack(0x1, b"\x0a\xbc"), 1.5) == b"< frame 001 1.500000 0ABC >"
    assert frame_message(frames.pack(0x1), 1.5) == b"< frame 001 1.500000  >"
    extended = frames.pack(0x1 | frames.EXTENDED, b"\x01")
    assert frame_message(extended, 2.0) == b"< frame 00000001 2.000000 01 >"
    assert frame_message(frames.error_frame(0x40), 2.0) == b"< error 040 2.000000 >"
    assert frame_message(frames.pack(0x1 | frames.REMOTE), 2.0) == b""


@pytest.mark.real_time  # how much fits in a socket is up to Linux
def test_a_client_that_does_not_read_loses_frames_and_nobody_else_does(sim, witnesses):
    one, other = witnesses
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as lazy:
        lazy.connect(sim.paths["crtk"])
        eventually(lambda: "native" in sim.control.status()["nodes"])
        for number in range(3000):
            one.send(frame(0x100, number.to_bytes(2, "little")), timeout=LONG)
            (got,) = receive(other)
            assert got.data == number.to_bytes(2, "little")
        assert sim.control.status()["nodes"]["native"]["missed"] > 0
