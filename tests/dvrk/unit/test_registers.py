"""The state of a board: known quadlets, and bits."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crtk_driver_dvrk.registers import AXES, QUADLETS, BoardState, state_of
from rigs.examples import examples

STATUS = 0x470F0000
"""Four channels, board 7, motor voltage good, power, relay closed and asked for."""


def block(**changes: int) -> list[int]:
    """Return a state at rest, but for changes: quadlets by q0, q1, ..."""
    found = [491_519, STATUS, 0x00000ABC, 0x3E42]
    found += [0x8000_8000] * AXES + [0x800000] * AXES + [0x83FFFFFF] * AXES + [0] * 3 * AXES
    found += [0x30108000] * AXES
    for name, value in changes.items():
        found[int(name[1:])] = value
    return found


def state(**changes: int) -> BoardState:
    """Return the state of `block`."""
    return state_of(block(**changes))


def test_a_state_with_everything_in_order() -> None:
    found = state()
    assert (found.board, found.channels) == (7, 4)
    assert found.elapsed == pytest.approx(0.01)
    assert found.power
    assert found.voltage_good
    assert found.relay
    assert found.relay_closed
    assert (found.timed_out, found.supply_fault, found.encoder_supply_fault) == (False,) * 3
    assert found.inputs == 0xABC
    assert found.temperatures == (31.0, 33.0)
    for axis in found.axes:
        assert (axis.potentiometer, axis.current, axis.counts) == (0x8000, 0x8000, 0)
        assert axis.velocity == 0.0
        assert axis.is_on
        assert (axis.overflow, axis.jumped, axis.is_tripped, axis.has_fault) == (False,) * 4


@pytest.mark.parametrize(
    ("bit", "name"),
    [(23, "timed_out"), (19, "voltage_good"), (18, "power"), (17, "relay_closed"), (16, "relay"),
     (15, "supply_fault")],
)  # fmt: skip
def test_each_bit_of_the_status_is_one_thing(bit: int, name: str) -> None:
    names = ("timed_out", "voltage_good", "power", "relay_closed", "relay", "supply_fault")
    found = state(q1=0x47000000 | 1 << bit)
    assert [each for each in names if getattr(found, each)] == [name]


def test_an_axis_has_its_own_quadlets() -> None:
    found = state(q6=0x1234_5678, q10=0x00FFFFFE, q30=0x20000000).axes
    assert (found[2].potentiometer, found[2].current) == (0x1234, 0x5678)
    assert found[2].counts == 0x7FFFFE
    assert not found[2].is_on  # asked for, and not on yet
    assert (found[1].current, found[1].counts, found[1].is_on) == (0x8000, 0, True)


def test_an_encoder_counts_from_the_middle_of_24_bits() -> None:
    assert state(q8=0x30000000).axes[0].counts == -0x800000
    assert state(q8=0x01800001).axes[0].overflow
    assert state(q8=0x01800001).axes[0].counts == 1


def test_faults_of_a_motor() -> None:
    found = state(q28=0x00028000, q29=0x00018000).axes
    assert (found[0].is_tripped, found[0].has_fault) == (True, False)
    assert (found[1].is_tripped, found[1].has_fault) == (False, True)


@pytest.mark.parametrize(
    ("period", "velocity"),
    [
        (0x40000000 | 49_152, 4000.0),  # forwards, four counts in a millisecond
        (49_152, -4000.0),
        (0x80000000 | 49_152, 0.0),  # too long
        (0x60000000 | 49_152, 0.0),  # it has just turned round
        (0x48000000 | 49_152, 4000.0),  # not a whole cycle yet
        (0x40000000, 4.0 * 49.152e6),
    ],
)
def test_velocity_is_four_counts_in_a_period(period: int, velocity: float) -> None:
    assert state(q12=period).axes[0].velocity == pytest.approx(velocity)


def test_an_impossible_change_of_the_signals_is_told() -> None:
    assert state(q12=0x10000000 | 100).axes[0].jumped


@settings(max_examples=examples(40))
@given(st.lists(st.integers(0, 0xFFFFFFFF), min_size=QUADLETS, max_size=QUADLETS))
def test_any_quadlets_are_a_state_with_numbers_in_their_ranges(quadlets: list[int]) -> None:
    for axis in state_of(quadlets).axes:
        assert 0 <= axis.potentiometer <= 0xFFFF
        assert 0 <= axis.current <= 0xFFFF
        assert -0x800000 <= axis.counts < 0x800000
        assert abs(axis.velocity) <= 4.0 * 49.152e6


@settings(max_examples=examples(40))
@given(st.lists(st.integers(0, 0xFFFFFFFF), max_size=60).filter(lambda q: len(q) != QUADLETS))
def test_another_number_of_quadlets_is_no_state(quadlets: list[int]) -> None:
    """28, too: those of firmware 7."""
    with pytest.raises(ValueError, match="32"):
        state_of(quadlets)
