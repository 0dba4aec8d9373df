"""Which force is in force, and how fast a grip turns."""

from __future__ import annotations

import math

import pytest

from crtk_driver_haply.force import ForceInForce
from crtk_driver_haply.messages import NO_FORCE
from crtk_driver_haply.turning import WINDOW, Turning
from crtk_drivers.samples import vector

FORCE = (1.0, -2.0, 0.5)
LASTS = 0.05


def test_a_force_is_zero_when_nobody_repeats_it() -> None:
    force = ForceInForce(0.0, LASTS)
    assert force.at(0.0) == NO_FORCE
    force.ask(FORCE, 1.0)
    assert force.at(1.0 + 0.9 * LASTS) == FORCE
    assert force.at(1.0 + 1.1 * LASTS) == NO_FORCE


def test_a_force_that_begins_grows_and_one_that_goes_on_does_not_begin_again() -> None:
    force = ForceInForce(0.1, LASTS)
    for cycle in range(26):
        force.ask(FORCE, 1.0 + 0.01 * cycle)
        share = min(1.0, 0.1 * cycle)
        assert force.at(1.0 + 0.01 * cycle) == pytest.approx([share * each for each in FORCE])
    force.ask(FORCE, 1.26 + LASTS)
    assert force.at(1.26 + LASTS) == NO_FORCE, "after a pause it begins anew"


def test_a_force_that_is_dropped_begins_anew() -> None:
    force = ForceInForce(0.1, LASTS)
    force.ask(FORCE, 1.0)
    force.drop()
    assert force.at(1.0) == NO_FORCE
    force.ask(FORCE, 1.01)
    assert force.at(1.01) == NO_FORCE


def test_a_grip_turns_as_fast_as_its_orientations_say() -> None:
    turning = Turning()
    told = []
    for cycle in range(100):
        now = 0.002 * cycle
        half = 0.5 * 2.0 * 0.01 * (cycle // 5)  # 2 rad/s, but a new one every 10 ms alone
        told.append(turning.take(vector((0.0, 0.0, math.sin(half), math.cos(half))), now))
    assert not told[0].any()
    rates = [rate[2] for rate in told if rate.any()]
    assert min(rates[10:]) > 1.2
    assert max(rates) < 2.8
    assert sum(rates[20:]) / len(rates[20:]) == pytest.approx(2.0, rel=0.1)


def test_a_grip_that_was_asleep_has_not_turned() -> None:
    turning = Turning()
    turning.take(vector((0.0, 0.0, 0.0, 1.0)), 0.0)
    turning.forget()
    assert not turning.take(vector((1.0, 0.0, 0.0, 0.0)), WINDOW).any()
