"""When requests came, whatever the clocks of their senders say and the middleware tells."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest

from crtk_drivers.ros.arrival import LONGEST_NS, ON_ITS_WAY_NS, Requests

MS = 1_000_000
SECOND = 1000 * MS
HOUR = 3600 * SECOND
BEGIN = 1_700_000_000 * SECOND

Taken = Callable[..., int]


@pytest.fixture
def taken(monkeypatch: pytest.MonkeyPatch) -> Taken:
    """Take a request at a time since `BEGIN`, in ns; return when it came, and what else is asked for."""
    requests = Requests()

    def take(now: int, sent: int, received: int | None = None, what: str = "received_ns") -> int:
        monkeypatch.setattr(time, "time_ns", lambda: BEGIN + now)
        monkeypatch.setattr(time, "monotonic_ns", lambda: now)
        told = BEGIN + sent if received is None else BEGIN + received
        found: int = getattr(requests.arrival(b"client", told, BEGIN + sent), what)
        return found - BEGIN if what == "received_ns" else found

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
