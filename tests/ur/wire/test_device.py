"""The whole UR driver against simulated controllers: real sockets, the unmodified vendor library."""

import math
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from unittest.mock import patch

import numpy as np
import pytest

from crtk_driver_ur import device as ur_device
from crtk_drivers.device import Mode, Setpoint
from crtk_drivers.errors import CommandRefused, KinematicsError, MotionAborted, TransitionFailed
from crtk_drivers.motion.move import Outcome
from crtk_drivers.options import EngineOptions
from crtk_drivers.samples import Pose, vector
from rigs.ur_bench import (
    FAR,
    HOME,
    LENIENT,
    LONG,
    PATIENT,
    WAYS,
    UrBench,
    brisk_sim,
    driver_at,
    eventually,
    ur_bench,
)

pytestmark = pytest.mark.sweep(4)

ARMS = {
    "ur10e ur_rtde": ("ur_rtde", "controller", {"model": "ur10e", "version": "5.23.0"}),
    "ur5 ur_rtde": ("ur_rtde", "driver", {"model": "ur5", "version": "3.15.8"}),
    "ur5e native": ("native", "driver", {"model": "ur5e", "version": "5.12.4"}),
    "ur5 native": ("native", "controller", {"model": "ur5", "version": "3.15.8"}),
}
"""Who carries commands out, who plans moves, and the arm: every pair of these."""
POWER_OFF, RUNNING = 3, 7
STOPPED, PLAYING = 1, 2
PERIOD = 0.004
STANDSTILL = 0.05
"""Seconds without a setpoint in which an arm goes on to the last one."""


@pytest.fixture(scope="module", params=ARMS)
def shared(request):
    control, planner, controller = ARMS[request.param]
    # Faster, an arm that its speed slider stops is not waited for in time: a protective stop.
    move = {**PATIENT["move"], "joint_acceleration": 10.0, "planned_by": planner}
    with ur_bench({"control": control, "move": move}, **controller) as bench:
        yield bench


@pytest.fixture
def bench(shared: UrBench) -> UrBench:
    shared.reset()
    return shared


@pytest.fixture
def arm(bench):
    return bench.arm


def at(*offsets: float) -> list[float]:
    """HOME with offsets to its first joints, rad."""
    return [q + d for q, d in zip(HOME, (*offsets, *[0.0] * 6), strict=False)]


def stream(send, until, what: str) -> None:
    """Call `send` again and again until `until`."""
    deadline = time.monotonic() + LONG
    while not until():
        assert time.monotonic() < deadline, f"never: {what}"
        send()
        time.sleep(PERIOD)


def shifted(pose: Pose, *offset: float) -> Pose:
    return Pose(vector(pose.position + np.array(offset)), pose.orientation, pose.frame_id)


# Operating state


def test_enable_moves_nothing_from_running_and_from_power_off(bench):
    with bench.nothing_moves():
        bench.arm.disable(timeout=LONG)
        assert bench.outputs("robot_mode") == POWER_OFF
        assert bench.status.state == "DISABLED"
        bench.arm.enable(timeout=LONG)
        assert bench.outputs("robot_mode") == RUNNING
        assert bench.outputs("runtime_state") == PLAYING
        assert bench.status.state == "ENABLED"
    np.testing.assert_allclose(bench.arm.setpoint_jp(), bench.q(), atol=1e-3)
    assert bench.log.states == ["DISABLED", "ENABLED"]


def test_pause_stops_and_refuses_until_resume_which_starts_where_the_arm_is(bench):
    move = bench.arm.move_jp(FAR)
    bench.until_moving()
    bench.arm.pause(timeout=LONG)
    bench.until_still()
    with pytest.raises(MotionAborted, match="aborted"):
        move.wait(LONG)
    with bench.nothing_sent():
        with bench.refused("not_enabled", "servo_jp"):
            bench.arm.servo_jp(HOME)
        with bench.refused("not_enabled", "move_jp"):
            bench.arm.move_jp(HOME)
    with bench.nothing_moves():
        bench.arm.resume(timeout=LONG)
        np.testing.assert_allclose(bench.arm.setpoint_jp(), bench.q(), atol=1e-3)
    assert bench.q()[0] < FAR[0] - 0.1
    bench.go_home()


def test_disable_under_motion_stops_and_switches_off(bench):
    bench.arm.move_jp(FAR)
    bench.until_moving()
    bench.arm.disable(timeout=LONG)
    assert bench.outputs("robot_mode") == POWER_OFF
    assert bench.outputs("runtime_state") == STOPPED
    assert bench.q()[0] < FAR[0] - 0.1
    with bench.nothing_moves():
        bench.arm.enable(timeout=LONG)


def test_disable_replaces_an_enable_that_runs(bench):
    bench.arm.disable(timeout=LONG)
    bench.arm.state_command("enable", timeout=0)
    bench.arm.disable(timeout=LONG)
    bench.until_outputs(robot_mode=(POWER_OFF,))
    assert bench.status.state == "DISABLED"
    bench.arm.enable(timeout=LONG)


# Moves


def test_moves_arrive_at_their_goals(bench):
    arm = bench.arm
    assert arm.move_jp(at(0.3, 0.2, -0.1)).wait(LONG)
    np.testing.assert_allclose(arm.goal_jp(), at(0.3, 0.2, -0.1))
    np.testing.assert_allclose(bench.q(), at(0.3, 0.2, -0.1), atol=1e-3)
    assert arm.move_jr([-0.3, 0.0, 0.0, 0.1, 0.0, 0.0]).wait(LONG)
    np.testing.assert_allclose(bench.q(), at(0.0, 0.2, -0.1, 0.1), atol=1e-3)
    goal = shifted(arm.setpoint_cp(), 0.0, 0.05, 0.08)
    assert arm.move_cp(goal).wait(LONG)
    np.testing.assert_allclose(arm.goal_cp().position, goal.position)
    np.testing.assert_allclose(bench.outputs("actual_TCP_pose")[:3], goal.position, atol=1e-3)
    np.testing.assert_allclose(arm.measured_cp().position, goal.position, atol=1e-3)
    assert abs(arm.measured_cp().orientation @ goal.orientation) > 1.0 - 1e-6


def test_busy_while_a_move_runs(bench):
    move = bench.arm.move_jp(at(0.3))
    assert bench.arm.is_busy() or not move.is_busy()
    assert move.wait(LONG)
    eventually(lambda: len(bench.log.statuses) > 1, "both are told")
    assert [status.is_busy for status in bench.log.statuses] == [True, False]
    assert bench.arm.wait_for_busy(False, LONG)


def test_a_newer_move_takes_over_and_arrives(bench):
    first = bench.arm.move_jp(FAR)
    bench.until_moving()
    second = bench.arm.move_jp(at(-0.2))
    with pytest.raises(MotionAborted, match="pre-empted"):
        first.wait(LONG)
    assert second.wait(LONG)
    np.testing.assert_allclose(bench.q(), at(-0.2), atol=1e-3)


def test_a_newer_move_goes_on_with_the_speed_of_the_one_before_or_begins_at_rest(
    bench, monkeypatch
):
    first = bench.arm.move_jp(at(4.5))
    bench.until_moving(speed=1.0)
    begin, read = bench.q()[0], bench.device.read
    states = []

    def read_and_keep(deadline):
        sample = read(deadline)
        states.append(bench.device.robot_state)
        return sample

    monkeypatch.setattr(bench.device, "read", read_and_keep)
    second = bench.arm.move_jp(FAR)
    eventually(lambda: bench.device.robot_state.target_q[0] > begin + 1.0, "it goes on")
    monkeypatch.undo()
    assert second.is_busy()
    bench.arm.hold()
    with pytest.raises(MotionAborted, match="pre-empted"):
        first.wait(LONG)
    speeds = np.array([state.target_qd[0] for state in states])
    if bench.engine.capabilities.native_moves:
        assert speeds.min() < 0.1
    else:
        # A driver that is late slows it down, and no more; one that is held up longer than this stops it.
        late = np.diff([state.timestamp for state in states], append=np.inf) > STANDSTILL
        assert speeds[: late.argmax() + 1].min() > 0.5


def test_moves_that_follow_each_other_fast_end_in_the_last(bench):
    pose = bench.arm.setpoint_cp()
    stops = bool(bench.engine.capabilities.native_moves)
    moves = []
    for i in range(10):
        if i % 3 == 2:
            # From a fast motion there may be no line to it, where that begins without a stop.
            with nullcontext() if stops else suppress(CommandRefused):
                moves.append(bench.arm.move_cp(shifted(pose, 0.0, 0.0, 0.01 * i)))
        else:
            moves.append(bench.arm.move_jp(at(0.3 * (-1) ** i)))
        time.sleep(0.05)
    last = bench.arm.move_jp(at(0.1))
    assert last.wait(LONG)
    np.testing.assert_allclose(bench.q(), at(0.1), atol=1e-3)
    ended = {move.outcome for move in moves}
    assert Outcome.PREEMPTED in ended
    assert ended <= {
        Outcome.PREEMPTED,
        Outcome.REACHED,
    }  # this on a busy machine, before the next came
    assert bench.status.state == "ENABLED"
    assert bench.arm.wait_for_busy(False, LONG)


def test_hold_ends_a_move_and_the_next_one_arrives(bench):
    move = bench.arm.move_jp(FAR)
    bench.until_moving()
    bench.arm.hold()
    with pytest.raises(MotionAborted, match="hold"):
        move.wait(LONG)
    again = bench.arm.move_jp(at(0.2))
    assert again.wait(LONG)
    np.testing.assert_allclose(bench.q(), at(0.2), atol=1e-3)
    bench.arm.move_jp(FAR)
    bench.until_moving()
    bench.arm.hold()
    bench.until_still()
    assert bench.q()[0] < FAR[0] - 0.1
    assert bench.watch(0.3) < 1e-3


# Streams


def test_servo_jp_is_followed_and_its_last_position_held(bench):
    arm, farthest, lag = bench.arm, 0.0, math.nan
    for i in range(300):
        arm.servo_jp(at(0.15 * (1.0 - math.cos(i * math.pi / 150.0))))
        farthest = max(farthest, arm.measured_jp(age=0)[0])
        lag = arm.health().device["servo lag (s)"]
        time.sleep(PERIOD)
    assert farthest > 0.25
    assert 0.02 < lag < 2.0
    # From rest, too, if the stream has ended: this test was held up.
    stream(
        lambda: arm.servo_jp(at(0.02, 0.01)),
        lambda: np.allclose(bench.q(), at(0.02, 0.01), atol=1e-3),
        "the arm reaches the last position",
    )
    np.testing.assert_allclose(arm.setpoint_jp(), at(0.02, 0.01))
    bench.until_still()
    with bench.nothing_moves():
        eventually(lambda: not arm.health().stream, "the stream has ended")
        assert bench.watch(0.3) < 1e-3
    assert bench.status.state == "ENABLED"
    assert bench.outputs("runtime_state") == PLAYING


@contextmanager
def patient_streams() -> Iterator[None]:
    """Let no stream end though the one who sends it was held up: it would begin anew, where the arm is."""
    with patch.object(EngineOptions, "silence", lambda options, level: LENIENT):
        yield


def test_no_increment_of_servo_jr_is_lost(bench):
    with patient_streams():
        start = bench.arm.setpoint_jp()
        for _ in range(100):
            bench.arm.servo_jr([0.0002, 0.0, -0.0001, 0.0, 0.0, 0.0])
            time.sleep(0.001)
    goal = start + np.array([0.02, 0.0, -0.01, 0.0, 0.0, 0.0])
    eventually(lambda: np.allclose(bench.q(), goal, atol=1e-3), "the sum is reached")
    np.testing.assert_allclose(bench.arm.setpoint_jp(), goal, atol=1e-9)


def test_servo_jv_is_reached_and_expires(bench):
    arm, wanted = bench.arm, [0.2, 0.0, 0.0, 0.0, 0.0, -0.1]

    def reached() -> bool:
        setpoint = arm.setpoint_js(age=0)
        told = setpoint.position.size == 0 and np.allclose(setpoint.velocity, wanted)
        return told and np.allclose(arm.measured_jv(age=0), wanted, atol=0.01)

    stream(lambda: arm.servo_jv(wanted), reached, "the speed is reached, and told as the setpoint")
    bench.until_still()
    eventually(lambda: arm.health().stream_timeouts, "the driver has noticed that it ended")
    assert bench.status.state == "ENABLED"


def test_servo_cp_is_followed(bench):
    arm, start = bench.arm, bench.arm.setpoint_cp()
    goal = shifted(start, 0.0, 0.03, 0.05)
    for i in range(101):
        arm.servo_cp(shifted(start, 0.0, 0.0003 * i, 0.0005 * i))
        time.sleep(PERIOD)
    stream(
        lambda: arm.servo_cp(goal),
        lambda: np.allclose(arm.measured_cp(age=0).position, goal.position, atol=1e-3),
        "the pose is reached",
    )
    np.testing.assert_allclose(arm.setpoint_cp().position, goal.position, atol=1e-6)
    np.testing.assert_allclose(bench.outputs("actual_TCP_pose")[:3], goal.position, atol=2e-3)


def test_servo_cv_is_reached_and_expires(bench):
    arm, wanted = bench.arm, [0.0, 0.0, 0.05, 0.0, 0.0, 0.1]
    stream(
        lambda: arm.servo_cv(wanted),
        lambda: np.allclose(arm.measured_cv(age=0).vector, wanted, atol=0.01),
        "the twist is reached",
    )
    bench.until_still()
    assert bench.status.state == "ENABLED"


@contextmanager
def written(bench: UrBench) -> Iterator[tuple[list[np.ndarray], list[np.ndarray]]]:
    """The joint positions that the device is told to send, and the velocities set before each."""
    positions: list[np.ndarray] = []
    velocities: list[np.ndarray] = []
    write = bench.device.write

    def record(setpoint: Setpoint) -> None:
        assert setpoint.mode is Mode.JOINT_POSITION
        positions.append(setpoint.values)
        velocities.append(bench.arm.setpoint_js(age=0).velocity)
        write(setpoint)

    bench.device.write = record
    try:
        yield positions, velocities
    finally:
        del bench.device.write


def test_interpolate_jp_makes_a_smooth_motion_of_20_goals_a_second(bench):
    arm, farthest = bench.arm, 0.0
    limit = bench.engine.capabilities.limits[0]
    cycle = 1.0 / bench.engine.capabilities.rate
    with written(bench) as (positions, velocities):
        for i in range(41):
            arm.interpolate_jp(at(0.15 * (1.0 - math.cos(i * math.pi / 20.0))))
            farthest = max(farthest, arm.measured_jp(age=0)[0])
            time.sleep(0.05)
        arm.interpolate_jp(at(0.05, 0.02))
        eventually(lambda: np.allclose(bench.q(), at(0.05, 0.02), atol=1e-3), "the last goal")
        eventually(lambda: not arm.health().stream, "the stream has ended")
    assert farthest > 0.25
    np.testing.assert_allclose(positions[-1], at(0.05, 0.02), atol=1e-9)
    np.testing.assert_allclose(arm.goal_jp(), at(0.05, 0.02), atol=1e-9)
    assert len(positions) > 3 * 42, "many on the way from one goal to the next"
    # After a late cycle it goes on by two cycles at most.
    fastest = np.abs(velocities).max()
    assert 0.3 < fastest <= limit.velocity  # it makes up for goals that came while it was held up
    assert np.abs(np.diff(positions, axis=0)).max() <= 2.0 * cycle * fastest + 1e-6
    assert np.abs(np.diff(velocities, axis=0)).max() <= 2.0 * cycle * limit.acceleration + 1e-6
    bench.until_still()
    with bench.nothing_moves():
        assert bench.watch(0.3) < 1e-3


@pytest.mark.parametrize("command", ["interpolate_jp", "servo_jp", "servo_cp"])
def test_a_stream_that_takes_over_from_a_native_move_begins_where_that_comes_to_rest(
    bench, command
):
    if not bench.engine.capabilities.native_moves:
        pytest.skip("its moves are the driver's")
    arm, device = bench.arm, bench.engine.device
    firsts, given = [], []

    def write(setpoint):
        firsts.append((setpoint.values, *(np.array(x) for x in targets(device))))
        type(device).write(device, setpoint)

    def targets(device):
        return device._robot.state.target_q, device._robot.state.target_qd

    move = arm.move_jp(FAR)
    bench.until_moving()
    device.write = write
    try:
        begin = time.monotonic()
        while not firsts or time.monotonic() < begin + 0.5:
            assert time.monotonic() < begin + LONG, "never: the stream"
            here = arm.setpoint_js(age=0).position
            goal = arm.forward_kinematics(here) if command == "servo_cp" else here
            given.append(here)
            with suppress(
                CommandRefused
            ):  # too far: the arm has gone on since it was asked where it is
                getattr(arm, command)(goal)
            time.sleep(0.02)
    finally:
        del device.write
    with pytest.raises(MotionAborted, match=f"by {command}"):
        move.wait(LONG)
    sent, target, speed = firsts[0]
    off = np.abs(np.array(given) - sent).max(axis=1)
    if (
        command == "servo_cp"
    ):  # of which the joints may be too far: it goes there as fast as they may
        off -= np.abs(np.array(given) - target).max(axis=1)
    assert off.min() < 2e-4, "what the client asked for"
    # Which is where the arm was a moment before, on its way to rest: how long before is the machine's.
    np.testing.assert_allclose(sent, target, atol=0.03)
    assert np.abs(speed).max() < 0.01
    bench.until_still()


def test_servo_cr_adds_up_along_the_axes_of_the_base(bench):
    arm = bench.arm
    start = arm.forward_kinematics(arm.setpoint_jp())
    with written(bench) as (positions, _), patient_streams():
        for _ in range(100):
            arm.servo_cr([0.0, 0.0003, 0.0005, 0.0, 0.0, 0.0, 1.0])
            time.sleep(0.002)
        goal = shifted(start, 0.0, 0.03, 0.05)
        eventually(
            lambda: np.allclose(
                arm.forward_kinematics(bench.q()).position, goal.position, atol=1e-3
            ),
            "the sum is reached",
        )
    end = arm.forward_kinematics(positions[-1])
    np.testing.assert_allclose(end.position, goal.position, atol=1e-6)
    assert abs(end.orientation @ goal.orientation) > 1.0 - 1e-9
    assert np.abs(np.diff(positions, axis=0)).max() < 0.05
    with bench.refused("unreachable", "servo_cr"):
        arm.servo_cr([5.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def test_kinds_of_motion_follow_each_other(bench):
    arm = bench.arm
    assert arm.move_jp(at(0.1)).wait(LONG)
    stream(
        lambda: arm.servo_jp(at(0.105)),
        lambda: abs(bench.q()[0] - 0.105) < 1e-3,
        "a stream right after a move",
    )
    assert arm.move_jp(at(0.0)).wait(LONG), "a move right after a stream"
    np.testing.assert_allclose(bench.q(), at(), atol=1e-3)
    arm.move_jp(FAR)
    bench.until_moving()
    # The newest command wins, while the arm is still slowing down for it.
    stream(
        lambda: arm.servo_jr([0.0] * 6),
        lambda: bench.stands() and arm.measured_jp(age=0)[0] < FAR[0] - 0.1,
        "a stream that ends a move",
    )
    stream(lambda: arm.hold() or arm.servo_jv([0.1] * 6), lambda: not bench.stands(), "speed")
    assert arm.move_jp(HOME).wait(LONG), "a move right after a speed"
    np.testing.assert_allclose(bench.q(), HOME, atol=1e-3)


@pytest.mark.parametrize(("policy", "state"), [("pause", "PAUSED"), ("fault", "FAULT")])
def test_a_stream_that_stops_under_motion_is_answered_as_configured(policy, state):
    with ur_bench({"on_stream_timeout": policy, "stream_timeout": 1.0}) as bench:
        bench.enable()
        stream(
            lambda: bench.arm.servo_jv([0.3] * 6), lambda: bench.outputs("actual_qd")[0] > 0.2, "v"
        )
        bench.until_state(state, "servo_jv stopped")
        bench.until_still()
        with bench.nothing_moves():
            bench.enable()


# Free drive


def test_free_lets_go_and_hold_holds(bench):
    bench.arm.free()
    with bench.nothing_moves():
        assert bench.watch(0.3) < 1e-3, "nothing pushes yet"
    before = bench.q()
    bench.sim.control.inject("external_force", wrench=[0.0, 40.0, 0.0, 0.0, 0.0, 0.0])
    eventually(lambda: np.abs(bench.q() - before).max() > 0.02, "the arm gives way")
    bench.arm.hold()
    bench.until_still()
    with bench.nothing_moves():
        assert bench.watch(0.3) < 1e-3, "still pushed"
    assert bench.status.state == "ENABLED"


# Kinematics


def test_kinematics_agree_with_the_controller(bench):
    arm = bench.arm
    for q in (at(0.4, 0.3, -0.5, 0.2, 0.3, 1.0), at(-0.5, -0.3, 0.4, 0.1, -0.2, -0.7)):
        assert arm.move_jp(q).wait(LONG)
        bench.until_still()
        joints = arm.measured_jp()
        pose = bench.outputs("actual_TCP_pose")
        found = arm.forward_kinematics(joints)
        np.testing.assert_allclose(found.position, pose[:3], atol=1e-4)
        np.testing.assert_allclose(arm.measured_cp().position, pose[:3], atol=1e-4)
        assert abs(found.orientation @ arm.measured_cp().orientation) > 1.0 - 1e-8
        np.testing.assert_allclose(arm.inverse_kinematics(found, joints), joints, atol=1e-6)


def test_a_pose_out_of_reach_is_refused_before_anything_is_sent(bench):
    far = shifted(bench.arm.setpoint_cp(), 3.0, 0.0, 0.0)
    with bench.nothing_sent():
        with bench.refused("unreachable", "servo_cp"):
            bench.arm.servo_cp(far)
        with bench.refused("unreachable", "move_cp"):
            bench.arm.move_cp(far)
        with pytest.raises(KinematicsError):
            bench.arm.inverse_kinematics(far)
    assert bench.status.state == "ENABLED"


# Feedback


def test_feedback_is_complete_and_in_si(bench):
    arm, joints = bench.arm, bench.arm.measured_js()
    assert joints.name[0] == "shoulder_pan_joint"
    assert [joints.position.size, joints.velocity.size] == [6, 6]
    np.testing.assert_allclose(joints.position, bench.q(), atol=1e-3)
    torque = bench.outputs("actual_current_as_torque") if has_torque(bench) else []
    assert joints.effort.size == len(torque), "efforts are N.m, or there are none"
    if joints.effort.size:
        np.testing.assert_allclose(joints.effort, torque, atol=2.0)
    setpoint = arm.setpoint_js()
    np.testing.assert_allclose(setpoint.position, bench.outputs("target_q"), atol=1e-3)
    assert setpoint.effort.size == 6
    for name in ("measured_cp", "measured_cv", "measured_cf", "setpoint_cp"):
        value, stamp = getattr(arm, name)(extra=True)
        assert value.frame_id == "base", name
        assert stamp > 0.0, name
    _, first = arm.measured_js(extra=True)
    eventually(lambda: arm.measured_js(extra=True)[1] > first, "newer samples have newer stamps")
    assert np.shape(arm.jacobian().values) == (6, 6)
    with pytest.raises(AttributeError, match="servo_jf"):
        _ = arm.servo_jf


def has_torque(bench: UrBench) -> bool:
    return "actual_current_as_torque" not in bench.device._stream.missing


def test_the_speed_slider_slows_motion_and_is_told(bench):
    bench.sim.control.inject("speed_slider", fraction=0.2)
    eventually(lambda: bench.arm.health().device["speed scaling"] < 0.3, "slider seen")
    move = bench.arm.move_jp(at(0.6))
    fastest = lag = 0.0
    while not move.wait(0.01):
        fastest = max(fastest, abs(bench.outputs("actual_qd")[0]))
        before, setpoint, after = bench.q()[0], bench.arm.setpoint_jp()[0], bench.q()[0]
        lag = max(lag, before - setpoint, setpoint - after)
    assert 0.0 < fastest < 0.5
    assert lag < 0.3, "the trajectory waits for the arm"
    np.testing.assert_allclose(bench.q(), at(0.6), atol=1e-3)


def test_at_no_speed_a_move_waits_and_then_goes_on(bench):
    goal = at(3.0)  # on its way for longer than a test is held up
    move = bench.arm.move_jp(goal)
    bench.until_moving()
    bench.sim.control.inject("speed_slider", fraction=0.0)
    bench.until_still()
    with bench.nothing_moves():
        assert not move.wait(0.5)
    bench.sim.control.clear("speed_slider")
    assert move.wait(LONG)
    np.testing.assert_allclose(bench.q(), goal, atol=1e-3)


# Configuration


@pytest.mark.parametrize("control", WAYS)
def test_payload_tool_and_gravity_arrive_at_the_controller(control):
    tool = [0.0, 0.0, 0.12, 0.0, 0.5, 0.0]
    config = {
        "control": control,
        "tcp": tool,
        "payload": {"mass": 1.5, "center_of_gravity": [0.01, 0.02, 0.05]},
        "gravity": [0.0, 9.82, 0.0],
    }
    with ur_bench(config) as bench:
        before = bench.arm.measured_cp()
        bench.enable()
        np.testing.assert_allclose(bench.outputs("tcp_offset"), tool)
        assert bench.outputs("payload") == 1.5
        np.testing.assert_allclose(bench.outputs("payload_cog"), [0.01, 0.02, 0.05])
        np.testing.assert_allclose(bench.outputs("target_gravity"), [0.0, 9.82, 0.0])
        np.testing.assert_allclose(bench.outputs("actual_TCP_pose")[:3], before.position, atol=1e-4)
        np.testing.assert_allclose(bench.arm.measured_cp().position, before.position, atol=1e-4)
        found = bench.arm.forward_kinematics(bench.arm.measured_jp())
        np.testing.assert_allclose(found.position, before.position, atol=1e-4)


def test_power_may_stay_on_when_disabled():
    with ur_bench({"power_off_on_disable": False}) as bench:
        bench.enable()
        bench.arm.disable(timeout=LONG)
        bench.until_outputs(runtime_state=(STOPPED,))
        assert bench.outputs("robot_mode") == RUNNING
        with bench.nothing_moves():
            bench.enable()


def test_the_wrong_model_is_not_enabled():
    with ur_bench({"model": "ur16e"}) as bench, bench.nothing_moves():
        with pytest.raises(TransitionFailed, match="no ur16e"):
            bench.enable()
        assert bench.outputs("runtime_state") == STOPPED


def test_a_model_of_the_other_generation_is_told_at_once():
    with ur_bench({"model": "ur5"}, start=False) as bench:
        bench.session.start()
        bench.until_state("FAULT", "is an e-Series controller, but model is ur5")


def test_another_program_is_left_alone():
    with ur_bench() as bench:
        text = "def somebody():\n while True:\n  sync()\n end\nend\n"
        with socket.create_connection((bench.sim.host, 30002), LONG) as peer:
            peer.sendall(text.encode())
            bench.until_outputs(runtime_state=(PLAYING,))
            # It never ends.
            with (
                patch.object(ur_device, "OTHER_PROGRAM_TIMEOUT", 0.2),
                pytest.raises(CommandRefused, match="another program"),
            ):
                bench.enable()
        assert bench.sim.control.status()["program"] == "somebody"
        assert bench.status.state == "DISABLED"
        bench.sim.control.inject("stop_program")
        bench.until_outputs(runtime_state=(STOPPED,))
        bench.enable()


# The end


@pytest.mark.parametrize("control", WAYS)
def test_closing_under_motion_leaves_the_arm_holding(control):
    with brisk_sim() as sim:
        with driver_at(sim, {"control": control}) as bench:
            bench.enable()
            move = bench.arm.move_jp(FAR)
            bench.until_moving()
        with pytest.raises(MotionAborted, match="shut"):
            move.wait(LONG)
        eventually(
            lambda: max(map(abs, sim.control.outputs("actual_qd")["actual_qd"])) < 1e-3, "stands"
        )
        outputs = sim.control.outputs("actual_q", "robot_mode", "runtime_state")
        assert outputs["actual_q"][0] < FAR[0] - 0.1
        assert (outputs["robot_mode"], outputs["runtime_state"]) == (RUNNING, STOPPED)
