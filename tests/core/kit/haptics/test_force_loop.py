"""The force loop: when forces are zero, how they rise, how strong they are."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.kit.haptics import (
    ForceLimits,
    ForceLoop,
    Motion,
    Spring,
    TankLimits,
    Triple,
    Wall,
)
from crtk_drivers.kit.haptics.triples import ZERO, size

LIMITS = ForceLimits(force=8.0, torque=0.5, ramp=0.1, command_timeout=0.05)
AMPLE = TankLimits(allowance=1e5, power=1e5)
"""Where something else than energy is tested."""
HERE = Motion((0.0, 0.0, 0.0))
UP = ((0.0, 0.0, 2.0), (0.0, 0.1, 0.0))


def enabled(at: float = 0.0) -> ForceLoop:
    loop = ForceLoop(LIMITS, AMPLE)
    loop.enable(at)
    return loop


def run(loop: ForceLoop, begin: float, end: float, motion: Motion = HERE) -> tuple[Triple, Triple]:
    """Step every 10 ms and return what the last step gave."""
    steps = round((end - begin) / 0.01)
    for index in range(steps):
        loop.step(motion, begin + index * 0.01)
    return loop.step(motion, end)


def test_nothing_goes_out_before_it_is_enabled_or_after_it_was_disabled() -> None:
    loop = ForceLoop(LIMITS, AMPLE)
    loop.use({"spring": Spring((0.1, 0.0, 0.0), stiffness=1000.0)})
    loop.command(*UP, 0.0)
    assert loop.step(HERE, 0.0) == (ZERO, ZERO)
    loop.enable(0.0)
    assert size(run(loop, 0.0, 0.2)[0]) == pytest.approx(8.0)
    loop.disable()
    assert loop.step(HERE, 0.21) == (ZERO, ZERO)
    loop.enable(0.22)
    assert loop.step(HERE, 0.22) == (ZERO, ZERO), "it rises anew"


def test_forces_rise_after_enable() -> None:
    loop = enabled()
    seen = []
    for index in range(21):
        loop.command(*UP, 0.01 * index)
        seen.append(loop.step(HERE, 0.01 * index)[0][2])
    assert seen[:11] == pytest.approx([0.2 * index for index in range(11)])
    assert seen[11:] == pytest.approx([2.0] * 10)


def test_what_was_commanded_before_it_was_enabled_is_forgotten() -> None:
    loop = ForceLoop(LIMITS, AMPLE)
    loop.command(*UP, 0.0)
    loop.follow(Spring((0.1, 0.0, 0.0), stiffness=100.0), 0.0)
    loop.enable(0.0)
    assert loop.step(HERE, 0.02) == (ZERO, ZERO)


def test_a_command_that_is_not_repeated_ends() -> None:
    loop = enabled()
    run(loop, 0.0, 1.0)
    loop.command(*UP, 1.0)
    assert loop.step(HERE, 1.04) == UP
    assert loop.step(HERE, 1.06) == (ZERO, ZERO)


def test_a_pose_that_is_followed_draws_and_ends() -> None:
    loop = enabled()
    run(loop, 0.0, 1.0)
    seen = []
    for index in range(11):
        loop.follow(Spring((0.01, 0.0, 0.0), stiffness=300.0), 1.01 + 0.01 * index)
        seen.append(loop.step(HERE, 1.01 + 0.01 * index)[0][0])
    assert seen[:3] == pytest.approx([0.8, 1.1, 1.4]), "its begin is no jerk"
    assert seen[-1] == pytest.approx(3.0)
    loop.command(*UP, 1.12)
    assert loop.step(HERE, 1.12) == UP, "one ends the other"
    loop.follow(Spring((0.01, 0.0, 0.0), stiffness=300.0), 1.13)
    loop.release()
    assert loop.step(HERE, 1.14) == (ZERO, ZERO)


def test_fixtures_stay_when_a_stream_ends() -> None:
    loop = enabled()
    loop.use({"floor": Wall((0.0, 0.0, 0.001), (0.0, 0.0, 1.0), 1000.0)})
    run(loop, 0.0, 1.0)
    loop.release()
    assert loop.step(HERE, 1.01)[0] == pytest.approx((0.0, 0.0, 1.0))
    loop.use({})
    assert loop.step(HERE, 1.02) == (ZERO, ZERO)


def test_a_gap_or_a_broken_measurement_begins_anew() -> None:
    loop = enabled()
    loop.use({"spring": Spring((0.002, 0.0, 0.0), stiffness=1000.0)})
    assert size(run(loop, 0.0, 0.5)[0]) == pytest.approx(2.0)
    assert size(loop.step(HERE, 0.7)[0]) == 0.0, "nobody saw where the hand went"
    assert size(run(loop, 0.71, 1.0)[0]) == pytest.approx(2.0)
    assert loop.step(Motion((math.nan, 0.0, 0.0)), 1.001) == (ZERO, ZERO)
    assert size(loop.step(HERE, 1.002)[0]) < 0.1
    assert size(run(loop, 1.01, 1.5)[0]) == pytest.approx(2.0)


@given(
    command=st.tuples(*[st.floats(-1e6, 1e6)] * 6),
    place=st.tuples(*[st.floats(-1.0, 1.0)] * 3),
    strength=st.floats(0.0, 20_000.0),
)
def test_the_whole_vector_is_bounded_and_keeps_its_direction(
    command: tuple[float, ...], place: Triple, strength: float
) -> None:
    loop = enabled()
    loop.use({"spring": Spring(place, stiffness=strength)})
    force = (command[0], command[1], command[2])
    torque = (command[3], command[4], command[5])
    run(loop, 0.0, 0.5)
    loop.command(force, torque, 0.51)
    pushed, turned = loop.step(HERE, 0.51)
    assert size(pushed) <= LIMITS.force * (1.0 + 1e-9)
    assert size(turned) <= LIMITS.torque * (1.0 + 1e-9)
    if size(torque) > 1.0:
        assert turned == pytest.approx([0.5 * each / size(torque) for each in torque], abs=1e-6)


def test_a_command_that_is_not_finite_is_refused_and_changes_nothing() -> None:
    loop = enabled()
    run(loop, 0.0, 0.5)
    loop.command(*UP, 0.5)
    with pytest.raises(ValueError, match="finite"):
        loop.command((math.inf, 0.0, 0.0), ZERO, 0.5)
    assert loop.step(HERE, 0.51) == UP


@pytest.mark.parametrize(
    "values", [{"force": 0.0}, {"force": math.nan}, {"ramp": -1.0}, {"torque": -0.1}]
)
def test_limits_that_limit_nothing_are_refused(values: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="must be"):
        ForceLimits(**{"force": 1.0, **values})


def test_fixtures_that_are_switched_on_in_reach_rise() -> None:
    loop = enabled()
    run(loop, 0.0, 1.0)
    loop.use({"wall": Wall((0.0, 0.0, 0.05), (0.0, 0.0, 1.0), 10_000.0)})
    seen = [size(loop.step(HERE, 1.01 + 0.01 * index)[0]) for index in range(11)]
    assert seen[:9] == pytest.approx([0.8 * (1 + index) for index in range(9)])
    assert seen[-1] == pytest.approx(8.0)
    loop.use({})
    assert loop.step(HERE, 1.12) == (ZERO, ZERO), "what is taken away is away"


def test_a_force_does_not_turn_round_at_once() -> None:
    loop = enabled()
    for index, way in enumerate((0.01, -0.01)):
        loop.use({"spring": Spring((way, 0.0, 0.0), stiffness=400.0)})
        force, _ = loop.step(HERE, 1.0 + index)
        run(loop, 1.0 + index, 1.99 + index)
    assert force[0] == pytest.approx(-0.8)


def test_fixtures_that_are_moved_a_little_push_on_at_once() -> None:
    loop = enabled()
    loop.use({"floor": Wall((0.0, 0.0, 0.002), (0.0, 0.0, 1.0), 1000.0)})
    run(loop, 0.0, 1.0)
    for index in range(5):
        loop.use({"floor": Wall((0.0, 0.0, 0.0025 + 0.0005 * index), (0.0, 0.0, 1.0), 1000.0)})
        force, _ = loop.step(HERE, 1.01 + 0.01 * index)
        assert force[2] == pytest.approx(2.5 + 0.5 * index)


def test_a_force_rises_as_slowly_where_a_fixture_is_far_away() -> None:
    loop = ForceLoop(LIMITS, AMPLE)
    loop.use({"spring": Spring((5.0, 0.0, 0.0), stiffness=20_000.0)})
    loop.enable(0.0)
    loop.step(HERE, 0.0)
    assert size(loop.step(HERE, 0.01)[0]) == pytest.approx(0.8)
    loop.begin_anew(0.02)
    loop.step(HERE, 0.02)
    assert size(loop.step(HERE, 0.03)[0]) == pytest.approx(0.8)


@pytest.mark.parametrize("number", [1e300, -1e308, math.inf, 1001.0])
def test_a_measurement_that_no_hand_may_have_is_none(number: float) -> None:
    loop = enabled()
    loop.use({"spring": Spring((0.002, 0.0, 0.0), stiffness=1000.0, damping=200.0)})
    run(loop, 0.0, 0.5)
    for motion in (Motion((number, 0.0, 0.0)), Motion((0.0,) * 3, velocity=(0.0, number, 0.0))):
        assert loop.step(motion, 0.501) == (ZERO, ZERO)
    assert size(run(loop, 0.51, 1.0)[0]) == pytest.approx(2.0), "and spoils nothing"
