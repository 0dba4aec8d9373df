"""Whatever servos say on the wire: no thread dies of it, nothing not finite is told, nothing moves."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from crtk_driver_dynamixel import PLUGIN
from crtk_drivers.errors import CrtkError, StopUnconfirmed
from crtk_drivers.state import OperatingState
from crtk_sim_backends.process import RunningSim
from rigs.claimed_values import no_surprise, numbers
from rigs.dynamixel_bench import (
    COUNT,
    DynamixelBench,
    arm_values,
    configuration,
    driver_at,
    eventually,
    sim_for,
)
from rigs.examples import examples
from rigs.extreme_values import IN_REAL_TIME

JOINTS: dict[str, Any] = {
    "a": {"id": 1, "model": "xm430-w350", "lower": -1.0, "upper": 1.0},
    "b": {"id": 2, "model": "xl330-m288", "lower": -1.0, "upper": 1.0},
}
VALUES = {
    **{key: value for key, value in arm_values().items() if key != "arm"},
    "joints": JOINTS,
    "slow_interval": 0.01,
    "rate": 500.0,
}
CHEAP = {
    **IN_REAL_TIME,
    "suppress_health_check": [HealthCheck.too_slow],
}


class Register(NamedTuple):
    address: int
    size: int


IN_CYCLES = (
    *(Register(126, 2), Register(128, 4), Register(132, 4)),  # current, velocity, position
    *(Register(64, 1), Register(68, 1), Register(70, 1), Register(98, 1)),
    *(Register(144, 2), Register(146, 1)),
    *(Register(100, 2), Register(102, 2), Register(104, 4), Register(116, 4)),  # goals
)
"""What is read in each cycle, and now and then (X series)."""

AT_SET_UP = (
    *(Register(0, 2), Register(6, 1), Register(10, 1), Register(11, 1), Register(12, 1)),
    *(Register(20, 4), Register(36, 2), Register(38, 2), Register(44, 4), Register(48, 4)),
    *(Register(52, 4), Register(60, 1), Register(31, 1)),
)
"""What is read when it is opened and enabled besides: model, firmware, modes, offsets, limits."""


def claims(registers: tuple[Register, ...]) -> st.SearchStrategy[tuple[int, str]]:
    """Addresses, and what the memory there reads as: a register, or a stretch of any bytes."""

    @st.composite
    def one(draw: st.DrawFn) -> tuple[int, str]:
        register = draw(st.sampled_from(registers))
        value = draw(numbers(register.size))
        if register.address == 132 and -64 < _signed(value) < 4096 + 64:
            value = 1 << 31  # a wrong angle within the turn is one that the servo itself goes by
        return register.address, value.to_bytes(register.size, "little").hex()

    return one()


def _signed(value: int) -> int:
    return value - (1 << 32) if value >= 1 << 31 else value


@pytest.fixture(scope="module")
def bench() -> Iterator[DynamixelBench]:
    with (
        sim_for(VALUES, servos="1:xm430-w350,2:xl330-m288", timing="none") as sim,
        driver_at(sim, VALUES) as bench,
    ):
        bench.enable()
        yield bench


@settings(max_examples=examples(40), **CHEAP)
@given(claim=claims(IN_CYCLES), servo=st.integers(1, 2))
def test_what_a_servo_claims_while_it_holds_moves_nothing(
    bench: DynamixelBench, claim: tuple[int, str], servo: int
) -> None:
    address, data = claim
    if not bench.arm.is_enabled():
        bench.enable()
    with no_surprise(), bench.nothing_moves(4.0):
        bench.sim.control.inject("claim", id=servo, address=address, data=data)
        cycles = bench.arm.health().cycles + 30
        eventually(lambda: bench.arm.health().cycles >= cycles, "the driver has seen it")
        bench.arm.hold()
        cycles = bench.arm.health().cycles + 10
        eventually(lambda: bench.arm.health().cycles >= cycles, "it has been stopped")
        told = bench.engine.feedback("measured_js")
        assert told is not None
        assert np.isfinite(told[0].position).all()
        assert np.isfinite(told[0].velocity).all()
        bench.sim.control.clear("claim")
        bench.until_connected()
        if bench.status.state is not OperatingState.ENABLED:
            bench.enable()
        bench.cycles(3)


@pytest.fixture(scope="module")
def servos() -> Iterator[RunningSim]:
    with sim_for(VALUES, servos="1:xm430-w350,2:xl330-m288", timing="none") as sim:
        yield sim


@settings(max_examples=examples(40), **CHEAP)
@given(claim=claims((*AT_SET_UP, *IN_CYCLES)), servo=st.integers(1, 2))
@example(claim=(38, "feff"), servo=1)  # current limit, more than a goal can be
@example(claim=(36, "feff"), servo=1)  # that of the voltage
def test_what_a_servo_claims_when_it_is_opened_and_enabled_is_refused_or_moves_nothing(
    servos: RunningSim, claim: tuple[int, str], servo: int
) -> None:
    address, data = claim
    before = {name: found["angle"] for name, found in servos.control.outputs().items()}
    servos.control.inject("claim", id=servo, address=address, data=data)
    device = PLUGIN.create(configuration(servos, {**VALUES, "latency_budget": 0.01}))
    try:
        device.open(time.monotonic() + 2.0)
        for _ in device.enable():
            device.read(time.monotonic() + 1.0)
        for _ in range(10):
            device.read(time.monotonic() + 1.0)
    except CrtkError:
        pass  # it was refused
    finally:
        with suppress(StopUnconfirmed):
            device.close()
        servos.control.clear("claim")
    after = servos.control.outputs()
    for name, angle in before.items():
        assert abs(after[name]["angle"] - angle) < 4 * COUNT, name
