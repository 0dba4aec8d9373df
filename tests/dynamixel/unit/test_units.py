"""Bytes, counts and SI: known values, and there and back for everything."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_dynamixel.control_tables import PROTOCOL_1, Item, control_table, model_files
from crtk_driver_dynamixel.models import MODELS, OperatingMode
from crtk_driver_dynamixel.units import (
    Scaling,
    Servo,
    decoded,
    encoded,
    read_number,
    record,
    write_number,
)

ITEMS = sorted(
    {item for number in (*model_files(), *PROTOCOL_1) for item in control_table(number).values()},
    key=lambda item: (item.name, item.address, item.size),
)
XM = MODELS["xm430-w350"]
XL = MODELS["xl430-w250"]


@st.composite
def servos(draw: st.DrawFn) -> Servo:
    model = draw(st.sampled_from(sorted(MODELS.values(), key=lambda model: model.name)))
    several = OperatingMode.EXTENDED_POSITION in model.modes and draw(st.booleans())
    return Servo(
        model=model,
        sign=draw(st.sampled_from([1, -1])),
        gear=draw(st.floats(0.1, 100.0)),
        offset=draw(st.floats(-4.0, 4.0)),
        shift=draw(st.integers(-5000, 5000)),
        torque_constant=draw(st.floats(0.1, 10.0)) if model.reports_current else math.nan,
        mode=OperatingMode.EXTENDED_POSITION if several else OperatingMode.POSITION,
    )


@given(st.sampled_from(ITEMS), st.data())
def test_numbers_and_bytes_there_and_back(item: Item, data: st.DataObject) -> None:
    number = data.draw(st.integers(*item.range))
    raw = write_number(number, item)
    assert len(raw) == item.size
    assert read_number(b"\xa5" + raw, item, 1) == number


@given(st.sampled_from(ITEMS), st.integers(-(2**33), 2**33))
def test_what_an_item_cannot_hold_is_refused(item: Item, number: int) -> None:
    least, most = item.range
    if least <= number <= most:
        write_number(number, item)
    else:
        with pytest.raises(ValueError, match=item.name):
            write_number(number, item)


def test_short_data_is_refused() -> None:
    item = control_table(1020)["present_position"]
    with pytest.raises(ValueError, match="present_position has 4 bytes, of which 2"):
        read_number(b"\x00\x08", item)


@pytest.mark.parametrize(
    ("number", "name", "raw", "value"),
    [
        (1020, "present_current", b"\xff\xff", -1),
        (1020, "goal_velocity", b"\xfd\xff\xff\xff", -3),
        (1020, "present_position", b"\x00\x08\x00\x00", 2048),
        (1020, "bus_watchdog", b"\xff", -1),
        (12, "present_speed", b"\x01\x04", -1),
        (12, "present_speed", b"\x01\x00", 1),
        (12, "present_position", b"\xff\x03", 1023),
        (310, "current", b"\x00\x08", 0),
        (310, "current", b"\xff\x07", -1),
    ],
)
def test_known_bytes(number: int, name: str, raw: bytes, value: int) -> None:
    assert read_number(raw, control_table(number)[name]) == value


@given(st.sampled_from(ITEMS), st.data())
def test_arrays_agree_with_single_numbers(item: Item, data: st.DataObject) -> None:
    numbers = data.draw(st.lists(st.integers(*item.range), min_size=1, max_size=8))
    raw = b"".join(write_number(number, item) for number in numbers)
    fields = np.frombuffer(raw, record([item], item.address, item.size))[item.name]
    np.testing.assert_array_equal(decoded(fields, item.coding), numbers)
    np.testing.assert_array_equal(encoded(numbers, item.coding), fields)


def test_a_block_of_the_cycle() -> None:
    table = control_table(1020)
    items = [table["present_current"], table["present_velocity"], table["present_position"]]
    address, length = table.block([item.name for item in items])
    data = b"\xff\xff\xfd\xff\xff\xff\x00\x08\x00\x00" + b"\x02\x00\x00\x00\x00\x00\xff\x0f\x00\x00"
    blocks = np.frombuffer(data, record(items, address, length))
    assert blocks["present_current"].tolist() == [-1, 2]
    assert blocks["present_velocity"].tolist() == [-3, 0]
    assert blocks["present_position"].tolist() == [2048, 4095]


def test_known_si() -> None:
    servo = Servo(XM, sign=-1, gear=2.0, offset=0.5, shift=10, torque_constant=1.783)
    scaling = Scaling.of([servo])
    assert scaling.position.to_si([2058 + 1024])[0] == pytest.approx(0.5 - math.pi / 4)
    assert scaling.velocity.to_si([100])[0] == pytest.approx(-100 * 0.229 * math.tau / 60 / 2)
    assert scaling.current.to_si([100])[0] == pytest.approx(-0.269)
    assert scaling.effort.to_si([100])[0] == pytest.approx(-0.269 * 1.783 * 2)
    assert scaling.pwm.to_si([885])[0] == pytest.approx(-1.0)
    assert scaling.acceleration.to_counts([0.374514 / 2])[0] == 1


def test_a_load_is_no_effort() -> None:
    scaling = Scaling.of([Servo(XL), Servo(XM, torque_constant=1.0)])
    assert np.isnan(scaling.effort.to_si([100, 100])).tolist() == [True, False]
    assert scaling.load.to_si([250, 250])[0] == pytest.approx(0.25)
    with pytest.raises(ValueError, match="no such unit"):
        scaling.effort.to_counts([0.1, 0.1])


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_refused(value: float) -> None:
    scale = Scaling.of([Servo(XM)]).position
    with pytest.raises(ValueError, match="not finite"):
        scale.to_counts([value])


@given(st.lists(servos(), min_size=1, max_size=6), st.data())
def test_counts_there_and_back(chain: list[Servo], data: st.DataObject) -> None:
    scaling = Scaling.of(chain)
    scales = (scaling.position, scaling.velocity)
    for scale in scales:
        counts = [
            data.draw(st.integers(max(int(least), -(2**30)), min(int(most), 2**30)))
            for least, most in zip(scale.lowest, scale.highest, strict=True)
        ]
        np.testing.assert_array_equal(scale.to_counts(scale.to_si(counts)), counts)


@given(st.lists(servos(), min_size=1, max_size=6), st.data())
def test_goals_are_rounded_to_the_nearest_count_or_to_the_end(
    chain: list[Servo], data: st.DataObject
) -> None:
    scale = Scaling.of(chain).position
    values = np.array([data.draw(st.floats(-50.0, 50.0)) for _ in chain])
    counts = scale.to_counts(values)
    assert (counts >= scale.lowest).all()
    assert (counts <= scale.highest).all()
    inside = (counts > scale.lowest) & (counts < scale.highest)
    error = np.abs(scale.to_si(counts) - values)
    assert (error[inside] <= 0.5000001 * np.abs(scale.factor[inside]) + 1e-9).all()


@given(servos(), st.integers(-5000, 10000))
def test_one_servo_and_the_chain_agree(servo: Servo, count: int) -> None:
    position = servo.position(count)
    assert Scaling.of([servo]).position.to_si([count])[0] == pytest.approx(position)
    assert servo.count(position) == pytest.approx(count, abs=1e-3)


def test_accelerations_are_magnitudes_within_the_register() -> None:
    scale = Scaling.of([Servo(XM), Servo(MODELS["ph54-200-s500"])]).acceleration
    assert scale.to_counts([-5.0, -5.0]).tolist() == [0, 0]
    assert scale.to_counts([1e9, 100.0]).tolist() == [32767, 57296]


def test_limits_can_only_become_narrower() -> None:
    scale = Scaling.of([Servo(XM, torque_constant=1.0)]).current.limited([-10_000], [100])
    assert scale.to_counts([-100.0])[0] == -1193
    assert scale.to_counts([100.0])[0] == 100
