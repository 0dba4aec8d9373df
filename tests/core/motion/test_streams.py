"""interpolate_* through the engine: smooth, within the limits, to the last goal, and gently to an end."""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from crtk_drivers.device import CartesianLimits, Mode
from crtk_drivers.engine import EngineOptions
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.options import LimitPolicy
from crtk_drivers.samples import JointState, Pose, Twist, Value, Vector, vector
from crtk_drivers.state import OperatingState
from crtk_drivers.status.board import WARNING_INTERVAL
from rigs.scripted_engine import LIMIT, PERIOD, Rig, jf, jp, jv, pose, two_joints

SLOW = 5
"""Cycles from one goal to the next: 20 Hz."""


def stream(rig: Rig, name: str, values: Sequence[Value], cycles: int = SLOW) -> None:
    for value in values:
        rig.engine.submit(name, value)
        rig.cycle(cycles)


def sine(count: int) -> list[Value]:
    times = np.arange(1, count + 1) * SLOW * PERIOD
    return [jp(0.1 * math.sin(4.0 * t), 0.1 - 0.1 * math.cos(4.0 * t)) for t in times]


def written(rig: Rig, start: int = 0) -> np.ndarray:
    return np.array([setpoint.values for setpoint in rig.written[start:]])


def assert_smooth(path: np.ndarray) -> None:
    """Velocity and acceleration of positions that were written in each cycle keep the limits."""
    velocity = np.diff(path, axis=0) / PERIOD
    acceleration = np.diff(velocity, axis=0) / PERIOD
    assert np.abs(velocity).max() <= LIMIT.velocity + 1e-6
    assert np.abs(acceleration).max() <= LIMIT.acceleration + 1e-4
    assert np.abs(np.diff(acceleration, axis=0)).max() <= 2.0 * LIMIT.jerk * PERIOD


def test_a_slow_stream_becomes_a_smooth_one_that_ends_at_its_last_goal() -> None:
    rig = Rig().enabled()
    goals = sine(40)
    stream(rig, "interpolate_jp", goals)
    assert rig.engine.health().stream == "interpolate_jp"
    assert not rig.engine.status.is_busy
    path = np.vstack(([0.0, 0.0], written(rig)))
    assert len(path) == 40 * SLOW + 1, "each cycle sends one"
    assert_smooth(path)
    setpoint = rig.setpoint()
    assert setpoint["position"] == path[-1].tolist()
    assert setpoint["velocity"] == pytest.approx((path[-1] - path[-2]) / PERIOD, abs=0.1)
    assert rig.value("setpoint_cp")[1] != 0
    last = goals[-1]
    assert isinstance(last, JointState)
    goal = rig.engine.latched("goal_js")
    assert goal is not None
    assert isinstance(goal[0], JointState)
    assert goal[0].position.tolist() == last.position.tolist()
    assert goal[0].name == ("slide", "turn")
    assert {"goal_js", "goal_cp"} <= set(rig.told.goals)

    rig.cycle(100)
    assert_smooth(np.vstack(([0.0, 0.0], written(rig))))
    assert rig.written[-1].values == pytest.approx(last.position, abs=1e-9)
    health = rig.engine.health()
    assert (health.stream, health.stream_timeouts) == ("", 1)
    assert "stop" not in rig.device.calls, "a position is held by itself"
    assert rig.setpoint()["position"] == pytest.approx(last.position, abs=1e-9)
    assert rig.told.refusals == []


def test_a_goal_far_away_is_no_jump() -> None:
    rig = Rig().enabled()
    stream(rig, "interpolate_jp", [jp(0.9, -0.9)], cycles=200)
    assert_smooth(np.vstack(([0.0, 0.0], written(rig))))
    assert rig.written[-1].values == pytest.approx([0.9, -0.9], abs=1e-9)


def test_increments_add_up_onto_the_newest_goal() -> None:
    rig = Rig().enabled()
    for _ in range(4):
        for _ in range(5):
            rig.engine.submit("interpolate_jr", jp(0.01, -0.02))
        rig.cycle(SLOW)
    rig.cycle(150)
    assert rig.written[-1].values == pytest.approx([0.2, -0.4], abs=1e-9)
    goal = rig.engine.latched("goal_js")
    assert goal is not None
    assert isinstance(goal[0], JointState)
    assert goal[0].position == pytest.approx([0.2, -0.4])


@pytest.mark.parametrize(
    ("name", "make", "mode", "rate"),
    [
        ("interpolate_jv", jv, Mode.JOINT_VELOCITY, LIMIT.acceleration),
        ("interpolate_jf", jf, Mode.JOINT_EFFORT, LIMIT.effort / 0.1),
    ],
)
def test_velocities_and_efforts_change_steadily_and_end_at_zero(
    name: str, make: Callable[..., Value], mode: Mode, rate: float
) -> None:
    rig = Rig().enabled()
    stream(rig, name, [make(0.8, -0.5)] * 20)
    field = {"interpolate_jv": "velocity", "interpolate_jf": "effort"}[name]
    setpoint = rig.setpoint()
    assert setpoint[field] == pytest.approx([0.8, -0.5])
    assert [setpoint[other] for other in setpoint if other != field] == [[], []]
    assert rig.value("setpoint_cp")[1] == 0, "valid under position commands only"
    goal = rig.engine.latched("goal_js")
    assert goal is not None
    assert getattr(goal[0], field).tolist() == [0.8, -0.5]
    assert "stop" not in rig.device.calls
    rig.cycle(100)
    assert {setpoint.mode for setpoint in rig.written} == {mode}
    values = np.vstack(([0.0, 0.0], written(rig)))
    assert np.abs(np.diff(values, axis=0)).max() <= rate * PERIOD + 1e-9
    assert values[-1] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert "stop" in rig.device.calls
    assert rig.engine.health().stream == ""


def test_a_velocity_that_the_range_holds_does_not_go_on_growing_behind_it() -> None:
    """Back from the end of its range a joint set out only when the velocity in mind was at zero."""
    slow = replace(LIMIT, acceleration=1.0, jerk=10.0)
    rig = Rig(capabilities=two_joints(limits=(slow, slow))).enabled()
    rig.device.position[0] = slow.upper - 0.002
    stream(rig, "interpolate_jv", [jv(0.8, 0.0)] * 20)
    sent = len(rig.written)
    assert 0.0 < rig.written[-1].values[0] < 0.1, "the range holds it"
    stream(rig, "interpolate_jv", [jv(-0.8, 0.0)] * 6)
    back = written(rig, sent - 1)[:, 0]
    assert np.abs(np.diff(back)).max() <= slow.acceleration * PERIOD + 1e-9
    assert np.flatnonzero(back < 0.0)[0] * PERIOD < 0.2, "it took 1 s"


@pytest.mark.parametrize(
    ("policy", "state"),
    [("hold", OperatingState.ENABLED), ("pause", OperatingState.PAUSED)],
)
def test_what_follows_when_the_stream_has_ended(policy: str, state: OperatingState) -> None:
    rig = Rig(EngineOptions(on_stream_timeout=policy)).enabled()
    stream(rig, "interpolate_jp", [jp(0.1, 0.0)])
    rig.cycle(30)
    assert rig.state is OperatingState.ENABLED, "its commands may be this far apart"
    rig.cycle(60)
    assert rig.state is state
    assert ("interpolate_jp stopped for more than 0.5 s" in rig.engine.status.detail) is (
        policy == "pause"
    )


def test_a_goal_out_of_range_is_clamped_with_a_warning_or_refused_as_the_user_chose() -> None:
    rig = Rig().enabled()
    stream(rig, "interpolate_jp", [jp(1.5, 0.0)], cycles=250)
    assert rig.written[-1].values == pytest.approx([1.0, 0.0], abs=1e-9)
    assert "slide at 1.5000 is outside" in rig.told.warnings[0]
    strict = Rig(EngineOptions(limits=LimitPolicy(clamp_servo=False))).enabled()
    assert strict.refused("interpolate_jp", jp(1.5, 0.0)).reason is Reason.OUT_OF_RANGE
    stream(strict, "interpolate_jr", [jp(0.6, 0.0), jp(0.6, 0.0)])
    assert [refusal.reason for refusal in strict.told.refusals[1:]] == [Reason.OUT_OF_RANGE]
    strict.cycle(200)
    assert strict.written[-1].values == pytest.approx([0.6, 0.0], abs=1e-9)


def test_a_stream_at_a_limit_warns_once_in_two_seconds_and_what_is_left_out_is_counted() -> None:
    rig = Rig().enabled()
    rig.device.position = np.array([0.98, 0.0])
    for cycle in range(250):
        rig.engine.submit("servo_jv", jv(0.8 + 0.0001 * cycle, 0.0))
        rig.cycle()
    health = rig.engine.health()
    assert health.clamped > 220
    first, second = rig.told.warnings
    assert first.startswith("servo_jv: slide ")
    assert "not told" not in first
    told = re.search(r"\((\d+) more of these were not told\)$", second)
    assert told is not None
    assert int(told[1]) == pytest.approx(WARNING_INTERVAL / PERIOD, abs=1)
    assert health.warnings_left_out == health.clamped - 2


def test_it_begins_with_the_motion_that_it_replaces() -> None:
    rig = Rig().enabled()
    rig.engine.submit("move_jp", jp(0.8, 0.0))
    rig.cycle(40)
    assert rig.setpoint()["velocity"][0] > 0.5
    stream(rig, "interpolate_jp", [jp(-0.2, 0.3)], cycles=200)
    assert_smooth(np.vstack(([0.0, 0.0], written(rig))))
    rig.engine.submit("interpolate_jp", jp(0.5, 0.0))
    rig.cycle(40)
    rig.engine.submit("move_jp", jp(0.0, 0.0))
    rig.cycle(200)
    assert_smooth(np.vstack(([0.0, 0.0], written(rig))))
    assert rig.written[-1].values.tolist() == [0.0, 0.0]


def test_a_position_stream_after_a_velocity_begins_at_that_velocity() -> None:
    rig = Rig(EngineOptions(mode_switch_dwell=0.0)).enabled()
    rig.engine.submit("servo_jv", jv(0.5, 0.0))
    rig.cycle(2)
    rig.engine.submit("interpolate_jp", jp(0.3, 0.0))
    rig.cycle()
    assert rig.setpoint()["velocity"][0] == pytest.approx(0.5, abs=0.05)
    rig.cycle(100)
    assert_smooth(written(rig, start=1))


def test_poses_are_followed_through_inverse_kinematics() -> None:
    rig = Rig().enabled()
    times = np.arange(1, 41) * SLOW * PERIOD
    goals = [pose(0.05 * math.sin(3.0 * t), 0.1 - 0.1 * math.cos(3.0 * t)) for t in times]
    stream(rig, "interpolate_cp", goals)
    assert {setpoint.mode for setpoint in rig.written} == {Mode.JOINT_POSITION}
    path = np.vstack(([0.0, 0.0], written(rig)))
    assert len(path) == 40 * SLOW + 1
    assert_smooth(path)
    setpoint = rig.setpoint()
    assert setpoint["position"] == path[-1].tolist()
    assert setpoint["velocity"] == pytest.approx((path[-1] - path[-2]) / PERIOD, abs=0.05)
    assert rig.value("setpoint_cp")[1] != 0
    goal = rig.engine.latched("goal_cp")
    assert goal is not None
    assert isinstance(goal[0], Pose)
    assert goal[0].position.tolist() == goals[-1].position.tolist()
    rig.cycle(120)
    assert_smooth(np.vstack(([0.0, 0.0], written(rig))))
    end = rig.device.solver.inverse(goals[-1], vector((0.0, 0.0)))
    assert rig.written[-1].values == pytest.approx(end, abs=1e-9)
    assert rig.engine.health().stream == ""


def test_increments_of_the_pose_add_up_onto_the_newest_goal() -> None:
    rig = Rig().enabled()
    for _ in range(4):
        for _ in range(3):
            rig.engine.submit("interpolate_cr", pose(0.01, -0.02))
        rig.cycle(SLOW)
    rig.cycle(150)
    assert rig.written[-1].values == pytest.approx([0.12, -0.24], abs=1e-9)
    assert_smooth(np.vstack(([0.0, 0.0], written(rig))))


def test_poses_out_of_reach_are_refused_and_the_stream_goes_on() -> None:
    rig = Rig().enabled()
    stream(rig, "interpolate_cp", [pose(0.1)])
    with pytest.raises(CommandRefused) as caught:
        rig.engine.submit("interpolate_cp", pose(0.0, y=0.1))
    assert caught.value.reason is Reason.UNREACHABLE
    with pytest.raises(CommandRefused) as caught:
        rig.engine.submit("interpolate_cp", pose(1.2))
    assert caught.value.reason is Reason.OUT_OF_RANGE
    rig.cycle(150)
    assert rig.written[-1].values == pytest.approx([0.1, 0.0], abs=1e-9)
    stream(rig, "interpolate_cr", [pose(0.1), pose(0.0, y=0.1), pose(0.1)])
    assert rig.told.refusals[-1].reason is Reason.UNREACHABLE
    rig.cycle(150)
    assert rig.written[-1].values == pytest.approx([0.3, 0.0], abs=1e-9)


def test_a_joint_that_would_be_too_fast_on_the_way_stops_the_stream() -> None:
    rig = Rig().enabled()
    stream(rig, "interpolate_cp", [pose(0.1)])
    straight = rig.device.solver.inverse

    def other_branch(goal: Pose, reference: Vector) -> Vector:
        return vector(straight(goal, reference) + 0.05)

    rig.device.solver.inverse = other_branch  # type: ignore[method-assign]
    rig.cycle(5)
    assert [refusal.reason for refusal in rig.told.refusals] == [Reason.STEP_TOO_LARGE]
    assert "stop" in rig.device.calls
    assert rig.engine.health().stream == ""
    assert rig.state is OperatingState.ENABLED
    assert_smooth(np.vstack(([0.0, 0.0], written(rig))))


def test_hardware_that_takes_poses_gets_poses() -> None:
    modes = frozenset({Mode.CARTESIAN_POSITION})
    rig = Rig(capabilities=two_joints(modes=modes), has_kinematics=False).enabled()
    stream(rig, "interpolate_cp", [pose(0.05 * index) for index in range(1, 9)])
    rig.cycle(300)
    path = written(rig)
    assert path.shape[1] == 7
    assert np.abs(np.diff(path, axis=0)).max() <= 0.5 * PERIOD + 1e-9
    assert path[-1] == pytest.approx([0.4, 0, 0, 0, 0, 0, 1], abs=1e-9)


def test_twists_change_steadily_and_end_at_zero() -> None:
    rig = Rig().enabled()
    goal = Twist(vector((0.3, 0, 0)), vector((0, 0, 0.5)))
    stream(rig, "interpolate_cv", [goal] * 10)
    assert {setpoint.mode for setpoint in rig.written} == {Mode.CARTESIAN_VELOCITY}
    assert rig.written[-1].values == pytest.approx(goal.vector)
    assert rig.value("setpoint_cp")[1] == 0
    found = rig.engine.latched("goal_cv")
    assert found is not None
    assert isinstance(found[0], Twist)
    assert (found[0].vector.tolist(), found[0].frame_id) == (goal.vector.tolist(), "base")
    rig.cycle(100)
    values = np.vstack((np.zeros(6), written(rig)))
    assert np.abs(np.diff(values, axis=0)).max() <= 5.0 * PERIOD + 1e-9
    assert values[-1] == pytest.approx(np.zeros(6), abs=1e-9)
    assert "stop" in rig.device.calls


def twist(x: float) -> Twist:
    return Twist(vector((x, 0.0, 0.0)), vector((0.0, 0.0, 0.0)))


ON_JOINTS = {
    Mode.JOINT_POSITION: two_joints(modes=frozenset({Mode.JOINT_POSITION})),
    Mode.JOINT_VELOCITY: two_joints(modes=frozenset({Mode.JOINT_VELOCITY})),
}


def rates(rig: Rig) -> np.ndarray:
    """The joint velocities that were commanded in each cycle."""
    values = np.vstack(([0.0, 0.0], written(rig)))
    is_position = rig.written[0].mode is Mode.JOINT_POSITION
    return np.diff(values, axis=0) / PERIOD if is_position else values[1:]


@pytest.mark.parametrize("name", ["servo_cv", "interpolate_cv"])
@pytest.mark.parametrize("mode", ON_JOINTS)
def test_twists_on_joints_are_followed_in_each_cycle_and_end_at_rest(mode: Mode, name: str) -> None:
    rig = Rig(capabilities=ON_JOINTS[mode]).enabled()
    goal = Twist(vector((0.3, 0, 0)), vector((0, 0, -0.5)))
    stream(rig, name, [goal] * 10)
    assert {setpoint.mode for setpoint in rig.written} == {mode}
    assert len(rig.written) == 10 * SLOW
    assert rates(rig)[-1] == pytest.approx([0.3, -0.5])
    setpoint = rig.setpoint()
    assert setpoint["velocity"] == pytest.approx([0.3, -0.5])
    assert len(setpoint["position"]) == (2 if mode is Mode.JOINT_POSITION else 0)
    assert (rig.engine.latched("goal_cv") is not None) is (name == "interpolate_cv")
    rig.cycle(100)
    assert rates(rig)[-1] == pytest.approx([0.0, 0.0], abs=1e-9)
    change = np.diff(np.vstack(([0.0, 0.0], rates(rig))), axis=0)
    assert np.abs(change).max() <= LIMIT.acceleration * PERIOD + 1e-9
    health = rig.engine.health()
    assert (health.stream, health.stream_timeouts) == ("", 1)
    assert ("stop" in rig.device.calls) is (mode is Mode.JOINT_VELOCITY)


def test_a_twist_stops_smoothly_at_the_limit_of_a_joint() -> None:
    rig = Rig(capabilities=ON_JOINTS[Mode.JOINT_POSITION]).enabled()
    stream(rig, "servo_cv", [Twist(vector((0.45, 0, 0)), vector((0, 0, 0)))] * 60)
    assert rig.written[-1].values == pytest.approx([1.0, 0.0], abs=1e-3)
    assert written(rig).max() <= 1.0
    change = np.diff(rates(rig), axis=0)
    assert np.abs(change).max() <= LIMIT.acceleration * PERIOD + 1e-9
    assert rig.told.warnings == []


@pytest.mark.parametrize("name", ["servo_jv", "interpolate_jv"])
def test_a_joint_that_is_not_seen_for_a_while_is_slowed_down_before_its_range_ends(
    name: str,
) -> None:
    rig = Rig().enabled()
    rig.device.position[0] = begin = LIMIT.upper - 0.2
    stream(rig, name, [jv(0.8, 0.0)] * 8, cycles=1)
    rig.device.silent = True
    stream(rig, name, [jv(0.8, 0.0)] * 40, cycles=1)
    assert rig.state is OperatingState.ENABLED
    gone = written(rig, 8)[:, 0].sum() * PERIOD
    assert 0.1 < gone < LIMIT.upper - begin, "what it goes while nobody sees it"
    assert rig.setpoint()["velocity"] == rig.written[-1].values.tolist(), "what was really sent"


@pytest.mark.parametrize(
    "mode", [Mode.JOINT_POSITION, Mode.JOINT_VELOCITY, Mode.CARTESIAN_VELOCITY]
)
def test_a_twist_that_the_range_of_a_joint_holds_does_not_go_on_growing_behind_it(
    mode: Mode,
) -> None:
    tool = CartesianLimits(0.5, 1.0, 1.0, 5.0)
    declared = two_joints(modes=frozenset({mode}), cartesian_limits=tool)
    rig = Rig(capabilities=declared)
    rig.device.position[0] = LIMIT.upper - 1e-4
    rig.enabled()
    stream(rig, "interpolate_cv", [twist(0.45)] * 20)
    sent = len(rig.written)
    stream(rig, "interpolate_cv", [twist(-0.45)] * 6)
    back = written(rig, sent - 1)[:, 0]
    if mode is Mode.JOINT_POSITION:
        back = np.diff(back) / PERIOD
    assert 0.0 <= back[0] < 0.1, "the range holds it"
    assert np.flatnonzero(back < -1e-6)[0] * PERIOD <= 0.25, "it took 0.8 s"


def test_a_twist_on_joints_begins_with_the_velocity_of_the_move_that_it_replaces() -> None:
    rig = Rig(capabilities=ON_JOINTS[Mode.JOINT_POSITION]).enabled()
    rig.engine.submit("move_jp", jp(0.8, 0.0))
    rig.cycle(40)
    stream(rig, "servo_cv", [Twist(vector((-0.3, 0, 0)), vector((0, 0, 0)))] * 10)
    change = np.diff(rates(rig), axis=0)
    assert np.abs(change).max() <= LIMIT.acceleration * PERIOD + 1e-4


def test_no_other_stream_comes_between_two_commands_and_hold_ends_it_at_once() -> None:
    rig = Rig().enabled()
    stream(rig, "interpolate_jp", [jp(0.5, 0.0)], cycles=20)
    count = len(rig.written)
    with pytest.raises(CommandRefused) as caught:
        rig.servo(0.0, 0.0)
    assert caught.value.reason is Reason.MODE_SWITCH
    rig.engine.submit("hold")
    rig.cycle(5)
    assert len(rig.written) == count
    assert rig.engine.health().stream == ""
    rig.servo(*rig.setpoint()["position"])
    rig.cycle()
    assert rig.engine.health().stream == "servo_jp"


def test_a_refused_goal_leaves_a_move_running() -> None:
    rig = Rig(EngineOptions(limits=LimitPolicy(clamp_servo=False))).enabled()
    move = rig.engine.submit("move_jp", jp(0.5, 0.0))
    rig.cycle(5)
    rig.engine.submit("interpolate_jr", jp(1.5, 0.0))
    rig.cycle(150)
    assert move is not None
    assert move.wait(0.0)
    assert [refusal.reason for refusal in rig.told.refusals] == [Reason.OUT_OF_RANGE]
