"""servo_cp and servo_cr on joints: exact where limits allow, damped near a singularity, never too fast."""

import itertools
import math

import numpy as np
import pytest

from crtk_drivers.device import JointLimits, Mode
from crtk_drivers.engine import EngineOptions
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.geometry.frames import moved
from crtk_drivers.geometry.quaternions import quaternion_from_rotvec, quaternion_product
from crtk_drivers.geometry.rates import turn
from crtk_drivers.options import LimitPolicy
from crtk_drivers.samples import Pose, Vector, vector
from rigs.scripted_arm import ARM, BENT, LIMIT, PERIOD, STRETCHED, ArmRig, apart, cs, step, twist
from rigs.scripted_engine import jp

CONVERGED = 1e-8


def arm(at: Vector = BENT, options: EngineOptions | None = None) -> ArmRig:
    return ArmRig(Mode.JOINT_POSITION, at=at, options=options).enabled()


def rates(rig: ArmRig, start: Vector = BENT) -> np.ndarray:
    return np.diff(np.vstack((start, rig.path)), axis=0) / PERIOD


def turned(pose: Pose, *rotvec: float) -> Pose:
    """The pose, turned about its own axes."""
    rotation = quaternion_from_rotvec(vector(rotvec))
    return Pose(pose.position, quaternion_product(pose.orientation, rotation))


def test_a_stream_within_the_limits_is_followed_exactly_in_each_cycle() -> None:
    rig = arm()
    start = rig.device.pose
    for count in range(1, 200):
        angle = 2.0 * math.pi * count * PERIOD
        goal = moved(
            start,
            step(
                0.04 * math.sin(angle),
                0.04 - 0.04 * math.cos(angle),
                0,
                0,
                0.1 * math.sin(angle),
                0,
            ),
        )
        rig.engine.submit("servo_cp", goal)
        rig.cycle()
        assert apart(rig.device.pose, goal) < CONVERGED
    assert len(rig.written) == 199
    rig.cycle(60)
    assert rig.engine.health().stream_timeouts == 1
    assert rig.told.refusals == [], "it has arrived"


@pytest.mark.parametrize("period", [0.95, 1.05])
def test_cycles_that_come_early_or_late_do_not_matter(period: float) -> None:
    rig = arm()
    goal = moved(rig.device.pose, step(0.045, 0, 0, 0, 0, 0))
    for _ in range(40):
        rig.engine.submit("servo_cp", goal)
        rig.cycle(period=period * PERIOD)
    assert rig.told.refusals == []
    assert "stop" not in rig.device.calls
    assert apart(rig.device.pose, goal) < CONVERGED


def test_an_approach_at_full_speed_bears_cycles_that_come_early() -> None:
    slow = JointLimits(-6.0, 6.0, velocity=1.0, acceleration=20.0, jerk=400.0, effort=50.0)
    rig = ArmRig(Mode.JOINT_POSITION, limits=(slow,) * 6).enabled()
    rig.engine.submit("servo_cp", turned(rig.device.pose, 0, 0, 0.0999))
    rig.cycle()  # nothing is left of what a stream may be ahead
    goal = turned(rig.device.pose, 0, 0, 0.1)
    for _ in range(40):
        rig.engine.submit("servo_cp", goal)
        rig.cycle(period=0.9 * PERIOD)
    assert rig.told.refusals == []
    assert apart(rig.device.pose, goal) < CONVERGED


def test_what_the_joints_cannot_do_at_once_is_approached_in_the_direction_of_the_goal() -> None:
    weak = JointLimits(-6.0, 6.0, LIMIT.velocity, acceleration=5.0, jerk=400.0, effort=50.0)
    rig = ArmRig(Mode.JOINT_POSITION, limits=(weak,) * 6).enabled()
    begin = rig.device.pose
    goal = moved(begin, step(0.02, 0.03, -0.02, 0.05, 0.03, 0.08))
    way, angle = goal.position - begin.position, turn(goal.orientation, begin.orientation)
    count = len(rig.written)
    for _ in range(60):
        rig.engine.submit("servo_cp", goal)
        rig.cycle()
    path = rig.path[count:]
    speeds = np.diff(np.vstack((BENT, path)), axis=0) / PERIOD
    assert np.abs(speeds).max() <= LIMIT.velocity * 1.01 + 1e-9
    tools = [ARM.forward(vector(joints)) for joints in path]
    on_the_way = [tool for tool in tools if apart(tool, goal) > 1e-4]
    assert len(on_the_way) > 5
    for tool in on_the_way:
        done = tool.position - begin.position
        share = float(done @ way / (way @ way))
        assert np.linalg.norm(done - share * way) < 0.02 * np.linalg.norm(way)
        spun = turn(tool.orientation, begin.orientation)
        assert spun == pytest.approx(share * angle, abs=0.02 * float(np.linalg.norm(angle)))
    distances = [apart(tool, goal) for tool in tools]
    assert all(b <= a + 1e-12 for a, b in itertools.pairwise(distances))
    assert distances[-1] < CONVERGED


def test_a_slower_stream_than_the_device_is_followed_to_each_of_its_poses() -> None:
    rig = arm()
    start = rig.device.pose
    for count in range(1, 20):
        goal = moved(start, step(0.004 * count, -0.002 * count, 0, 0, 0, 0.01 * count))
        rig.engine.submit("servo_cp", goal)
        rig.cycle(5)
        assert apart(rig.device.pose, goal) < CONVERGED
    assert len(rig.written) == 19 * 5, "it goes on between its commands"


# ------------------------------------------------------------------------------------------ singularity


def through_the_wrist(count: int) -> list[Pose]:
    """A tool that turns evenly where the wrist would have to turn at once."""
    start = ARM.forward(vector((*STRETCHED[:4], 0.06, STRETCHED[5])))
    end = ARM.forward(vector((*STRETCHED[:4], -0.06, STRETCHED[5])))
    aside = 0.02  # not quite through it
    way = turn(end.orientation, start.orientation)
    poses = []
    for index in range(count + 1):
        share = index / count
        extra = vector((aside * math.sin(math.pi * share), 0.0, 0.0))
        rotation = quaternion_product(
            quaternion_from_rotvec(vector(way * share)), start.orientation
        )
        rotation = quaternion_product(rotation, quaternion_from_rotvec(extra))
        poses.append(
            Pose(vector(start.position + (end.position - start.position) * share), rotation)
        )
    return poses


def test_near_a_singularity_the_joints_keep_their_velocity_limits_in_each_cycle() -> None:
    at = vector((*STRETCHED[:4], 0.06, STRETCHED[5]))
    rig = arm(at)
    poses = through_the_wrist(100)
    fastest = [np.abs(b - a).max() / PERIOD for a, b in itertools.pairwise(_exactly(poses, at))]
    assert max(fastest) > 5.0 * LIMIT.velocity, "no singularity"
    for goal in poses:
        rig.engine.submit("servo_cp", goal)
        rig.cycle()
    for _ in range(150):
        rig.engine.submit("servo_cp", poses[-1])
        rig.cycle()
    assert rig.told.refusals == []
    assert np.abs(rates(rig, at)).max() <= LIMIT.velocity * 1.02
    assert apart(rig.device.pose, poses[-1]) < CONVERGED, "in the end it gets there"


def _exactly(poses: list[Pose], start: Vector) -> list[Vector]:
    joints = [start]
    for pose in poses:
        joints.append(ARM.inverse(pose, joints[-1]))
    return joints


def test_increments_near_a_singularity_keep_the_limits_and_add_up() -> None:
    rig = arm(STRETCHED)
    goal = rig.device.pose
    for _ in range(60):
        rig.engine.submit("body/servo_cr", step(0, 0, 0, 0.002, 0, 0))
        goal = turned(goal, 0.002, 0, 0)
        rig.cycle()
    assert np.abs(rates(rig, STRETCHED)).max() <= LIMIT.velocity * 1.02
    for _ in range(200):
        rig.engine.submit("body/servo_cr", step(0, 0, 0, 0, 0, 0))
        rig.cycle()
    assert rig.told.refusals == []
    assert np.abs(rates(rig, STRETCHED)).max() <= LIMIT.velocity * 1.02
    assert apart(rig.device.pose, goal) < 1e-6


# ------------------------------------------------------------------------------------------- its end


def test_when_the_stream_falls_silent_it_goes_no_further() -> None:
    rig = arm(STRETCHED)
    goal = turned(rig.device.pose, 0.1, 0, 0)
    rig.engine.submit("servo_cp", goal, stamp_ns=7)
    rig.cycle(10)
    assert apart(rig.device.pose, goal) > 1e-3, "on the way"
    assert rig.told.refusals == []
    rig.cycle(60)
    (told,) = rig.told.refusals
    assert (told.command, told.reason, told.stamp_ns) == ("servo_cp", Reason.STREAM_ENDED, 7)
    assert "has not arrived" in str(told)
    assert "move_cp" in told.remedy
    health = rig.engine.health()
    assert (health.stream, health.stream_timeouts) == ("", 1)
    place, count = rig.device.position.copy(), len(rig.written)
    rig.cycle(20)
    assert len(rig.written) == count
    assert (rig.device.position == place).all()
    assert rig.setpoint()["position"] == place.tolist()
    assert apart(rig.device.pose, goal) > 1e-3
    assert "stop" not in rig.device.calls, "a position is held by itself"


@pytest.mark.parametrize("what", ["hold", "disable"])
def test_what_is_stopped_does_not_go_on_to_its_goal(what: str) -> None:
    rig = arm(STRETCHED)
    rig.engine.submit("servo_cp", turned(rig.device.pose, 0.1, 0, 0))
    rig.cycle(3)
    (rig.engine.submit if what == "hold" else rig.engine.state_command)(what)
    count = len(rig.written)
    rig.cycle(20)
    assert len(rig.written) == count


# ------------------------------------------------------------------------------------------- refused


@pytest.mark.parametrize("name", ["servo_cp", "servo_cr"])
def test_out_of_reach_is_refused_and_the_stream_goes_on(name: str) -> None:
    rig = arm(vector((0.4, -1.2, 0.05, -0.4, -1.3, 0.3)))  # nearly stretched out
    start = rig.device.pose
    outwards = start.position - np.array((0, 0, 0.1625))
    outwards /= np.linalg.norm(outwards)

    def away(distance: float) -> Pose:
        increment = step(*(distance * outwards), 0, 0, 0)
        return moved(start, increment) if name == "servo_cp" else increment

    rig.engine.submit(name, away(-0.002))
    rig.cycle(5)
    with pytest.raises(CommandRefused) as caught:
        rig.engine.submit(name, away(0.04))
    assert caught.value.reason is Reason.UNREACHABLE
    assert caught.value.remedy
    rig.cycle(15)
    assert rig.engine.health().stream == name
    assert apart(rig.device.pose, moved(start, step(*(-0.002 * outwards), 0, 0, 0))) < CONVERGED


def test_the_refusal_leaves_the_stream_running() -> None:
    rig = arm()
    near = moved(rig.device.pose, step(0.001, 0, 0, 0, 0, 0))
    rig.stream("servo_cp", near, 3)
    with pytest.raises(CommandRefused) as caught:
        rig.engine.submit("servo_cp", moved(near, step(0.3, 0, 0, 0, 0, 0)))
    assert caught.value.reason is Reason.STEP_TOO_LARGE
    with pytest.raises(CommandRefused) as caught:
        rig.engine.submit("servo_cp", moved(near, step(3.0, 0, 0, 0, 0, 0)))
    assert caught.value.reason is Reason.UNREACHABLE
    with pytest.raises(CommandRefused) as caught:
        rig.engine.submit("servo_cp", turned(near, 0.5, 0, 0))
    assert caught.value.reason is Reason.STEP_TOO_LARGE
    rig.cycle()
    assert rig.engine.health().stream == "servo_cp"
    assert "stop" not in rig.device.calls
    assert apart(rig.device.pose, near) < CONVERGED


def test_a_sum_of_increments_that_is_a_jump_is_refused_and_the_goal_before_stays() -> None:
    rig = arm()
    rig.stream("servo_cr", step(0.001, 0, 0, 0, 0, 0), 5)
    goal = rig.device.pose
    for _ in range(4):
        rig.engine.submit("servo_cr", step(0.02, 0, 0, 0, 0, 0))
    rig.cycle(3)
    assert [told.reason for told in rig.told.refusals] == [Reason.STEP_TOO_LARGE]
    assert apart(rig.device.pose, goal) < CONVERGED
    rig.stream("servo_cr", step(0.001, 0, 0, 0, 0, 0), 1)
    assert apart(rig.device.pose, moved(goal, step(0.001, 0, 0, 0, 0, 0))) < CONVERGED


def test_a_joint_at_the_end_of_its_range_is_clamped_or_refused_as_the_user_chose() -> None:
    at = vector((*BENT[:5], 5.99))
    goal = turned(ARM.forward(at), 0, 0, 0.05)
    rig = arm(at)
    rig.stream("servo_cp", goal, 20)
    assert rig.path[:, 5].max() <= LIMIT.upper
    strict = arm(at, EngineOptions(limits=LimitPolicy(clamp_servo=False)))
    with pytest.raises(CommandRefused) as caught:
        strict.engine.submit("servo_cp", goal)
    assert caught.value.reason is Reason.OUT_OF_RANGE


# --------------------------------------------------------------------------------------------- drift


TAKES_OVER = {
    "move_jp": lambda rig: jp(*(rig.path[-1] + 0.5)),
    "move_cp": lambda rig: moved(rig.device.pose, step(0.05, 0, 0.05, 0, 0, 0.1)),
    "interpolate_jp": lambda rig: jp(*(rig.path[-1] + 0.05)),
    "interpolate_cp": lambda rig: moved(rig.device.pose, step(0.01, 0, 0, 0, 0, 0)),
    "servo_cv": lambda rig: twist(0, 0, 0, 0, 0, 0),
}


@pytest.mark.parametrize("every", [1, 5])
@pytest.mark.parametrize("second", TAKES_OVER)
@pytest.mark.parametrize("first", ["servo_jp", "servo_jr", "servo_cp"])
def test_what_takes_over_from_positions_begins_with_their_velocity(
    first: str, second: str, every: int
) -> None:
    rig = arm(options=EngineOptions(mode_switch_dwell=0.0))
    rate = np.array((0.3, -0.2, 0.25, 0.2, 0.1, -0.3))
    for count in range(1, 31):
        joints = BENT + rate * count * every * PERIOD
        value = {
            "servo_jp": jp(*joints),
            "servo_jr": jp(*(rate * every * PERIOD)),
            "servo_cp": ARM.forward(vector(joints)),
        }[first]
        rig.engine.submit(first, value)
        rig.cycle(every if count < 30 else 1)
    begin = rig.path[-1]
    assert begin == pytest.approx(BENT + rate * 30 * every * PERIOD, abs=1e-7)
    rig.engine.submit(second, TAKES_OVER[second](rig))
    rig.cycle()
    velocity = (rig.path[-1] - begin) / PERIOD
    # By no more than the acceleration limit allows, or the tool's, in one cycle.
    assert np.abs(velocity - rate).max() <= LIMIT.acceleration * PERIOD + 0.01
    assert velocity @ rate > 0.5 * rate @ rate


@pytest.mark.parametrize("second", ["move_jp", "servo_cv"])
def test_a_stream_that_stands_has_no_velocity(second: str) -> None:
    rig = arm(options=EngineOptions(mode_switch_dwell=0.0))
    for count in range(1, 11):
        rig.engine.submit("servo_jp", jp(*(BENT + 0.3 * count * PERIOD)))
        rig.cycle()
    rig.cycle(5)
    begin = rig.path[-1]
    rig.engine.submit(second, TAKES_OVER[second](rig))
    rig.cycle()
    assert np.abs(rig.path[-1] - begin).max() < 1e-3 * PERIOD + 1e-5


@pytest.mark.parametrize(
    "name", ["servo_cp", "servo_cr", "body/servo_cr", "servo_cs", "interpolate_cr"]
)
def test_no_stream_asks_for_a_search_that_may_take_long(name: str) -> None:
    rig = arm()

    def search(pose: Pose, reference: Vector) -> Vector:
        raise AssertionError(f"a search for {pose} from {reference}")

    rig.device.solver.inverse = search  # type: ignore[method-assign]
    nearby = ARM.inverse
    rig.device.solver.nearby_inverse = nearby  # type: ignore[method-assign, assignment]
    here = rig.device.pose
    values = {
        "servo_cp": moved(here, step(0, 0, 0.001, 0, 0, 0)),
        "servo_cs": cs("PVNNNN", here, twist(0, 0.01, 0, 0, 0, 0)),
    }
    for _ in range(5):
        rig.engine.submit(name, values.get(name, step(0, 0, 0.001, 0, 0, 0)))
        rig.cycle()
    assert len(rig.written) == 5
