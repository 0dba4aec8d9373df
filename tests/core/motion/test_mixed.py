"""servo_js and servo_cs: each joint, or axis of a task frame, follows a value of its own kind."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from crtk_drivers.device import Mode
from crtk_drivers.engine import EngineOptions
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.geometry.frames import moved, product
from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from crtk_drivers.geometry.rates import turn
from crtk_drivers.options import LimitPolicy
from crtk_drivers.samples import JointServo, Pose, Value, Vector, vector
from rigs.scripted_arm import (
    ARM,
    BENT,
    JOINTS,
    LIMIT,
    PERIOD,
    STRETCHED,
    TOOL,
    ArmRig,
    apart,
    cs,
    js,
    letters,
    step,
    twist,
    wrench,
)
from rigs.scripted_engine import jp

ZERO = (0.0,) * 6
NAN = math.nan
QUIET = 0.1
"""Seconds after which a servo stream is silent."""


def rates(rig: ArmRig) -> np.ndarray:
    return np.diff(np.vstack((BENT, rig.path)), axis=0) / PERIOD


def refusal(rig: ArmRig, name: str, value: Value) -> CommandRefused:
    with pytest.raises(CommandRefused) as caught:
        rig.engine.submit(name, value)
    return caught.value


# --------------------------------------------------------------------------------------- servo_js, alike

ALIKE = {
    "P": (Mode.JOINT_POSITION, BENT + 0.01),
    "V": (Mode.JOINT_VELOCITY, np.array((0.1, -0.2, 0.3, 0, 0.1, 0))),
    "F": (Mode.JOINT_EFFORT, np.array((5.0, -2, 1, 0, 1, 0))),
}


def of_kind(letter: str, modes: str, values: Vector) -> JointServo:
    return js(modes, **{{"P": "position", "V": "velocity", "F": "effort"}[letter]: values})


@pytest.mark.parametrize("letter", ALIKE)
def test_axes_of_one_kind_go_the_direct_way(letter: str) -> None:
    mode, values = ALIKE[letter]
    rig = ArmRig(*(mode for mode, _ in ALIKE.values())).enabled()
    rig.engine.submit("servo_js", of_kind(letter, letter * 6, values))
    rig.cycle(3)
    assert [setpoint.mode for setpoint in rig.written] == [mode]
    assert rig.written[0].values == pytest.approx(values)
    assert rig.engine.health().stream == "servo_js"


@pytest.mark.parametrize("letter", ALIKE)
def test_of_the_direct_way_axes_without_a_mode_stay_and_their_values_do_not_count(
    letter: str,
) -> None:
    mode, values = ALIKE[letter]
    rig = ArmRig(*(mode for mode, _ in ALIKE.values())).enabled()
    wanted = values.copy()
    wanted[4:] = NAN, 1e9
    rig.engine.submit("servo_js", of_kind(letter, letter * 4 + "NN", wanted))
    rig.cycle()
    stay = BENT if letter == "P" else np.zeros(6)
    assert rig.written[0].mode is mode
    assert rig.written[0].values == pytest.approx([*values[:4], *stay[4:]])
    wanted[3] = NAN
    bad = of_kind(letter, letter * 4 + "NN", wanted)
    assert rig.refused("servo_js", bad).reason is Reason.NOT_FINITE


def test_velocities_on_hardware_that_takes_positions_are_integrated() -> None:
    rig = ArmRig(Mode.JOINT_POSITION).enabled()
    wanted = np.array((0.5, -0.4, 0.3, 0.2, -0.1, 0.0))
    rig.stream("servo_js", js("VVVVVV", velocity=wanted), 100)
    assert {setpoint.mode for setpoint in rig.written} == {Mode.JOINT_POSITION}
    assert rates(rig)[-1] == pytest.approx(wanted)


# --------------------------------------------------------------------------------------- servo_js, mixed


def test_positions_and_velocities_at_once() -> None:
    rig = ArmRig(Mode.JOINT_POSITION).enabled()
    wanted = (NAN, NAN, 0.6, -0.3, NAN, NAN)
    for count in range(1, 76):
        positions = (BENT[0] + 0.002 * count, BENT[1] - 0.001 * count, NAN, NAN, NAN, NAN)
        rig.engine.submit("servo_js", js("PPVVNN", positions, wanted))
        rig.cycle()
    path = rig.path
    assert path[:, 0] == pytest.approx(BENT[0] + 0.002 * np.arange(1, 76))
    assert path[:, 1] == pytest.approx(BENT[1] - 0.001 * np.arange(1, 76))
    assert (path[:, 4:] == BENT[4:]).all()
    assert rates(rig)[-1][2:4] == pytest.approx([0.6, -0.3])
    change = np.diff(rates(rig)[:, 2:4], axis=0) / PERIOD
    assert np.abs(change).max() <= LIMIT.acceleration + 1e-6
    assert rig.setpoint()["position"] == path[-1].tolist()


def test_what_was_silent_stops_smoothly_and_positions_stay() -> None:
    rig = ArmRig(Mode.JOINT_POSITION).enabled()
    rig.stream("servo_js", js("PVNNNN", BENT, (0, 1.5, 0, 0, 0, 0)), 50)
    rig.cycle(100)
    speed = rates(rig)[:, 1]
    still = np.flatnonzero(np.abs(speed) < 1e-6)[0]
    assert still * PERIOD > 50 * PERIOD + QUIET, "it goes on until the timeout"
    change = np.diff(speed) / PERIOD
    assert np.abs(change).max() <= LIMIT.acceleration + 1e-6
    health = rig.engine.health()
    assert (health.stream, health.stream_timeouts) == ("", 1)
    assert (rig.path[:, [0, 2, 3, 4, 5]] == np.array(BENT)[[0, 2, 3, 4, 5]]).all()
    assert rig.setpoint()["position"] == rig.path[-1].tolist()


def test_an_axis_that_loses_its_mode_slows_down() -> None:
    rig = ArmRig(Mode.JOINT_POSITION).enabled()
    rig.stream("servo_js", js("VVNNNN", velocity=(1.0, 0.5, 0, 0, 0, 0)), 60)
    rig.stream("servo_js", js("NVNNNN", velocity=(NAN, 0.5, 0, 0, 0, 0)), 60)
    change = np.diff(rates(rig), axis=0) / PERIOD
    assert np.abs(change).max() <= LIMIT.acceleration + 1e-6
    assert rates(rig)[-1] == pytest.approx([0, 0.5, 0, 0, 0, 0])


def test_velocities_begin_with_those_of_the_move_that_they_replace() -> None:
    rig = ArmRig(Mode.JOINT_POSITION).enabled()
    rig.engine.submit("move_jp", jp(*(BENT + 1.0)))
    rig.cycle(60)
    assert rates(rig)[-1].min() > 0.5
    rig.stream("servo_js", js("VVVNNN", velocity=(-0.5, -0.5, -0.5, 0, 0, 0)), 60)
    change = np.diff(rates(rig), axis=0) / PERIOD
    assert np.abs(change).max() <= LIMIT.acceleration * (1.0 + 1e-3)
    assert rates(rig)[-1] == pytest.approx([-0.5, -0.5, -0.5, 0, 0, 0])


def test_a_velocity_stops_at_the_limit_of_its_joint() -> None:
    at = vector((5.8, *BENT[1:]))
    rig = ArmRig(Mode.JOINT_POSITION, at=at).enabled()
    rig.stream("servo_js", js("VPNNNN", at, (2.0, 0, 0, 0, 0, 0)), 250)
    assert rig.path[:, 0].max() <= LIMIT.upper
    assert rig.path[-1][0] == pytest.approx(LIMIT.upper, abs=1e-3)
    change = np.diff(rig.path[:, 0], 2) / PERIOD**2
    assert np.abs(change).max() <= LIMIT.acceleration + 1e-4
    assert rig.told.refusals == []
    assert rig.told.warnings == []


def test_names_in_another_order_are_sorted() -> None:
    rig = ArmRig(Mode.JOINT_POSITION).enabled()
    position = (*(NAN,) * 4, BENT[1] + 0.01, BENT[0] - 0.01)
    value = js("NNNVPP", position, (NAN, NAN, NAN, 0.4, NAN, NAN))
    value = replace(value, name=tuple(reversed(JOINTS)))
    rig.stream("servo_js", value, 40)
    assert rig.path[-1][[0, 1]] == pytest.approx([BENT[0] - 0.01, BENT[1] + 0.01])
    assert rates(rig)[-1][2] == pytest.approx(0.4)
    assert rig.path[-1][3:] == pytest.approx(BENT[3:])


P6, V6 = tuple(BENT), (0.1,) * 6
BAD_JOINTS: dict[str, tuple[JointServo, Reason]] = {
    "nothing": (js("NNNNNN"), Reason.EMPTY),
    "too few": (js("PPPPP", P6[:5]), Reason.WRONG_SIZE),
    "too many": (js("VVVVVVV", velocity=(0.0,) * 7), Reason.WRONG_SIZE),
    "none at all": (js(""), Reason.EMPTY),
    "no positions": (js("PVVVVV", velocity=V6), Reason.EMPTY),
    "no velocities": (js("PVVVVV", P6), Reason.EMPTY),
    "no efforts": (js("PPPPPF", P6), Reason.EMPTY),
    "position and velocity of one axis": (JointServo((3, *letters("PPPPP")), vector(P6)), Reason.UNSUPPORTED),
    "an unknown mode": (JointServo((64, *letters("PPPPP")), vector(P6)), Reason.UNSUPPORTED),
    "a negative mode": (JointServo((-1, *letters("PPPPP")), vector(P6)), Reason.UNSUPPORTED),
    "a strange name": (replace(js("PPPPPP", P6), name=(*JOINTS[:5], "z")), Reason.WRONG_NAMES),
    "a name twice": (replace(js("PPPPPP", P6), name=(*JOINTS[:5], "a")), Reason.WRONG_NAMES),
    "not a number": (js("PVVVVV", P6, (0, NAN, 0, 0, 0, 0)), Reason.NOT_FINITE),
    "infinite": (js("PVVVVV", (math.inf, 0, 0, 0, 0, 0), V6), Reason.NOT_FINITE),
    "too fast": (js("PVVVVV", P6, (0, 2.1, 0, 0, 0, 0)), Reason.OUT_OF_RANGE),
    "a jump": (js("PVVVVV", (BENT[0] + 0.3, 0, 0, 0, 0, 0), V6), Reason.STEP_TOO_LARGE),
    "effort beside a position": (js("PFNNNN", P6, (), ZERO), Reason.UNSUPPORTED),
    "effort beside a velocity": (js("VFNNNN", (), V6, ZERO), Reason.UNSUPPORTED),
    "effort": (js("FFFFFF", effort=ZERO), Reason.UNSUPPORTED),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_JOINTS)
def test_a_mixture_that_is_none_is_refused_with_the_reason(case: str) -> None:
    value, reason = BAD_JOINTS[case]
    rig = ArmRig(Mode.JOINT_POSITION).enabled()
    told = rig.refused("servo_js", value)
    assert told.reason is reason
    assert told.remedy


@pytest.mark.parametrize("mode", [Mode.JOINT_VELOCITY, Mode.JOINT_EFFORT])
def test_hardware_that_takes_no_positions_takes_no_mixture(mode: Mode) -> None:
    rig = ArmRig(mode).enabled()
    told = rig.refused("servo_js", js("PVNNNN", P6, V6))
    assert told.reason is Reason.UNSUPPORTED
    assert f"position and velocity, on hardware that takes {mode}" in told.detail


def test_names_of_another_number_are_no_mixture() -> None:
    with pytest.raises(ValueError, match="6 modes for vectors of 5"):
        js("PPPPPP", P6[:5])


def test_a_position_that_is_too_fast_is_refused_and_the_stream_goes_on() -> None:
    rig = ArmRig(Mode.JOINT_POSITION).enabled()
    rig.stream("servo_js", js("PVNNNN", P6, (0, 1.0, 0, 0, 0, 0)), 40)
    wanted = np.array(BENT)
    for _ in range(4):
        wanted[0] += 0.15
        rig.engine.submit("servo_js", js("PVNNNN", wanted, (0, 1.0, 0, 0, 0, 0)), 77)
        rig.cycle()
        wanted[0] = rig.path[-1][0]
    assert {told.reason for told in rig.told.refusals} == {Reason.STEP_TOO_LARGE}
    assert {told.stamp_ns for told in rig.told.refusals} == {77}
    assert "stop" not in rig.device.calls
    assert rig.engine.health().stream == "servo_js"
    rig.cycle(3)
    assert rates(rig)[-1] == pytest.approx([0, 1.0, 0, 0, 0, 0])


# --------------------------------------------------------------------------------------- servo_cs, moving

TASK = step(-0.3, -0.2, 0.1, 0.3, -0.4, 0.8)
AXES = matrix_from_quaternion(TASK.orientation)
TAKES = (Mode.JOINT_POSITION, Mode.CARTESIAN_POSITION)


def seen(pose: Pose) -> Vector:
    """Where the tool is in the task frame (3,)."""
    return vector(AXES.T @ (pose.position - TASK.position))


@pytest.mark.parametrize("mode", TAKES)
def test_a_position_along_one_axis_and_a_velocity_along_another(mode: Mode) -> None:
    rig = ArmRig(mode).enabled()
    start = rig.device.pose
    x, y, z = seen(start)
    for count in range(1, 101):
        goal = step(x + 2e-4 * count, NAN, NAN, 0, 0, 0)
        goal = Pose(goal.position, vector((NAN,) * 4))
        rate = twist(NAN, -0.06, NAN, NAN, NAN, NAN)
        rig.engine.submit("servo_cs", cs("PVNNNN", goal, rate, task=TASK))
        rig.cycle()
    end = seen(rig.device.pose)
    assert end[0] == pytest.approx(x + 0.02, abs=1e-8)
    assert y - 0.06 * 100 * PERIOD < end[1] < y - 0.06 * 95 * PERIOD
    assert end[2] == pytest.approx(z, abs=1e-8)
    assert turn(rig.device.pose.orientation, start.orientation) == pytest.approx(
        [0, 0, 0], abs=1e-8
    )
    assert {setpoint.mode for setpoint in rig.written} == {mode}

    rig.cycle(60)
    rest = seen(rig.device.pose)
    assert rest[[0, 2]] == pytest.approx(end[[0, 2]], abs=1e-8)
    assert rest[1] < end[1] - 0.06 * QUIET
    health = rig.engine.health()
    assert (health.stream, health.stream_timeouts) == ("", 1)


def test_what_moves_speeds_up_and_slows_down_within_the_limits_of_the_tool() -> None:
    rig = ArmRig(Mode.JOINT_POSITION).enabled()
    rate = twist(0.2, 0.2, 0, 0.5, 0, 0.5)
    rig.stream("servo_cs", cs("VVNVVV", rate=rate, task=TASK), 60)
    middle = len(rig.written)
    rig.cycle(100)
    tools = [ARM.forward(BENT), *rig.tool_path]
    places = np.array([tool.position for tool in tools])
    speeds = np.diff(places, axis=0) / PERIOD
    assert AXES.T @ speeds[middle - 2] == pytest.approx([0.2, 0.2, 0], abs=1e-6)
    assert np.linalg.norm(np.diff(speeds, axis=0), axis=1).max() <= (
        TOOL.linear_acceleration * PERIOD + 1e-6
    )
    turns = np.array([turn(b.orientation, a.orientation) for a, b in itertools.pairwise(tools)])
    assert AXES.T @ turns[middle - 2] / PERIOD == pytest.approx([0.5, 0, 0.5], abs=1e-5)
    bends = np.linalg.norm(np.diff(turns / PERIOD, axis=0), axis=1)
    assert bends.max() <= TOOL.angular_acceleration * PERIOD + 1e-3
    assert np.linalg.norm(speeds[-1]) < 1e-6


def test_axes_go_on_with_what_the_tool_did_before() -> None:
    rig = ArmRig(Mode.JOINT_POSITION).enabled()
    goal = moved(rig.device.pose, step(0.1, 0.1, 0.05, 0, 0, 0))
    rig.engine.submit("move_cp", goal)
    rig.cycle(60)
    assert rig.device.pose.position[0] > ARM.forward(BENT).position[0] + 0.01
    rig.stream("servo_cs", cs("VNNNNN", rate=twist(-0.1, 0, 0, 0, 0, 0), task=TASK), 50)
    other = step(0.1, 0, 0, 0.0, 1.0, 0.5)
    rig.stream("servo_cs", cs("NVNNNN", rate=twist(0, 0.1, 0, 0, 0, 0), task=other), 50)
    places = np.array([ARM.forward(BENT).position, *(tool.position for tool in rig.tool_path)])
    change = np.diff(places, 2, axis=0) / PERIOD**2
    assert np.linalg.norm(change, axis=1).max() <= TOOL.linear_acceleration * 1.05


def test_an_axis_of_position_goes_there_though_it_moved() -> None:
    rig = ArmRig(Mode.JOINT_POSITION).enabled()
    rig.stream("servo_cs", cs("VNNNNN", rate=twist(0.2, 0, 0, 0, 0, 0), task=TASK), 30)
    x = seen(rig.device.pose)[0] + 0.001
    goal = step(x, 0, 0, 0, 0, 0)
    rig.stream("servo_cs", cs("PNNNNN", goal, task=TASK), 3)
    assert seen(rig.device.pose)[0] == pytest.approx(x, abs=1e-8)


def test_all_axes_of_position_are_a_pose_in_the_task_frame() -> None:
    rig = ArmRig(Mode.JOINT_POSITION).enabled()
    goal = moved(rig.device.pose, step(0.003, 0.002, -0.001, 0.002, 0.001, -0.003))
    there = Pose(seen(goal), product(_inverse(TASK), goal).orientation)
    rig.stream("servo_cs", cs("PPPPPP", there, task=TASK), 5)
    assert apart(rig.device.pose, goal) < 1e-8


def _inverse(pose: Pose) -> Pose:
    x, y, z, w = pose.orientation
    return Pose(vector(-(AXES.T @ pose.position)), vector((-x, -y, -z, w)))


# ------------------------------------------------------------------------------------- servo_cs, pushing


@pytest.mark.parametrize("mode", [Mode.JOINT_EFFORT, Mode.CARTESIAN_EFFORT])
def test_a_wrench_in_the_axes_of_the_task_frame(mode: Mode) -> None:
    rig = ArmRig(Mode.JOINT_POSITION, mode).enabled()
    push = wrench(NAN, 4.0, -2.0, 0.3, 0.2, 0.1)
    rig.engine.submit("servo_cs", cs("NFFFFF", push=push, task=TASK))
    rig.cycle()
    counted = np.array((0.0, 4.0, -2.0, 0.3, 0.2, 0.1))
    in_base = np.concatenate((AXES @ counted[:3], AXES @ counted[3:]))
    assert rig.written[-1].mode is mode
    expected = in_base if mode is Mode.CARTESIAN_EFFORT else ARM.jacobian(BENT).T @ in_base
    assert rig.written[-1].values == pytest.approx(expected)


NOWHERE = Pose(vector((NAN, 0, 0)), vector((NAN,) * 4))
BAD_AXES: dict[str, tuple[Value, Reason]] = {
    "nothing": (cs("NNNNNN"), Reason.EMPTY),
    "three modes": (replace(cs("PPPPPP"), modes=letters("PPP")), Reason.WRONG_SIZE),
    "an unknown mode": (replace(cs("PPPPPP"), modes=(3, *letters("NNNNN"))), Reason.UNSUPPORTED),
    "rotations of two kinds": (cs("NNNPVV"), Reason.UNSUPPORTED),
    "rotation about one axis": (cs("NNNVNN"), Reason.UNSUPPORTED),
    "effort beside a position": (cs("PFNNNN", step(0, 0, 0, 0, 0, 0)), Reason.UNSUPPORTED),
    "effort beside a velocity": (cs("VFNNNN"), Reason.UNSUPPORTED),
    "effort": (cs("FNNNNN"), Reason.UNSUPPORTED),
    "no position": (cs("PNNNNN", NOWHERE), Reason.NOT_FINITE),
    "no orientation": (cs("NNNPPP", NOWHERE), Reason.NOT_FINITE),
    "no quaternion": (cs("NNNPPP", Pose(vector((0, 0, 0)), vector((0,) * 4))), Reason.BAD_QUATERNION),
    "no velocity": (cs("VNNNNN", rate=twist(NAN, 0, 0, 0, 0, 0)), Reason.NOT_FINITE),
    "no turn": (cs("NNNVVV", rate=twist(0, 0, 0, 0, math.inf, 0)), Reason.NOT_FINITE),
    "too fast": (cs("NVNNNN", rate=twist(0, 0.6, 0, 0, 0, 0)), Reason.OUT_OF_RANGE),
    "too strong": (cs("NFNNNN", push=wrench(0, 41.0, 0, 0, 0, 0)), Reason.OUT_OF_RANGE),
    "no task frame": (cs("VNNNNN", task=NOWHERE), Reason.NOT_FINITE),
    "another frame": (cs("VNNNNN", frame="tool"), Reason.WRONG_FRAME),
    "another task frame": (cs("VNNNNN", task=step(*ZERO, frame="tool")), Reason.WRONG_FRAME),
    "two numbers": (cs("PNNNNN", Pose(vector((0, 0)), vector((0, 0, 0, 1)))), Reason.WRONG_SIZE),
    "out of reach": (cs("PNNNNN", step(3.0, 0, 0, 0, 0, 0)), Reason.UNREACHABLE),
    "a jump": (cs("PNNNNN", step(BENT[0], 0, 0, 0, 0, 0)), Reason.STEP_TOO_LARGE),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_AXES)
def test_axes_that_do_not_go_together_are_refused_with_the_reason(case: str) -> None:
    value, reason = BAD_AXES[case]
    if case == "a jump":
        x = ARM.forward(BENT).position[0]
        value = cs("PNNNNN", step(x + 0.06, 0, 0, 0, 0, 0))
    rig = ArmRig(Mode.JOINT_POSITION).enabled()
    told = rig.refused("servo_cs", value)
    assert told.reason is reason
    assert told.remedy


def test_values_of_a_kind_that_no_axis_follows_do_not_count() -> None:
    rig = ArmRig(Mode.JOINT_POSITION).enabled()
    nothing = cs("VNNNNN", NOWHERE, twist(0.1, 9, NAN, NAN, 9, 9), wrench(NAN, 1e9, 0, 0, 0, 0))
    rig.stream("servo_cs", nothing, 30)
    assert rig.told.refusals == []
    assert rig.device.pose.position[0] > ARM.forward(BENT).position[0] + 0.005


def test_near_a_singularity_the_axes_are_followed_within_the_limits_of_the_joints() -> None:
    rig = ArmRig(Mode.JOINT_POSITION, at=STRETCHED).enabled()
    rig.stream("servo_cs", cs("NNNVVV", rate=twist(0, 0, 0, 0.5, 1.0, 0.5)), 200)
    places = np.array([tool.position for tool in rig.tool_path]) - ARM.forward(STRETCHED).position
    assert np.abs(places).max() < 1e-3, "damped, the held axes give way a little"
    assert np.abs(places[-1]).max() < 1e-8, "and come back"
    rate = np.diff(np.vstack((STRETCHED, rig.path)), axis=0) / PERIOD
    assert len(rig.path) == 200
    assert np.abs(rate).max() <= LIMIT.velocity * 1.02
    assert rig.told.refusals == []


def test_positions_out_of_range_are_clamped_or_refused_as_the_user_chose() -> None:
    at = vector((5.99, *BENT[1:]))
    there = (6.05, *BENT[1:])
    rig = ArmRig(Mode.JOINT_POSITION, at=at).enabled()
    rig.stream("servo_js", js("PVNNNN", there, ZERO), 2)
    assert rig.path[-1][0] == LIMIT.upper
    assert "clamped" in rig.told.warnings[-1]
    options = EngineOptions(limits=LimitPolicy(clamp_servo=False))
    strict = ArmRig(Mode.JOINT_POSITION, at=at, options=options).enabled()
    assert refusal(strict, "servo_js", js("PVNNNN", there, ZERO)).reason is Reason.OUT_OF_RANGE
