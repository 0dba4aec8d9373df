"""Joints and servos: shadows, buses, gears, signs, and what a servo cannot be sent."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from crtk_driver_dynamixel.calibration import Calibration, ServoCalibration
from crtk_driver_dynamixel.config import DynamixelConfig
from crtk_driver_dynamixel.joints import Chain
from crtk_driver_dynamixel.turns import Turns
from crtk_drivers.config import from_values, load
from crtk_drivers.errors import ConfigError

SHADOWED: dict[str, Any] = {
    "buses": {"main": {}, "right": {}},
    "joints": {
        "waist": {"id": 1, "model": "xm430-w350"},
        "shoulder": {
            "id": 2,
            "model": "xm540-w270",
            "sign": -1,
            "offset": 0.5,
            "lower": -1.0,
            "upper": 1.5,
            "shadows": [
                {"id": 3, "sign": 1},
                {"id": 4, "sign": -1, "follow": "secondary_id", "reverse": True},
            ],
        },
        "wrist": {"id": 1, "bus": "right", "model": "xm430-w210", "gear": 2.0},
    },
    "gripper": {
        "id": 9,
        "bus": "right",
        "model": "xl330-m288",
        "finger": {"kind": "slider_crank", "horn": 0.022, "rod": 0.036},
        "closed": 0.03,
        "open": 0.1,
        "velocity": 0.1,
    },
}


def chain(values: dict[str, Any], calibration: Calibration | None = None) -> Chain:
    return Chain.of(load(DynamixelConfig, from_values(values)), calibration)


@pytest.fixture(scope="module")
def arm() -> Chain:
    return chain(SHADOWED)


def test_order_and_buses(arm: Chain) -> None:
    assert arm.joints == ("waist", "shoulder", "wrist")
    assert [(s.name, s.bus, s.id) for s in arm.servos] == [
        ("waist", "main", 1),
        ("shoulder", "main", 2),
        ("shoulder", "main", 3),
        ("shoulder", "main", 4),
        ("wrist", "right", 1),
        ("gripper", "right", 9),
    ]
    assert [arm.of_joint(i) for i in range(4)] == [(0,), (1, 2, 3), (4,), (5,)]
    assert [s.is_first for s in arm.servos] == [True, True, False, False, True, True]
    assert [s.follow for s in arm.servos][1:4] == ["goals", "goals", "secondary_id"]
    assert [s.reverse for s in arm.servos][1:4] == [False, False, True]
    assert arm.servos[2].place == "joint shoulder (servo 3 on main)"
    assert {s.protocol for s in arm.servos} == {2}


def test_shadows_move_as_one_joint(arm: Chain) -> None:
    servos = arm.to_servos(np.array([0.1, 0.7, -0.2, 0.0]))
    counts = arm.scaling.position.to_counts(servos)
    turned = round(0.2 * 4096 / math.tau)
    assert counts[1:4].tolist() == [2048 - turned, 2048 + turned, 2048 - turned]
    assert counts[4] == 2048 - round(0.4 * 4096 / math.tau)
    back = arm.positions(arm.scaling.position.to_si(counts))
    np.testing.assert_allclose(back, [0.1, 0.7, -0.2, 0.0], atol=1e-3)


def test_a_joint_is_known_while_one_of_its_servos_answers(arm: Chain) -> None:
    values = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    everything = np.ones(6, dtype=np.bool_)
    assert arm.positions(values, everything).tolist() == [1.0, 2.0, 5.0, 6.0]
    silent = np.array([True, False, True, True, True, True])
    assert arm.positions(values, silent).tolist() == [1.0, 3.0, 5.0, 6.0]
    silent = np.array([True, False, False, False, True, False])
    np.testing.assert_equal(arm.positions(values, silent), [1.0, math.nan, 5.0, math.nan])


def test_efforts_add_up_and_are_shared(arm: Chain) -> None:
    servos = arm.efforts_to_servos(np.array([1.0, 6.0, 3.0, 0.5]))
    assert servos.tolist() == [1.0, 2.0, 2.0, 2.0, 3.0, 0.5]
    assert arm.efforts(servos).tolist() == [1.0, 6.0, 3.0, 0.5]
    valid = np.array([True, True, False, True, True, True])
    np.testing.assert_equal(arm.efforts(servos, valid), [1.0, math.nan, 3.0, 0.5])


def test_limits_from_models_and_keys(arm: Chain) -> None:
    waist, shoulder, wrist = arm.limits
    assert waist.velocity == pytest.approx(0.9 * 46.0 * math.tau / 60)
    assert waist.effort == pytest.approx(4.1)
    assert shoulder.effort == pytest.approx(3 * 10.6)
    assert (shoulder.lower, shoulder.upper) == (-1.0, 1.5)
    assert wrist.velocity == pytest.approx(0.9 * 77.0 * math.tau / 60 / 2)
    assert wrist.effort == pytest.approx(6.0)
    assert wrist.upper == pytest.approx(4095 * math.tau / 4096 / 4)
    assert waist.jerk == 100.0
    assert arm.gripper_limits is not None
    assert (arm.gripper_limits.lower, arm.gripper_limits.upper) == (0.03, 0.1)
    assert arm.gripper_limits.acceleration == pytest.approx(1.0)


def test_efforts_need_every_joint_to_measure_current() -> None:
    joints = {"a": {"id": 1, "model": "xm430-w350"}, "b": {"id": 2, "model": "xl430-w250"}}
    assert not chain({"joints": joints}).has_efforts
    assert chain({"joints": {"a": joints["a"]}}).has_efforts
    unknown = {"id": 2, "model": "xw430-t200", "velocity": 1.0, "effort": 1.0}
    assert not chain({"joints": {"a": unknown}}).has_efforts
    assert chain({"joints": {"a": {**unknown, "torque_constant": 1.5}}}).has_efforts
    assert not chain({"gripper": SHADOWED["gripper"] | {"bus": "main"}}).has_efforts


@pytest.mark.parametrize(
    ("joint", "text"),
    [
        (
            {"lower": 0.0, "upper": 4.0},
            r"counts 2048 to 4656, of which mode position takes 0 to 4095",
        ),
        ({"lower": -1.0, "upper": 1.0, "offset": 2.5}, r"counts -\d+ to"),
        ({"lower": -4.0, "upper": 0.0, "sign": -1}, r"counts 2048 to 4656"),
    ],
)
def test_a_range_beyond_the_servo_is_refused(joint: dict[str, Any], text: str) -> None:
    values = {"joints": {"elbow": {"id": 5, "model": "xm430-w350", **joint}}}
    with pytest.raises(ConfigError, match=text) as caught:
        chain(values)
    assert caught.value.where == "joints.elbow"
    assert "joint elbow (servo 5 on main)" in caught.value.message
    several = values["joints"]["elbow"] | {"mode": "extended_position"}
    chain({"joints": {"elbow": several}})


def test_the_range_of_a_gripper_is_that_of_its_servo() -> None:
    gripper = {**SHADOWED["gripper"], "bus": "main", "offset": -2.0, "gear": 1.5}
    with pytest.raises(ConfigError, match="mode position takes") as caught:
        chain({"gripper": gripper})
    assert caught.value.where == "gripper"


def test_a_calibration_shifts_the_counts() -> None:
    values = {"joints": {"elbow": {"id": 5, "model": "xm430-w350", "lower": -1.0, "upper": 1.0}}}
    found = ServoCalibration(joint="elbow", bus="main", id=5, model="xm430-w350", shift=100)
    calibrated = chain(values, Calibration(servos=(found,)))
    assert calibrated.scaling.position.to_si([2148])[0] == pytest.approx(0.0)
    far = found.model_copy(update={"shift": 1800})
    with pytest.raises(ConfigError, match="mode position takes 0 to 4095"):
        chain(values, Calibration(servos=(far,)))
    other = found.model_copy(update={"id": 6})
    with pytest.raises(ConfigError, match="not of this chain"):
        chain(values, Calibration(servos=(other,)))


def test_a_range_is_judged_when_the_calibration_is_there() -> None:
    joint = {"id": 5, "model": "xm430-w350", "lower": 2.0, "upper": 4.0}
    chain({"calibration": "later.yaml", "joints": {"elbow": joint}})
    with pytest.raises(ConfigError, match="mode position"):
        chain({"joints": {"elbow": joint}})


def test_shifts_of_turns(arm: Chain) -> None:
    turned = arm.with_shifts({1: 4096})
    before, after = arm.scaling.position, turned.scaling.position
    assert (after.zero - before.zero).tolist() == [0.0, 4096.0, 0.0, 0.0, 0.0, 0.0]
    assert turned.servos[1].units.shift == 4096


def test_turns_are_found_for_the_whole_chain() -> None:
    joints = {
        "lift": {
            "id": 1,
            "model": "xm430-w350",
            "mode": "extended_position",
            "lower": -2,
            "upper": 2,
        },
        "pan": {"id": 2, "model": "xm430-w350"},
        "winch": {
            "id": 3,
            "model": "xm430-w350",
            "mode": "extended_position",
            "lower": -50,
            "upper": 50,
        },
    }
    gripper = {**SHADOWED["gripper"], "bus": "main", "mode": "current_based_position"}
    arm = chain({"joints": joints, "gripper": gripper})
    assert arm.names == ("lift", "pan", "winch", "gripper")
    counts = [2048 + 4096, 2048, 2148, 2048 - 4096]
    with pytest.raises(ConfigError, match="may be in any of 15 turns") as caught:
        arm.turn_shifts(counts)
    assert caught.value.where == "joint winch (servo 3 on main)"
    found = arm.turn_shifts(counts, Turns(clean=True, positions={"winch": 18.5}))
    shifts = {place: turn.shift for place, turn in found.items()}
    assert shifts == {0: 4096, 2: -3 * 4096, 3: -4096}
    positions = arm.with_shifts(shifts).scaling.position.to_si(counts)
    unit = math.tau / 4096
    np.testing.assert_allclose(positions, [0.0, 0.0, 3 * math.tau + 100 * unit, 0.0], atol=1e-9)


def test_registers_limit_what_a_servo_is_asked_for() -> None:
    joints = {
        "a": {"id": 1, "model": "xm430-w350"},
        "b": {"id": 2, "model": "xm430-w350", "sign": -1, "mode": "extended_position"},
    }
    read = {
        "min_position_limit": 1000,
        "max_position_limit": 3000,
        "velocity_limit": 100,
        "current_limit": 200,
        "pwm_limit": 300,
    }
    scaling = chain({"joints": joints}).with_registers([read, read]).scaling
    assert scaling.position.to_counts([-3.0, -3.0]).tolist() == [1000, 4004]
    assert scaling.position.to_counts([3.0, 3.0]).tolist() == [3000, 92]
    for scale, most in ((scaling.velocity, 100), (scaling.current, 200), (scaling.effort, 200)):
        assert scale.to_counts([1000.0, 1000.0]).tolist() == [most, -most]
    assert scaling.pwm.to_counts([-1.0, 1.0]).tolist() == [-300, -300]
    free = chain({"joints": joints}).with_registers([{}, {}]).scaling
    assert free.current.to_counts([1000.0, 1000.0]).tolist() == [1193, -1193]
    assert free.position.to_counts([3.0, 3.0]).tolist() == [4004, 92]
