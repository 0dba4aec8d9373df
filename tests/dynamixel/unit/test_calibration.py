"""Calibration: shifts, homing offsets, files that fit or do not, and turns after a power-off."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_dynamixel.calibration import (
    Calibration,
    Identity,
    ServoCalibration,
    calibrate,
    load_calibration,
    save_calibration,
    turn_shift,
    unshifted,
)
from crtk_driver_dynamixel.models import MODELS, OperatingMode
from crtk_driver_dynamixel.units import Servo
from crtk_drivers.errors import ConfigError

XM = MODELS["xm430-w350"]
PH = MODELS["ph54-200-s500"]
EXTENDED = OperatingMode.EXTENDED_POSITION
WHO: Identity = ("elbow", "main", 3, "xm430-w350")


def one(
    servo: Servo, count: int, position: float, homing: int = 0, **keys: bool
) -> ServoCalibration:
    return calibrate([(WHO, servo)], [count], [homing], [position], **keys).servos[0]


def test_half_turn() -> None:
    found = one(Servo(XM), count=2500, position=0.0)
    assert (found.shift, found.homing_offset) == (452, 0)
    found = one(Servo(XM), count=2500, position=0.0, in_eeprom=True)
    assert (found.shift, found.homing_offset) == (0, -452)


@pytest.mark.parametrize(("count", "homing"), [(2048 + 1024, -1024), (2048 - 1024, 1024)])
def test_the_largest_homing_offset(count: int, homing: int) -> None:
    assert one(Servo(XM), count, 0.0, in_eeprom=True).homing_offset == homing


@pytest.mark.parametrize("count", [2048 + 1025, 2048 - 1025, 0, 4095])
def test_what_position_mode_would_ignore_is_left_to_the_driver(count: int) -> None:
    found = one(Servo(XM), count, 0.0, in_eeprom=True)
    assert (found.shift, found.homing_offset) == (count - 2048, 0)


def test_a_series_without_known_homing_limits_is_left_to_the_driver() -> None:
    found = one(Servo(PH), 1000, 0.0, in_eeprom=True)
    assert (found.shift, found.homing_offset) == (1000, 0)


def test_homing_offsets_in_force() -> None:
    assert unshifted(Servo(XM), 2048, 100) == 1948
    assert unshifted(Servo(XM), 2048, 1024) == 1024
    assert unshifted(Servo(XM), 2048, 1025) == 2048  # position mode ignores it
    assert unshifted(Servo(XM, mode=EXTENDED), 2048, 5000) == -2952


def test_calibrating_twice_gives_the_same() -> None:
    first = one(Servo(XM), 2500, 0.3, in_eeprom=True)
    present = 2500 + first.homing_offset
    again = one(Servo(XM), present, 0.3, homing=first.homing_offset, in_eeprom=True)
    assert again == first


@given(
    sign=st.sampled_from([1, -1]),
    gear=st.floats(0.5, 50.0),
    offset=st.floats(-3.0, 3.0),
    mode=st.sampled_from([OperatingMode.POSITION, EXTENDED]),
    actual=st.integers(0, 4095),
    before=st.integers(-3000, 3000),
    position=st.floats(-3.0, 3.0),
    in_eeprom=st.booleans(),
)
def test_afterwards_the_joint_is_where_it_was_said_to_be(
    sign: int,
    gear: float,
    offset: float,
    mode: OperatingMode,
    actual: int,
    before: int,
    position: float,
    in_eeprom: bool,
) -> None:
    servo = Servo(XM, sign, gear, offset, mode=mode)
    ignored = mode is OperatingMode.POSITION and abs(before) > 1024
    read = actual if ignored else actual + before
    found = one(servo, read, position, before, in_eeprom=in_eeprom)
    assert mode is not OperatingMode.POSITION or abs(found.homing_offset) <= 1024
    calibrated = Servo(XM, sign, gear, offset, found.shift, mode=mode)
    now = calibrated.position(actual + found.homing_offset)
    period = math.tau / gear
    error = now - position
    if mode is EXTENDED:  # which turn is not for a calibration to say
        error -= period * round(error / period)
        assert abs(found.shift) <= 2048
    assert abs(error) <= 0.5001 * XM.family.position_unit / gear


@pytest.mark.parametrize("position", [math.nan, math.inf])
def test_a_position_must_be_finite(position: float) -> None:
    with pytest.raises(ValueError, match="elbow has no position"):
        one(Servo(XM), 2048, position)


def test_the_file(tmp_path: Path) -> None:
    path = tmp_path / "arm.calibration.yaml"
    identities: list[Identity] = [WHO, ("gripper", "right", 7, "xl330-m288")]
    servos = [(who, Servo(MODELS[who[3]])) for who in identities]
    made = calibrate(servos, [1000, 3000], [0, 0], [0.0, 0.5])
    save_calibration(path, made)
    read = load_calibration(path)
    assert read == made
    read.check(identities)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    save_calibration(path, made)  # replaces it


def test_another_chain_is_refused() -> None:
    found = calibrate([(WHO, Servo(XM))], [2048], [0], [0.0])
    for servos, text in (
        ([], r"servo 3 on main \(elbow\) is not in the chain"),
        ([WHO, ("pan", "main", 1, "xm430-w350")], r"it has no servo 1 on main \(pan\)"),
        (
            [("elbow", "main", 3, "xm430-w210")],
            r"is elbow xm430-w350 there and elbow xm430-w210 here",
        ),
        (
            [("wrist", "main", 3, "xm430-w350")],
            r"is elbow xm430-w350 there and wrist xm430-w350 here",
        ),
        ([("elbow", "left", 3, "xm430-w350")], r"it has no servo 3 on left.*is not in the chain"),
    ):
        with pytest.raises(ConfigError, match=text) as caught:
            found.check(servos, "arm.yaml")
        assert "arm.yaml: the calibration is not of this chain" in str(caught.value)
        assert "Calibrate again" in str(caught.value)
    twice = Calibration(servos=(*found.servos, *found.servos))
    with pytest.raises(ConfigError, match="in it twice"):
        twice.check([WHO])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("version: 2\nservos: []\n", ":1: version: must be 1, not 2"),
        ("servos: 3\n", ":1: servos: must be a list"),
        (
            "servos:\n- {joint: a, bus: main, id: 300, model: x}\n",
            r":2: servos\[0\].id: must be less",
        ),
        ("servos:\n- {joint: a, bus: main, id: 3, model: x, shit: 3}\n", "Did you mean .*shift"),
        ("{}", "servos: is required"),
        ("- 1\n", "holds no keys"),
        ("\x00", "not valid YAML"),
    ],
)
def test_files_that_are_none(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        load_calibration(path)


def test_a_file_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none/arm\.yaml: cannot be written"):
        save_calibration(tmp_path / "none" / "arm.yaml", Calibration(servos=()))


@given(
    sign=st.sampled_from([1, -1]),
    gear=st.floats(0.5, 20.0),
    offset=st.floats(-3.0, 3.0),
    part=st.floats(0.05, 0.95),
    width=st.floats(0.1, 0.95),
    start=st.floats(-20.0, 20.0),
)
def test_the_turn_is_found_in_a_range_of_less_than_one(
    sign: int, gear: float, offset: float, part: float, width: float, start: float
) -> None:
    servo = Servo(XM, sign, gear, offset, mode=EXTENDED)
    period = math.tau / gear
    lower, upper = start, start + width * period
    true = lower + part * (upper - lower)
    encoder = round(servo.count(true)) % 4096  # what it says after the power came back
    shift = turn_shift(servo, encoder, lower, upper)
    assert shift % 4096 == 0
    found = Servo(XM, sign, gear, offset, shift, mode=EXTENDED).position(encoder)
    assert found == pytest.approx(true, abs=0.51 * XM.family.position_unit / gear)


@given(
    sign=st.sampled_from([1, -1]),
    gear=st.floats(0.5, 20.0),
    true=st.floats(-100.0, 100.0),
    moved=st.floats(-0.49, 0.49),
)
def test_the_turn_is_that_of_the_last_position(
    sign: int, gear: float, true: float, moved: float
) -> None:
    servo = Servo(XM, sign, gear, mode=EXTENDED)
    encoder = round(servo.count(true)) % 4096
    last = true + moved * math.tau / gear
    shift = turn_shift(servo, encoder, -1000.0, 1000.0, last)
    found = Servo(XM, sign, gear, shift=shift, mode=EXTENDED).position(encoder)
    assert found == pytest.approx(true, abs=0.51 * XM.family.position_unit / gear)


def test_a_range_of_several_turns_needs_the_last_position() -> None:
    servo = Servo(XM, mode=EXTENDED)
    with pytest.raises(ConfigError, match=r"any of 3 turns.*key turns.*lost with the power"):
        turn_shift(servo, 2048, -7.0, 7.0)


def test_a_joint_a_little_beyond_its_range_is_believed() -> None:
    servo = Servo(XM, mode=EXTENDED)
    for position in (-1.3, 1.3):  # it hangs in its stops, or is pushed there
        for turns in (-1, 0, 1):
            count = round(servo.count(position)) + turns * 4096
            assert turn_shift(servo, count, -1.0, 1.0) == turns * 4096


def test_a_joint_outside_of_its_range() -> None:
    servo = Servo(XM, mode=EXTENDED)
    with pytest.raises(ConfigError, match=r"no turn.*between -1\.0000 and 1\.0000.*by hand"):
        turn_shift(servo, 0, -1.0, 1.0)


def test_the_middle_of_the_range_stays_where_it_is() -> None:
    assert turn_shift(Servo(XM, mode=EXTENDED), 2048, -3.0, 3.0) == 0


@pytest.mark.parametrize(("lower", "upper"), [(-0.6, 1.57), (-3.14, 3.14)])
def test_any_mounting_is_found_again_after_a_loss_of_power(lower: float, upper: float) -> None:
    """The ranges of two joints of the Koch leader; the horn is put on at every count of the servo."""
    family = MODELS["xl330-m077"].family
    plain = Servo(MODELS["xl330-m077"], mode=EXTENDED)
    pose = 0.3
    ends = (lower + 0.01, upper - 0.01)
    for count in range(family.counts):
        (found,) = calibrate([(WHO, plain)], [count], [0], [pose]).servos
        servo = found.applied_to(plain)
        for position in (pose, *ends):
            told = (count + round((position - pose) / family.position_unit)) % family.counts
            turned = servo.position(told - turn_shift(servo, told, lower, upper))
            assert abs(turned - position) < 2.0 * family.position_unit, (count, position)
