"""Groups over a pseudo-terminal: all at once, and what a silent or damaged servo costs the others."""

import time
from collections import deque
from contextlib import contextmanager
from random import Random

import pytest

from crtk_driver_dynamixel import groups, protocol1, protocol2
from crtk_driver_dynamixel.bus import ServoLink
from crtk_driver_dynamixel.replies import Failure
from rigs.dynamixel_packets import fast_status2, status1, status2
from rigs.dynamixel_peer import FAST, Peer, open_bus
from rigs.waiting import LONG

SHORT = 0.5
"""Seconds of patience where silence is expected, and answers of a peer that may be held up."""
BRIEF = 0.3
"""The same where nothing that is expected could come too late."""


@contextmanager
def bus_on(links=None, *, budget=LONG, baud=FAST):
    with Peer() as peer:
        bus = open_bus(peer, links, budget=budget, baud=baud)
        try:
            yield peer, bus
        finally:
            bus.close()


def data(id, turn=0):
    return bytes((id, turn, 0, 0))


def statuses(ids, turn=0):
    return b"".join(status2(id, data(id, turn)) for id in ids)


def fast(ids, turn=0):
    return fast_status2([(id, 0, data(id, turn)) for id in ids])


def answers(turn=0):
    """What servos answer to whatever read; data of 4 bytes tell their id and the turn."""

    def answer(request):
        body = request[8:-2]
        if request[7] == 0x02:
            length = int.from_bytes(body[2:4], "little")
            return status2(request[4], data(request[4], turn) if length == 4 else bytes(length))
        return (fast if request[7] == 0x8A else statuses)(body[4:], turn)

    return answer


def failures(result):
    return {reply.id: reply.failure for reply in result.replies if reply.failure}


def values(result):
    return {reply.id: reply.data for reply in result.replies if reply.data is not None}


def test_a_sync_read():
    with bus_on() as (peer, bus):
        peer.script(statuses([1, 2, 3]))
        result = bus.sync_read([1, 2, 3], 132, 4)
        assert peer.requests == [protocol2.sync_read([1, 2, 3], 132, 4)]
        assert result.complete
        assert not result.alert
        assert result.block == data(1) + data(2) + data(3)
        assert values(result) == {id: data(id) for id in (1, 2, 3)}
        assert [bus.counters(id).replies for id in (1, 2, 3)] == [1, 1, 1]


def test_a_bulk_read():
    with bus_on() as (peer, bus):
        peer.script(status2(1, b"abcd") + status2(2, b"e"))
        result = bus.bulk_read([(1, 132, 4), (2, 146, 1)])
        assert peer.requests == [protocol2.bulk_read([(1, 132, 4), (2, 146, 1)])]
        assert result.block == b"abcde"


def test_fast_reads():
    with bus_on() as (peer, bus):
        peer.script(fast([1, 2, 3]), fast_status2([(1, 0x80, b"abcd"), (2, 0, b"e")]))
        result = bus.fast_sync_read([1, 2, 3], 132, 4)
        assert result.block == data(1) + data(2) + data(3)
        result = bus.fast_bulk_read([(1, 132, 4), (2, 146, 1)])
        assert result.block == b"abcde"
        assert result.alert
        assert [reply.alert for reply in result.replies] == [True, False]
        assert peer.requests == [
            protocol2.fast_sync_read([1, 2, 3], 132, 4),
            protocol2.fast_bulk_read([(1, 132, 4), (2, 146, 1)]),
        ]


@pytest.mark.parametrize("size", [1, 3, 15, 31])
def test_replies_in_pieces(size):
    with bus_on() as (peer, bus):
        for stream, read in (
            (statuses([1, 2, 3]), bus.sync_read),
            (fast([1, 2, 3]), bus.fast_sync_read),
        ):
            pieces = [stream[i : i + size] for i in range(0, len(stream), size)]
            peer.script([part for piece in pieces for part in (piece, 0.0005)])
            assert read([1, 2, 3], 132, 4).block == data(1) + data(2) + data(3)


def test_alerts_and_refusals_are_kept_for_each_servo():
    with bus_on() as (peer, bus):
        peer.script(
            status2(1, data(1)) + status2(2, data(2), 0x80) + status2(3, data(3)),
            status2(1, data(1)) + status2(2, b"", 0x87) + status2(3, data(3)),
        )
        group = bus.sync_group([1, 2, 3], 132, 4)
        result = group.run()
        assert result.complete
        assert result.alert
        assert [reply.alert for reply in result.replies] == [False, True, False]
        result = group.run()
        assert not result.complete
        assert result.alert
        assert (result.replies[1].error, result.replies[1].failure) == (7, Failure.REFUSED)
        assert values(result) == {1: data(1), 3: data(3)}
        assert result.block == data(1) + bytes(4) + data(3)
        assert (bus.counters(2).alerts, bus.counters(2).refused) == (2, 1)


def test_stuffed_values():
    nasty = {1: b"\xff\xff\xfd\xff", 2: b"\xfd\xff\xff\xfd", 3: b"\xff\xff\xff\xfd"}
    with bus_on() as (peer, bus):
        peer.script(
            b"".join(status2(id, value) for id, value in nasty.items()),
            fast_status2([(id, 0, value) for id, value in nasty.items()]),
        )
        assert values(bus.sync_read([1, 2, 3], 132, 4)) == nasty
        assert values(bus.fast_sync_read([1, 2, 3], 132, 4)) == nasty


def test_a_damaged_reply_costs_its_own_data():
    with bus_on(budget=SHORT) as (peer, bus):
        stream = bytearray(statuses([1, 2, 3]))
        stream[24] ^= 4
        peer.script(bytes(stream))
        result = bus.sync_read([1, 2, 3], 132, 4)
        assert failures(result) == {2: Failure.CORRUPT}
        assert values(result) == {1: data(1), 3: data(3)}
        assert len(peer.requests) == 1
        assert bus.counters(2).corrupt == 1


def test_a_silent_servo_whose_followers_go_on():
    """Seen from the replies: the rest is there, nothing is waited for or asked again."""
    with bus_on(budget=5.0) as (peer, bus):
        peer.script(statuses([1, 3]))
        result = bus.sync_read([1, 2, 3], 132, 4)
        assert failures(result) == {2: Failure.SILENT}
        assert values(result) == {1: data(1), 3: data(3)}
        assert len(peer.requests) == 1


def test_a_silent_servo_whose_followers_stall():
    with bus_on(budget=SHORT) as (peer, bus):
        peer.script(statuses([1]), statuses([3, 4]))
        result = bus.sync_read([1, 2, 3, 4], 132, 4)
        assert failures(result) == {2: Failure.SILENT}
        assert values(result) == {1: data(1), 3: data(3), 4: data(4)}
        assert peer.requests[1:] == [protocol2.sync_read([3, 4], 132, 4)]
        assert bus.line_counters.probes == 0


def test_a_truncated_reply_whose_followers_stall():
    with bus_on(budget=SHORT) as (peer, bus):
        peer.script(statuses([1]) + statuses([2])[:-4], statuses([3]))
        result = bus.sync_read([1, 2, 3], 132, 4)
        assert failures(result) == {2: Failure.CORRUPT}
        assert values(result) == {1: data(1), 3: data(3)}


def test_a_chain_without_power_ends_in_time():
    with bus_on(budget=BRIEF) as (peer, bus):
        result = bus.sync_read(range(1, 9), 132, 4)
        waited = groups.MOST_GAPS
        expected = [Failure.SILENT] * waited + [Failure.LEFT_OUT] * (8 - waited)
        assert list(failures(result).values()) == expected
        assert len(peer.requests) == waited


def test_who_is_silent_again_and_again_is_left_out_and_tried_at_times():
    with bus_on(budget=SHORT) as (peer, bus):
        group = bus.sync_group([1, 2, 3], 132, 4)
        for _ in range(groups.LEAVE_OUT_AFTER):
            peer.script(statuses([1, 3]))
            assert failures(group.run()) == {2: Failure.SILENT}
        assert group.left_out == (2,)
        asked = protocol2.sync_read([1, 3], 132, 4)
        for _ in range(groups.LEAVE_OUT_AFTER + 1, groups.TRY_EVERY):
            peer.script(statuses([1, 3]))
            result = group.run()
            assert failures(result) == {2: Failure.LEFT_OUT}
            assert values(result) == {1: data(1), 3: data(3)}
            assert peer.requests[-1] == asked
        peer.script(statuses([1, 3]), None)
        assert failures(group.run()) == {2: Failure.SILENT}
        assert peer.requests[-2:] == [asked, protocol2.sync_read([2], 132, 4)]
        for _ in range(groups.TRY_EVERY - 1):
            peer.script(statuses([1, 3]))
            assert failures(group.run()) == {2: Failure.LEFT_OUT}
        peer.script(statuses([1, 3]), statuses([2]))
        assert group.run().complete
        assert group.left_out == ()
        peer.script(statuses([1, 2, 3]))
        assert group.run().complete
        assert peer.requests[-1] == protocol2.sync_read([1, 2, 3], 132, 4)


def test_a_chain_that_gets_its_power_back_is_found_again():
    with bus_on(budget=0.1) as (peer, bus):
        group = bus.sync_group([1, 2], 132, 4)
        for _ in range(groups.LEAVE_OUT_AFTER):
            group.run()
        assert set(group.left_out) == {1, 2}
        bus.latency_budget = LONG
        peer.answer_all(answers())
        assert set(values(group.run())) == {1}
        assert group.left_out == ()
        assert group.run().complete
        assert peer.requests[-1] == protocol2.sync_read([1, 2], 132, 4)


def test_late_replies_of_the_last_servo_are_not_taken():
    with bus_on(budget=SHORT) as (peer, bus):
        group = bus.sync_group([1, 2, 3], 132, 4)
        peer.script(
            statuses([1, 2], turn=1),
            [statuses([3], turn=1), BRIEF / 3, statuses([1, 2, 3], turn=2)],
            statuses([3], turn=3),
        )
        assert failures(group.run()) == {3: Failure.SILENT}
        assert values(group.run()) == {id: data(id, 2) for id in (1, 2, 3)}
        assert bus.read(3, 132, 4) == data(3, 3)
        assert (bus.line_counters.strays, bus.line_counters.probes) == (1, 0)


def test_a_reply_that_is_owed_cannot_come_behind_those_to_a_later_request():
    with bus_on(budget=SHORT) as (peer, bus):
        peer.script(statuses([1]), statuses([1, 2], turn=2), statuses([2], turn=3))
        assert failures(bus.sync_read([1, 2], 132, 4)) == {2: Failure.SILENT}
        assert bus.sync_read([1, 2], 132, 4).complete
        assert bus.read(2, 132, 4) == data(2, 3)
        assert bus.line_counters.probes == 0


def until_complete(group):
    """Run until every servo has brought its data; nothing else may be among them meanwhile."""
    seen = []
    deadline = time.monotonic() + LONG
    while not (result := group.run()).complete:
        seen += values(result).values()
        assert time.monotonic() < deadline
    return [*seen, *values(result).values()]


@pytest.mark.parametrize("is_fast", [False, True])
def test_late_replies_of_all_servos_are_not_taken(is_fast):
    with bus_on(budget=BRIEF) as (peer, bus):
        group = bus.sync_group([1, 2], 132, 4, fast=is_fast)
        peer.script([4 * BRIEF, (fast if is_fast else statuses)([1, 2], turn=1)])
        peer.answer_all(answers(turn=2))
        group.run()
        assert {told[1] for told in until_complete(group)} == {2}
        assert bus.line_counters.probes >= 1


@pytest.mark.parametrize("is_fast", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_whatever_is_held_back_no_cycle_has_data_of_an_earlier_one(seed, is_fast):
    random, held, cycle = Random(seed), deque(), [0]

    def answer(request):
        reply = answers(cycle[0])(request)
        held.extend(reply[at : at + 9] for at in range(0, len(reply), 9))
        comes = random.choice((0, 0, 1, 3, 200, 200))
        return b"".join(held.popleft() for _ in range(min(comes, len(held))))

    with bus_on(budget=0.003) as (peer, bus):
        group = bus.sync_group([1, 2, 3], 132, 4, fast=is_fast)
        peer.answer_all(answer)
        found = 0
        for turn in range(1, 120):
            cycle[0] = turn
            for id, told in values(group.run()).items():
                assert told == data(id, turn)
                found += 1
        assert found > 0


def test_a_late_fast_reply_is_not_taken():
    with bus_on(budget=SHORT) as (peer, bus):
        group = bus.sync_group([1, 2], 132, 4, fast=True)
        peer.script(None, None, fast([1, 2], turn=1) + statuses([2], turn=2), fast([1, 2], turn=3))
        assert values(group.run()) == {2: data(2, 2)}
        assert values(group.run()) == {id: data(id, 3) for id in (1, 2)}
        assert (bus.line_counters.strays, bus.line_counters.probes) == (1, 0)


def test_a_reply_that_comes_too_early_does_not_prove_others_missing():
    """At this rate no servo can have answered yet: it was left over from before."""
    with bus_on(baud=1200) as (peer, bus):
        peer.script([statuses([3], 1), 0.01, statuses([1, 2, 3], 2)])
        assert values(bus.sync_read([1, 2, 3], 132, 4)) == {id: data(id, 2) for id in (1, 2, 3)}


def test_replies_that_take_long_are_not_looked_at_piece_by_piece(monkeypatch):
    with bus_on(baud=1200) as (peer, bus):
        looks = []
        read = bus.port.read
        monkeypatch.setattr(bus.port, "read", lambda deadline: looks.append(0) or read(deadline))
        stream = statuses([1, 2, 3])
        peer.script([part for byte in stream for part in (bytes((byte,)), 0.0002)])
        assert bus.sync_read([1, 2, 3], 132, 4).complete
        assert len(looks) < len(stream) / 3


def test_deadlines_follow_the_servos_settings():
    with bus_on({1: ServoLink(return_delay=100.0)}, budget=BRIEF) as (_, bus):
        group = bus.sync_group([1], 132, 4)
        bus.set_link(1, return_delay=0.0)
        assert failures(group.run()) == {1: Failure.SILENT}


def test_a_reply_out_of_order_is_taken_back_when_those_before_it_follow():
    with bus_on() as (peer, bus):
        peer.script([0.01, statuses([2], 1) + statuses([1, 2, 3], 2)])
        assert values(bus.sync_read([1, 2, 3], 132, 4)) == {id: data(id, 2) for id in (1, 2, 3)}


def test_a_doubled_reply_counts_once():
    with bus_on() as (peer, bus):
        peer.script(statuses([1, 2], 1) + statuses([2, 3], 2))
        assert values(bus.sync_read([1, 2, 3], 132, 4)) == {
            1: data(1, 1),
            2: data(2, 2),
            3: data(3, 2),
        }
        assert bus.counters(2).strays == 1


def test_an_adapter_that_echoes():
    with bus_on() as (peer, bus):
        group = bus.sync_group([1, 2], 132, 4)
        quick = bus.sync_group([1, 2], 132, 4, fast=True)
        for turn in range(3):
            for asked, replies in ((group, statuses([1, 2], turn)), (quick, fast([1, 2], turn))):
                request = protocol2.sync_read([1, 2], 132, 4)
                if asked is quick:
                    request = protocol2.fast_sync_read([1, 2], 132, 4)
                peer.script([request, 0.002, replies])
                result = asked.run()
                assert values(result) == {id: data(id, turn) for id in (1, 2)}
                assert result.at_once == (turn > 0 or asked is quick)
        assert bus.line_counters.echoes == 6
        peer.script(statuses([1, 2]))
        assert group.run().complete
        assert bus.line_counters.garbage == 0


def test_noise_before_the_header():
    with bus_on() as (peer, bus):
        peer.script(b"\xff\xfd" + statuses([1, 2]), b"\xff\xfd" + fast([1, 2]))
        assert bus.sync_read([1, 2], 132, 4).complete
        assert bus.fast_sync_read([1, 2], 132, 4).complete
        assert bus.line_counters.garbage == 4


def test_a_fast_reply_that_ends_early_is_completed_by_a_plain_read():
    with bus_on(budget=SHORT) as (peer, bus):
        peer.script(fast([1, 2, 3], 1)[: 8 + 8 + 3], statuses([2, 3], 2))
        result = bus.fast_sync_read([1, 2, 3], 132, 4)
        assert values(result) == {1: data(1, 1), 2: data(2, 2), 3: data(3, 2)}
        assert peer.requests[-1] == protocol2.sync_read([2, 3], 132, 4)


def test_a_damaged_block_of_a_fast_reply_is_asked_for_again():
    with bus_on() as (peer, bus):
        reply = bytearray(fast([1, 2, 3], 1))
        reply[18] ^= 1
        peer.script(bytes(reply), statuses([2], 2))
        result = bus.fast_sync_read([1, 2, 3], 132, 4)
        assert values(result) == {1: data(1, 1), 2: data(2, 2), 3: data(3, 1)}


def test_servos_that_know_no_fast_read_are_read_plainly():
    with bus_on(budget=SHORT) as (peer, bus):
        group = bus.sync_group([1, 2], 132, 4, fast=True)
        for _ in range(groups.FAST_FAILURES):
            assert group.is_fast or group._cycle == groups.FAST_FAILURES
            peer.script(None, statuses([1, 2]))
            assert group.run().complete
        assert not group.is_fast
        peer.script(statuses([1, 2]))
        assert group.run().complete
        assert peer.requests[-1] == protocol2.sync_read([1, 2], 132, 4)


def test_protocol_1_in_bulk_and_one_by_one():
    links = {id: ServoLink(1, 0.0) for id in (1, 2, 3)}
    with bus_on(links, budget=SHORT) as (peer, bus):
        items = [(1, 36, 2), (2, 36, 2), (3, 36, 2)]
        peer.script(status1(1, b"ab") + status1(2, b"cd", 0x20) + status1(3, b"ef"))
        result = bus.bulk_read(items)
        assert result.block == b"abcdef"
        assert [reply.hardware for reply in result.replies] == [0, 0x20, 0]
        peer.script(status1(1, b"ab"), None, status1(3, b"ef"))
        result = bus.single_group(items).run()
        assert failures(result) == {2: Failure.SILENT}
        assert values(result) == {1: b"ab", 3: b"ef"}
        assert peer.requests[-1] == protocol1.read(3, 36, 2)
        with pytest.raises(ValueError, match="no sync read"):
            bus.sync_group([1, 2], 36, 2)


def test_servos_of_both_protocols_are_no_group():
    with bus_on({2: ServoLink(1, 0.0)}) as (_, bus):
        with pytest.raises(ValueError, match="one protocol"):
            bus.bulk_group([(1, 36, 2), (2, 36, 2)])
        with pytest.raises(ValueError, match="one protocol"):
            bus.write_group([1, 2], 30, 2)


def test_group_writes():
    with bus_on() as (peer, bus):
        group = bus.write_group([3, 1], 116, 4)
        group.run(b"abcdefgh")
        group.run(b"\xff\xff\xfd\xffijkl")
        with pytest.raises(ValueError, match="7 bytes"):
            group.run(b"abcdefg")
        assert peer.wait_for(2) == [
            protocol2.sync_write(116, 4, {3: b"abcd", 1: b"efgh"}),
            protocol2.sync_write(116, 4, {3: b"\xff\xff\xfd\xff", 1: b"ijkl"}),
        ]


def test_group_writes_of_protocol_1():
    with bus_on({id: ServoLink(1, 0.0) for id in (1, 2)}) as (peer, bus):
        bus.write_group([1, 2], 30, 2).run(b"abcd")
        bus.sync_write(30, 2, {1: b"ef", 2: b"gh"})
        assert peer.wait_for(2) == [
            protocol1.sync_write(30, 2, {1: b"ab", 2: b"cd"}),
            protocol1.sync_write(30, 2, {1: b"ef", 2: b"gh"}),
        ]
