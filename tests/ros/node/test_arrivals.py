"""When messages and requests were sent, whatever the clocks of their senders say and the middleware tells."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest

from crtk_drivers.ros.arrival import (
    DRIFT,
    LONGEST_NS,
    ON_ITS_WAY_NS,
    UNEVEN,
    Arrival,
    Requests,
    SenderClock,
)

MS = 1_000_000
SECOND = 1000 * MS
MINUTE = 60 * SECOND
HOUR = 3600 * SECOND
BEGIN = 1_700_000_000 * SECOND

Taken = Callable[..., int]


@pytest.fixture
def taken(monkeypatch: pytest.MonkeyPatch) -> Taken:
    """Take a request at a time since `BEGIN`, in ns; return when it was sent, or what else is asked for."""
    requests = Requests()

    def take(now: int, sent: int, received: int | None = None, what: str = "sent_ns") -> int:
        monkeypatch.setattr(time, "time_ns", lambda: BEGIN + now)
        monkeypatch.setattr(time, "monotonic_ns", lambda: now)
        told = BEGIN + sent if received is None else BEGIN + received
        found: int = getattr(requests.arrival(b"client", told, BEGIN + sent), what)
        return found - BEGIN if what == "sent_ns" else found

    return take


@pytest.mark.parametrize("waited", [2 * MS, 300 * MS, 9 * SECOND])
def test_what_waited_here_came_when_it_was_sent(taken: Taken, waited: int) -> None:
    assert taken(waited, sent=0) == 0
    assert taken(waited, sent=100) == 100, "both waited"


def test_a_busy_machine_makes_no_request_newer(taken: Taken) -> None:
    taken(12 * MS, sent=0)
    assert taken(60 * SECOND + 30 * MS, sent=60 * SECOND) == 60 * SECOND


@pytest.mark.parametrize("off", [-HOUR, 6 * MS, 2 * SECOND, HOUR])
def test_the_first_request_by_another_clock_comes_now(taken: Taken, off: int) -> None:
    assert taken(SECOND, sent=SECOND + off) == SECOND - ON_ITS_WAY_NS


@pytest.mark.parametrize("off", [-HOUR, -2 * SECOND, 8 * MS, 2 * SECOND, HOUR])
def test_a_later_request_came_as_long_ago_as_it_waited(taken: Taken, off: int) -> None:
    taken(MS, sent=off)
    later = LONGEST_NS + 2 * SECOND
    assert taken(later, sent=later - 700 * MS + off) == later - 699 * MS - ON_ITS_WAY_NS
    assert taken(later, sent=later - MS + off, what="ahead_ns") == off - MS


@pytest.mark.parametrize("off", [-400 * MS, -6 * MS, -MS, 4 * MS])
def test_a_clock_that_may_agree_is_believed(taken: Taken, off: int) -> None:
    taken(MS, sent=off)
    later = LONGEST_NS + 2 * SECOND
    assert taken(later, sent=later + off) == later + off


@pytest.mark.parametrize("jump", [-HOUR, HOUR])
def test_a_clock_that_is_set_makes_no_request_old(taken: Taken, jump: int) -> None:
    taken(MS, sent=0)
    assert taken(SECOND, sent=SECOND + jump) == SECOND - ON_ITS_WAY_NS


def test_a_middleware_that_tells_when_it_came_is_believed(taken: Taken) -> None:
    assert taken(SECOND, sent=-HOUR, received=700 * MS) == 700 * MS
    assert taken(SECOND, sent=-HOUR, received=700 * MS, what="ahead_ns") == -HOUR - 700 * MS


class Network:
    """Messages of one process, on a machine whose clock is off.

    Args:
        monkeypatch: for the clocks of this machine.
        off: ns by which the sender's clock is ahead.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, off: int) -> None:
        self.clock = SenderClock()
        self.off = off
        self.set = 0
        self._sent_last = 0
        self._patch = monkeypatch

    def message(self, sent: int, *, late: int = 0) -> Arrival:
        """Let one come that was sent at a time since `BEGIN`, and is later than usual; ns."""
        came = sent + MS + late
        self._patch.setattr(time, "time_ns", lambda: BEGIN + self.set + came)
        self._patch.setattr(time, "monotonic", lambda: came / SECOND)
        stamp = BEGIN + sent + self.off
        found = self.clock.arrival(BEGIN + self.set + came, stamp, self._sent_last)
        self._sent_last = stamp
        return found

    def stream(self, begin: int, end: int) -> list[float]:
        """Let one come each 20 ms; return by how many s each was late."""
        return [self.message(sent).late for sent in range(begin, end, 20 * MS)]


@pytest.mark.parametrize("off", [-HOUR, -2 * SECOND, 0, 8 * MS, HOUR])
@pytest.mark.parametrize("idle", [SECOND, HOUR])
def test_repeated_message_counts_as_sent_before(
    monkeypatch: pytest.MonkeyPatch, off: int, idle: int
) -> None:
    network = Network(monkeypatch, off)
    assert max(network.stream(0, SECOND)) == pytest.approx(0.0, abs=1e-5)
    late = network.message(SECOND + idle, late=3 * SECOND)
    drift = DRIFT * (idle + 3 * SECOND) / SECOND
    assert 3.0 - drift - 1e-4 < late.late < 3.0 + 1e-4
    assert late.sent_ns == late.received_ns - round(late.late * SECOND)
    assert late.earliest_ns <= late.sent_ns


@pytest.mark.parametrize(
    ("off", "earliest"), [(0, -3 * SECOND), (-HOUR, 0), (HOUR, 0), (-500 * MS, -3500 * MS)]
)
def test_first_message_may_be_late_by_a_clock_that_agrees(
    monkeypatch: pytest.MonkeyPatch, off: int, earliest: int
) -> None:
    first = Network(monkeypatch, off).message(0, late=3 * SECOND)
    assert first.late == 0.0, "nothing says that it is not its clock"
    assert first.earliest_ns - first.received_ns == pytest.approx(earliest, abs=2 * MS)


@pytest.mark.parametrize("off", [-HOUR, 0])
@pytest.mark.parametrize("step", [-HOUR, -2 * SECOND, -300 * MS, 300 * MS, HOUR])
@pytest.mark.parametrize("whose", ["ours", "theirs", "both"])
@pytest.mark.parametrize("idle", [0, 5 * SECOND])
def test_clock_that_is_set_makes_no_message_late(
    monkeypatch: pytest.MonkeyPatch, off: int, step: int, whose: str, idle: int
) -> None:
    if whose == "theirs" and idle and -5 * SECOND < step < 0:
        pytest.skip("nothing tells that from a network that keeps messages")
    network = Network(monkeypatch, off)
    network.stream(0, 5 * SECOND)
    network.set += step if whose != "theirs" else 0
    network.off += step if whose != "ours" else 0
    late = network.stream(5 * SECOND + idle, 6 * SECOND + idle)
    assert late == pytest.approx([0.0] * len(late), abs=1e-3)


def test_slower_network_is_got_used_to(monkeypatch: pytest.MonkeyPatch) -> None:
    network = Network(monkeypatch, 0)
    network.stream(0, SECOND)
    late = [network.message(sent, late=SECOND).late for sent in range(SECOND, 10 * SECOND, 20 * MS)]
    assert late[0] == pytest.approx(1.0, abs=1e-3)
    assert late[-1] == pytest.approx(0.0, abs=1e-3)


def test_what_follows_an_own_stop_is_sent_after_it(monkeypatch: pytest.MonkeyPatch) -> None:
    network = Network(monkeypatch, -HOUR)
    network.stream(0, 10 * SECOND)
    stop = network.message(10 * SECOND, late=30 * MS)
    move = network.message(10 * SECOND + MS, late=35 * MS)
    assert move.earliest_ns < stop.received_ns
    network.clock.changes_state(stop)
    assert network.clock.in_order(move).earliest_ns == stop.received_ns
    assert network.clock.in_order(stop).sent_ns == stop.received_ns


def test_what_came_before_an_own_stop_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    network = Network(monkeypatch, 0)
    network.stream(0, 10 * SECOND)
    move = network.message(10 * SECOND, late=3 * SECOND)
    stop = network.message(11 * SECOND, late=round(UNEVEN * SECOND))
    network.clock.changes_state(stop)
    assert network.clock.in_order(move) == move


def test_middleware_that_tells_nothing_makes_nothing_late() -> None:
    clock = SenderClock()
    assert clock.arrival(0, 0) == Arrival(0, 0, 0, 0)
    assert clock.arrival(BEGIN, 0) == Arrival(BEGIN, BEGIN, BEGIN, 0)


@pytest.mark.parametrize("gap", [3, 5, 7, 20, 600])
def test_second_lost_message_is_late_too(monkeypatch: pytest.MonkeyPatch, gap: int) -> None:
    network = Network(monkeypatch, -HOUR)
    network.stream(0, 5 * SECOND)
    for number in (1, 2, 3):
        late = network.message((5 + number * gap) * SECOND, late=3 * SECOND).late
        assert late == pytest.approx(3.0, abs=0.2)


@pytest.mark.parametrize("inverted", [0, 12 * MS])
def test_all_of_a_late_burst_are_late(monkeypatch: pytest.MonkeyPatch, inverted: int) -> None:
    network = Network(monkeypatch, HOUR)
    network.stream(0, 5 * SECOND)
    sent = [20 * SECOND + number * 20 * MS for number in range(100)]
    sent[50] -= 20 * MS + inverted
    came = sent[-1] + SECOND
    late = [network.message(each, late=came - each).late for each in sent]
    assert late == pytest.approx([(came - each) / SECOND for each in sent], abs=0.01)


def test_backlog_of_a_long_standstill_is_late(monkeypatch: pytest.MonkeyPatch) -> None:
    network = Network(monkeypatch, 0)
    network.stream(0, 5 * SECOND)
    came = 60 * SECOND
    sent = range(10 * SECOND, came, 200 * MS)
    late = [network.message(each, late=came - each).late for each in sent]
    assert late == pytest.approx([(came - each) / SECOND for each in sent], abs=0.01)


def test_clock_set_back_by_hours_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    network = Network(monkeypatch, 0)
    network.stream(0, 5 * SECOND)
    network.off -= HOUR
    begin = 2 * HOUR
    late = network.stream(begin, begin + SECOND)
    assert late[0] > 3590.0
    assert late[30:] == pytest.approx([0.0] * 20, abs=1e-3)


@pytest.mark.parametrize("drift", [-50e-6, 50e-6])
@pytest.mark.parametrize("idle", [MINUTE, HOUR, 10 * HOUR])
def test_clocks_that_drift_make_nothing_late(
    monkeypatch: pytest.MonkeyPatch, drift: float, idle: int
) -> None:
    network = Network(monkeypatch, -2 * SECOND)
    network.stream(0, 5 * SECOND)
    network.off += round(drift * idle)
    assert max(network.stream(5 * SECOND + idle, 6 * SECOND + idle)) < 0.01


def test_a_new_client_may_follow_its_own_enable(monkeypatch: pytest.MonkeyPatch) -> None:
    network = Network(monkeypatch, -2 * SECOND)
    enable = network.message(0)
    network.clock.changes_state(enable)
    move = network.message(300 * MS)
    assert move.earliest_ns < enable.received_ns, "a stop of another client in between counts"
    assert network.clock.in_order(move).earliest_ns == enable.received_ns


def test_clock_set_before_a_message_is_read_misleads_nobody(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    network = Network(monkeypatch, 0)
    network.stream(0, 5 * SECOND)
    came = 5 * SECOND + MS
    network.set += 2 * SECOND
    monkeypatch.setattr(time, "time_ns", lambda: BEGIN + network.set + came)
    monkeypatch.setattr(time, "monotonic", lambda: came / SECOND)
    network.clock.arrival(BEGIN + came, BEGIN + 5 * SECOND)
    assert max(network.stream(5 * SECOND + 20 * MS, 6 * SECOND)) == pytest.approx(0.0, abs=1e-3)
