"""Lost, repeated and late records, against a model that knows what was sent."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.kit.sensing.sequence import FROZEN_AFTER, LATEST, Event, SequenceTracker

RATE = 7000.0
WRAP = 2**32


@dataclass
class Feeder:
    """Feeds a tracker with records in batches and collects what it accepts."""

    tracker: SequenceTracker

    def __post_init__(self) -> None:
        self.accepted: list[int] = []
        self.ticks: list[int] = []
        self.events: list[Event] = []

    def feed(self, rows, batch: int = 7) -> None:
        """`rows` of rdt, ft, when."""
        for i in range(0, len(rows), batch):
            part = rows[i : i + batch]
            rdt = np.array([r[0] % WRAP for r in part], np.uint32)
            ft = np.array([r[1] % WRAP for r in part], np.uint32)
            when = np.array([r[2] for r in part], float)
            found = self.tracker.take(rdt, ft, when)
            kept = rdt if found.keep is None else rdt[found.keep]
            assert len(kept) == len(found.ticks)
            self.accepted += kept.tolist()
            self.ticks += found.ticks.tolist()
            self.events += [event for event, _ in found.events]


def series(count: int, rdt: int = 1, ft: int = 1000, step: int = 1, when: float = 10.0):
    return [(rdt + i, ft + i * step, when + i * step / RATE) for i in range(count)]


@pytest.fixture
def feeder() -> Feeder:
    feeder = Feeder(SequenceTracker(RATE))
    feeder.tracker.expect_series()
    return feeder


def counts(feeder: Feeder) -> tuple[int, int, int]:
    found = feeder.tracker.counters
    return found.lost, found.duplicates, found.late


@pytest.mark.parametrize("batch", [1, 7, 1000])
@pytest.mark.parametrize("first", [1, WRAP - 20])
@pytest.mark.parametrize("ft", [5, WRAP - 30])
def test_a_plain_stream_is_accepted_over_both_wraps(feeder, batch, first, ft) -> None:
    feeder.feed([(1, ft - 7, 9.9)])
    feeder.tracker._rdt = first - 1  # a stream of days
    rows = series(100, rdt=first, ft=ft, step=7)
    feeder.feed(rows, batch)
    assert feeder.accepted[1:] == [row[0] % WRAP for row in rows]
    assert np.diff(feeder.ticks).tolist() == [7] * 100
    assert counts(feeder) == (0, 0, 0)
    assert feeder.events == [Event.BEGUN]
    assert feeder.tracker.step == 7


@given(
    data=st.data(),
    step=st.sampled_from([1, 7, 700]),
    start=st.sampled_from([1, 1000, WRAP - 40]),
    batch=st.integers(1, 40),
)
def test_counters_say_what_became_of_each_record(data, step, start, batch) -> None:
    """The model: of each record that was sent it is known how often and after which others it arrived."""
    count = data.draw(st.integers(2, 80))
    sent = series(count, rdt=start, ft=12345, step=step)
    arrivals: list[tuple[float, int]] = []
    for i in range(count):
        times = data.draw(st.sampled_from([1, 1, 1, 1, 0, 2])) if 0 < i < count - 1 else 1
        for _ in range(times):
            delay = data.draw(st.sampled_from([0.0, 0.0, 0.0, 1.5, 3.5, 9.5])) if i > 0 else 0.0
            arrivals.append((i + delay, i))
    arrivals.sort()
    feeder = Feeder(SequenceTracker(RATE))
    feeder.feed([(start - 1, 12345 - step, 9.9)])
    order = [i for _, i in arrivals]
    feeder.feed([(sent[i][0], sent[i][1], 11.0 + k * 1e-4) for k, i in enumerate(order)], batch)

    newest, seen, accepted, duplicates, late = -1, set(), [], 0, 0
    for i in order:
        if i in seen:
            duplicates += 1
        elif i < newest:
            late += 1
        else:
            accepted.append(sent[i][0] % WRAP)
        seen.add(i)
        newest = max(newest, i)
    lost = newest + 1 - len(seen)
    assert feeder.accepted[1:] == accepted
    assert counts(feeder) == (lost, duplicates, late)
    assert feeder.events == [Event.TAKEN_OVER]
    assert feeder.tracker.counters.received == len(order) + 1
    assert (np.diff(feeder.ticks) > 0).all()


def test_the_first_records_of_a_series_may_be_lost(feeder) -> None:
    feeder.feed(series(10, rdt=4))
    assert counts(feeder) == (3, 0, 0)
    assert feeder.events == [Event.BEGUN]


@pytest.mark.parametrize("first", [1, 3])
@pytest.mark.parametrize("length", [1, 2, 5, 50, 5000])
def test_a_series_that_was_asked_for_is_no_loss(feeder, first, length) -> None:
    feeder.feed(series(length))
    feeder.tracker.expect_series()
    feeder.feed(series(20, rdt=first, ft=1000 + length + 700, when=10.1 + length / RATE))
    assert feeder.tracker.counters.restarts == 0
    assert len(feeder.accepted) == length + 20
    if first == 1 or length not in (1, 2):  # those cannot be told from a series that goes on
        assert feeder.events == [Event.BEGUN, Event.BEGUN]
        assert counts(feeder)[0] == first - 1


def test_records_on_their_way_belong_to_the_series_before(feeder) -> None:
    feeder.feed(series(500))
    feeder.tracker.expect_series()
    feeder.feed(series(30, rdt=501, ft=1500))
    feeder.feed(series(30, rdt=1, ft=1530))
    assert feeder.events == [Event.BEGUN, Event.BEGUN]
    assert counts(feeder) == (0, 0, 0)


def test_a_series_that_was_not_asked_for_is_another_clients(feeder) -> None:
    feeder.feed(series(500))
    feeder.feed(series(500, ft=1500, when=10.0 + 500 / RATE))
    assert feeder.events == [Event.BEGUN, Event.TAKEN_OVER]
    assert feeder.tracker.counters.takeovers == 1
    assert counts(feeder) == (0, 0, 0)
    assert (np.diff(feeder.ticks) == 1).all()


@pytest.mark.parametrize("expected", [True, False])
@pytest.mark.parametrize(
    ("before", "ft", "pause"),
    [
        (10_000_000, 0, 3.0),
        (1000, 100, 3.0),
        (3 * 10**9, 100, 3.0),
        (1000, 0, 0.05),
        (300, 0, 0.05),
        (WRAP - 500, 200, 8.0),
        (10_000, 400_000, 3.0),
    ],
)
def test_a_clock_that_began_anew_is_a_restart(feeder, before, ft, pause, expected) -> None:
    feeder.feed(series(600, ft=before))
    if expected:
        feeder.tracker.expect_series()
    feeder.feed(series(50, ft=ft, when=10.0 + 600 / RATE + pause))
    if not expected and pause < 1.0:
        assert (
            Event.RESTARTED not in feeder.events
        )  # older by its own clock, and by less than a second
        return
    assert feeder.events[1:] == [Event.RESTARTED, Event.BEGUN if expected else Event.TAKEN_OVER]
    assert feeder.ticks[-50:] == list(range(ft, ft + 50))
    assert feeder.tracker.counters.restarts == 1


def test_a_frozen_transducer_does_not_thaw_because_the_stream_was_asked_for_again(feeder) -> None:
    feeder.feed(series(600))
    feeder.feed([(601 + i, 1599, 10.0 + (600 + i) / RATE) for i in range(FROZEN_AFTER)])
    feeder.tracker.expect_series()
    feeder.feed([(1, 1599, 10.2)])
    assert feeder.tracker.frozen
    assert feeder.events == [Event.BEGUN, Event.FROZEN, Event.BEGUN]
    feeder.feed([(2, 3000, 10.3)])
    assert not feeder.tracker.frozen


@pytest.mark.parametrize("late", [0.0, 0.9])
@pytest.mark.parametrize("pause", [0.2, 5.0, 86400.0])
def test_a_pause_is_no_restart_also_where_what_follows_is_late(feeder, pause, late) -> None:
    feeder.feed(series(600, ft=50))
    feeder.tracker.expect_series()
    feeder.feed(series(50, ft=650 + int(pause * RATE), when=10.0 + 600 / RATE + pause + late))
    assert feeder.events == [Event.BEGUN, Event.BEGUN]
    assert feeder.ticks[-1] == 650 + int(pause * RATE) + 49


def test_an_outage_within_a_series_is_loss(feeder) -> None:
    feeder.feed(series(10))
    feeder.feed(series(10, rdt=11 + 21000, ft=1010 + 21000, when=10.0 + 21010 / RATE))
    assert counts(feeder) == (21000, 0, 0)
    assert feeder.tracker.counters.gaps == 1
    assert feeder.events == [Event.BEGUN]


def test_a_frozen_transducer_is_a_fault_and_no_loss(feeder) -> None:
    feeder.feed(series(50))
    feeder.feed([(51 + i, 1049, 10.1 + i / RATE) for i in range(FROZEN_AFTER + 10)])
    assert feeder.tracker.frozen
    assert feeder.events == [Event.BEGUN, Event.FROZEN]
    assert feeder.tracker.counters.frozen == FROZEN_AFTER + 10
    assert counts(feeder) == (0, 0, 0)
    feeder.feed(series(20, rdt=61 + FROZEN_AFTER, ft=1200, when=10.2))
    assert not feeder.tracker.frozen
    assert feeder.events == [Event.BEGUN, Event.FROZEN, Event.THAWED]


def test_a_measurement_that_is_repeated_for_a_moment_is_no_fault(feeder) -> None:
    rdt, ft = 1, 1000
    for _ in range(3):
        feeder.feed(series(20, rdt=rdt, ft=ft, when=10.0 + rdt / RATE))
        rdt, ft = rdt + 20, ft + 19
        feeder.feed([(rdt + i, ft, 10.0 + rdt / RATE) for i in range(FROZEN_AFTER - 10)])
        rdt, ft = rdt + FROZEN_AFTER - 10, ft + 1
    assert not feeder.tracker.frozen
    assert feeder.events == [Event.BEGUN]


def test_events_say_from_which_record_on(feeder) -> None:
    feeder.feed(series(10))
    rows = series(3, rdt=11, ft=1010) + series(4, ft=1013)
    rdt, ft, when = (np.array(column) for column in zip(*rows, strict=True))
    found = feeder.tracker.take(rdt.astype(np.uint32), ft.astype(np.uint32), when.astype(float))
    assert found.events == ((Event.TAKEN_OVER, 3),)


@given(
    rows=st.lists(
        st.tuples(
            st.one_of(st.integers(0, WRAP - 1), st.integers(0, 2 * LATEST)),
            st.one_of(st.integers(0, WRAP - 1), st.integers(0, 2 * LATEST)),
        ),
        max_size=60,
    ),
    batch=st.integers(1, 30),
    expecting=st.booleans(),
)
def test_any_numbers_are_survived(rows, batch, expecting) -> None:
    feeder = Feeder(SequenceTracker(RATE))
    if expecting:
        feeder.tracker.expect_series()
    feeder.feed([(a, b, 10.0 + i) for i, (a, b) in enumerate(rows)], batch)
    found = feeder.tracker.counters
    assert found.received == len(rows)
    assert found.received == len(feeder.accepted) + found.duplicates + found.late
    assert found.lost >= 0


@given(batches=st.lists(st.integers(1, 50), min_size=2, max_size=5))
def test_the_quick_way_and_the_careful_way_agree(batches) -> None:
    total = sum(batches)
    rows = series(total)
    rows[total // 2 :] = [(a + 3, b + 3, c) for a, b, c in rows[total // 2 :]]
    one, many = Feeder(SequenceTracker(RATE)), Feeder(SequenceTracker(RATE))
    one.feed(rows, 1)
    begin = 0
    for size in batches:
        many.feed(rows[begin : begin + size], size)
        begin += size
    assert (one.accepted, one.ticks) == (many.accepted, many.ticks)
    assert one.tracker.counters == many.tracker.counters
