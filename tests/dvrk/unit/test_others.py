"""Another program at the same boards is told from delays, and from packets that are lost or doubled."""

from __future__ import annotations

import tracemalloc

from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_dvrk.others import OtherReaders

TIMES = st.lists(
    st.tuples(st.floats(0.0, 0.1), st.floats(0.0, 0.1), st.floats(0.0, 0.1), st.booleans()),
    min_size=1,
    max_size=40,
)


@given(TIMES)
def test_nobody_is_seen_where_only_we_read(times: list[tuple[float, float, float, bool]]) -> None:
    """Whatever the delays to the board and back, and whichever answers are lost."""
    watch, now, read_before = OtherReaders(), 0.0, 0.0
    for pause, there, back, is_lost in times:
        now += pause
        watch.asked(now)
        read_at = now + there
        elapsed, read_before = read_at - read_before, read_at
        now = read_at + back
        if not is_lost:
            watch.answered(elapsed, now)
        assert not watch.are_there(now)


def test_one_that_reads_in_between_is_seen() -> None:
    watch, now = OtherReaders(), 0.0
    for _ in range(4):
        watch.asked(now)
        watch.answered(0.001, now + 0.0005)  # it read 1 ms before we did
        now += 0.004
    assert watch.are_there(now)


def test_a_request_that_was_doubled_once_is_nobody() -> None:
    watch, now = OtherReaders(), 0.0
    for at in range(40):
        watch.asked(now)
        watch.answered(0.0002 if at == 20 else 0.004, now + 0.0005)
        now += 0.004
    assert not watch.are_there(now)


def test_who_has_gone_is_forgotten() -> None:
    watch, now = OtherReaders(), 0.0
    for _ in range(5):
        watch.asked(now)
        watch.answered(0.001, now + 0.0005)
        now += 0.004
    assert watch.are_there(now)
    assert not watch.are_there(now + 1.5)


def test_one_that_reads_all_day_fills_no_memory() -> None:
    """Beside an arm that is not driven that is no fault, and nobody looks whether it is there."""
    watch, now = OtherReaders(), 0.0
    tracemalloc.start()
    try:
        for _ in range(50_000):
            watch.asked(now)
            watch.answered(0.001, now + 0.0005)
            now += 0.004
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert held < 100_000
    assert watch.are_there(now)
