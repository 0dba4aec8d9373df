"""Setpoints of every kind, changes between them, and what ends them."""

import time

import numpy as np
import pytest

from crtk_drivers.commands import Kind
from crtk_drivers.errors import MotionAborted
from rigs.dynamixel_bench import (
    COUNT,
    LONG,
    arm_values,
    driver_at,
    eventually,
    set_upright,
    sim_for,
    torque_ons,
)

ZERO = [0.0] * 6
POSITION, VELOCITY, CURRENT = 3, 1, 0
MODES = {"servo_jp": POSITION, "servo_jv": VELOCITY, "servo_jf": CURRENT}

GAIN, PROFILE = 700, 0.8
"""Not what a servo has after a change of mode."""


def values(**more):
    joints = {
        "waist": {"gains": {"position_p": GAIN}, "profile_acceleration": PROFILE * 10},
        "wrist_angle": {"gains": {"position_p": GAIN}},
    }
    return arm_values(joints=joints, mode_switch_dwell=0.0, **more)


@pytest.fixture(scope="module")
def shared():
    with sim_for(values()) as sim:
        yield sim


@pytest.fixture
def bench(shared):
    set_upright(shared)
    with driver_at(shared, values()) as bench:
        bench.enable()
        yield bench


def until_stream_ended(bench):
    """Wait until it has ended by itself; one that a busy machine ended has been followed by another."""
    eventually(
        lambda: (
            (bench.arm.health().stream_timeouts > 0 or bench.log.refusals)
            and not bench.arm.health().stream
        ),
        "the stream ends",
    )


def setpoint(bench, name):
    """A setpoint of a kind that moves nothing."""
    return bench.arm.measured_js().position if name == "servo_jp" else ZERO


def go_over_to(bench, name) -> list[int]:
    """Stream setpoints that move nothing until they take effect; return the mode of each servo."""
    register = {"servo_jp": 116, "servo_jv": 104, "servo_jf": 102}[name]
    value, mark = setpoint(bench, name), bench.mark()
    modes = {}

    def arrived():
        writes = bench.writes(mark)
        modes.update({on.id: on.registers["operating_mode"] for on in torque_ons(writes)})
        return any(w.address == register and len(w.data) <= 4 for w in writes[-6:])

    bench.stream(name, value, lambda: bench.device.takes_setpoints and arrived())
    return [modes.get(id, -1) for id in range(1, 7)]


@pytest.mark.parametrize("name", ["servo_jv", "servo_jf"])
def test_modes_change_both_ways_without_a_jump(bench, name):
    with bench.nothing_moves(counts=4):
        mark = bench.mark()
        assert go_over_to(bench, name) == [MODES[name]] * 6
        goal = {"servo_jv": "goal_velocity", "servo_jf": "goal_current"}[name]
        ons = [
            on
            for on in torque_ons(bench.writes(mark))
            if on.registers["operating_mode"] == MODES[name]  # one that is held up holds in between
        ]
        assert {on.id for on in ons} == set(range(1, 7))
        assert {on.registers[goal] for on in ons} == {0}
        assert all(bench.torques())
    before, mark = bench.servos(), bench.mark()
    assert go_over_to(bench, "servo_jp") == [POSITION] * 6
    for on in torque_ons(bench.writes(mark)):
        here = 2048 + before[on.id]["angle"] / COUNT
        assert on.registers["goal_position"] == pytest.approx(here, abs=6), f"servo {on.id}"
    with bench.nothing_moves(counts=2):
        bench.cycles(20)
    assert bench.status.state == "ENABLED"


def test_gains_and_profile_are_restored_after_a_change_of_mode(bench):
    go_over_to(bench, "servo_jv")
    mark = bench.mark()
    go_over_to(bench, "servo_jp")
    assert {(1, GAIN), (5, GAIN)} <= set(bench.written("position_p_gain", mark))
    acceleration = dict(bench.written("profile_acceleration", mark))
    assert acceleration[1] == round(PROFILE * 10 / 0.37451)
    assert acceleration[2] == 0
    for on in torque_ons(bench.writes(mark)):
        if on.id in (1, 5):
            assert on.registers["position_p_gain"] == GAIN, "before torque"
    bench.until_still()
    goal = bench.arm.measured_js().position.copy()
    goal[[0, 4]] += 0.1
    assert bench.arm.move_jp(goal).wait(LONG)


@pytest.mark.parametrize(
    ("name", "value"),
    [("servo_jv", [0.4, 0, 0, 0, 0, 0.5]), ("servo_jf", [0.6, 0, 0, 0, 0, 0.3])],
)
def test_the_end_of_a_stream_is_a_position_hold(bench, name, value):
    mark = bench.mark()
    bench.stream(name, value, lambda: bench.servos()[1]["velocity"] > 0.2)
    until_stream_ended(bench)
    eventually(lambda: bench.device.takes_setpoints, "it is at rest")
    modes = {on.id: on.registers["operating_mode"] for on in torque_ons(bench.writes(mark))}
    assert set(modes.values()) == {POSITION}
    bench.until_still()
    with bench.nothing_moves(counts=2):
        bench.cycles(20)
    assert bench.status.state == "ENABLED"
    assert all(bench.torques())
    here = bench.arm.measured_js().position
    assert np.abs(bench.arm.setpoint_js().position - here).max() < 5e-3
    assert here[0] > 0.01


@pytest.mark.parametrize("name", ["servo_jp", "servo_jv", "servo_jf"])
def test_pause_from_each_mode_holds(bench, name):
    if name == "servo_jp":
        bench.arm.move_jp([2.5, *ZERO[1:]])
        eventually(lambda: bench.servos()[1]["velocity"] > 0.2, "it moves")
    else:
        moving = [0.5 if name == "servo_jv" else 0.6, *ZERO[1:]]
        bench.stream(name, moving, lambda: bench.servos()[1]["velocity"] > 0.2)
    bench.arm.pause()
    eventually(lambda: bench.device.takes_setpoints, "it is at rest")
    bench.until_still()
    with bench.nothing_moves(counts=2):
        bench.cycles(20)
        assert all(bench.torques())
        bench.arm.resume()
        bench.cycles(20)
    assert 0.0 < bench.servos()[1]["angle"] < 2.48


def test_hold_ends_a_slow_profile_of_the_servo(shared):
    set_upright(shared)
    with driver_at(shared, arm_values(joints={"waist": {"profile_velocity": 0.2}})) as bench:
        bench.enable()
        move = bench.arm.move_jp([1.0, *ZERO[1:]])
        eventually(lambda: bench.servos()[1]["angle"] > 0.2, "it is on its way")
        assert move.is_busy()
        bench.arm.hold()
        bench.until_still()
        here = bench.servos()[1]["angle"]
        assert here < 0.9
        # The servo stands before the driver has read back that it does.
        eventually(lambda: bench.device.has_stopped, "the stop is read back")
        bench.cycles(1)
        assert bench.arm.setpoint_js().position[0] == pytest.approx(here, abs=2 * COUNT)
        with bench.nothing_moves():
            bench.cycles(20)
        assert bench.arm.move_jr([-0.1, *ZERO[1:]]).wait(LONG)
        bench.until_still()
        assert bench.servos()[1]["angle"] == pytest.approx(here - 0.1, abs=4 * COUNT)


def test_servo_jp_stream_that_stops_holds_the_last_setpoint(bench):
    goal = bench.arm.setpoint_js().position.copy()
    for _ in range(60):
        goal[0] += 0.0005
        bench.arm.servo_jp(goal)
        time.sleep(0.01)  # the pace of the stream
    until_stream_ended(bench)
    bench.until_still()
    assert bench.servos()[1]["angle"] == pytest.approx(goal[0], abs=3 * COUNT)
    assert bench.status.state == "ENABLED"


def test_a_velocity_is_what_was_asked_for(bench):
    value = [0.5, 0, 0, -0.8, 0, 0]
    bench.stream("servo_jv", value, lambda: abs(bench.servos()[4]["velocity"] + 0.8) < 0.03)
    bench.stream("servo_jv", value, lambda: abs(bench.servos()[1]["velocity"] - 0.5) < 0.03)
    near = pytest.approx([0.5, -0.8], abs=0.05)
    bench.stream("servo_jv", value, lambda: bench.arm.measured_js().velocity[[0, 3]] == near)


def test_an_effort_is_what_was_asked_for(bench):
    bench.sim.control.inject("stuck", id=4)
    value = [0, 0, 0, 0.8, 0, 0]
    asked = pytest.approx(0.8, rel=0.05)
    bench.stream("servo_jf", value, lambda: bench.servos()[4]["torque_applied"] == asked)
    bench.stream("servo_jf", value, lambda: abs(bench.arm.measured_js().effort[3] - 0.8) < 0.05)


def test_move_and_interpolate(bench):
    goal = np.array([0.2, -0.05, 0.05, 0.3, -0.2, 0.3])
    assert bench.arm.move_jp(goal).wait(LONG)
    bench.until_still()
    assert bench.arm.measured_js().position == pytest.approx(goal, abs=5e-3)
    back = np.zeros(6)
    bench.stream(
        "interpolate_jp", back, lambda: np.abs(bench.arm.measured_js().position).max() < 5e-3
    )


def test_a_stream_takes_over_from_a_move(bench):
    move = bench.arm.move_jp([3.0, *ZERO[1:]])
    eventually(lambda: bench.servos()[1]["velocity"] > 0.2, "it moves")
    bench.stream("servo_jv", ZERO, lambda: bench.device.part.kind is Kind.VELOCITY)
    with pytest.raises(MotionAborted):
        move.wait(LONG)
    until_stream_ended(bench)
    bench.until_still()
    assert bench.servos()[1]["angle"] < 2.95


def test_a_torque_that_is_lost_does_not_come_back_by_itself(bench):
    bench.sim.control.inject("power_off", id=6)
    bench.sim.control.clear()
    bench.until_state("FAULT", "joint wrist_rotate (servo 6 on main)")
    bench.cycles(40)
    assert bench.torques()[5] is False
    assert bench.torques()[:5] == [True] * 5
    eventually(lambda: "torque is off" in bench.status.detail, "the reason")
    with bench.nothing_moves(ids=(1, 2, 3, 4, 5)):
        bench.arm.enable(timeout=LONG)
    assert all(bench.torques())
