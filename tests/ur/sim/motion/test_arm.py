"""The joints of the simulated UR: tracking, limits, stop ramps, servo filter."""

from __future__ import annotations

import pytest

from crtk_sim_backends.ur.models import MODELS
from crtk_sim_backends.ur.motion.arm import (
    BRAKE_DECELERATION,
    FORGIVING_SECONDS,
    HOME,
    SUDDEN_CHANGE,
    Arm,
    approach,
)
from rigs.ur_controller import apart

DT = 0.002


@pytest.fixture
def arm() -> Arm:
    arm = Arm(MODELS["ur5e"], DT)
    arm.enabled = True
    return arm


def drive(arm: Arm, speed: float, seconds: float) -> None:
    for _ in range(round(seconds / DT)):
        arm.command_velocity([speed] + [0.0] * 5)
        assert arm.step() is None


def test_actual_lags_while_moving_and_arrives_exactly(arm: Arm) -> None:
    drive(arm, 1.0, 0.5)
    assert 0.003 < arm.deviation < 0.02
    assert arm.actual_qd[0] == pytest.approx(1.0, abs=1e-3)
    for _ in range(250):
        arm.step()
    assert arm.actual_q == arm.target_q
    assert arm.actual_qd == [0.0] * 6


def test_uncommanded_arm_slows_down_with_its_deceleration(arm: Arm) -> None:
    drive(arm, 1.0, 0.2)
    speeds = []
    while arm.moving:
        arm.step()
        speeds.append(arm.target_qd[0])
    steps = [a - b for a, b in zip([1.0, *speeds], speeds, strict=False)]
    assert max(steps) <= arm.stop_deceleration * DT + 1e-12
    assert len(speeds) == pytest.approx(1.0 / (arm.stop_deceleration * DT), abs=1)


def test_brakes_stop_harder_than_a_ramp_but_not_at_once(arm: Arm) -> None:
    drive(arm, 1.0, 0.2)
    arm.enabled = False
    arm.command_velocity([1.0] + [0.0] * 5)  # a braked arm obeys nobody
    arm.step()
    assert arm.target_qd[0] == pytest.approx(1.0 - BRAKE_DECELERATION * DT)


def test_stop_ramp_keeps_the_direction(arm: Arm) -> None:
    direction = [0.8, -0.4, 0.2, 0.1, 0.0, -0.6]
    for _ in range(50):
        arm.command_velocity(direction)
        arm.step()
    arm.step()
    ratio = arm.target_qd[0] / direction[0]
    assert apart(arm.target_qd, [v * ratio for v in direction]) < 1e-12


def test_position_limit_is_reported_and_not_crossed(arm: Arm) -> None:
    limit = arm.model.position[0]
    violation = None
    for _ in range(5000):
        arm.command_velocity([3.0] + [0.0] * 5)
        violation = arm.step()
        if violation:
            break
    assert violation is not None
    assert (violation.code, violation.argument) == (150, 0)
    for _ in range(500):
        arm.step()
    assert arm.target_q[0] <= limit
    arm.command_velocity([-0.5] + [0.0] * 5)
    assert arm.step() is None


def test_speed_above_the_limit_is_a_violation(arm: Arm) -> None:
    arm.command_velocity([0.0, 0.0, 3.2, 0.0, 0.0, 0.0])
    violation = arm.step()
    assert violation is not None
    assert (violation.code, violation.argument) == (191, 34)
    assert arm.target_q == list(HOME)


def test_position_jump_is_a_violation(arm: Arm) -> None:
    arm.command([q + 0.1 for q in HOME], [0.0] * 6)
    violation = arm.step()
    assert violation is not None
    assert violation == SUDDEN_CHANGE
    assert arm.target_q == list(HOME)


def test_frozen_joint_deviates_and_is_reported(arm: Arm) -> None:
    arm.frozen.add(0)
    violation = None
    for _ in range(500):
        arm.command_velocity([0.5] + [0.0] * 5)
        violation = arm.step() or violation
    assert violation is not None
    assert (violation.code, violation.argument) == (153, 0)
    assert arm.actual_q[0] == HOME[0]


@pytest.mark.parametrize("lookahead", [0.03, 0.1, 0.2])
@pytest.mark.parametrize("model", ["ur5e", "ur5"])
def test_servo_follows_a_ramp_late_by_the_lookahead(model: str, lookahead: float) -> None:
    arm = Arm(MODELS[model], 1.0 / MODELS[model].frequency)
    arm.enabled = True
    goal = list(HOME)
    for _ in range(round(2.0 / arm.dt)):
        goal[0] += 0.3 * arm.dt
        arm.servo(goal, lookahead, 300.0)
        assert arm.step() is None
    assert (goal[0] - arm.target_q[0]) / 0.3 == pytest.approx(lookahead, abs=arm.dt)


def test_servo_arrives_exactly_without_overshoot(arm: Arm) -> None:
    goal = [q + 0.05 for q in HOME]
    for _ in range(1500):
        arm.servo(goal, 0.1, 300.0)
        assert arm.step() is None
        assert arm.target_q[0] <= goal[0] + 1e-9
    assert arm.target_q == goal
    assert arm.actual_q == goal
    assert not arm.moving


def test_low_gain_makes_the_servo_softer(arm: Arm) -> None:
    goal = [q + 0.05 for q in HOME]
    positions = {}
    for gain in (100.0, 300.0):
        fresh = Arm(MODELS["ur5e"], DT)
        fresh.enabled = True
        for _ in range(50):
            fresh.servo(goal, 0.1, gain)
            fresh.step()
        positions[gain] = fresh.target_q[0]
    assert positions[100.0] < positions[300.0]


def test_servo_to_a_far_point_violates_the_speed_limit(arm: Arm) -> None:
    goal = [q + 1.0 for q in HOME]
    codes = set()
    for _ in range(200):
        arm.servo(goal, 0.03, 300.0)
        violation = arm.step()
        if violation:
            codes.add(violation.code)
            break
    assert codes == {204}


@pytest.mark.parametrize("speed", [-3.0, 0.0, 2.5])
@pytest.mark.parametrize("lookahead", [0.03, 0.1])
def test_where_periods_were_left_out_it_goes_to_a_far_point_at_top_speed(
    arm: Arm, lookahead: float, speed: float
) -> None:
    drive(arm, speed, 0.1)
    goal = [q + 0.8 for q in HOME]
    arm.forgive()
    fastest = 0.0
    for _ in range(round(FORGIVING_SECONDS / DT)):
        arm.servo(goal, lookahead, 300.0)
        assert arm.step() is None
        fastest = max(fastest, arm.target_qd[0])
    assert fastest == arm.model.velocity[0]
    assert apart(arm.target_q, goal) < 1e-4
    violations = []
    for _ in range(200):
        arm.servo(HOME, 0.03, 300.0)
        violations.append(arm.step())
    assert SUDDEN_CHANGE in violations, "it is forgiven for a while only"


def test_a_stream_at_top_speed_goes_on_when_nothing_is_forgiven_any_more(arm: Arm) -> None:
    arm.forgive()
    goal, speed = list(HOME), 0.0
    for _ in range(round(1.2 * FORGIVING_SECONDS / DT)):
        speed = min(0.9995 * arm.model.velocity[0], speed + 5.0 * DT)
        goal[0] += speed * DT
        arm.servo(goal, 0.03, 300.0)
        assert arm.step() is None


def test_steady_only_after_half_a_second_of_rest(arm: Arm) -> None:
    drive(arm, 0.1, 0.1)
    while arm.moving:
        arm.step()
    assert not arm.steady
    for _ in range(240):
        arm.step()
    assert not arm.steady
    for _ in range(20):
        arm.step()
    assert arm.steady


def test_approach_is_straight_and_bounded() -> None:
    assert approach([0.0, 0.0], [2.0, -1.0], 1.0) == [1.0, -0.5]
    assert approach([0.0, 0.0], [0.2, -0.1], 1.0) == [0.2, -0.1]
