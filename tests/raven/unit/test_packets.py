"""Packets as Raven's header file has them, and what an arm puts into them."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_raven.arm import Arm
from crtk_driver_raven.config import RavenConfig
from crtk_driver_raven.packets import FIRST, NOTHING, PRIMING, SIZE, Increment, after, encode
from crtk_drivers.device import Setpoint
from crtk_drivers.device.capabilities import Mode
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.samples import Number, vector

KNOWN = (
    "05000000 00000000 00000000"
    "0a000000 00000000 ecffffff 00000000 00000000 03000000"
    "0000000000000000 0000000000000000 0000000000000000 0000000000000000"
    "0000000000000000 0000000000000000 000000000000f03f 000000000000f03f"
    "00000000 00000000 07000000 feffffff 01000000 ffffffff"
)
ints = st.integers(-(2**31), 2**31 - 1)
increments = st.builds(
    Increment, st.tuples(ints, ints, ints), st.tuples(*[st.floats(-1.0, 1.0)] * 4), ints
)
unheard: Any = type("Unheard", (), {"is_lost": False, "engaged": True, "address": "nowhere"})()


def arm(**values: Any) -> Arm:
    led = Arm(unheard, "gold", RavenConfig(rate=100, **values))
    assert list(led.enable()) == []
    return led


def goal(*position: float) -> Setpoint:
    return Setpoint(Mode.CARTESIAN_POSITION, vector((*position, 0.0, 0.0, 0.0, 1.0)))


def test_a_known_packet() -> None:
    gold = Increment((10, -20, 0), closing=7)
    green = Increment((0, 0, 3), closing=-2)
    data = encode(5, (gold, green), engaged=True)
    assert data == bytes.fromhex(KNOWN)
    assert len(data) == SIZE == 124


@given(st.integers(1, 2**32 - 1), increments, increments, st.booleans())
def test_every_packet_has_its_place_and_its_sum(
    number: int, gold: Increment, green: Increment, engaged: bool
) -> None:
    data = encode(number, (gold, green), engaged=engaged)
    words = struct.unpack("<9i", data[:36])
    assert words[3::2] == gold.position
    assert words[4::2] == green.position
    assert struct.unpack_from("<8d", data, 36)[1::2] == green.rotation
    *_, down, checksum = struct.unpack("<6i", data[100:])
    assert down == engaged
    assert (checksum - down - sum(words[3:]) - number) % 2**32 == 0


def test_numbers_go_on_and_none_is_zero() -> None:
    assert after(7) == 8
    assert after(2**32 - 1) == FIRST
    assert after(2**32 - 5, PRIMING) == FIRST


@given(st.lists(st.floats(-0.01, 0.01), min_size=1, max_size=20))
def test_what_is_rounded_is_not_lost(positions: list[float]) -> None:
    led = arm(tool={"linear_velocity": 2.0})
    total = np.zeros(3)
    for position in positions:
        led.write(goal(position, 0.0, 0.0))
        total += led.step(0.01).position
    assert total[0] == pytest.approx(1e6 * positions[-1], abs=0.51)


def test_no_packet_leads_faster_than_the_arm_may_go() -> None:
    led = arm(tool={"linear_velocity": 0.05, "angular_velocity": 1.0})
    led.write(goal(0.0, 0.0012, 0.0))
    assert [led.step(0.01).position for _ in range(4)] == [(0, 500, 0)] * 2 + [
        (0, 200, 0),
        (0, 0, 0),
    ]
    half = 0.04
    turned_by = (float(np.sin(half)), 0.0, 0.0, float(np.cos(half)))
    led.write(Setpoint(Mode.CARTESIAN_POSITION, vector((0.0, 0.0012, 0.0, *turned_by))))
    turned = led.step(0.01).rotation
    assert 2.0 * np.arcsin(turned[0]) == pytest.approx(0.01)


@pytest.mark.parametrize(
    "beyond", [(0.0051, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 0.06, 0.0, 0.0, 0.9982)]
)
def test_it_is_told_no_further_than_it_gets_soon(beyond: tuple[float, ...]) -> None:
    """When commands stop, what it was told before would lead it on."""
    led = arm(tool={"linear_velocity": 0.05, "angular_velocity": 1.0})
    led.write(goal(0.001, 0.0, 0.0))
    with pytest.raises(CommandRefused) as refused:
        led.write(Setpoint(Mode.CARTESIAN_POSITION, vector(beyond)))
    assert refused.value.reason is Reason.STEP_TOO_LARGE
    assert [led.step(0.01).position[0] for _ in range(3)] == [500, 500, 0]


def test_an_arm_that_may_go_less_than_a_micrometre_a_packet_gets_there_no_sooner() -> None:
    led = arm(tool={"linear_velocity": 0.0005})
    led.write(goal(20e-6, -20e-6, 20e-6))
    here, speed = np.zeros(3), 0.5
    for packets in range(1, 80):
        here += led.step(0.001).position
        assert np.hypot.reduce(here) <= speed * packets + 1e-9
    assert here.tolist() == [20.0, -20.0, 20.0]


@pytest.mark.parametrize("opening", [0.02, -0.02])
def test_a_jaw_is_no_faster_than_it_may_be_whatever_the_packets_are(opening: float) -> None:
    led = arm(jaw_velocity=0.3)
    led.inputs["jaw_increment"].take(Number(opening))
    closed = 0
    for packets in range(1, 80):
        closed += led.step(0.001).closing
        assert abs(closed) <= 0.3 * packets + 1e-9
    assert closed == -1000 * opening
    led.inputs["jaw_increment"].take(Number(opening))
    assert abs(led.step(0.01).closing) <= 3, "nothing was saved up meanwhile"


def test_a_stop_leaves_nothing_to_be_done() -> None:
    led = arm()
    led.write(goal(0.004, 0.0, 0.0))
    jaw = led.inputs["jaw_increment"]
    jaw.take(Number(0.1))
    assert led.step(0.01) != NOTHING
    led.stop()
    assert led.step(0.01) == NOTHING


def test_a_jaw_opens_as_far_as_it_was_told() -> None:
    led = arm(jaw_velocity=2.0)
    led.inputs["jaw_increment"].take(Number(0.05))
    led.inputs["jaw_increment"].take(Number(-0.01))
    assert [led.step(0.01).closing for _ in range(5)] == [-20, -20, -10, 10, 0]


@pytest.mark.parametrize(
    ("value", "reason"), [(0.3, Reason.OUT_OF_RANGE), (float("nan"), Reason.NOT_FINITE)]
)
def test_a_jaw_is_not_told_what_it_cannot_do(value: float, reason: Reason) -> None:
    with pytest.raises(CommandRefused) as refused:
        arm().inputs["jaw_increment"].take(Number(value))
    assert refused.value.reason is reason


def test_a_jaw_is_not_told_more_than_it_gets_done() -> None:
    led = arm(jaw_velocity=0.25)
    jaw = led.inputs["jaw_increment"]
    jaw.take(Number(0.2))
    jaw.take(Number(0.2))
    with pytest.raises(CommandRefused, match="has not done"):
        jaw.take(Number(0.2))
    assert sum(led.step(0.01).closing for _ in range(500)) == -400
