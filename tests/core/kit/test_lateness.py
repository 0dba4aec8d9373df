"""How old a record is when it comes."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.kit.lateness import Lateness

PERIOD = 0.004
MADE_AND_WAITED = st.lists(
    st.tuples(st.floats(1e-3, 1.0), st.floats(0.0, 1.0)), min_size=1, max_size=60
)


def flowing(seconds: float = 1.0) -> tuple[Lateness, float]:
    late, now = Lateness(), 100.0
    while now < 100.0 + seconds:
        assert late.of(PERIOD, now) == pytest.approx(0.0, abs=1e-9)
        now += PERIOD
    return late, now - PERIOD


def test_what_was_kept_is_late_and_what_follows_is_not() -> None:
    late, now = flowing()
    now += 3.0
    for waited in range(300):
        assert late.of(PERIOD, now) == pytest.approx(3.0 - PERIOD * (1 + waited), abs=1e-6)
    assert late.of(3.0 - 300 * PERIOD, now) == pytest.approx(0.0, abs=1e-6)


def test_a_delay_that_stays_is_forgotten() -> None:
    """A device that stood still itself, or another way through the network."""
    late, now = flowing()
    now += 0.3
    assert late.of(PERIOD, now) == pytest.approx(0.3 - PERIOD, abs=1e-6)
    found = [late.of(PERIOD, now + PERIOD * count) for count in range(1, 60)]
    assert found[-1] == pytest.approx(0.0, abs=1e-6)


@given(MADE_AND_WAITED)
def test_it_is_never_ahead_and_time_never_goes_back(steps: list[tuple[float, float]]) -> None:
    late, now, made = Lateness(), 100.0, -1.0
    for passed, waited in steps:
        now += waited
        found = late.of(passed, now)
        assert 0.0 <= found <= now - 100.0 + 1e-9
        assert now - found >= made - 1e-9
        made = now - found
