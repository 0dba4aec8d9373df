"""Servos with a speed of their own below that of the joint: a move ends where the servo really is."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from crtk_drivers.errors import MotionAborted
from crtk_drivers.motion import executions
from crtk_drivers.samples import Pose
from crtk_sim_backends.process import RunningSim
from rigs.dynamixel_bench import (
    COUNT,
    LONG,
    PATIENT,
    DynamixelBench,
    arm_values,
    driver_at,
    eventually,
    place,
    set_upright,
    sim_for,
)

XM = {"id": 1, "model": "xm430-w350", "lower": -2.0, "upper": 2.0, "velocity": 4.0}
JAW = {"id": 1, "model": "xm430-w350", "closed": -0.5, "open": 1.0, "velocity": 3.0}
RACK = {"closed": 0.0, "open": 0.03, "velocity": 0.1, "finger": {"kind": "linear", "travel": 0.02}}


def joint(**more: Any) -> dict[str, Any]:
    return {**PATIENT, "joints": {"a": {**XM, **more}}}


def off(bench: DynamixelBench, angle: float, id: int = 1) -> float:
    """How far a servo really is from an angle, in rad."""
    return abs(float(bench.servos()[id]["angle"]) - angle)


@pytest.fixture(scope="module")
def servo() -> Iterator[RunningSim]:
    with sim_for(joint(), timing="none") as sim:
        yield sim


@pytest.mark.parametrize(
    "profile",
    [
        {"profile_velocity": 1.0},
        {"profile_velocity": 1.0, "profile_acceleration": 2.0},
        {"profile_velocity": 1.0, "sign": -1},
        {"profile_velocity": 0.6, "gear": 2.0, "mode": "extended_position"},
    ],
)
def test_a_move_is_done_where_a_slow_servo_is(servo: RunningSim, profile: dict[str, Any]) -> None:
    set_upright(servo)
    with driver_at(servo, joint(**profile)) as bench:
        bench.arm.enable(timeout=LONG)
        goal = 0.8
        assert bench.arm.move_jp([goal]).wait(LONG)
        angle = goal * profile.get("sign", 1) * profile.get("gear", 1.0)
        assert off(bench, angle) <= 4 * COUNT
        assert not bench.arm.is_busy()


def test_a_move_of_an_older_servo_waits_for_it() -> None:
    values = {**PATIENT, "joints": {"a": {"id": 1, "model": "ax-12a", "profile_velocity": 1.0}}}
    with sim_for(values, timing="none") as sim, driver_at(sim, values) as bench:
        bench.arm.enable(timeout=LONG)
        assert bench.arm.move_jp([0.8]).wait(LONG)
        assert off(bench, 0.8) < 0.03  # a count of 0.3 degrees, and its compliance


def test_a_newer_move_of_a_slow_servo_is_waited_for(servo: RunningSim) -> None:
    set_upright(servo)
    with driver_at(servo, joint(profile_velocity=1.0)) as bench:
        bench.arm.enable(timeout=LONG)
        first = bench.arm.move_jp([1.0])
        eventually(lambda: off(bench, 0.0) > 0.2, "it is on its way")
        assert bench.arm.move_jp([-0.2]).wait(LONG)
        assert off(bench, -0.2) <= 4 * COUNT
        assert not first.is_busy()


def test_a_line_is_done_where_slow_servos_are() -> None:
    values = arm_values(joints={"waist": {"profile_velocity": 0.3}})
    with sim_for(values) as sim, driver_at(sim, values) as bench:
        bench.enable()
        assert bench.arm.move_jp([0.0, -0.3, 0.3, 0.0, 0.3, 0.0]).wait(LONG)
        pose = bench.arm.setpoint_cp()
        aside = Pose(pose.position + np.array([0.0, 0.1, 0.0]), pose.orientation)
        assert bench.arm.move_cp(aside).wait(LONG)
        goal = bench.arm.setpoint_js().position[0]
        assert abs(goal) > 0.2, "the waist has turned"
        assert off(bench, goal) <= 4 * COUNT


@pytest.mark.parametrize("finger", [{}, RACK], ids=["jaw", "rack"])
def test_a_gripper_is_done_where_its_slow_servo_is(
    servo: RunningSim, finger: dict[str, Any]
) -> None:
    set_upright(servo)
    values = {**PATIENT, "gripper": {**JAW, "profile_velocity": 1.0, **finger}}
    with driver_at(servo, values) as bench:
        bench.arm.enable(timeout=LONG)
        opening = 0.016 if finger else 0.8  # both are 0.8 rad of the servo
        assert bench.arm.move_jp([opening]).wait(LONG)
        assert off(bench, 0.8) <= 4 * COUNT


def test_a_gripper_is_done_at_what_it_grips(servo: RunningSim) -> None:
    set_upright(servo)
    limited = {"mode": "current_based_position", "current_limit": 0.3}
    values = {**PATIENT, "gripper": {**JAW, **limited}}
    with driver_at(servo, values) as bench:
        bench.arm.enable(timeout=LONG)
        servo.control.inject("stuck", id=1)
        try:
            assert bench.arm.move_jp([-0.4]).wait(LONG)
        finally:
            servo.control.clear()


def test_an_aborted_joint_that_yields_stays_where_it_is(
    servo: RunningSim, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(executions, "ARRIVAL_TIMEOUT", 0.5)
    set_upright(servo)
    values = joint(mode="current_based_position", current_limit=0.3)
    with driver_at(servo, values) as bench:
        bench.arm.enable(timeout=LONG)
        servo.control.inject("stuck", id=1)
        try:
            with pytest.raises(MotionAborted, match="a is at"):
                bench.arm.move_jp([0.8]).wait(LONG)
            eventually(lambda: abs(bench.servos()[1]["torque_applied"]) < 0.1, "it does not push")
        finally:
            servo.control.clear()
        # It is free, stays, and the next move begins where it is.
        eventually(lambda: abs(bench.arm.setpoint_js().position[0]) < 0.02, "the setpoint is here")
        assert off(bench, 0.0) < 0.02
        assert bench.arm.move_jp([0.1]).wait(LONG)
        assert off(bench, 0.1) <= 4 * COUNT


def test_a_move_takes_as_long_as_its_servo_needs(
    servo: RunningSim, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each time that it came nearer it has `ARRIVAL_TIMEOUT` more."""
    monkeypatch.setattr(executions, "ARRIVAL_TIMEOUT", 0.5)
    set_upright(servo)
    with driver_at(servo, joint(profile_velocity=0.8)) as bench:
        bench.arm.enable(timeout=LONG)
        # What the driver does not know of: another program has made the profile four times slower.
        servo.control.call("write", id=1, address=112, data=(8).to_bytes(4, "little").hex())
        assert bench.arm.move_jp([0.6]).wait(LONG)
        assert off(bench, 0.6) <= 4 * COUNT


def test_the_other_joints_are_still_watched() -> None:
    """One joint with a profile does not take the watch from those without."""
    values = arm_values(joints={"waist": {"profile_velocity": 0.5}})
    with sim_for(values) as sim, driver_at(sim, values) as bench:
        bench.enable()
        sim.control.inject("stuck", id=4)
        with pytest.raises(MotionAborted):
            bench.arm.move_jp(np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])).wait(LONG)
        assert "does not follow" in bench.until_state("FAULT")
        place(sim, 1, float(bench.servos()[1]["angle"]))
