"""move_cp on an arm: a straight line and a geodesic, or the joints; refused before anything moves."""

import contextlib
import itertools
from typing import Any

import numpy as np
import pytest

from crtk_drivers.device import CartesianLimits, JointLimits, Mode
from crtk_drivers.engine import EngineOptions
from crtk_drivers.errors import CommandRefused, MotionAborted, Reason
from crtk_drivers.geometry.frames import moved
from crtk_drivers.geometry.rates import turn
from crtk_drivers.motion.move import Move
from crtk_drivers.samples import Number, Pose, Vector, vector
from rigs.scripted_arm import ARM, BENT, LIMIT, PERIOD, TOOL, ArmRig, apart, step, twist
from rigs.scripted_engine import jp

EXACT = 1e-6
BY_JOINTS = EngineOptions(move_cp="joints")
WAY = (0.12, 0.1, 0.08, 0.3, -0.2, 0.4)
TAKES = (Mode.JOINT_POSITION, Mode.CARTESIAN_POSITION)


def arm(*modes: Mode, **changes: Any) -> ArmRig:
    return ArmRig(*(modes or (Mode.JOINT_POSITION,)), **changes).enabled()


def until_done(rig: ArmRig, move: Any, cycles: int = 2000) -> int:
    """Return in how many cycles it is done."""
    assert move is not None
    for count in range(cycles):
        rig.cycle()
        if move.wait(0.0):
            return count + 1
    raise AssertionError("never done")


def off_the_line(tools: list[Pose], start: Pose, goal: Pose) -> tuple[float, float]:
    """How far poses are from a line in m, and from the geodesic at the same share of the way in rad."""
    way, angle = goal.position - start.position, turn(goal.orientation, start.orientation)
    aside = spun = 0.0
    for tool in tools:
        done = tool.position - start.position
        share = float(done @ way / (way @ way))
        assert -1e-9 <= share <= 1.0 + 1e-9
        aside = max(aside, float(np.linalg.norm(done - share * way)))
        turned = turn(tool.orientation, start.orientation)
        spun = max(spun, float(np.linalg.norm(turned - share * angle)))
    return aside, spun


def tools(rig: ArmRig) -> list[Pose]:
    if rig.written[0].mode is Mode.JOINT_POSITION:
        return rig.tool_path
    return [Pose(vector(values[:3]), vector(values[3:])) for values in rig.path]


# ---------------------------------------------------------------------------------------------- straight


@pytest.mark.parametrize("mode", TAKES)
@pytest.mark.parametrize("name", ["move_cp", "move_cr"])
def test_the_tool_goes_straight_in_each_cycle_and_within_its_limits(name: str, mode: Mode) -> None:
    rig = arm(Mode.JOINT_POSITION, mode)
    start = rig.device.pose
    goal = moved(start, step(*WAY))
    move = rig.engine.submit(name, goal if name == "move_cp" else step(*WAY))
    assert rig.engine.status.is_busy
    count = until_done(rig, move)
    assert len(rig.written) == count
    assert {setpoint.mode for setpoint in rig.written} == {mode}
    assert max(off_the_line(tools(rig), start, goal)) < EXACT
    assert apart(rig.device.pose, goal) < 1e-8
    places = np.array([start.position, *(tool.position for tool in tools(rig))])
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / PERIOD
    assert speeds.max() <= TOOL.linear_velocity + 1e-6
    assert np.linalg.norm(np.diff(places, 2, axis=0), axis=1).max() / PERIOD**2 <= (
        TOOL.linear_acceleration + 1e-3
    )
    pairs = itertools.pairwise([start, *tools(rig)])
    turns = [np.linalg.norm(turn(b.orientation, a.orientation)) / PERIOD for a, b in pairs]
    assert max(turns) <= TOOL.angular_velocity + 1e-6


def test_the_setpoint_is_where_the_joints_are_sent_and_how_fast() -> None:
    rig = arm()
    rig.engine.submit("move_cp", moved(rig.device.pose, step(*WAY)))
    rig.cycle(60)
    before, _ = rig.value("setpoint_cp")
    rig.cycle()
    after, stamp = rig.value("setpoint_cp")
    assert stamp != 0
    set_twist, stamp = rig.value("setpoint_cv")
    assert stamp != 0
    assert (after.position - before.position) / PERIOD == pytest.approx(set_twist.linear, abs=0.01)
    setpoint = rig.setpoint()
    assert setpoint["position"] == rig.path[-1].tolist()
    assert setpoint["velocity"] == pytest.approx((rig.path[-1] - rig.path[-2]) / PERIOD)


def test_turning_on_the_spot_and_going_nowhere_are_lines_too() -> None:
    rig = arm()
    start = rig.device.pose
    turned = moved(start, step(0, 0, 0, 0.2, 0.1, -0.3))
    until_done(rig, rig.engine.submit("move_cp", turned))
    for tool in rig.tool_path:
        assert tool.position == pytest.approx(start.position, abs=1e-8)
    assert apart(rig.device.pose, turned) < 1e-8
    assert until_done(rig, rig.engine.submit("move_cp", turned)) <= 5
    assert not rig.engine.status.is_busy


def test_the_goals_are_latched_for_the_tool_and_the_joints() -> None:
    rig = arm()
    goal = moved(rig.device.pose, step(*WAY))
    rig.engine.submit("move_cp", goal)
    pose, joints = rig.engine.latched("goal_cp"), rig.engine.latched("goal_js")
    assert pose is not None
    assert joints is not None
    assert apart(pose[0], goal) < 1e-12
    assert apart(ARM.forward(joints[0].position), goal) < 1e-8


# ----------------------------------------------------------------------------------------- other ways


@pytest.mark.parametrize("mode", TAKES)
def test_by_option_the_joints_go_all_at_once(mode: Mode) -> None:
    rig = arm(Mode.JOINT_POSITION, mode, options=BY_JOINTS)
    start = rig.device.pose
    goal = moved(start, step(*WAY))
    until_done(rig, rig.engine.submit("move_cp", goal))
    assert {setpoint.mode for setpoint in rig.written} == {Mode.JOINT_POSITION}
    assert apart(rig.device.pose, goal) < 1e-8
    assert max(off_the_line(tools(rig), start, goal)) > 1e-3
    _all_at_once(rig)


def _all_at_once(rig: ArmRig) -> None:
    total = rig.path[-1] - BENT
    shares = (rig.path - BENT) / total
    assert np.abs(np.diff(rig.path, axis=0)).max() <= LIMIT.velocity * PERIOD + 1e-9
    assert shares.min() >= -1e-9
    assert shares.max() <= 1.0 + 1e-9


def test_without_limits_of_the_tool_the_joints_go_all_at_once() -> None:
    rig = arm(cartesian_limits=None)
    goal = moved(rig.device.pose, step(*WAY))
    until_done(rig, rig.engine.submit("move_cp", goal))
    assert apart(rig.device.pose, goal) < 1e-8
    _all_at_once(rig)


@pytest.mark.parametrize("options", [None, BY_JOINTS])
@pytest.mark.parametrize("moves", [("move_cp",), ("move_jp",), ("move_jp", "move_cp")])
def test_what_hardware_that_moves_by_itself_is_given(
    moves: tuple[str, ...], options: EngineOptions | None
) -> None:
    rig = arm(native_moves=frozenset(moves), options=options)
    goal = moved(rig.device.pose, step(*WAY))
    for name, value in (("ratio_v", 0.5), ("ratio_a", 0.25)):
        rig.engine.submit(f"trajectory_j/set_{name}", Number(value))
    rig.engine.submit("move_cp", goal)
    rig.cycle(2)
    by_itself = ("move_jp" if options else "move_cp") in moves
    assert bool(rig.device.goals) is by_itself
    assert bool(rig.written) is not by_itself
    if not by_itself:
        return
    given = rig.device.goals[0]
    assert (given.ratios.velocity, given.ratios.acceleration) == (0.5, 0.25)
    if options:
        assert given.pose is None
        assert given.joints is not None
        assert apart(ARM.forward(given.joints), goal) < 1e-8
    else:
        assert given.joints is None
        assert given.pose is not None
        assert apart(given.pose, goal) < 1e-12


def test_hardware_that_moves_no_joints_is_given_the_pose_in_spite_of_the_option() -> None:
    moves = frozenset({"move_cp"})
    rig = arm(Mode.JOINT_VELOCITY, native_moves=moves, options=BY_JOINTS)
    rig.engine.submit("move_cp", moved(rig.device.pose, step(*WAY)))
    rig.cycle(2)
    assert rig.device.goals[0].pose is not None
    assert rig.written == []


@pytest.mark.parametrize("slower", [None, CartesianLimits(0.05, 0.2, 1.0, 2.0)])
def test_a_line_of_the_hardware_is_judged_by_the_limits_of_its_lines(
    slower: CartesianLimits | None,
) -> None:
    at = vector((*BENT[:4], 0.25, BENT[5]))
    rig = arm(native_moves=frozenset({"move_cp"}), line_limits=slower, at=at)
    goal = moved(rig.device.pose, step(0, 0, 0, *_across_the_wrist(at)))
    if slower is not None:
        rig.engine.submit("move_cp", goal)
        rig.cycle()
        assert len(rig.device.goals) == 1
        return
    assert rig.refused("move_cp", goal).reason is Reason.UNREACHABLE
    assert rig.device.goals == []


def _across_the_wrist(joints: Vector) -> Vector:
    """A turn that needs much of joints 4 and 6, as the wrist is nearly stretched."""
    return vector(0.35 * np.linalg.svd(ARM.jacobian(joints))[0][3:, -1])


# ---------------------------------------------------------------------------------------------- refused


def test_a_line_that_leaves_the_reach_is_refused_though_its_end_is_within() -> None:
    tight = JointLimits(-2.4, 2.4, velocity=2.0, acceleration=20.0, jerk=400.0, effort=50.0)
    at = vector((0.0, -1.2, 1.8, -1.1, -1.3, 0.3))
    goal = ARM.forward(vector((2.2, -1.2, 1.8, -1.1, -1.3, 0.3)))
    rig = arm(at=at)
    refusal = rig.refused("move_cp", goal)
    assert refusal.reason is Reason.UNREACHABLE
    assert "the line breaks off after" in refusal.detail
    assert refusal.remedy
    assert not rig.engine.status.is_busy
    assert rig.told.busy[-2:] == [True, False]
    joints = arm(at=at, options=BY_JOINTS, limits=(tight,) * 6)
    until_done(joints, joints.engine.submit("move_cp", goal))
    assert apart(joints.device.pose, goal) < 1e-8, "by joints there is a way"


def test_a_line_on_which_a_joint_leaves_its_range_is_refused() -> None:
    start = ARM.forward(BENT)
    goal = moved(start, step(0.25, 0.1, -0.1, 0, 0, 0))
    exact = [ARM.inverse(_between(start, goal, share), BENT) for share in np.linspace(0, 1, 50)]
    joint = int(np.argmax(np.ptp(exact, axis=0)))
    values = np.array(exact)[:, joint]
    reached = values.max() if values[-1] < values.max() - 1e-3 else None
    upper = reached - 5e-4 if reached else values[-1] - 1e-3
    limits = [LIMIT] * 6
    limits[joint] = JointLimits(-6.0, float(upper), 2.0, 20.0, 400.0, 50.0)
    rig = arm(limits=tuple(limits))
    refusal = rig.refused("move_cp", goal)
    assert refusal.reason in (Reason.UNREACHABLE, Reason.OUT_OF_RANGE)
    assert rig.written == []


def _between(start: Pose, goal: Pose, share: float) -> Pose:
    way = (goal.position - start.position) * share
    return moved(start, step(*way, *(turn(goal.orientation, start.orientation) * share)))


def test_a_line_through_a_singularity_is_refused_with_the_joint_that_is_too_fast() -> None:
    at = vector((*BENT[:4], 0.3, BENT[5]))
    end = vector((*BENT[:4], -0.3, BENT[5]))
    goal = moved(ARM.forward(end), step(0, 0.01, 0, 0.02, 0, 0.02))
    rig = arm(at=at)
    refusal = rig.refused("move_cp", goal)
    assert refusal.reason is Reason.UNREACHABLE
    assert "the line breaks off after" in refusal.detail
    until_done(rig, rig.engine.submit("move_jp", jp(*end)))


def test_what_is_out_of_reach_altogether_is_refused_while_another_move_goes_on() -> None:
    rig = arm()
    move = rig.engine.submit("move_jp", jp(*(BENT + 0.5)))
    rig.cycle(20)
    with pytest.raises(CommandRefused, match="unreachable"):
        rig.engine.submit("move_cp", moved(rig.device.pose, step(3.0, 0, 0, 0, 0, 0)))
    until_done(rig, move)
    assert rig.path[-1] == pytest.approx(BENT + 0.5)


def _random_line(seed: int, ratio: float) -> tuple[ArmRig, Move | None, Pose]:
    """A line at a share of the velocity limits, if it is accepted."""
    at = vector(np.random.default_rng(seed + 1000).uniform(-1.5, 1.5, 6))
    rig = arm(at=at)
    random = np.random.default_rng(seed + 5000)
    goal = moved(rig.device.pose, step(*random.uniform(-0.2, 0.2, 3), *random.uniform(-1, 1, 3)))
    rig.engine.submit("trajectory_j/set_ratio_v", Number(ratio))
    with contextlib.suppress(CommandRefused):
        return rig, rig.engine.submit("move_cp", goal), goal
    return rig, None, goal


@pytest.mark.parametrize("seed", [166, 167, 397])
def test_a_line_that_is_only_just_accepted_is_carried_out(seed: int) -> None:
    slow, fast = 0.02, 1.0  # near a singularity, where the joints are much faster for a moment
    for _ in range(7):
        middle = (slow + fast) / 2.0
        if _random_line(seed, middle)[1] is None:
            fast = middle
        else:
            slow = middle
    assert slow > 0.02
    assert fast < 1.0
    rig, move, goal = _random_line(seed, slow)
    until_done(rig, move, 20_000)
    assert apart(rig.device.pose, goal) < 1e-8
    assert np.abs(np.diff(rig.path, axis=0)).max() > 0.8 * LIMIT.velocity * PERIOD


# ------------------------------------------------------------------------------------------- on the move


@pytest.mark.parametrize("mode", TAKES)
@pytest.mark.parametrize("after", [5, 25, 45])
def test_a_line_takes_over_from_a_moving_joint_profile_without_a_jump(
    after: int, mode: Mode
) -> None:
    rig = arm(Mode.JOINT_POSITION, mode)
    rig.engine.submit("trajectory_j/set_ratio_v", Number(0.2))
    first = rig.engine.submit("move_jp", jp(*(BENT + np.array((0.3, 0.2, -0.2, 0.2, 0.2, 0.3)))))
    assert first is not None
    rig.cycle(after)
    begin = len(rig.written)
    goal = moved(rig.device.pose, step(0.1, 0.15, 0.1, 0.1, 0, 0.2))
    line = rig.engine.submit("move_cp", goal)
    until_done(rig, line)
    with pytest.raises(MotionAborted, match="pre-empted: by move_cp"):
        first.wait(0.0)
    assert apart(rig.device.pose, goal) < 1e-8
    path = [ARM.forward(BENT)]
    for setpoint in rig.written:
        values = setpoint.values
        is_pose = setpoint.mode is Mode.CARTESIAN_POSITION
        path.append(
            Pose(vector(values[:3]), vector(values[3:])) if is_pose else ARM.forward(values)
        )
    rates = np.array(
        [
            np.concatenate((b.position - a.position, turn(b.orientation, a.orientation))) / PERIOD
            for a, b in itertools.pairwise(path)
        ]
    )
    changes = np.diff(rates, axis=0) / PERIOD
    around = slice(begin - 3, begin + 4)
    jerks = np.diff(changes, axis=0) / PERIOD
    elsewhere = np.abs(np.delete(jerks, np.r_[around], axis=0)).max(axis=0)
    # A jump of the velocity would be a jerk of rates / PERIOD², one of the acceleration changes / PERIOD.
    assert (np.abs(jerks[around]).max(axis=0) <= 2.0 * elsewhere + 5.0).all()


def test_a_line_that_cannot_take_over_is_refused_and_what_was_going_on_goes_on() -> None:
    rig = arm()
    first = rig.engine.submit("move_jp", jp(*(BENT + np.array((0.8, 0.6, -0.4, 0.3, 0.2, 0.5)))))
    rig.cycle(50)
    before = rig.device.pose
    rig.cycle()
    speed = np.linalg.norm(rig.device.pose.position - before.position) / PERIOD
    assert speed > 2.0 * TOOL.linear_velocity, "too fast to be stopped within reach"
    with pytest.raises(CommandRefused) as caught:
        rig.engine.submit("move_cp", moved(rig.device.pose, step(0.05, 0, 0.05, 0, 0, 0)))
    assert caught.value.reason is Reason.UNREACHABLE
    assert "from rest there may be a way" in caught.value.remedy
    until_done(rig, first)
    assert rig.path[-1] == pytest.approx(BENT + np.array((0.8, 0.6, -0.4, 0.3, 0.2, 0.5)))


def test_a_line_takes_over_from_a_twist_that_speeds_up() -> None:
    rig = arm(options=EngineOptions(mode_switch_dwell=0.0))
    rig.stream("servo_cv", twist(0.3, 0, 0.3, 0, 0, 0), 8)
    begin = rig.path.copy()
    line = rig.engine.submit("move_cp", moved(rig.device.pose, step(0.1, 0.1, 0.1, 0, 0, 0)))
    rig.cycle(3)
    rates = np.diff(np.vstack((begin[-2:], rig.path[len(begin) :])), axis=0) / PERIOD
    assert np.abs(np.diff(rates, axis=0)).max() <= LIMIT.acceleration * PERIOD + 1e-6
    until_done(rig, line)


def test_a_joint_profile_takes_over_from_a_line_without_a_jump() -> None:
    rig = arm()
    rig.engine.submit("move_cp", moved(rig.device.pose, step(*WAY)))
    rig.cycle(60)
    move = rig.engine.submit("move_jp", jp(*BENT))
    until_done(rig, move)
    rates = np.diff(np.vstack((BENT, rig.path)), axis=0) / PERIOD
    assert np.abs(np.diff(rates, axis=0)).max() <= LIMIT.acceleration * PERIOD + 1e-3
    assert rig.path[-1] == pytest.approx(BENT)


def test_a_profile_that_must_go_beyond_the_range_is_clamped_and_what_is_set_says_so() -> None:
    at = vector((5.7, *BENT[1:]))
    rig = arm(at=at)
    for count in range(1, 36):  # too fast to be stopped in time
        rig.engine.submit("servo_jp", jp(at[0] + 2.0 * count * PERIOD, *at[1:]))
        rig.cycle()
    assert rig.path[-1][0] == pytest.approx(5.98)
    move = rig.engine.submit("move_jp", jp(*at))
    for _ in range(50):
        rig.cycle()
        assert rig.path[-1][0] <= LIMIT.upper
        assert rig.setpoint()["position"] == rig.path[-1].tolist()
    assert "clamped" in rig.told.warnings[-1]
    until_done(rig, move)
    assert rig.path[-1] == pytest.approx(at)


# --------------------------------------------------------------------------------------------- ratios


@pytest.mark.parametrize("options", [None, BY_JOINTS])
def test_half_of_the_velocity_takes_about_twice_as_long(options: EngineOptions | None) -> None:
    counts = []
    for ratio in (1.0, 0.5):
        # So fast to speed up that the time is that of the way.
        quick = CartesianLimits(0.2, 0.6, 50.0, 100.0)
        joints = JointLimits(-6.0, 6.0, 1.0, 500.0, 1e6, 50.0)
        rig = arm(options=options, cartesian_limits=quick, limits=(joints,) * 6)
        rig.engine.submit("trajectory_j/set_ratio_v", Number(ratio))
        goal = moved(rig.device.pose, step(*WAY[:3], 0, 0, 0))
        counts.append(until_done(rig, rig.engine.submit("move_cp", goal)))
        places = np.array([ARM.forward(BENT).position, *(t.position for t in rig.tool_path)])
        speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / PERIOD
        if options is None:
            assert speeds.max() == pytest.approx(0.2 * ratio, rel=1e-3)
        else:
            fastest = np.abs(np.diff(rig.path, axis=0)).max() / PERIOD
            assert fastest == pytest.approx(ratio, rel=1e-3)
    assert counts[1] / counts[0] == pytest.approx(2.0, abs=0.25)


def test_a_line_that_takes_days_is_judged_as_fast_as_any(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = arm()
    rig.engine.submit("trajectory_j/set_ratio", Number(1e-9))
    asked = 0

    def counted(pose: Pose, near: Vector) -> Vector:
        nonlocal asked
        asked += 1
        assert asked <= 10_000, "the caller would wait for ever"
        return ARM.inverse(pose, near)

    monkeypatch.setattr(rig.device.solver, "inverse", counted)
    assert rig.engine.submit("move_cp", moved(rig.device.pose, step(*WAY))) is not None
    assert rig.engine.status.is_busy
    assert asked > 100, "it was judged"


def test_a_fourth_of_the_acceleration_takes_longer_to_speed_up() -> None:
    highest = []
    for ratio in (1.0, 0.25):
        rig = arm()
        rig.engine.submit("trajectory_j/set_ratio_a", Number(ratio))
        until_done(rig, rig.engine.submit("move_cp", moved(rig.device.pose, step(*WAY))))
        places = np.array([tool.position for tool in rig.tool_path])
        highest.append(np.linalg.norm(np.diff(places, 2, axis=0), axis=1).max() / PERIOD**2)
    assert highest[1] <= 0.26 * TOOL.linear_acceleration
    assert highest[1] < 0.5 * highest[0]


def test_a_ratio_concerns_the_moves_that_are_accepted_after_it() -> None:
    rig = arm()
    move = rig.engine.submit("move_jp", jp(*(BENT + 0.8)))
    rig.engine.submit("trajectory_j/set_ratio", Number(0.1))
    fast = until_done(rig, move)
    slow = until_done(rig, rig.engine.submit("move_jp", jp(*BENT)))
    assert slow > 4 * fast
    for name in ("ratio", "ratio_v", "ratio_a"):
        found = rig.engine.latched(f"trajectory_j/{name}")
        assert found is not None
        assert found[0].value == 0.1  # type: ignore[union-attr]
