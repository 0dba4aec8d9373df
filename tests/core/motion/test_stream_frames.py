"""body/, spatial/ and local/ on an arm: the tool moves as crtk_drivers.geometry.frames says."""

import math
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from crtk_drivers.device import Mode
from crtk_drivers.engine import EngineOptions
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from crtk_drivers.samples import Pose, Twist, Vector, Wrench, vector
from rigs.scripted_arm import ARM, BENT, PERIOD, ArmRig, apart, cs, step, twist, wrench
from rigs.scripted_engine import jp

BASE = step(0.2, -0.1, 0.3, 0.0, 0.5, math.pi / 2.0)
"""Where the device stands, for local/."""

FRAMES = ("", "body", "spatial", "local")
MOVING = (Mode.JOINT_POSITION, Mode.JOINT_VELOCITY, Mode.CARTESIAN_VELOCITY)
POSING = (Mode.JOINT_POSITION, Mode.CARTESIAN_POSITION)


def named(frame: str, name: str) -> str:
    return f"{frame}/{name}" if frame else name


def arm(*modes: Mode, **changes: Any) -> ArmRig:
    return ArmRig(*modes, base_pose=BASE, **changes).enabled()


def se3(pose: Pose) -> Any:
    return pin.SE3(matrix_from_quaternion(pose.orientation), np.array(pose.position))


def as_pose(matrix: Any) -> Pose:
    numbers = pin.SE3ToXYZQUAT(matrix)
    return Pose(vector(numbers[:3]), vector(numbers[3:]))


def carried(start: Pose, rate: Vector, frame: str, time: float) -> Pose:
    """Where a tool is after `time` seconds of a twist that is held in `frame`, exactly."""
    motion = pin.Motion(np.array(rate) * time)
    here = se3(start)
    if frame == "body":
        return as_pose(here * pin.exp6(motion))
    if frame == "spatial":
        return as_pose(pin.exp6(motion) * here)
    axes = matrix_from_quaternion(BASE.orientation) if frame == "local" else np.eye(3)
    turned = pin.exp3(axes @ motion.angular) @ here.rotation
    return as_pose(pin.SE3(turned, here.translation + axes @ motion.linear))


@pytest.mark.sweep(5)
@pytest.mark.parametrize("mode", MOVING)
@pytest.mark.parametrize("name", ["servo_cv", "interpolate_cv"])
@pytest.mark.parametrize("frame", FRAMES)
def test_a_held_twist_moves_the_tool_as_its_frame_says(mode: Mode, name: str, frame: str) -> None:
    rig = arm(mode)
    rate = twist(0.05, -0.08, 0.06, 0.3, -0.2, 0.5)
    rig.stream(named(frame, name), rate, 60)
    start = rig.device.pose
    rig.stream(named(frame, name), rate, 100)
    end = rig.device.pose
    expected = carried(start, rate.vector, frame, 100 * PERIOD)
    assert apart(end, expected) < 5e-4
    for other in set(FRAMES) - {frame}:
        assert apart(end, carried(start, rate.vector, other, 100 * PERIOD)) > 5e-3, other
    assert {setpoint.mode for setpoint in rig.written} == {mode}


def test_a_body_twist_that_is_held_turns_with_the_tool() -> None:
    rig = arm(Mode.JOINT_POSITION)
    forwards = twist(0.1, 0.0, 0.0, 0.0, 0.0, 1.2)
    rig.stream("body/servo_cv", forwards, 30)
    directions = []
    for _ in range(5):
        before = rig.device.pose
        rig.stream("body/servo_cv", forwards, 25)
        x_axis = matrix_from_quaternion(before.orientation)[:, 0]
        directions.append(x_axis)
        way = rig.device.pose.position - before.position
        turned = 1.2 * 25 * PERIOD
        assert way @ x_axis == pytest.approx(0.1 / 1.2 * math.sin(turned), rel=0.01)
    assert directions[0] @ directions[-1] < 0.9, "it has turned on the way"


@pytest.mark.parametrize("mode", POSING)
@pytest.mark.parametrize("name", ["servo_cr", "interpolate_cr"])
@pytest.mark.parametrize("frame", FRAMES)
def test_no_increment_is_lost_and_their_sum_is_their_exact_product(
    mode: Mode, name: str, frame: str
) -> None:
    rig = arm(mode)
    expected = se3(rig.device.pose)
    axes = matrix_from_quaternion(BASE.orientation) if frame == "local" else np.eye(3)
    random = np.random.default_rng(1)
    for _ in range(12):
        for _ in range(int(random.integers(1, 5))):
            values = random.uniform(-1.0, 1.0, 6) * ([8e-4] * 3 + [2e-3] * 3)
            rig.engine.submit(named(frame, name), step(*values))
            change = pin.SE3(pin.exp3(values[3:]), values[:3])
            if frame == "body":
                expected = expected * change
            elif frame == "spatial":
                expected = change * expected
            else:
                turned = axes @ change.rotation @ axes.T @ expected.rotation
                expected = pin.SE3(turned, expected.translation + axes @ change.translation)
        rig.cycle(2)
    rig.cycle(250)
    assert rig.told.refusals == []
    assert apart(rig.device.pose, as_pose(expected)) < 1e-8


@pytest.mark.parametrize("frame", FRAMES)
def test_a_relative_move_goes_where_its_frame_says(frame: str) -> None:
    rig = arm()
    values = (0.05, -0.03, 0.04, 0.1, 0.2, -0.3)
    start, change = se3(rig.device.pose), se3(step(*values))
    move = rig.engine.submit(named(frame, "move_cr"), step(*values))
    rig.cycle(2)
    assert rig.engine.status.is_busy
    rig.cycle(500)
    assert move is not None
    assert move.wait(0.0)
    assert not rig.engine.status.is_busy
    axes = matrix_from_quaternion(BASE.orientation) if frame == "local" else np.eye(3)
    expected = {"body": start * change, "spatial": change * start}.get(
        frame,
        pin.SE3(
            axes @ change.rotation @ axes.T @ start.rotation,
            start.translation + axes @ change.translation,
        ),
    )
    assert apart(rig.device.pose, as_pose(expected)) < 1e-8
    goal = rig.engine.latched("goal_cp")
    assert goal is not None
    assert isinstance(goal[0], Pose)
    assert goal[0].frame_id == "base"
    assert apart(goal[0], as_pose(expected)) < 1e-8


@pytest.mark.parametrize("mode", POSING)
@pytest.mark.parametrize("name", ["servo_cp", "interpolate_cp", "move_cp", "servo_cs"])
def test_a_pose_in_local_is_one_from_where_the_device_stands(name: str, mode: Mode) -> None:
    if name == "move_cp":
        mode = Mode.JOINT_POSITION
    rig = arm(mode)
    goal = as_pose(se3(rig.device.pose) * se3(step(0.002, -0.001, 0.002, 0.004, 0, 0.002)))
    there = as_pose(se3(BASE).inverse() * se3(goal))
    value = cs("PPPPPP", there) if name == "servo_cs" else there
    rig.engine.submit(f"local/{name}", value)
    rig.cycle(2)
    assert rig.engine.status.is_busy is (name == "move_cp")
    rig.cycle(150)
    assert apart(rig.device.pose, goal) < 1e-8
    if name in ("interpolate_cp", "move_cp"):
        told = rig.engine.latched("goal_cp")
        assert told is not None
        assert isinstance(told[0], Pose)
        assert apart(told[0], goal) < 1e-8
        assert told[0].frame_id == "base"


def test_a_task_frame_in_local_is_one_there() -> None:
    rig = arm()
    task = step(0.0, 0.0, 0.0, 0.0, 0.0, 0.4)
    rig.stream("local/servo_cs", cs("VNNNNN", rate=twist(0.1, 0, 0, 0, 0, 0), task=task), 50)
    start = rig.device.pose
    rig.stream("local/servo_cs", cs("VNNNNN", rate=twist(0.1, 0, 0, 0, 0, 0), task=task), 50)
    way = rig.device.pose.position - start.position
    axis = (se3(BASE) * se3(task)).rotation[:, 0]
    assert way == pytest.approx(axis * 0.1 * 50 * PERIOD, abs=1e-6)


VALUES: dict[str, Any] = {
    "servo_cv": twist,
    "interpolate_cv": twist,
    "servo_cf": wrench,
    "interpolate_cf": wrench,
    "servo_cr": step,
    "interpolate_cr": step,
    "move_cr": step,
}
FRAME_IDS = {"": "base", "body": "tool", "spatial": "base", "local": "local"}


@pytest.mark.parametrize("name", VALUES)
@pytest.mark.parametrize("frame", FRAMES)
def test_a_frame_id_is_that_of_the_sub_namespace_or_empty(name: str, frame: str) -> None:
    modes = (Mode.JOINT_POSITION, Mode.JOINT_VELOCITY, Mode.JOINT_EFFORT)
    options = EngineOptions(mode_switch_dwell=0.0, interpolate_timeout=0.0)
    rig = arm(*modes, options=options)
    make, numbers = VALUES[name], (0.001, 0, 0, 0, 0, 0.001)
    for frame_id in ("", FRAME_IDS[frame]):
        rig.engine.submit(named(frame, name), make(*numbers, frame=frame_id))
    for frame_id in {"base", "tool", "local", "world"} - {FRAME_IDS[frame]}:
        with pytest.raises(CommandRefused) as caught:
            rig.engine.submit(named(frame, name), make(*numbers, frame=frame_id))
        assert caught.value.reason is Reason.WRONG_FRAME
        assert repr(FRAME_IDS[frame]) in caught.value.remedy


def test_busy_rises_and_falls_for_a_move_that_is_refused() -> None:
    rig = arm()
    rig.refused("local/move_cp", step(9.0, 0, 0, 0, 0, 0))
    assert rig.told.busy[-2:] == [True, False]


@pytest.mark.parametrize("name", ["servo_cp", "interpolate_cp", "move_cp"])
def test_a_pose_in_local_says_so_or_nothing(name: str) -> None:
    rig = arm()
    there = as_pose(se3(BASE).inverse() * se3(rig.device.pose))
    for frame_id in ("base", "tool", "world"):
        with pytest.raises(CommandRefused) as caught:
            rig.engine.submit(f"local/{name}", Pose(there.position, there.orientation, frame_id))
        assert caught.value.reason is Reason.WRONG_FRAME
    rig.engine.submit(f"local/{name}", Pose(there.position, there.orientation, "local"))


def test_what_a_device_lacks_is_not_offered_in_a_frame_either() -> None:
    rig = ArmRig(Mode.JOINT_VELOCITY).enabled()
    names = set(rig.engine.commands)
    assert {"body/servo_cv", "spatial/interpolate_cv", "body/jacobian", "body/setpoint_cv"} <= names
    assert not {"local/servo_cv", "body/servo_cf", "body/servo_cr", "body/servo_cp"} & names
    refusal = rig.refused("local/servo_cv", twist(0, 0, 0, 0, 0, 0))
    assert refusal.reason is Reason.UNSUPPORTED
    assert "a base with a pose of its own" in refusal.remedy


# --------------------------------------------------------------------------------------------- feedback


def measured(rig: ArmRig, name: str) -> tuple[Vector, str, int]:
    value, stamp = rig.value(name)
    return vector(value.vector), value.frame_id, stamp


@pytest.mark.parametrize("told_in", ["base", "tool"])
def test_what_is_measured_is_told_in_every_frame(told_in: str) -> None:
    rig = arm(measured=("measured_js", "measured_cp", "measured_cv", "measured_cf"))
    pose = rig.device.pose
    turned = np.kron(np.eye(2), matrix_from_quaternion(pose.orientation))
    rate, push = np.array((0.1, -0.2, 0.3, 0.4, 0.5, -0.6)), np.array((5.0, 1, -2, 0.3, 0.2, 0.1))
    own = turned.T if told_in == "tool" else np.eye(6)
    rig.device.extra = {
        "measured_cv": twist(*(own @ rate), frame=told_in),
        "measured_cf": wrench(*(own @ push), frame=told_in),
    }
    rig.cycle()
    body, frame_id, stamp = measured(rig, "body/measured_cv")
    assert (frame_id, stamp) == ("tool", rig.value("measured_cv")[1])
    assert body == pytest.approx(turned.T @ rate)
    spatial, frame_id, _ = measured(rig, "spatial/measured_cv")
    assert frame_id == "base"
    # The velocity of the point of the tool, extended, that is at the origin.
    assert spatial == pytest.approx([*(rate[:3] - np.cross(rate[3:], pose.position)), *rate[3:]])
    body_push, frame_id, _ = measured(rig, "body/measured_cf")
    assert frame_id == "tool"
    assert body_push == pytest.approx(turned.T @ push)
    spatial_push, frame_id, _ = measured(rig, "spatial/measured_cf")
    assert frame_id == "base"
    assert spatial_push == pytest.approx(
        [*push[:3], *(push[3:] + np.cross(pose.position, push[:3]))]
    )
    assert spatial @ spatial_push == pytest.approx(rate @ push)

    rig.clock.advance(0.1)
    for name in ("body/measured_cv", "spatial/measured_cv", "body/measured_cf"):
        assert rig.value(name)[1] == 0, "stale"


def test_the_jacobian_of_a_frame_gives_the_twist_there() -> None:
    rig = arm()
    plain, body, spatial = (
        rig.value(name)[0].values for name in ("jacobian", "body/jacobian", "spatial/jacobian")
    )
    pose = se3(rig.device.pose)
    assert plain == pytest.approx(ARM.jacobian(BENT))
    rates = np.array((0.1, 0.2, -0.3, 0.4, -0.5, 0.6))
    short = 1e-6
    after = se3(ARM.forward(vector(BENT + rates * short)))
    assert body @ rates == pytest.approx(pin.log6(pose.actInv(after)).vector / short, abs=1e-5)
    assert spatial @ rates == pytest.approx(
        pin.log6(after * pose.inverse()).vector / short, abs=1e-5
    )
    assert rig.value("body/jacobian")[1] == rig.value("measured_js")[1] != 0


@pytest.mark.parametrize("mode", MOVING)
def test_the_set_twist_is_what_the_tool_was_told_to_do(mode: Mode) -> None:
    rig = arm(mode)
    assert rig.value("setpoint_cv")[1] == 0, "holding"
    rate = twist(0.05, -0.08, 0.06, 0.3, -0.2, 0.5)
    for count in (2, 60):  # while it speeds up, and later
        rig.stream("body/servo_cv", rate, count)
        before = rig.device.pose
        rig.cycle()
        after = rig.device.pose
        set_twist, stamp = rig.value("setpoint_cv")
        assert stamp != 0
        assert set_twist.frame_id == "base"
        if mode is Mode.JOINT_POSITION:
            done = (after.position - before.position) / PERIOD
            assert set_twist.linear == pytest.approx(done, abs=2e-3)
        body, _ = rig.value("body/setpoint_cv")
        assert body.frame_id == "tool"
        inwards = matrix_from_quaternion(rig.device.pose.orientation).T
        assert body.linear == pytest.approx(inwards @ set_twist.linear, abs=1e-3)
    assert body.linear == pytest.approx(rate.linear, abs=1e-3)
    assert body.angular == pytest.approx(rate.angular, abs=1e-3)
    rig.cycle(100)
    at_rest, stamp = rig.value("body/setpoint_cv")
    assert not at_rest.vector.any()
    assert (stamp != 0) is (mode is Mode.JOINT_POSITION), "a position that is held has no velocity"


def test_the_set_twist_of_a_move_is_its_own_and_that_of_positions_is_not_known() -> None:
    rig = arm()
    rig.engine.submit("move_jp", jp(*BENT + 0.2))
    rig.cycle(30)
    before = rig.device.pose
    rig.cycle()
    done = (rig.device.pose.position - before.position) / PERIOD
    value, stamp = rig.value("setpoint_cv")
    assert isinstance(value, Twist)
    assert stamp != 0
    assert value.linear == pytest.approx(done, abs=0.02)
    rig.engine.submit("servo_jp", jp(*rig.device.position))
    rig.cycle()
    assert rig.value("setpoint_cv")[1] == 0
    assert rig.value("spatial/setpoint_cv")[1] == 0


@pytest.mark.parametrize("mode", [Mode.JOINT_EFFORT, Mode.CARTESIAN_EFFORT])
def test_the_set_wrench_is_valid_while_one_is_in_force(mode: Mode) -> None:
    rig = arm(mode)
    assert rig.value("setpoint_cf")[1] == 0
    rig.stream("body/servo_cf", wrench(3.0, 0, 0, 0, 0.5, 0), 3)
    value, stamp = rig.value("setpoint_cf")
    assert isinstance(value, Wrench)
    turned = matrix_from_quaternion(rig.device.pose.orientation)
    assert stamp != 0
    assert value.force == pytest.approx(turned @ [3.0, 0, 0])
    body, stamp = rig.value("body/setpoint_cf")
    assert stamp != 0
    assert body.vector == pytest.approx([3.0, 0, 0, 0, 0.5, 0])
    assert rig.value("setpoint_cv")[1] == 0, "an effort is no velocity"
    assert rig.value("setpoint_cp")[1] == 0
    rig.cycle(60)
    assert rig.value("setpoint_cf")[1] == 0
    assert rig.value("body/setpoint_cf")[1] == 0
