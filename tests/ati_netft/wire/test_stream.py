"""The stream over real datagrams: taken in batches, stamped, kept, and taken back."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from crtk_driver_ati_netft import stream as stream_module
from crtk_driver_ati_netft.profiles import AXIA, NETBOX, ONROBOT, Action, Mode
from crtk_driver_ati_netft.stream import Batch, RdtStream
from crtk_drivers.errors import ConnectionFailed, ConnectionLost
from crtk_drivers.kit.clock_fit import WallClock
from crtk_drivers.kit.sensing.datagrams import (
    MOST,
    SLOT,
    BatchReceiver,
    Datagrams,
    PlainReceiver,
    _Arrivals,
    ask_for_buffer,
    receiver_for,
)
from crtk_drivers.kit.sensing.sequence import Event
from crtk_drivers.samples import vector
from rigs.netft_peer import Peer, record
from rigs.waiting import LONG, eventually

FACTORS = vector([1e-6] * 3 + [1e-3] * 3)


def soon(seconds: float = LONG) -> float:
    return time.monotonic() + seconds


def once(peer: Peer, send: Callable[[], object]) -> None:
    """Have it send something when it is asked for the stream, but not again where it is asked twice."""

    def start(_: int) -> None:
        peer.on_start = None
        send()

    peer.on_start = start


@pytest.fixture
def peer() -> Iterator[Peer]:
    with Peer() as peer:
        once(peer, lambda: peer.stream(1))
        yield peer


@pytest.fixture(params=[BatchReceiver, PlainReceiver])
def stream(peer, request) -> Iterator[RdtStream]:
    stream = RdtStream(peer.host, NETBOX, FACTORS, port=peer.port, make_receiver=request.param)
    stream.open(soon())
    stream.receive(soon())
    yield stream
    stream.close()


def collect(stream: RdtStream, count: int) -> list[Batch]:
    """Receive until there are so many measurements."""
    batches: list[Batch] = []
    deadline = soon()
    while sum(map(len, batches)) < count:
        batch = stream.receive(deadline)
        assert batch is not None, f"{sum(map(len, batches))} of {count} arrived"
        batches.append(batch)
    return batches


# ------------------------------------------------------------------------------------------- receivers


@pytest.mark.parametrize("kind", [BatchReceiver, PlainReceiver])
def test_a_receiver_takes_all_that_arrived_with_its_length(kind) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here:
        here.bind(("127.0.0.1", 0))
        here.setblocking(False)
        receiver = kind(here)
        assert receiver.receive() is None
        datagrams = [b"", b"a", b"b" * 36, b"c" * 1440, b"d" * SLOT, b"e" * (SLOT + 1), b"f" * 40]
        before = time.monotonic()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as there:
            for data in datagrams:
                there.sendto(data, here.getsockname())
        found = receiver.receive()
        after = time.monotonic()
        assert found is not None
        if kind is BatchReceiver:
            assert found.lengths.tolist() == [len(data) for data in datagrams]
        for row, length, data in zip(found.slots, found.lengths.tolist(), datagrams, strict=True):
            assert row[: min(length, SLOT)].tobytes() == data[:SLOT]
            assert not length or length % 36 or len(data) <= SLOT, "a cut one must not look whole"
        assert before - 1e-3 <= found.arrivals[0] <= found.arrivals[-1] <= after
        assert receiver.receive() is None


@pytest.mark.parametrize("kind", [BatchReceiver, PlainReceiver])
def test_more_than_fits_at_once_is_taken_by_the_next_call(kind) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here:
        here.bind(("127.0.0.1", 0))
        here.setblocking(False)
        if ask_for_buffer(here, 1 << 20) < 1 << 20:
            pytest.skip("the kernel grants no buffer that holds them")
        receiver = kind(here)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as there:
            for i in range(MOST + 10):
                there.sendto(i.to_bytes(4, "big"), here.getsockname())
        first, second = receiver.receive(), None
        assert first is not None
        assert len(first.lengths) == MOST
        assert int.from_bytes(first.slots[MOST - 1, :4].tobytes(), "big") == MOST - 1
        second = receiver.receive()
        assert second is not None
        assert len(second.lengths) == 10
        assert int.from_bytes(second.slots[9, :4].tobytes(), "big") == MOST + 9


def test_the_kernel_tells_when_it_arrived_not_when_it_was_read() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here:
        here.bind(("127.0.0.1", 0))
        here.setblocking(False)
        receiver = BatchReceiver(here)
        receiver.receive()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as there:

            def is_stamped_as_it_arrives() -> bool:
                there.sendto(b"x", here.getsockname())
                sent = time.monotonic()
                time.sleep(0.1)
                found = receiver.receive()
                return found is not None and bool(found.arrivals[0] < sent + 0.09)

            eventually(
                is_stamped_as_it_arrives, "the kernel begins with it a moment after it was asked"
            )
        assert receiver.kernel_stamps


@pytest.mark.parametrize("shift", [3600, -3600])
def test_a_wall_clock_that_is_set_does_not_move_the_arrivals(monkeypatch, shift) -> None:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as there,
    ):
        here.bind(("127.0.0.1", 0))
        here.setblocking(False)
        receiver = BatchReceiver(here)
        there.sendto(b"x", here.getsockname())
        assert receiver.receive() is not None
        shifted = WallClock(wall=lambda: time.time_ns() + shift * 10**9)
        monkeypatch.setattr(receiver._arrivals, "_wall_clock", shifted)
        before = time.monotonic()
        there.sendto(b"x", here.getsockname())
        found = receiver.receive()
    assert found is not None
    assert before <= found.arrivals[0] <= time.monotonic()


@pytest.mark.parametrize("shift", [2.0, 3600.0, -2.0, -3600.0])
def test_what_waits_while_the_wall_clock_is_set_keeps_its_age(monkeypatch, shift) -> None:
    arrivals = _Arrivals()
    arrivals.of(np.array([time.time_ns()]), 1)
    monkeypatch.setattr(arrivals, "_looked", time.monotonic() - 1.8)
    shifted = WallClock(wall=lambda: time.time_ns() + int(shift * 1e9))
    monkeypatch.setattr(arrivals, "_wall_clock", shifted)
    ages = np.array([1.5, 1.0, 0.5, 0.1])
    now, wall = time.monotonic(), time.time_ns()
    stamps = wall - ages * 1e9 + np.array([0.0, 0.0, shift, shift]) * 1e9
    found = arrivals.of(stamps.astype(np.int64), len(ages))
    assert now - found == pytest.approx(ages, abs=0.05)


def test_the_receive_buffer_is_what_the_kernel_granted() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here:
        assert ask_for_buffer(here, 8192) == 8192
        granted = ask_for_buffer(here, 1 << 28)
        assert 8192 < granted <= 1 << 28


# ------------------------------------------------------------------------------------------- the stream


def test_measurements_are_in_si_units(stream, peer) -> None:
    peer.send(record(2, 1001, 0x80020000, (1000000, -2000000, 3, 4000, -5000, 6)))
    (batch,) = collect(stream, 1)
    assert batch.values == pytest.approx(np.array([[1.0, -2.0, 3e-6, 4.0, -5.0, 6e-3]]))
    assert batch.status.tolist() == [0x80020000]
    assert batch.sequence.tolist() == [2]
    assert batch.ticks.tolist() == [1001]
    assert abs(batch.times[0] - time.monotonic()) < LONG


def test_what_arrives_between_two_calls_is_one_batch(stream, peer) -> None:
    peer.stream(200, rdt=2, ft=1001)
    batch = stream.receive(soon(), begin=time.monotonic() + 0.3)
    assert batch is not None
    assert batch.sequence.tolist() == list(range(2, 202))
    assert stream.receive(time.monotonic() + 0.01) is None


@pytest.mark.parametrize("mode", [Mode.REALTIME, Mode.SINGLE, Mode.BUFFERED])
def test_each_mode_has_its_command_and_any_number_of_records_is_taken(peer, mode) -> None:
    def start() -> None:
        several = [record(i, 1000 + i) for i in range(1, 61)]
        peer.send(b"".join(several[:40]), several[40], b"".join(several[41:]))

    once(peer, start)
    stream = RdtStream(peer.host, AXIA, FACTORS, port=peer.port, mode=mode)
    stream.open(soon())
    try:
        found = collect(stream, 60)
    finally:
        stream.close()
    assert np.concatenate([b.sequence for b in found]).tolist() == list(range(1, 61))
    assert peer.requests[0] == (AXIA.starts[mode], 0)
    assert stream.counters["lost"] == 0


def test_a_mode_that_the_family_does_not_have_is_refused() -> None:
    with pytest.raises(ValueError, match="onrobot has no mode buffered"):
        RdtStream("127.0.0.1", ONROBOT, FACTORS, mode=Mode.BUFFERED)


def test_rubbish_is_counted_and_the_rest_is_taken(stream, peer) -> None:
    whole = record(2, 1001)
    peer.send(whole[:35], b"", whole + b"x", b"\xff" * 100, whole, whole[:-1] * 3, record(3, 1002))
    batches = collect(stream, 2)
    assert np.concatenate([b.sequence for b in batches]).tolist() == [2, 3]
    deadline = soon()
    while stream.counters["malformed"] < 5 and time.monotonic() < deadline:
        stream.receive(time.monotonic() + 0.01)
    assert stream.counters["malformed"] == 5
    assert stream.counters["lost"] == 0


def test_a_stranger_is_not_heard(stream, peer) -> None:
    stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with stranger:
        stranger.bind(("127.0.0.2", 0))
        for i in range(50):
            stranger.sendto(record(2 + i, 1001 + i), stream._socket.getsockname())
        peer.stream(3, rdt=2, ft=1001)
        collect(stream, 3)
    assert stream.counters["received"] == 4


def test_rubbish_without_end_ends_the_connection(stream, peer, monkeypatch) -> None:
    monkeypatch.setattr(stream_module, "MALFORMED_IN_A_ROW", 20)
    with pytest.raises(ConnectionLost, match="5 bytes"):  # noqa: PT012 - the peer must not be faster
        while True:
            peer.send(b"12345")
            stream.receive(time.monotonic() + 0.01)


@pytest.mark.parametrize("seed", range(5))
def test_any_datagrams_are_survived(stream, peer, seed) -> None:
    random = np.random.default_rng(seed)
    begin, near = time.monotonic(), 1
    for _ in range(60):
        for _ in range(int(random.integers(1, 20))):
            near += int(random.integers(0, 3))
            numbers = random.integers(0, 2**32, 9, dtype=np.uint32)
            if random.random() < 0.9:
                numbers[:2] = near, near * 7
            data = numbers.astype(">u4").tobytes() * int(random.integers(1, 4))
            if random.random() < 0.2:
                data = data[: int(random.integers(0, len(data)))]
            peer.send(data)
        while (batch := stream.receive(time.monotonic() + 0.002)) is not None:
            assert len(batch.values) == len(batch.times) == len(batch.ticks) == len(batch)
            assert (batch.times <= time.monotonic()).all()
            assert (batch.times > begin - LONG).all()
    counters = stream.counters
    assert counters["received"] > 0
    assert all(np.isfinite(list(counters.values())))


def test_loss_repetition_and_reordering_are_counted(stream, peer) -> None:
    peer.send(*(record(n, 999 + n) for n in (2, 3, 3, 6, 5, 7, 10)))
    batches = collect(stream, 5)
    assert np.concatenate([b.sequence for b in batches]).tolist() == [2, 3, 6, 7, 10]
    counters = stream.counters
    assert (counters["lost"], counters["duplicates"], counters["late"]) == (3, 1, 1)


# -------------------------------------------------------------------------------------- silence


class HeldUp(BatchReceiver):
    """Who has found nothing is held up before it asks for the stream, and more has come meanwhile."""

    is_held_up = False

    def receive(self) -> Datagrams | None:
        found = super().receive()
        if found is None and self.is_held_up:
            time.sleep(1.5 * stream_module.PATIENCE)
        return found


def test_who_was_held_up_takes_what_has_come_before_it_asks_again(peer, monkeypatch) -> None:
    peer.on_start, peer.rate = None, 100.0
    receivers: list[HeldUp] = []

    def held_up(here: socket.socket) -> HeldUp:
        receivers.append(HeldUp(here))
        return receivers[-1]

    stream = RdtStream(peer.host, NETBOX, FACTORS, port=peer.port, make_receiver=held_up)
    with contextlib.closing(stream):
        stream.open(soon())
        collect(stream, 1)
        asked: list[int] = []
        monkeypatch.setattr(stream, "_start", lambda: asked.append(0))
        receivers[-1].is_held_up = True
        for _ in range(3):
            collect(stream, 1)
        assert not asked


def test_silence_is_answered_with_a_request(stream, peer) -> None:
    deadline = soon()
    while [command for command, _ in peer.requests].count(2) < 2:
        assert time.monotonic() < deadline, peer.requests
        assert stream.receive(time.monotonic() + 0.02) is None


def test_a_stream_that_was_taken_is_taken_back_and_told(stream, peer) -> None:
    begun = time.monotonic()
    # If it does not come at once it was not there, and nobody took it.
    while not stream.counters["takeovers"]:
        assert time.monotonic() < begun + LONG
        once(peer, lambda: peer.stream(5, ft=1800 + int(7000.0 * (time.monotonic() - begun))))
        batch = collect(stream, 1)[-1]
    assert (Event.TAKEN_OVER, 0) in batch.events
    assert stream.counters["takeovers"] == 1
    assert stream.counters["lost"] == 0


def test_a_stream_that_was_held_up_was_not_taken(stream, peer) -> None:
    def send() -> None:
        peer.stream(5, rdt=2, ft=1001)  # on its way before the request came
        peer.stream(5, ft=1010)

    once(peer, send)
    events = [event for batch in collect(stream, 10) for event, _ in batch.events]
    assert events == [Event.BEGUN]
    assert stream.counters["takeovers"] == 0


def test_a_series_that_was_not_asked_for_is_told(stream, peer) -> None:
    peer.stream(10, rdt=2, ft=1001)
    peer.stream(5, rdt=1, ft=1011)
    events = [event for batch in collect(stream, 15) for event, _ in batch.events]
    assert events == [Event.TAKEN_OVER]
    assert stream.counters["takeovers"] == 1


def test_a_sensor_that_was_switched_off_and_on_is_told(stream, peer) -> None:
    peer.stream(500, rdt=2, ft=1_000_000)
    collect(stream, 500)
    peer.on_start = lambda _: peer.stream(5, ft=20)
    events = [event for batch in collect(stream, 5) for event, _ in batch.events]
    assert Event.RESTARTED in events
    assert stream.counters["restarts"] >= 1


def test_a_port_that_is_closed_ends_the_connection() -> None:
    with Peer() as peer:
        once(peer, lambda: peer.stream(1))
        stream = RdtStream(peer.host, NETBOX, FACTORS, port=peer.port)
        stream.open(soon())
        stream.receive(soon())
    try:
        with pytest.raises(ConnectionLost, match="closed") as caught:  # noqa: PT012
            while True:
                stream.receive(soon())
    finally:
        stream.close()
    assert str(peer.port) in caught.value.where
    assert caught.value.remedy


# ------------------------------------------------------------------------------- opening and closing


def test_an_open_that_nobody_answers_fails_in_time(peer) -> None:
    peer.on_start = None
    stream = RdtStream(peer.host, NETBOX, FACTORS, port=peer.port)
    with pytest.raises(ConnectionFailed, match="nothing answers"):
        stream.open(time.monotonic() + 1.0)
    peer.wait_for(2, count=2)
    with pytest.raises(ConnectionLost, match="closed"):
        stream.receive(soon())


def test_an_open_at_a_closed_port_says_so() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with pytest.raises(ConnectionFailed, match="closed"):
        RdtStream("127.0.0.1", NETBOX, FACTORS, port=port).open(time.monotonic() + 1.0)


def test_an_open_that_waits_can_be_ended(peer) -> None:
    peer.on_start = None
    stream = RdtStream(peer.host, NETBOX, FACTORS, port=peer.port)
    failed: list[ConnectionFailed] = []

    def run() -> None:
        try:
            stream.open(soon(600.0))
        except ConnectionFailed as error:
            failed.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    peer.wait_for(2)
    stream.abort()
    thread.join(LONG)
    assert not thread.is_alive()
    assert failed
    with pytest.raises(ConnectionFailed):
        stream.open(soon(600.0))


def test_closing_stops_the_stream_and_may_be_done_twice(stream, peer) -> None:
    stream.close()
    stream.close()
    peer.wait_for(0)
    once(peer, lambda: peer.stream(1, ft=1100))
    stream.open(soon())
    assert stream.receive(soon()) is not None


def test_counters_survive_a_new_connection(stream, peer) -> None:
    peer.send(record(2, 1001), record(5, 1004))
    collect(stream, 2)
    begun = time.monotonic()
    stream.close()
    once(peer, lambda: peer.stream(1, ft=1100 + int(7000.0 * (time.monotonic() - begun))))
    stream.open(soon())
    assert stream.counters["lost"] == 2
    assert stream.counters["series"] == 2
    assert stream.counters["restarts"] == 0


# ------------------------------------------------------------------------------------------ requests


def test_after_a_bias_the_stream_is_asked_for_again(stream, peer) -> None:
    once(peer, lambda: peer.stream(3, ft=1700))
    stream.request(Action.BIAS)
    batches = collect(stream, 3)
    commands = [command for command, _ in peer.requests]
    assert commands.count(0x42) == 1
    asked = commands.index(0x42)
    assert asked < len(commands) - 1
    assert set(commands[:asked]) == set(commands[asked + 1 :]) == {2}, (
        "once more, where one is held up"
    )
    assert [event for batch in batches for event, _ in batch.events] == [Event.BEGUN]
    assert stream.counters["takeovers"] == 0


def test_a_stream_on_hold_is_not_asked_for(stream, peer) -> None:
    stream.hold()
    peer.wait_for(0)
    assert stream.receive(time.monotonic() + 0.3) is None
    *before, held = [command for command, _ in peer.requests]
    assert held == 0
    assert set(before) == {2}
    once(peer, lambda: peer.stream(3, ft=5000))
    stream.resume()
    collect(stream, 3)
    assert stream.counters["takeovers"] == 0


def test_what_a_family_does_not_know_is_not_sent(stream) -> None:
    with pytest.raises(ValueError, match="netbox has no request for unbias"):
        stream.request(Action.UNBIAS)


def test_the_usual_receiver_takes_batches() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here:
        assert isinstance(receiver_for(here), BatchReceiver)
