"""Whatever a hand does, fixtures give it no more energy than the tank says; without it they do."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crtk_drivers.kit.haptics import (
    Box,
    EnergyTank,
    Fixture,
    ForceLimits,
    ForceLoop,
    Sphere,
    Spring,
    TankLimits,
    Triple,
    Wall,
)
from crtk_drivers.kit.haptics.passivity import TRICKLE
from rigs.examples import examples
from rigs.simulated_hand import Hand, driven

FORCE = 10.0
"""N, of the loop and of the hand at most."""
LOOP = ForceLimits(force=FORCE, ramp=0.02)
FLOOR = Wall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 4000.0)
FIXTURES: list[dict[str, Fixture]] = [
    {"floor": FLOOR},
    {"floor": Wall((0.0, 0.0, 0.0), (0.0, 1.0, 1.0), 2000.0, 20.0)},
    {"spring": Spring((0.0, 0.0, 0.02), stiffness=3000.0)},
    {"cage": Box((-0.01,) * 3, (0.01,) * 3, 5000.0)},
    {"ball": Sphere((0.0, 0.0, 0.0), 0.03, 3000.0, keep="outside"), "floor": FLOOR},
]

pushes = st.tuples(*[st.floats(-FORCE / 2, FORCE / 2)] * 3)


def tank_of(mass: float, period: float, delay: int) -> TankLimits:
    fastest = 2.0 * FORCE / mass
    return TankLimits(acceleration=fastest, period=period, delay=delay, power=1.0)


@settings(max_examples=examples(40), deadline=None)
@given(
    fixtures=st.sampled_from(FIXTURES),
    others=st.sampled_from(FIXTURES),
    pushed=st.lists(st.tuples(pushes, st.integers(1, 40)), min_size=1, max_size=15),
    mass=st.floats(0.05, 1.0),
    speed=st.floats(-1.0, 1.0),
    delay=st.integers(0, 4),
    period=st.sampled_from((0.00025, 0.001, 0.002)),
)
def test_the_energy_that_goes_out_is_bounded_at_any_time(
    fixtures: dict[str, Fixture],
    others: dict[str, Fixture],
    pushed: list[tuple[Triple, int]],
    mass: float,
    speed: float,
    delay: int,
    period: float,
) -> None:
    limits = tank_of(mass, period, delay)
    loop = ForceLoop(LOOP, limits)
    hand = Hand(mass, velocity=(0.0, 0.0, speed))
    all_pushes = [push for push, count in pushed for _ in range(count)]
    loop.use(fixtures)
    loop.enable(100.0)
    began = 100.0
    for cycle, now in enumerate(
        driven(hand, loop, all_pushes, period=period, delay=delay, begin=began)
    ):
        if cycle == len(all_pushes) // 2:
            loop.use(others)
        passed = now - began + period
        assert loop.tank.granted <= limits.power * passed + 1e-9
        most = limits.allowance + TRICKLE * passed + loop.tank.granted
        assert hand.given <= most + 1e-9
    assert hand.acceleration <= limits.acceleration + 1e-9, "beyond what the tank is told"


def bouncing(allowance: float) -> float:
    """A frictionless mass is pushed on a floor of 4000 N/m with a delay of 5 ms; return the most J given."""
    loop = ForceLoop(LOOP, TankLimits(allowance=allowance, acceleration=100.0, delay=5))
    loop.use({"floor": FLOOR})
    loop.enable(0.0)
    hand = Hand(0.2, position=(0.0, 0.0, 0.01))
    return max(hand.given for _ in driven(hand, loop, [(0.0, 0.0, -4.0)] * 2000, delay=5))


def test_a_stiff_floor_with_a_delay_gives_energy_without_end_but_for_the_tank() -> None:
    assert bouncing(allowance=0.01) < 0.01 + 2.0 * TRICKLE
    assert bouncing(allowance=1e5) > 0.5


def test_a_spring_that_is_sampled_well_is_not_reduced() -> None:
    loop = ForceLoop(LOOP, TankLimits(acceleration=100.0, delay=0, period=0.00025))
    loop.use({"floor": Wall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 500.0, 5.0)})
    loop.enable(0.0)
    hand = Hand(0.2, position=(0.0, 0.0, 0.005))
    for _ in driven(hand, loop, [(0.0, 0.0, -3.0)] * 8000, period=0.00025, delay=0):
        pass
    assert loop.tank.reduced == 0
    assert hand.position[2] == pytest.approx(-3.0 / 500.0, abs=1e-3)


def test_what_is_sure_to_take_energy_passes_an_empty_tank() -> None:
    tank = EnergyTank(TankLimits(delay=0))
    tank.energy = 0.0
    tank.moved((0.0, 0.0, -0.001), (0.0, 0.0, 0.0), 0.001, 0.0, 0.0)
    assert tank.allow((0.0, 0.0, 5.0), (0.0, 0.0, 0.0)) == ((0.0, 0.0, 5.0), (0.0, 0.0, 0.0))
    force, _ = tank.allow((0.0, 0.0, -5.0), (0.0, 0.0, 0.0))
    assert abs(force[2]) < 0.1
    assert tank.reduced == 1


def test_a_torque_is_kept_account_of_as_a_force_is() -> None:
    tank = EnergyTank(TankLimits(delay=0, allowance=0.001))
    given = 0.0
    for _ in range(1000):
        tank.moved((0.0, 0.0, 0.0), (0.0, 0.002, 0.0), 0.001, 0.0, 0.0)
        _, torque = tank.allow((0.0, 0.0, 0.0), (0.0, 1.0, 0.0))
        tank.sent((0.0, 0.0, 0.0), torque)
        given += torque[1] * 0.002
    assert 0.0005 < given <= 0.001 + TRICKLE


@pytest.mark.parametrize(
    "values",
    [
        {"allowance": 0.0},
        {"power": math.inf},
        {"period": -1.0},
        {"delay": 101},
        {"turning": math.nan},
    ],
)
def test_limits_that_bound_nothing_are_refused(values: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="must be"):
        TankLimits(**values)  # type: ignore[arg-type]
