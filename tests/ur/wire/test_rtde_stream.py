"""The state stream against the simulated controller, and against peers that misbehave."""

import contextlib
import math
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager

import pytest

from crtk_driver_ur.rtde.state_sample import StateSample
from crtk_driver_ur.rtde.stream import RtdeStream
from crtk_driver_ur.rtde.variables import OPTIONAL_OUTPUTS, OUTPUTS
from crtk_drivers.errors import ConnectionFailed, ConnectionLost, ProtocolError
from crtk_sim_backends.ur import SIM
from rigs.full_queue import full_queue
from rigs.waiting import LONG, eventually


def soon(seconds: float = LONG) -> float:
    return time.monotonic() + seconds


@contextmanager
def opened(host: str, **options) -> Iterator[RtdeStream]:
    stream = RtdeStream(host, **options)
    try:
        stream.open(soon())
        yield stream
    finally:
        stream.close()


def next_sample(stream: RtdeStream) -> StateSample:
    sample = stream.receive(soon())
    assert sample is not None
    return sample


def receive_until_broken(stream: RtdeStream) -> None:
    deadline = soon()
    while time.monotonic() < deadline:
        stream.receive(deadline)


def refused_open(host: str, seconds: float, words: str = "") -> ConnectionFailed:
    """Open until it fails, and says so.

    A fault comes into force shortly after it was injected, and who is held up has no time for another step.
    """
    deadline = soon()
    while time.monotonic() < deadline:
        with closing(RtdeStream(host)) as stream:
            try:
                stream.open(soon(seconds))
            except ConnectionFailed as error:
                if words in error.message:
                    return error
    pytest.fail("the stream can still be opened")


@contextmanager
def silent(sim, stream: RtdeStream) -> Iterator[None]:
    """Let the controller send nothing; what it sent until then has been received."""
    sim.control.inject("silence", port="rtde")
    try:
        eventually(lambda: sim.control.status()["faults"], "it says nothing")
        while stream.receive(soon(0.05)) is not None:
            pass
        yield
    finally:
        sim.control.clear("silence")


@pytest.fixture(scope="module")
def sim():
    with SIM.spawn(model="ur5e", version="5.12.4") as running:
        yield running


# Against the simulated controller


@pytest.mark.parametrize(
    ("model", "version", "rate"), [("ur5e", "5.12.4", 500.0), ("ur5", "3.15.8", 125.0)]
)
@pytest.mark.parametrize("protocol", [1, 2])
def test_streams_the_state_of_the_arm(model, version, rate, protocol):
    with (
        SIM.spawn(model=model, version=version) as controller,
        opened(controller.host, protocol_version=protocol) as stream,
    ):
        assert stream.frequency == rate
        assert stream.protocol_version == protocol
        assert str(stream.controller_version).startswith(version)
        assert set(stream.missing) <= OPTIONAL_OUTPUTS.keys()
        sample = next_sample(stream)
        truth = controller.control.outputs("actual_q", "robot_mode", "safety_mode")
        assert sample.actual_q == pytest.approx(truth["actual_q"], abs=1e-3)
        assert (sample.robot_mode, sample.safety_mode) == (7, 1)
        later = next_sample(stream)
        assert later.timestamp > sample.timestamp
        assert later.received >= sample.received


def test_optional_variable_that_the_controller_lacks_is_none(sim):
    with opened(sim.host) as stream:
        sample = next_sample(stream)
        assert "actual_current_as_torque" in stream.missing
        assert sample.actual_current_as_torque is None
        assert sample.tcp_offset is not None


def test_newer_controller_reports_torque():
    with SIM.spawn(model="ur5e", version="5.23.0") as new, opened(new.host) as stream:
        assert stream.missing == ()
        assert len(next_sample(stream).actual_current_as_torque) == 6


def test_lower_frequency(sim):
    with opened(sim.host, frequency=100.0) as stream:
        assert stream.frequency == 100.0
        first, second = next_sample(stream), next_sample(stream)
        steps = (second.timestamp - first.timestamp) * 100.0
        assert steps == pytest.approx(1 + second.lost + second.skipped, abs=1e-6)


def test_of_states_that_all_come_fewer_become_samples(sim):
    with opened(sim.host, frequency=125.0, sees_all=True) as stream:
        assert stream.frequency == 125.0
        first, second = next_sample(stream), next_sample(stream)
        steps = round((second.timestamp - first.timestamp) * 500.0)
        assert steps >= 4
        assert second.passed
        assert second.lost == stream.counters.lost == 0
        assert stream.counters.received >= 1 + steps


def test_every_controller_cycle_is_accounted_for(sim):
    with opened(sim.host) as stream:
        first = next_sample(stream)
        clock = lambda: sim.control.outputs("timestamp")["timestamp"]  # noqa: E731
        eventually(lambda: clock() > first.timestamp + 0.1, "the controller goes on")
        late = next_sample(stream)
        assert late.skipped > 10
        cycles = round((late.timestamp - first.timestamp) * stream.frequency)
        assert cycles == 1 + late.skipped + late.lost
        assert stream.counters.skipped >= late.skipped
        assert stream.counters.received == 2 + stream.counters.skipped


def test_split_packages_are_put_together(sim):
    sim.control.inject("split", port="rtde", size=7, direction="out")
    try:
        with opened(sim.host) as stream:
            for _ in range(20):
                next_sample(stream)
            assert stream.counters.malformed == 0
    finally:
        sim.control.clear("split")


def test_corrupt_bytes_end_in_a_protocol_error_or_are_counted(sim):
    with opened(sim.host) as stream:
        sim.control.inject("corrupt", port="rtde", every=1, direction="out")
        try:
            with pytest.raises((ProtocolError, ConnectionLost)) as caught:
                receive_until_broken(stream)
            assert f"{sim.host}:30004" in str(caught.value)
        finally:
            sim.control.clear("corrupt")


def test_silence_ends_at_the_deadline_without_blocking(sim):
    with opened(sim.host) as stream:
        next_sample(stream)
        with silent(sim, stream):
            before = time.monotonic()
            assert stream.receive(before + 0.05) is None
            assert time.monotonic() >= before + 0.05
        assert next_sample(stream).timestamp > 0


def test_closed_by_the_controller(sim):
    with opened(sim.host) as stream:
        next_sample(stream)
        sim.control.inject("disconnect", port="rtde", duration=LONG)
        try:
            with pytest.raises(ConnectionLost) as caught:
                receive_until_broken(stream)
            assert refused_open(sim.host, LONG).remedy
        finally:
            sim.control.clear("disconnect")
        assert caught.value.where == f"RTDE {sim.host}:30004"
        assert caught.value.remedy


def test_controller_that_is_killed():
    with SIM.spawn(model="ur5e") as doomed, opened(doomed.host) as stream:
        next_sample(stream)
        doomed.kill()
        with pytest.raises(ConnectionLost):
            receive_until_broken(stream)


def test_accepts_but_never_answers(sim):
    sim.control.inject("no_answer", port="rtde")
    try:
        error = refused_open(sim.host, 0.3, "protocol version is not answered")
        assert f"{sim.host}:30004" in str(error)
        assert error.remedy
    finally:
        sim.control.clear("no_answer")


def test_nobody_listens():
    stream = RtdeStream("127.0.0.1", port=1)
    with pytest.raises(ConnectionFailed, match=r"127\.0\.0\.1:1: cannot connect: .*refused"):
        stream.open(soon())
    stream.close()


@pytest.mark.real_time  # how many wait to be accepted is up to Linux
def test_connection_nobody_takes_ends_by_deadline():
    with (
        full_queue() as (host, port),
        closing(RtdeStream(host, port=port)) as stream,
        pytest.raises(ConnectionFailed, match="nothing answers at this address"),
    ):
        stream.open(soon(0.1))


def test_close_ends_a_connection_being_made():
    with full_queue() as (host, port), closing(RtdeStream(host, port=port)) as stream:
        threading.Timer(0.05, stream.close).start()
        with pytest.raises(ConnectionFailed, match="while connecting: the stream is closed"):
            stream.open(soon())


def test_name_that_cannot_be_resolved():
    stream = RtdeStream("no such host")
    with pytest.raises(ConnectionFailed, match="cannot be resolved"):
        stream.open(soon())
    stream.close()


def test_close_from_another_thread_ends_a_waiting_receive(sim):
    stream = RtdeStream(sim.host)
    stream.open(soon())
    with silent(sim, stream):
        caught: list[Exception] = []

        def wait() -> None:
            try:
                stream.receive(soon(60.0))
            except ConnectionLost as error:
                caught.append(error)

        thread = threading.Thread(target=wait)
        thread.start()
        stream.close()
        thread.join(LONG)
        assert not thread.is_alive()
        assert len(caught) == 1
        stream.close()


def test_a_stream_is_used_once(sim):
    stream = RtdeStream(sim.host)
    stream.open(soon())
    stream.close()
    with pytest.raises(RuntimeError, match="make a new one"):
        stream.open(soon())
    with pytest.raises(ConnectionLost, match="closed"):
        stream.receive(soon(0.1))


# Against a peer written here from the protocol guide, that sends what no controller should


def state_package(timestamp: float, spoiled: str = "", value: float = 0.0) -> bytes:
    codes = {"DOUBLE": "d", "VECTOR6D": "6d", "VECTOR3D": "3d", "VECTOR6INT32": "6i"}
    codes |= {"INT32": "i", "UINT32": "I", "UINT64": "Q"}
    body = struct.pack(">d", timestamp)
    for name, kind in list(OUTPUTS.items())[1:]:
        layout = struct.Struct(">" + codes[kind])
        count = len(layout.unpack(bytes(layout.size)))
        body += layout.pack(*(value if name == spoiled else 0,) * count)
    return struct.pack(">HBB", 4 + len(body), ord("U"), 1) + body


ACCEPT = {
    ord("V"): b"\x00\x04V\x01",
    ord("v"): b"\x00\x13v" + struct.pack(">IIII", 5, 23, 0, 0),
    ord("S"): b"\x00\x04S\x01",
}


def setup_reply(types: str, recipe: int = 1) -> bytes:
    return struct.pack(">HBB", 4 + len(types), ord("O"), recipe) + types.encode()


GOOD_SETUP = setup_reply(",".join(OUTPUTS.values()))


@contextmanager
def peer(answers: dict[int, bytes]) -> Iterator[tuple[int, Callable[[bytes], None]]]:
    """Listen on a free port and answer requests by their type.

    Yields the port, and a function that sends bytes to the client once it has started.
    """
    listener = socket.create_server(("127.0.0.1", 0))
    started = threading.Event()
    connections: list[socket.socket] = []

    def serve() -> None:
        connection, _ = listener.accept()
        connections.append(connection)
        # A client that closes with unread data resets the connection.
        with connection, contextlib.suppress(ConnectionResetError):
            data = b""
            while chunk := connection.recv(4096):
                data += chunk
                while len(data) >= 3:
                    size, kind = struct.unpack(">HB", data[:3])
                    data = data[size:]
                    connection.sendall(answers[kind])
                    if kind == ord("S"):
                        started.set()

    def send(data: bytes) -> None:
        assert started.wait(LONG)
        connections[0].sendall(data)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield listener.getsockname()[1], send
    finally:
        thread.join(LONG)
        listener.close()
        assert not thread.is_alive()


@contextmanager
def talking() -> Iterator[tuple[RtdeStream, Callable[[bytes], None]]]:
    with (
        peer({**ACCEPT, ord("O"): GOOD_SETUP}) as (port, send),
        opened("127.0.0.1", port=port) as stream,
    ):
        yield stream, send


def test_a_receive_that_waits_is_woken_and_misses_nothing():
    with talking() as (stream, send):
        send(state_package(1.0))
        next_sample(stream)
        with ThreadPoolExecutor() as pool:
            waiting = pool.submit(stream.receive, soon(60.0))
            assert stream.wake()
            assert waiting.result(LONG) is None
        assert stream.wake()
        assert stream.receive(soon(60.0)) is None  # the next one, where none waits
        assert stream.wake()
        assert stream.wake()
        send(state_package(1.002))
        found = stream.receive(soon()) or next_sample(stream)
        assert (found.timestamp, found.lost, found.skipped) == (1.002, 0, 0)
    assert not stream.wake()


def test_lost_packages_are_counted_from_the_controllers_clock():
    with talking() as (stream, send):
        send(state_package(1.0))
        assert next_sample(stream).lost == 0
        send(state_package(1.008))
        assert next_sample(stream).lost == 3
        assert (stream.counters.lost, stream.counters.gaps) == (3, 1)


@pytest.mark.parametrize("together", [False, True])
def test_what_was_told_between_two_samples_is_not_missed(together):
    """A program that ran no more for one state only."""
    stood, runs = (state_package(at, "runtime_state", of) for at, of in ((1.004, 1), (1.008, 2)))
    between = [state_package(1.002, "runtime_state", 2), stood, state_package(1.006)]
    with (
        peer({**ACCEPT, ord("O"): GOOD_SETUP}) as (port, send),
        opened("127.0.0.1", port=port, frequency=125.0, sees_all=True) as stream,
    ):
        send(state_package(1.0))
        assert next_sample(stream).passed == ()
        for package in [b"".join([*between, runs])] if together else [*between, runs]:
            send(package)
        found = next_sample(stream)
        assert (found.timestamp, found.lost, found.skipped) == (1.008, 0, 0)
        assert set(found.passed) == {0, 1, 2}
        assert stream.counters.received == 5


def test_what_is_told_beside_a_number_that_is_none_does_not_count():
    """Of a package that was passed over as of the newest: all of it is in doubt."""
    good = [state_package(at, "runtime_state", 2) for at in (1.002, 1.006, 1.008)]
    good.insert(1, state_package(1.004, "actual_q", math.nan))
    with (
        peer({**ACCEPT, ord("O"): GOOD_SETUP}) as (port, send),
        opened("127.0.0.1", port=port, frequency=125.0, sees_all=True) as stream,
    ):
        send(state_package(1.0, "runtime_state", 2))
        next_sample(stream)
        send(b"".join(good))
        found = next_sample(stream)
        assert (found.timestamp, found.lost) == (1.008, 0)
        assert set(found.passed) == {2}
        assert stream.counters.malformed == 1


def test_of_packages_that_came_together_the_newest_is_returned():
    with talking() as (stream, send):
        send(state_package(1.0) + state_package(1.002) + state_package(1.004))
        sample = next_sample(stream)
        while sample.timestamp < 1.004:
            sample = next_sample(stream)
        assert stream.counters.received == 3
        assert stream.counters.lost == 0


def test_controller_that_starts_again_is_noticed():
    with talking() as (stream, send):
        send(state_package(100.0))
        assert not next_sample(stream).restarted
        send(state_package(0.002))
        assert next_sample(stream).restarted
        assert (stream.counters.restarts, stream.counters.lost) == (1, 0)


@pytest.mark.parametrize(
    ("stamp", "counter"), [(1.0, "repeated"), (math.nan, "malformed"), (math.inf, "malformed")]
)
def test_package_with_an_old_or_impossible_stamp_is_no_sample(stamp, counter):
    with talking() as (stream, send):
        send(state_package(1.0))
        assert next_sample(stream).timestamp == 1.0
        send(state_package(stamp))
        assert stream.receive(soon(0.1)) is None
        assert getattr(stream.counters, counter) == 1
        send(state_package(1.004))
        assert next_sample(stream).timestamp == 1.004


REALS = [name for name, kind in OUTPUTS.items() if kind in ("DOUBLE", "VECTOR3D", "VECTOR6D")]


@pytest.mark.sweep(5)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e308, -1e308])
def test_a_package_with_anything_not_finite_is_no_sample(value, caplog):
    with talking() as (stream, send):
        for number, name in enumerate(REALS[1:], 1):
            send(state_package(0.5 + number, name, value))
            deadline = soon()
            while stream.counters.malformed < number:  # as soon as it has been taken
                assert stream.receive(soon(0.01)) is None
                assert time.monotonic() < deadline, "never: it comes"
            assert stream.nonsense == name
            assert stream.counters.malformed == number
            assert name in caplog.text
        send(state_package(100.0))
        assert next_sample(stream).timestamp == 100.0
        assert stream.nonsense == ""


def test_text_and_a_broken_package_do_not_disturb(caplog):
    body = b"\x05hallo" + b"\x03ctl" + b"\x02"
    text = struct.pack(">HB", 3 + len(body), ord("M")) + body
    with talking() as (stream, send), caplog.at_level("INFO"):
        send(text + b"\x00\x04X\x00" + state_package(1.0))
        assert next_sample(stream).timestamp == 1.0
        assert (stream.counters.texts, stream.counters.malformed) == (1, 1)
    assert "ctl: hallo" in caplog.text


def test_three_broken_packages_in_a_row_end_the_stream():
    with talking() as (stream, send):
        send(b"\x00\x04X\x00" * 3)
        with pytest.raises(ProtocolError, match="3 broken packages in a row"):
            stream.receive(soon())


def test_impossible_size_ends_the_stream():
    with talking() as (stream, send):
        send(b"\xff\xff\x55\x01")
        with pytest.raises(ProtocolError, match="claims 65535 bytes"):
            stream.receive(soon())


@pytest.mark.parametrize(
    ("answers", "error", "words"),
    [
        ({ord("S"): b"\x00\x04S\x00"}, ConnectionFailed, "refuses to start"),
        (
            {ord("O"): setup_reply(",".join(["NOT_FOUND"] * len(OUTPUTS)), 0)},
            ConnectionFailed,
            "lacks .*actual_q",
        ),
        (
            {ord("O"): setup_reply(",".join(["IN_USE", *list(OUTPUTS.values())[1:]]), 0)},
            ConnectionFailed,
            r"timestamp \(IN_USE\)",
        ),
        ({ord("O"): setup_reply("DOUBLE")}, ProtocolError, "1 types in the answer"),
        (
            {ord("O"): setup_reply(",".join(["INT32", *list(OUTPUTS.values())[1:]]))},
            ProtocolError,
            "timestamp is announced as INT32",
        ),
        ({ord("V"): b"HTTP/1.1 400 Bad Request\r\n"}, ProtocolError, "claims"),
        ({ord("v"): b"\x00\x04P\x01"}, ProtocolError, "controller version is StateReply"),
    ],
)
def test_wrong_answers_are_explained(answers, error, words):
    with peer({**ACCEPT, ord("O"): GOOD_SETUP, **answers}) as (port, _):
        stream = RtdeStream("127.0.0.1", port=port)
        with pytest.raises(error, match=words) as caught:
            stream.open(soon())
        stream.close()
    assert f"127.0.0.1:{port}" in str(caught.value)
    assert caught.value.remedy


def test_version_2_is_not_insisted_on():
    answers = {**ACCEPT, ord("V"): b"\x00\x04V\x00"}
    types = ",".join(OUTPUTS.values()).encode()
    answers[ord("O")] = struct.pack(">HB", 3 + len(types), ord("O")) + types
    body = state_package(2.0)[4:]

    with peer(answers) as (port, send), opened("127.0.0.1", port=port) as stream:
        send(struct.pack(">HB", 3 + len(body), ord("U")) + body)
        assert stream.protocol_version == 1
        assert next_sample(stream).timestamp == 2.0
