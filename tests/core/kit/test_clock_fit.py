"""Stamps from late arrivals and a clock of unknown rate."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.kit.clock_fit import BLOCK, QUICK, ClockFit, WallClock, lower_envelope


def arrivals_of(seconds, rate, step=1, seed=1, start=1000.0, base=0.0, bursts=0.01, mean=60e-6):
    """Return ticks, true times, and arrivals: jitter with a long tail, and stalls that delay all behind."""
    random = np.random.default_rng(seed)
    count = int(seconds * rate / step)
    ticks = 4_000_000_000 + np.arange(count) * step
    true = start + np.arange(count) * step / rate
    jitter = base + random.exponential(mean, count)
    stalls = random.random(count) < bursts * step / 70
    jitter[stalls] += random.uniform(1e-3, 30e-3, int(stalls.sum()))
    arrivals = np.maximum.accumulate(true + jitter)  # the network keeps the order
    return ticks, true, arrivals


def stamps_of(fit, ticks, arrivals, batch=14):
    parts = [
        fit.stamp(ticks[i : i + batch], arrivals[i : i + batch])
        for i in range(0, len(ticks), batch)
    ]
    return np.concatenate(parts)


@pytest.mark.parametrize("batch", [1, 14, 70])
@pytest.mark.parametrize(
    ("rate", "step"),
    [(7000.0, 1), (7912.3, 1), (6650.0, 1), (7000.3, 7), (999.95, 1), (7912.0, 79)],
)
def test_stamps_are_right_within_100_microseconds(rate, step, batch) -> None:
    fit = ClockFit()
    seconds = 6.0 if batch > 1 else 2.0
    ticks, true, arrivals = arrivals_of(seconds, rate, step)
    stamps = stamps_of(fit, ticks, arrivals, batch)
    settled = true > true[0] + 2.5 * BLOCK
    error = np.abs(stamps - true)[settled]
    late = (arrivals - true)[settled]
    assert np.percentile(error, 99) < 100e-6
    assert np.percentile(late, 99) > 250e-6, "the test is too easy"
    assert (stamps <= arrivals + 1e-12).all()
    assert (np.diff(stamps) >= 0.0).all()
    assert fit.locked
    assert fit.tick_rate == pytest.approx(rate, rel=1e-4)


def test_jitter_is_what_arrivals_are_later_than_the_line() -> None:
    fit = ClockFit()
    ticks, _, arrivals = arrivals_of(4.0, 7000.0, bursts=0.0, mean=100e-6)
    stamps_of(fit, ticks, arrivals)
    p50, p99, most = fit.jitter
    assert p50 == pytest.approx(69e-6, rel=0.3)
    assert p99 == pytest.approx(460e-6, rel=0.4)
    assert most > p99


def test_a_clock_that_drifts_is_followed() -> None:
    fit = ClockFit()
    ticks, true, arrivals = arrivals_of(30.0, 1000.0)
    wander = 20e-6 * np.sin((true - true[0]) / 5.0)
    stamps = stamps_of(fit, ticks, arrivals + wander)
    error = np.abs(stamps - true - wander)[true > true[0] + 1.0]
    assert np.percentile(error, 99) < 100e-6


def test_records_of_one_datagram_arrive_together_and_were_measured_one_after_the_other() -> None:
    fit = ClockFit()
    ticks, true, arrivals = arrivals_of(5.0, 7000.0)
    arrivals = np.repeat(arrivals[39::40], 40)
    ticks, true = ticks[: len(arrivals)], true[: len(arrivals)]
    stamps = stamps_of(fit, ticks, arrivals, 40)
    settled = true > true[0] + 1.0
    assert np.percentile(np.abs(stamps - true)[settled], 99) < 100e-6
    assert (arrivals - true)[settled].mean() > 2e-3


def test_stamps_do_not_go_back_when_the_line_is_found() -> None:
    fit = ClockFit()
    true = 1000.0 + np.arange(4000) / 7000.0
    arrivals = true + 10e-6
    stalled = (true > 1000.0 + BLOCK - 0.03) & (true < 1000.0 + BLOCK)
    arrivals[stalled] = 1000.0 + BLOCK + 10e-6
    stamps = stamps_of(fit, np.arange(4000), arrivals)
    assert fit.locked
    assert (np.diff(stamps) >= 0.0).all()


def test_gaps_and_outages_do_not_move_the_line() -> None:
    fit = ClockFit()
    ticks, true, arrivals = arrivals_of(8.0, 7000.0)
    keep = (np.arange(len(ticks)) % 11 != 0) & ~((true > 1003.0) & (true < 1005.0))
    stamps = stamps_of(fit, ticks[keep], arrivals[keep])
    error = np.abs(stamps - true[keep])[true[keep] > 1001.0]
    assert np.percentile(error, 99) < 100e-6


def test_until_there_is_a_line_the_arrival_is_the_stamp() -> None:
    fit = ClockFit()
    ticks, _, arrivals = arrivals_of(BLOCK / 2, 7000.0)
    assert stamps_of(fit, ticks, arrivals) == pytest.approx(arrivals, abs=0.0)
    assert not fit.locked
    assert fit.tick_rate == 0.0


def test_a_jump_of_the_clock_begins_a_new_fit() -> None:
    fit = ClockFit()
    ticks, _, arrivals = arrivals_of(2.0, 7000.0)
    stamps_of(fit, ticks, arrivals)
    later, true, after = arrivals_of(4.0, 7000.0, start=1003.0, seed=2)
    stamps = stamps_of(fit, later + 70_000, after)
    assert fit.resets == 1
    assert np.abs(stamps - true)[true > 1005.0].max() < 100e-6


def test_a_clock_that_stands_gives_no_line() -> None:
    fit = ClockFit()
    _, _, arrivals = arrivals_of(1.0, 7000.0)
    stamps = stamps_of(fit, np.full(len(arrivals), 7), arrivals)
    assert (stamps <= arrivals).all()
    assert not fit.locked


points = st.lists(
    st.tuples(st.integers(0, 1000), st.floats(0.0, 1.0)),
    min_size=2,
    max_size=40,
    unique_by=lambda p: p[0],
)


@given(points)
def test_the_envelope_is_below_all_points_and_as_near_as_any_line_can_be(some) -> None:
    some = sorted((float(x), 0.01 * x + y) for x, y in some)
    found = lower_envelope(some)
    best = None
    for i, (ax, ay) in enumerate(some):
        for bx, by in some[i + 1 :]:
            slope = (by - ay) / (bx - ax)
            base = ay - slope * ax
            gaps = [y - base - slope * x for x, y in some]
            if min(gaps) >= -1e-9 and (best is None or sum(gaps) < best[0]):
                best = sum(gaps), slope
    assert best is not None
    if found is None:
        assert best[1] <= 1e-9
        return
    base, slope = found
    gaps = [y - base - slope * x for x, y in some]
    assert min(gaps) >= -1e-9
    assert sum(gaps) == pytest.approx(best[0], abs=1e-6)


class Clocks:
    """A monotonic clock and one of the epoch; each reading takes a while, and now and then very long."""

    def __init__(self, ahead: int) -> None:
        self.now = 5_000_000_000
        self.ahead = ahead
        self.pauses: list[int] = []

    def _read(self) -> int:
        self.now += 200
        seen = self.now
        self.now += self.pauses.pop(0) if self.pauses else 0
        return seen

    def monotonic(self) -> int:
        return self._read()

    def wall(self) -> int:
        return self._read() + self.ahead


@given(
    st.lists(
        st.tuples(st.integers(0, 5_000_000), st.integers(0, 5_000_000)), min_size=1, max_size=20
    )
)
def test_the_time_of_the_epoch_does_not_jump_when_the_process_stands_still(pauses) -> None:
    clocks = Clocks(1_763_709_179_000_000_000)
    wall = WallClock(clocks.monotonic, clocks.wall)
    first = wall.offset()
    assert abs(first - clocks.ahead) < 1000
    for before, after in pauses:
        clocks.pauses = [before, after]
        assert abs(wall.offset() - clocks.ahead) <= QUICK


def test_a_clock_that_is_set_or_that_drifts_is_followed() -> None:
    clocks = Clocks(1_763_709_179_000_000_000)
    wall = WallClock(clocks.monotonic, clocks.wall)
    wall.offset()
    for change in (3_600_000_000_000, -50_000_000, 2_000, -100):
        clocks.ahead += change
        assert abs(wall.offset() - clocks.ahead) < 1000
    clocks.ahead += 1_000_000_000
    clocks.pauses = [3_000_000]
    assert abs(wall.offset() - clocks.ahead) <= 3_000_000
