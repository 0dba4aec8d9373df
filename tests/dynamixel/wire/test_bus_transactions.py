"""Transactions with one servo over a pseudo-terminal: answers, refusals, silence, damage, late replies."""

import subprocess
import time
from collections import deque
from contextlib import contextmanager
from random import Random

import pytest

from crtk_driver_dynamixel import protocol1, protocol2
from crtk_driver_dynamixel.bus import BROADCAST, Ping, ServoLink
from crtk_driver_dynamixel.replies import ServoCorrupt, ServoRefused, ServoSilent
from crtk_drivers.errors import ConnectionLost
from rigs.dynamixel_packets import status1, status2
from rigs.dynamixel_peer import Peer, open_bus
from rigs.waiting import LONG

SHORT = 0.5
"""Seconds of patience where silence is expected, and answers of a peer that may be held up."""
BRIEF = 0.3
"""The same where nothing that is expected could come too late."""


@contextmanager
def bus_on(links=None, *, budget=LONG):
    with Peer() as peer:
        bus = open_bus(peer, links, budget=budget)
        try:
            yield peer, bus
        finally:
            bus.close()


def test_ping_read_and_write():
    with bus_on() as (peer, bus):
        peer.script(status2(1, b"\x06\x04\x26"), status2(1, b"\xa6\0\0\0", 0x80), status2(1))
        assert bus.ping(1) == Ping(1, 1030, 0x26, False)
        reply = bus.read_reply(1, 132, 4)
        assert (reply.data, reply.alert) == (b"\xa6\0\0\0", True)
        bus.write(1, 116, b"\0\2\0\0")
        assert peer.requests == [
            protocol2.ping(1),
            protocol2.read(1, 132, 4),
            protocol2.write(1, 116, b"\0\2\0\0"),
        ]
        assert (bus.counters(1).replies, bus.counters(1).alerts) == (3, 1)


@pytest.mark.parametrize(
    ("call", "request_bytes"),
    [
        (lambda bus: bus.write(1, 116, b"abcd"), protocol2.write(1, 116, b"abcd")),
        (lambda bus: bus.reboot(1), protocol2.reboot(1)),
    ],
)
def test_commands_wait_for_their_answer(call, request_bytes):
    with bus_on() as (peer, bus):
        peer.script(status2(1), status2(1, error=0x02))
        call(bus)
        assert peer.requests == [request_bytes]
        with pytest.raises(ServoRefused, match="does not know the instruction"):
            call(bus)


def test_a_refusal_names_the_servo_and_what_to_do():
    with bus_on() as (peer, bus):
        peer.script(status2(3, error=0x87))
        with pytest.raises(ServoRefused) as caught:
            bus.write(3, 11, b"\4")
        assert caught.value.error == 7
        for part in (peer.name, "id 3", "write of 04 at 11", "access error", "control table"):
            assert part in str(caught.value)
        assert len(peer.requests) == 1  # it would be refused again
        assert (bus.counters(3).refused, bus.counters(3).alerts) == (1, 1)


def test_silence_is_asked_again_and_then_told():
    with bus_on(budget=BRIEF) as (peer, bus):
        with pytest.raises(ServoSilent, match=r"id 4: read of 2 bytes at 144: no answer") as caught:
            bus.read(4, 144, 2)
        assert isinstance(caught.value, TimeoutError)
        assert peer.requests == [protocol2.read(4, 144, 2)] * 2
        assert bus.counters(4).timeouts == 2


def test_an_answer_to_the_second_attempt():
    with bus_on(budget=SHORT) as (peer, bus):
        peer.script(None, status2(4, b"ab"))
        assert bus.read(4, 144, 2) == b"ab"


def test_damage_is_told():
    with bus_on(budget=SHORT) as (peer, bus):
        broken = status2(4, b"ab")[:-1] + b"!"
        peer.script(broken, broken)
        with pytest.raises(ServoCorrupt, match="damaged"):
            bus.read(4, 144, 2)
        assert bus.counters(4).corrupt == 2
        assert bus.line_counters.bad_crc == 2


@pytest.mark.parametrize("size", [1, 2, 5])
def test_an_answer_in_pieces(size):
    with bus_on() as (peer, bus):
        packet = status2(1, b"\xff\xff\xfd\x00")
        pieces = [packet[i : i + size] for i in range(0, len(packet), size)]
        peer.script([part for piece in pieces for part in (piece, 0.001)])
        assert bus.read(1, 132, 4) == b"\xff\xff\xfd\x00"


def test_noise_and_foreign_answers_are_passed_over():
    with bus_on() as (peer, bus):
        peer.script(
            b"\xff\xff\xfd\x00noise" + status2(7, b"ab") + status2(1, b"abc") + status2(1, b"ab")
        )
        assert bus.read(1, 132, 2) == b"ab"
        assert bus.line_counters.strays == 2  # of another servo, and of another length
        assert bus.line_counters.garbage > 0


def test_an_echo_is_passed_over():
    with bus_on() as (peer, bus):
        request = protocol2.read(1, 132, 2)
        peer.script(request + status2(1, b"ab"), [request, 0.01, status2(1, b"cd")])
        assert bus.read(1, 132, 2) == b"ab"
        assert bus.read(1, 132, 2) == b"cd"
        assert bus.line_counters.echoes == 2


def test_an_answer_before_the_request_is_not_taken():
    with bus_on() as (peer, bus):
        peer.script(status2(1, b"ab"), [BRIEF, status2(1, b"cd")])
        assert bus.read(1, 132, 2) == b"ab"
        peer.say(status2(1, b"xx"))  # doubled
        assert bus.read(1, 132, 2) == b"cd"
        assert bus.counters(1).strays == 1


def reply_to_read(request, data):
    """The answer to a read of one servo: to one of as many bytes as `data` these, to a probe others."""
    length = int.from_bytes(request[10:12], "little")
    return status2(request[4], data if length == len(data) else bytes(length))


def until_answered(call):
    deadline = time.monotonic() + LONG
    while True:
        try:
            return call()
        except ServoSilent:
            assert time.monotonic() < deadline


def test_a_late_answer_is_not_taken_for_the_next_one():
    """The next one could not be told from it: the servo is asked for something else before."""
    with bus_on(budget=BRIEF) as (peer, bus):
        peer.script([3 * BRIEF, status2(1, b"ab")])
        peer.answer_all(lambda request: reply_to_read(request, b"cd"))
        with pytest.raises(ServoSilent):
            bus.read(1, 132, 2, attempts=1)
        assert until_answered(lambda: bus.read(1, 132, 2)) == b"cd"
        assert bus.line_counters.probes > 0
        assert peer.requests[1] == protocol2.read(1, 0, 1)
        probes = bus.line_counters.probes
        assert bus.read(1, 132, 2) == b"cd"
        assert bus.line_counters.probes == probes


def test_nothing_is_asked_of_a_servo_whose_answer_could_not_be_told_from_a_late_one():
    with bus_on(budget=BRIEF) as (peer, bus):
        for _ in range(2):
            with pytest.raises(ServoSilent):
                bus.read(1, 132, 2)
        assert peer.requests == [protocol2.read(1, 132, 2)] * 2 + [protocol2.read(1, 0, 1)] * 2


def test_what_is_owed_is_remembered_when_the_port_is_opened_anew():
    with bus_on(budget=SHORT) as (peer, bus):
        with pytest.raises(ServoSilent):
            bus.read(1, 132, 2, attempts=1)
        bus.open()
        peer.script(status2(1, b"ab") + status2(1, b"p"), status2(1, b"cd"))
        assert bus.read(1, 132, 2) == b"cd"


def test_a_late_answer_that_differs_costs_no_time():
    with bus_on(budget=SHORT) as (peer, bus):
        peer.script(None, status2(1, b"ab") + status2(2, b"cd"))
        with pytest.raises(ServoSilent):
            bus.read(1, 132, 2, attempts=1)
        assert bus.read(2, 132, 2) == b"cd"
        assert (bus.line_counters.probes, bus.line_counters.strays) == (0, 1)


@pytest.mark.parametrize("seed", range(6))
def test_an_adapter_that_stalls(seed):
    """However long it holds replies back, each answer is to the request just made."""
    random, held, asked = Random(seed), deque(), [0]

    def answer(request):
        asked[0] += 1
        held.append(reply_to_read(request, asked[0].to_bytes(4, "little")))
        comes = random.choice((0, 0, 1, 2, 50))
        return b"".join(held.popleft() for _ in range(min(comes, len(held))))

    with bus_on(budget=0.003) as (peer, bus):
        peer.answer_all(answer)
        answers = 0
        for _ in range(150):
            before = asked[0]
            try:
                number = int.from_bytes(
                    bus.read(1, 132, 4, attempts=random.choice((1, 2))), "little"
                )
            except ServoSilent:
                continue
            assert before < number <= asked[0]
            answers += 1
        assert answers > 0
        assert bus.line_counters.probes > 0


def test_who_is_there():
    with bus_on(budget=SHORT) as (peer, bus):
        peer.script(None, status2(2, b"\x06\x04\x26"), None)
        assert bus.ping_many([1, 2, 3]) == [Ping(2, 1030, 38, False)]


def test_writes_that_are_not_answered_are_not_waited_for():
    with bus_on(budget=30.0) as (peer, bus):
        bus.set_link(1, answers_writes=False)
        begin = time.monotonic()
        bus.write(1, 116, b"a")
        bus.write(BROADCAST, 64, b"\0")
        assert time.monotonic() - begin < 20.0
        assert peer.wait_for(2) == [
            protocol2.write(1, 116, b"a"),
            protocol2.write(BROADCAST, 64, b"\0"),
        ]


def test_protocol_1():
    with bus_on({5: ServoLink(1, 0.0)}) as (peer, bus):
        request = protocol1.read(5, 36, 2)
        peer.script(
            status1(5),
            status1(5, b"\x12\x34", 0x20),
            request + status1(5, b"\x56\x78"),
            status1(5, b"", 0x08),
        )
        assert bus.ping(5) == Ping(5, 0, 0, False)
        reply = bus.read_reply(5, 36, 2)
        assert (reply.data, reply.alert, reply.hardware) == (b"\x12\x34", True, 0x20)
        assert bus.read(5, 36, 2) == b"\x56\x78"
        with pytest.raises(ServoRefused, match="out of range"):
            bus.write(5, 30, b"\xff\xff")
        assert bus.line_counters.echoes == 1


def test_endless_noise_ends_in_time():
    with bus_on(budget=BRIEF) as (peer, bus):
        peer.script([part for _ in range(40) for part in (b"\xff\xff\xfd\x00\x01\x40\x00", 0.01)])
        with pytest.raises(ServoSilent):
            bus.read(1, 132, 2, attempts=1)
        assert len(peer.requests) == 1


@pytest.mark.real_time  # its noise is made by `cat`
@pytest.mark.parametrize("ask", ["one", "group"])
def test_noise_without_a_pause_does_not_keep_the_thread(ask):
    """Whoever looks finds more of it, as from a servo that has lost its rate on a fast line."""
    with bus_on(budget=BRIEF) as (peer, bus):
        babbler = subprocess.Popen(["cat", "/dev/zero"], stdout=peer.master)
        try:
            peer.until_heard()
            if ask == "one":
                with pytest.raises(ServoSilent):
                    bus.read(1, 132, 2, attempts=1)
            else:
                assert not any(bus.fast_sync_read([1, 2], 132, 2).data)
        finally:
            babbler.kill()
            babbler.wait()


def test_an_unplugged_adapter():
    with Peer() as peer:
        bus = open_bus(peer)
    with pytest.raises(ConnectionLost, match="adapter is gone"):
        bus.read(1, 132, 2)
    bus.close()
