"""The clock of another machine: measured by round trips, and judged by the shift that it was given."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.client.clock_offset import (
    EXCHANGES,
    Exchange,
    measured_offset,
    offset_of,
)
from crtk_drivers.client.ros_link import Link
from crtk_drivers.samples import ClockOffset
from rigs.system_clock import shifted
from rigs.waiting import LONG, eventually

pytestmark = pytest.mark.ros

SCRIPT = Path(__file__).parents[2] / "rigs" / "serve_loopback.py"
SHIFT = 0.25
"""Seconds; less than 5 ms of it shall be lost."""
NOW = 1_790_000_000 * 10**9

spans = st.integers(0, 10**8)
"""Nanoseconds that something takes: up to 0.1 s, there and back different."""
jumps = st.integers(-(10**13), 10**13)
legs = st.lists(st.tuples(spans, spans, spans), min_size=EXCHANGES, max_size=EXCHANGES)


class Clocks:
    """Two machines as numbers: one true time, two wall clocks, and our monotonic one."""

    def __init__(self, ours: int, theirs: int) -> None:
        self.now, self.ours, self.theirs = 0, NOW + ours, NOW + theirs

    def exchange(self, out: int, back: int) -> Exchange:
        sent = self.now
        self.now += out
        stamp = self.theirs + self.now
        self.now += back
        return Exchange(sent, self.now, stamp)

    def own(self) -> Exchange:
        return Exchange(self.now, self.now, self.ours + self.now)

    @property
    def truth(self) -> float:
        return (self.theirs - self.ours) * 1e-9


def ask(clocks: Clocks, trips: list[tuple[int, int, int]]) -> Iterator[Exchange]:
    for out, back, pause in trips:
        yield clocks.exchange(out, back)
        clocks.now += pause


def is_right(found: ClockOffset | None, truth: float) -> bool:
    return found is not None and abs(found.value - truth) <= found.uncertainty + 1e-9


@given(legs, jumps, jumps)
def test_the_truth_is_within_the_uncertainty(trips, ours, theirs):
    clocks = Clocks(ours, theirs)
    found = offset_of(list(ask(clocks, trips)), clocks.own())
    assert is_right(found, clocks.truth)
    assert found is not None
    assert found.uncertainty == pytest.approx(min(out + back for out, back, _ in trips) / 2e9)


@given(legs, jumps, st.integers(0, EXCHANGES))
def test_our_clock_may_be_set_meanwhile(trips, jump, at):
    clocks = Clocks(0, 0)
    exchanges = list(ask(clocks, trips[:at]))
    clocks.ours += jump
    exchanges += ask(clocks, trips[at:])
    assert is_right(offset_of(exchanges, clocks.own()), clocks.truth)


@given(legs, jumps, st.integers(1, EXCHANGES - 1))
def test_their_clock_may_be_set_meanwhile(trips, jump, at):
    clocks = Clocks(0, 0)
    exchanges = list(ask(clocks, trips[:at]))
    clocks.theirs += jump
    exchanges += ask(clocks, trips[at:])
    found = offset_of(exchanges, clocks.own())
    slowest = max(out + back for out, back, _ in trips) / 1e9
    if found is not None and abs(jump) > 2e9 * slowest:
        assert is_right(found, clocks.truth), "what was before counts no more"


@given(st.integers(10, 10**8), jumps)
def test_stamps_that_stand_still_give_no_offset(trip, theirs):
    clocks = Clocks(0, theirs)
    frozen = NOW + theirs
    exchanges = [
        Exchange(each.sent, each.received, frozen + count)
        for count, each in enumerate(ask(clocks, [(trip, trip, 0)] * EXCHANGES))
    ]
    assert offset_of(exchanges, clocks.own()) is None


def test_no_answer_gives_no_offset():
    assert offset_of([], Exchange(0, 0, NOW)) is None


class Driver:
    """One that answers, and counts how often."""

    def __init__(self) -> None:
        self.asked = 0

    def operating_state(self, timeout):
        self.asked += 1
        return SimpleNamespace(wall_ns=time.time_ns())


def test_who_ends_waits_for_one_answer_only():
    driver = Driver()
    assert measured_offset(driver) is not None
    assert driver.asked == EXCHANGES
    assert measured_offset(driver, lambda: driver.asked > EXCHANGES) is None
    assert driver.asked == EXCHANGES + 1


@contextmanager
def other_machine(shift: float) -> Iterator[None]:
    process = subprocess.Popen(
        [sys.executable, SCRIPT, "/shifted"], stdout=subprocess.DEVNULL, env=shifted(shift)
    )
    with process:
        try:
            yield
        finally:
            process.kill()


@pytest.mark.real_time  # a compiled library
@pytest.mark.parametrize("shift", [SHIFT, -SHIFT])
def test_a_shifted_clock_is_measured_over_ros(shift):
    link = Link()
    try:
        link.start()
        with other_machine(shift):
            caller = link.state_caller("/shifted/operating_state")
            found = eventually(lambda: measured_offset(caller), "it answers", LONG)
            assert found.value == pytest.approx(shift, abs=0.005)
            assert abs(found.value - shift) <= found.uncertainty
    finally:
        link.close()
