"""The drivers' kit over real wires: sockets of the system, and what arrives on them cut anywhere."""

import itertools
import os
import select
import socket
import threading
import time

import pytest

from crtk_drivers.device import Capabilities, Sensor, StopPolicy
from crtk_drivers.device.giving_up import given_up_by
from crtk_drivers.errors import ConnectionFailed, ConnectionLost, ProtocolError
from crtk_drivers.kit import (
    BadData,
    ClosedByPeer,
    FrameDecoder,
    LineDecoder,
    Linked,
    MessageLink,
    RequestWorker,
    RoundRobin,
    SeekingDecoder,
    TcpTransport,
    UdpTransport,
    until,
)
from crtk_drivers.kit.serial_port import SerialPort
from crtk_drivers.kit.serial_server import ServerAddress, connect
from crtk_drivers.kit.waiting_steps import LATE_LOOKS
from rigs.full_queue import full_queue
from rigs.waiting import LONG, eventually


def soon() -> float:
    return time.monotonic() + LONG


@pytest.fixture
def listener():
    with socket.create_server(("127.0.0.1", 0)) as made:
        made.settimeout(LONG)
        yield made


@pytest.fixture
def transport(listener):
    made = TcpTransport("127.0.0.1", listener.getsockname()[1], "scale")
    yield made
    made.close()


@pytest.fixture
def peer(listener, transport):
    transport.open(soon())
    accepted, _ = listener.accept()
    with accepted:
        accepted.settimeout(LONG)
        yield accepted


def test_bytes_go_both_ways(transport, peer):
    transport.write(b"ask")
    assert peer.recv(16) == b"ask"
    peer.sendall(b"answer")
    assert transport.read(soon()) == b"answer"


def test_a_read_ends_at_its_deadline(transport, peer):
    began = time.monotonic()
    assert transport.read(began + 0.08) == b""
    assert 0.08 <= time.monotonic() - began < LONG


def test_what_lies_there_is_returned_when_the_deadline_is_past(transport, peer):
    peer.sendall(b"late")
    data = b""
    end = soon()
    while not data and time.monotonic() < end:
        data = transport.read(0.0)
    assert data == b"late"


def test_a_connection_that_was_closed_is_told_from_one_that_was_lost(transport, peer):
    peer.close()
    with pytest.raises(ClosedByPeer, match=r"scale 127\.0\.0\.1:\d+: the other side closed"):
        transport.read(soon())


def test_a_reset_connection_is_lost(transport, peer):
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\0\0\0\0\0\0\0")
    peer.close()
    with pytest.raises(ConnectionLost, match="connection is gone") as caught:
        transport.read(soon())
    assert not isinstance(caught.value, ClosedByPeer)


def test_it_is_opened_again_after_it_was_lost(listener, transport, peer):
    peer.close()
    with pytest.raises(ConnectionLost):
        transport.read(soon())
    transport.open(soon())
    again, _ = listener.accept()
    with again:
        again.sendall(b"again")
        assert transport.read(soon()) == b"again"


def test_a_closed_one_is_not_connected(transport):
    with pytest.raises(ConnectionLost, match="it is closed"):
        transport.read(soon())
    with pytest.raises(ConnectionLost, match="it is closed"):
        transport.write(b"x")


def test_nobody_there_is_told_with_a_way_out(listener):
    port = listener.getsockname()[1]
    listener.close()
    nobody = TcpTransport("127.0.0.1", port, "scale", "Is the scale on?")
    with pytest.raises(ConnectionFailed, match="cannot connect: Connection refused") as caught:
        nobody.open(soon())
    assert caught.value.remedy == "Is the scale on?"
    assert not nobody.is_open


def test_tcp_connection_nobody_takes_ends_by_deadline():
    with full_queue() as (host, port):
        with pytest.raises(ConnectionFailed, match="cannot connect: no connection in time"):
            TcpTransport(host, port).open(time.monotonic() + 0.1)
        with pytest.raises(TimeoutError, match="no connection in time"):
            connect(ServerAddress(host, port), 0.1)


def test_a_name_that_is_none_is_told():
    with pytest.raises(ConnectionFailed, match="cannot connect"):
        TcpTransport("no-such-host.invalid", 1).open(soon())


def test_a_full_buffer_is_lost_and_does_not_wait(transport, peer):
    began = time.monotonic()

    def fill():
        while True:
            transport.write(bytes(1 << 20))

    with pytest.raises(ConnectionLost, match="gone"):
        fill()
    assert time.monotonic() - began < LONG


def test_what_waits_is_given_up_from_another_thread(transport, peer):
    threading.Timer(0.05, transport.abort).start()
    with pytest.raises(ConnectionLost, match="given up"):
        transport.read(time.monotonic() + 60.0)
    with pytest.raises(ConnectionFailed, match="given up"):
        transport.open(time.monotonic() + 60.0)


def test_datagrams_are_whole():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as device:
        device.bind(("127.0.0.1", 0))
        device.settimeout(LONG)
        transport = UdpTransport(*device.getsockname())
        transport.open(soon())
        transport.write(b"start")
        data, sender = device.recvfrom(100)
        assert data == b"start"
        for datagram in (b"one", b"two"):
            device.sendto(datagram, sender)
        assert [transport.read(soon()) for _ in range(2)] == [b"one", b"two"]
        transport.close()


LINES = b"1\n22\n333\n"


@pytest.mark.parametrize("cut", range(len(LINES) + 1))
def test_where_lines_are_cut_does_not_matter(cut):
    decoder = LineDecoder(int)
    assert decoder.feed(LINES[:cut]) + decoder.feed(LINES[cut:]) == [1, 22, 333]


@pytest.mark.parametrize("data", [b"x\n", b"\xff\n", b"1" * 201])
def test_who_asks_may_have_a_damaged_line_refused(data):
    with pytest.raises(BadData, match="end of line" if len(data) > 200 else r"^b'"):
        LineDecoder(int, strict=True).feed(data)


@pytest.mark.parametrize("bad", [b"x\n", b"\xff\n", b"1" * 201 + b"\n"])
def test_a_damaged_line_is_left_out_and_counted(bad):
    decoder = LineDecoder(int)
    assert decoder.feed(b"1\n" + bad + b"2\n") == [1, 2]
    assert (decoder.damage.total, decoder.damage.in_a_row) == (1, 0)


@pytest.mark.parametrize("cut", range(12))
def test_half_a_line_takes_no_good_one_with_it(cut):
    decoder = LineDecoder(lambda line: int(line.removeprefix("N ")), end=b"\r\n")
    data = b"x1\r\nN 2\r\nN 3\r\n"[1:]
    assert decoder.feed(data[:cut]) + decoder.feed(data[cut:])[-2:] in ([2, 3], [1, 2, 3])
    decoder = LineDecoder(lambda line: int(line.removeprefix("N ")), end=b"\r\n")
    assert decoder.feed(b"\nN 2\r\n") == [2], "it began between the two bytes of an end"
    assert decoder.damage.total == 0


def test_a_line_without_an_end_is_forgotten_up_to_the_next_end():
    decoder = LineDecoder(int, end=b"\r\n", longest=5)
    found = [number for piece in (b"123456", b"7\r", b"\n8\r\n") for number in decoder.feed(piece)]
    assert found == [8]
    assert decoder.damage.last == "6 bytes without an end of line"


def test_bytes_that_are_no_text_may_be_replaced():
    assert LineDecoder(str, errors="replace").feed(b"a\xffb\n") == ["a\ufffdb"]


def size_of(data: bytes) -> int:
    """Of a frame that begins with a colon and its size."""
    if data[:1] not in (b"", b":"):
        raise BadData("no colon")
    return data[1] if len(data) > 1 else 0


FRAMES = b":\x03a:\x02:\x04bc"


@pytest.mark.parametrize("cut", range(len(FRAMES) + 1))
def test_where_frames_are_cut_does_not_matter(cut):
    decoder = FrameDecoder(size_of, lambda frame: frame[2:])
    assert decoder.feed(FRAMES[:cut]) + decoder.feed(FRAMES[cut:]) == [b"a", b"", b"bc"]


def test_what_is_no_frame_is_refused():
    with pytest.raises(BadData, match="no colon"):
        FrameDecoder(size_of, bytes).feed(b"x")
    with pytest.raises(BadData, match="3a 03 78: invalid literal"):
        FrameDecoder(size_of, lambda frame: int(frame[2:]), strict=True).feed(b":\x03x")


def test_a_damaged_frame_is_left_out_and_counted():
    decoder = FrameDecoder(size_of, lambda frame: int(frame[2:]))
    assert decoder.feed(b":\x031:\x03x:\x032") == [1, 2]
    assert decoder.damage.total == 1
    assert decoder.damage.last.startswith("3a 03 78: invalid literal")


def summed(body: bytes) -> bytes:
    """Return the body of a frame of eight bytes: a head of one, and the sum of the others at its end."""
    if sum(body[1:7]) & 0xFF != body[7]:
        raise ValueError("its sum is wrong")
    return body[1:7]


@pytest.mark.parametrize("cut", range(25))
def test_one_damaged_frame_counts_once_whatever_is_in_it(cut):
    """Bytes like its head are in it, which begin no frame."""
    decoder = SeekingDecoder(b"\x02", lambda _: 8, summed)
    good = b"\x02abcdef" + bytes([sum(b"abcdef") & 0xFF])
    data = good + b"\x02" * 7 + b"x" + good
    assert decoder.feed(data[:cut]) + decoder.feed(data[cut:]) == [b"abcdef"] * 2
    assert decoder.damage.total == 1


def test_damaged_frames_in_a_row_are_counted_each():
    decoder = SeekingDecoder(b"\x02", lambda _: 8, summed)
    good = b"\x02abcdef" + bytes([sum(b"abcdef") & 0xFF])
    assert decoder.feed(good + 3 * (b"\x02\x02bcdefx") + good) == [b"abcdef"] * 2
    assert decoder.damage.total == 3


def test_a_link_returns_messages_and_begins_anew(listener, transport):
    link = MessageLink(transport, lambda: LineDecoder(int), "Is it a counter?")
    link.open(soon())
    first, _ = listener.accept()
    with first:
        first.sendall(b"1\n2\n3")
        assert link.read(soon()) == [1, 2]
        assert link.read(time.monotonic() + 0.05) == []
        first.sendall(b"0\n9\n")
        assert link.read(soon()) == [30, 9]
    link.open(soon())
    second, _ = listener.accept()
    with second:
        second.sendall(b"4\n")
        assert link.read(soon()) == [4]
        second.sendall(b"five\n6\n")
        assert link.read(soon()) == [6]
        assert link.damaged == 1


@pytest.fixture
def link(transport):
    return MessageLink(transport, lambda: LineDecoder(int), "Is it a counter?", lost_after=5)


def test_what_is_sent_is_unheard_until_a_message(transport, peer):
    link = MessageLink(transport, lambda: LineDecoder(int))
    assert link.unheard == 0.0, "nothing was sent"
    link.write(b"first\n")
    eventually(lambda: link.unheard > 0.05, "its age grows")
    link.write(b"second\n")
    assert link.unheard > 0.05, "the oldest counts"
    peer.sendall(b"4")
    assert link.read(time.monotonic() + 0.02) == []
    assert link.unheard > 0.0, "half a message is none"
    peer.sendall(b"2\n")
    assert link.read(soon()) == [42]
    assert link.unheard == 0.0
    link.write(b"third\n")
    link.open(soon())
    assert link.unheard == 0.0, "it is another connection"


@pytest.fixture
def counter(listener, link):
    link.open(soon())
    peer, _ = listener.accept()
    with peer:
        yield peer


def test_damaged_records_in_a_row_are_told_then_lost(link, counter):
    counter.sendall(b"1\nx\nx\n2\n")
    assert link.read(soon()) == [1, 2]
    assert not link.notes
    counter.sendall(b"x\n" * 3)
    assert link.read(time.monotonic() + 0.02) == []
    (note,) = link.notes
    assert note.text == "3 in a row, the last b'x'"
    counter.sendall(b"3\n")
    assert link.read(soon()) == [3]
    assert not link.notes
    counter.sendall(b"x\n" * 5)
    with pytest.raises(ProtocolError, match="5 damaged records in a row, the last b'x'") as caught:
        link.read(soon())
    assert caught.value.remedy == "Is it a counter?"
    assert link.counters == {"damaged": 10.0}
    link.open(soon())
    assert link.damaged == 10
    assert not link.notes


class CounterDevice(Linked[int], Sensor):
    """A sensor that is nothing but its link."""

    address = "counter"
    capabilities = Capabilities(measured=("measured_cf",), stop=StopPolicy(0.0, "never moves"))

    def __init__(self, link):
        self._link = link

    def open(self, deadline):
        self._link.open(deadline)

    def close(self):
        self._link.close()

    def read(self, deadline):
        self._link.read(deadline)


def test_linked_device_reports_damage_of_its_link(link, counter):
    device = CounterDevice(link)
    assert device.counters == {"damaged": 0.0}
    assert device.notes == ()
    counter.sendall(b"1\n" + b"x\n" * 3)
    device.read(soon())
    device.read(time.monotonic() + 0.02)
    assert device.counters == {"damaged": 3.0}
    (note,) = device.notes
    assert note.text == "3 in a row, the last b'x'"


def test_what_never_ends_a_line_is_lost(link, counter):
    counter.sendall(b"\x80" * 2000)
    with pytest.raises(ProtocolError, match="without an end of line"):
        link.read(soon())


def test_late_datagrams_are_answers_to_no_later_question():
    """Each is read for itself: those that stay make all that follow late, one by one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as device:
        device.bind(("127.0.0.1", 0))
        device.settimeout(LONG)
        link = MessageLink(UdpTransport(*device.getsockname()), lambda: LineDecoder(int))
        link.open(soon())
        link.write(b"?")
        _, asker = device.recvfrom(8)
        for late in (b"1\n", b"x\n", b"2\n"):
            device.sendto(late, asker)
        assert link.came() == [1, 2]
        assert link.came() == []
        device.sendto(b"3\n", asker)
        assert link.read(soon()) == [3]
        link.close()


def test_the_message_that_is_wanted_is_waited_for(link, counter):
    counter.sendall(b"ney\n7\n300\n")
    assert link.await_message(soon(), lambda number: number > 99, ask=b"?") == 300
    assert counter.recv(8) == b"?"


def test_a_question_whose_answer_is_damaged_is_asked_again(link, counter):
    counter.sendall(b"1\nx\n")

    def answer() -> None:
        for _ in range(2):
            assert counter.recv(1) == b"?"
        counter.sendall(b"300\n")

    thread = threading.Thread(target=answer)
    thread.start()
    found = link.await_message(soon(), lambda number: number > 99, ask=b"?", again=0.02)
    thread.join()
    assert found == 300


def test_what_came_in_place_of_the_answer_is_told(link, counter):
    counter.sendall(b"1\n2\nx\n")
    with pytest.raises(ConnectionFailed) as caught:
        link.await_message(time.monotonic() + 0.1, lambda number: number > 99)
    assert "2 other messages, the last 2 and 1 damaged records, the last b'x'" in str(caught.value)


@pytest.mark.parametrize("waits", ["read", "open"])
def test_what_open_waits_for_is_given_up_by_the_core(waits, transport, peer):
    """So that no device has to see to it that the program can end."""
    asked = threading.Event()
    threading.Timer(0.05, asked.set).start()
    with given_up_by(asked.is_set):
        with pytest.raises(ConnectionLost, match="given up"):
            transport.read(time.monotonic() + 60.0)
        with pytest.raises(ConnectionFailed, match="given up"):
            transport.open(time.monotonic() + 60.0)
    assert transport.open(soon()) is None, "and later ones are not"


@pytest.mark.parametrize("kind", ["server", "terminal"])
def test_a_serial_line_that_open_waits_for_is_given_up(kind, listener):
    master, slave = os.openpty()
    host, number = listener.getsockname()
    name = os.ttyname(slave) if kind == "terminal" else f"socket://{host}:{number}"
    asked = threading.Event()
    threading.Timer(0.05, asked.set).start()
    with SerialPort(name) as port, given_up_by(asked.is_set):
        with pytest.raises(ConnectionLost, match="given up"):
            port.read(time.monotonic() + 60.0)
        if kind == "server":
            with pytest.raises(ConnectionFailed, match="given up"):
                port.open(time.monotonic() + 60.0)
    os.close(master)
    os.close(slave)


def test_a_link_waits_for_the_rest_of_what_it_forgets(listener, transport):
    link = MessageLink(transport, lambda: LineDecoder(str))
    link.open(soon())
    peer, _ = listener.accept()
    with peer:
        peer.sendall(b"dam")
        timer = threading.Timer(0.05, lambda: peer.sendall(b"aged\n"))
        timer.start()
        link.forget(quiet=1.0)
        timer.join()
        peer.sendall(b"whole\n")
        assert link.read(soon()) == ["whole"]


def test_a_link_that_is_never_quiet_is_not_waited_for_for_ever(listener, transport, monkeypatch):
    monkeypatch.setattr(transport, "read", lambda deadline: b"x")
    MessageLink(transport, lambda: LineDecoder(str)).forget(quiet=0.002)


def test_a_flood_of_what_is_no_message_keeps_no_link_from_its_deadline():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 0))
        transport = UdpTransport(*peer.getsockname())
        link = MessageLink(transport, lambda: LineDecoder(str))
        link.open(soon())
        link.write(b"?")
        _, client = peer.recvfrom(8)
        for _ in range(8):
            peer.sendto(b"no end", client)
        assert link.read(time.monotonic()) == []
        assert transport.read(time.monotonic()) == b"no end", "more is coming, for all it knows"
        link.close()


def test_a_link_forgets_what_was_not_asked_for(listener, transport):
    link = MessageLink(transport, lambda: LineDecoder(int))
    link.open(soon())
    peer, _ = listener.accept()
    with peer:
        peer.sendall(b"1\n2")
        assert link.read(soon()) == [1]
        link.forget()
        peer.sendall(b"7\n")
        assert link.read(soon()) == [7]


def test_a_worker_carries_out_requests_in_order_and_wakes_who_waits():
    done = []
    worker = RequestWorker(lambda n: n * n, "squares", release=lambda: done.append("released"))
    worker.start()
    for number in (2, 3):
        worker.submit(number)
    replies = []
    while len(replies) < 2:
        assert select.select([worker.wake_fd], [], [], LONG)[0]
        replies += worker.take_replies()
    assert replies == [4, 9]
    assert worker.take_replies() == []
    worker.stop()
    worker.join(soon())
    assert done == ["released"]


def test_a_worker_that_waits_is_interrupted():
    waits, free = threading.Event(), threading.Event()

    def wait(request: None) -> bool:
        waits.set()
        return free.wait(60.0)

    worker = RequestWorker(wait, "waits", interrupt=free.set)
    worker.start()
    worker.submit(None)
    assert waits.wait(LONG)
    began = time.monotonic()
    worker.stop()
    worker.join(soon())
    assert time.monotonic() - began < LONG


def test_each_has_its_turn_once_an_interval():
    slow = RoundRobin(["volts", "heat"], 2.0)
    assert [slow.due(now) for now in (10.0, 10.5, 11.0, 11.9, 12.0)] == [
        "volts",
        None,
        "heat",
        None,
        "volts",
    ]
    slow.restart()
    assert slow.due(12.1) == "volts"
    assert RoundRobin([], 1.0).due(5.0) is None


def test_until_ends_with_the_condition_or_the_time():
    left = iter([False, False, True])
    steps = until(lambda: next(left), LONG)
    assert next(steps) is None
    assert next(steps) is None
    with pytest.raises(StopIteration) as ended:
        next(steps)
    assert ended.value.value is True


@pytest.mark.parametrize(
    ("told", "wanted"), [(0, True), (LATE_LOOKS, True), (LATE_LOOKS + 1, False)]
)
def test_who_was_held_up_for_longer_than_he_waits_looks_before_he_gives_up(told, wanted):
    cycles = itertools.count()
    steps = until(lambda: next(cycles) >= told, -1.0)
    for _ in range(min(told, LATE_LOOKS)):
        assert next(steps) is None
    with pytest.raises(StopIteration) as ended:
        next(steps)
    assert ended.value.value is wanted
