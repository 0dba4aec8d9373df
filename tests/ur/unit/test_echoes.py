"""How old a state may be, by the packages that it answers: never less than it is, on any network."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_ur.rtde.echoes import CLOCK_ERROR, KEPT, MOST_NUMBERS, Echoes

BOOT = 1000.0
"""Monotonic seconds at which the controller's clock began."""
PERIOD = 0.02

delays = st.lists(st.tuples(st.floats(0.0, 0.5), st.floats(0.0, 0.5)), min_size=1, max_size=60)
"""Of a package to the controller and of the state that answers it, s."""


def exchange(echoes: Echoes, sent: float, there: float, back: float, rate: float = 1.0) -> float:
    """Return how old the state that answers a package may be; its true age is `back`."""
    number = echoes.leaves(sent)
    made = sent + there
    timestamp = (made - BOOT) * rate
    echoes.take(number, timestamp)
    return echoes.age(made + back, timestamp)


@given(delays, st.floats(1.0 - CLOCK_ERROR / 2, 1.0 + CLOCK_ERROR / 2))
def test_no_state_is_older_than_is_said(found, rate):
    echoes, sent = Echoes(), BOOT
    for there, back in found:
        sent += PERIOD + there + back
        age = exchange(echoes, sent, there, back, rate)
        assert back - 1e-6 <= age <= there + back + 1e-6


@given(st.floats(0.05, 0.5))
def test_states_that_begin_to_come_late_are_told_from_late_commands(late):
    echoes = Echoes()
    for index in range(10):
        exchange(echoes, BOOT + index * PERIOD, 0.002, 0.002)
    assert exchange(echoes, BOOT + 1.0, late, 0.002) < 0.006
    assert exchange(echoes, BOOT + 2.0, 0.002, late) >= late


def test_nothing_is_known_before_the_first_answer():
    echoes = Echoes()
    echoes.leaves(BOOT)
    assert not echoes.began
    assert echoes.age(BOOT + 5.0, 0.0) == 0.0


def test_another_program_is_judged_anew():
    echoes = Echoes()
    exchange(echoes, BOOT, 0.0, 0.3)
    echoes.begin()
    assert not echoes.began
    assert exchange(echoes, 2 * BOOT, 0.01, 0.01) == pytest.approx(0.02)


def test_a_state_that_shows_nothing_new_ages_by_the_clocks():
    echoes = Echoes()
    number = echoes.leaves(BOOT)
    echoes.take(number, 0.001)
    assert echoes.age(BOOT + 0.002, 0.001) == pytest.approx(0.002)
    assert echoes.age(BOOT + 0.502, 0.301) == pytest.approx(0.202)


def test_what_no_package_had_says_nothing():
    echoes = Echoes()
    exchange(echoes, BOOT, 0.001, 0.001)
    echoes.leaves(BOOT + 1.0)
    echoes.take(12345, 7.0)
    assert echoes.age(BOOT + 1.0, 1.0) == pytest.approx(0.0, abs=0.0021)


def test_numbers_begin_anew_after_the_last():
    echoes = Echoes()
    numbers = [echoes.leaves(float(i)) for i in range(MOST_NUMBERS + 2)]
    assert numbers[-2:] == [1, 2]
    assert len(set(numbers[-KEPT:])) == KEPT
