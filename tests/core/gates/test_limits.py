"""The last gate before the wire: properties for every value."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.commands import COMMANDS
from crtk_drivers.device import Mode, Setpoint
from crtk_drivers.engine import EngineOptions
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.gates.braking import braking_way, stoppable_speed
from crtk_drivers.gates.command import LARGEST, CommandCheck
from crtk_drivers.gates.setpoint import SetpointLimiter, norms_into
from crtk_drivers.options import LimitPolicy
from crtk_drivers.samples import EMPTY, Array, JointState, Pose, Vector, vector
from rigs.scripted_engine import JOINTS, Rig, SlideAndTurn, jp, jv, two_joints

POLICY = LimitPolicy(max_step=0.1)
LOWER, UPPER, VELOCITY, EFFORT = -1.0, 1.0, 1.0, 5.0
number = st.floats(-3.0, 3.0)
anything = st.floats(allow_nan=True, allow_infinity=True)
pair = st.tuples(number, number).map(vector)
six = st.lists(st.floats(-50.0, 50.0), min_size=6, max_size=6).map(vector)


def limiter(policy: LimitPolicy = POLICY) -> SetpointLimiter:
    return SetpointLimiter(two_joints(), policy, "here")


@given(pair, pair)
def test_a_position_is_in_range_and_near_or_refused(values: Vector, before: Vector) -> None:
    try:
        sent = limiter().judge("servo_jp", Setpoint(Mode.JOINT_POSITION, values), before)
    except CommandRefused:
        assert np.abs(np.clip(values, LOWER, UPPER) - before).max() > 0.1 * VELOCITY - 1e-9
        return
    result = sent.setpoint.values
    assert np.abs(result - before).max() <= 0.1 * VELOCITY
    # Never further out than it is already.
    assert (result >= np.minimum(LOWER, before)).all()
    assert (result <= np.maximum(UPPER, before)).all()
    assert bool(sent.warning) is (result.tolist() != values.tolist())
    assert not result.flags.writeable


@given(st.lists(st.tuples(number, st.floats(0.0, 0.2)), max_size=40))
def test_no_stream_is_faster_than_the_velocity_limit_over_time(
    stream: list[tuple[float, float]],
) -> None:
    gate = limiter()
    now, start, position = 0.0, None, vector((0.0, 0.0))
    travelled = 0.0
    for target, pause in stream:
        now += pause
        setpoint = Setpoint(Mode.JOINT_POSITION, vector((target * 0.1, 0.0)))
        try:
            sent = gate.limit("servo_jp", setpoint, position, now).setpoint.values
        except CommandRefused:
            continue
        start = now if start is None else start
        travelled += abs(sent[0] - position[0])
        position = sent
        assert travelled <= VELOCITY * (1.01 * (now - start) + POLICY.max_step) + 1e-9


@pytest.mark.parametrize(
    ("mode", "limit"), [(Mode.JOINT_VELOCITY, VELOCITY), (Mode.JOINT_EFFORT, EFFORT)]
)
@given(values=pair)
def test_rates_are_scaled_as_a_whole(mode: Mode, limit: float, values: Vector) -> None:
    sent = limiter().judge("servo", Setpoint(mode, values * 3), EMPTY).setpoint.values
    assert np.abs(sent).max() <= limit + 1e-12
    assert sent[0] * values[1] == pytest.approx(sent[1] * values[0]), "the direction is kept"


@pytest.mark.parametrize(
    ("mode", "first", "second"),
    [(Mode.CARTESIAN_VELOCITY, 0.5, 1.0), (Mode.CARTESIAN_EFFORT, 10.0, 2.0)],
)
@given(values=six)
def test_cartesian_rates_are_scaled_by_their_norms(
    mode: Mode, first: float, second: float, values: Vector
) -> None:
    sent = limiter().judge("servo", Setpoint(mode, values), EMPTY).setpoint.values
    assert np.linalg.norm(sent[:3]) <= first + 1e-12
    assert np.linalg.norm(sent[3:]) <= second + 1e-12
    small = np.linalg.norm(values[:3]) <= first and np.linalg.norm(values[3:]) <= second
    if small:
        assert sent.tolist() == values.tolist()


@given(values=six)
def test_where_torques_are_not_possible_none_is_sent_and_forces_are_limited_alone(
    values: Vector,
) -> None:
    sent = norms_into(values, 10.0, 0.0)
    assert not sent[3:].any()
    length = np.linalg.norm(values[:3])
    assert sent[:3] == pytest.approx(values[:3] * min(1.0, 10.0 / max(length, 1e-9)))


@pytest.mark.parametrize("mode", list(Mode))
def test_nothing_that_is_not_finite_passes(mode: Mode) -> None:
    for bad in (math.nan, math.inf, -math.inf):
        with pytest.raises(CommandRefused, match="not finite"):
            limiter().judge("servo", Setpoint(mode, vector([0.0, bad] + [0.0] * 5)), EMPTY)


def test_a_pose_that_jumps_or_turns_too_far_is_refused() -> None:
    gate = limiter(LimitPolicy(max_linear_step=0.05, max_step=0.1))
    before = vector((0, 0, 0, 0, 0, 0, 1))

    def judge(x: float, angle: float) -> None:
        values = vector((x, 0, 0, 0, 0, math.sin(angle / 2), math.cos(angle / 2)))
        gate.judge("servo_cp", Setpoint(Mode.CARTESIAN_POSITION, values), before)

    judge(0.049, 0.09)
    with pytest.raises(CommandRefused, match=r"jump by 0.0510 m"):
        judge(0.051, 0.0)
    with pytest.raises(CommandRefused, match=r"turn by 0.1100 rad"):
        judge(0.0, 0.11)


@given(st.lists(anything, max_size=4), st.permutations(JOINTS))
def test_a_joint_command_passes_only_if_it_is_sound(values: list[float], names: list[str]) -> None:
    check = CommandCheck(two_joints(), POLICY, "here")
    given_names = tuple(names) if len(values) == 2 else ()
    state = JointState(position=vector(values), name=given_names)
    sound = len(values) == 2 and all(abs(value) <= LARGEST for value in values)  # NaN is not
    way = sound and all(abs(value) <= UPPER - LOWER for value in values)
    in_range = sound and all(LOWER <= value <= UPPER for value in values)
    for name, passes in (("servo_jp", sound), ("servo_jr", way), ("move_jp", in_range)):
        if passes:
            found = check.check(COMMANDS[name], state)
            assert isinstance(found, JointState)
            assert found.position.tolist() == [values[names.index(joint)] for joint in JOINTS]
        else:
            with pytest.raises(CommandRefused):
                check.check(COMMANDS[name], state)


@given(st.lists(st.floats(-2.0, 2.0), min_size=4, max_size=4))
def test_a_pose_passes_only_with_a_unit_quaternion(numbers: list[float]) -> None:
    check = CommandCheck(two_joints(), POLICY, "here")
    norm = float(np.linalg.norm(numbers))
    pose = Pose(vector((0, 0, 0)), vector(numbers))
    if abs(norm - 1.0) > 1e-3:
        with pytest.raises(CommandRefused) as caught:
            check.check_pose(COMMANDS["servo_cp"], pose)
        assert caught.value.reason is Reason.BAD_QUATERNION
    else:
        found = check.check_pose(COMMANDS["servo_cp"], pose)
        assert np.linalg.norm(found.orientation) == pytest.approx(1.0, abs=1e-12)


def test_a_limit_itself_is_within_the_limits() -> None:
    check = CommandCheck(two_joints(), POLICY, "here")
    check.check(COMMANDS["move_jp"], jp(LOWER, UPPER))
    check.check(COMMANDS["servo_jv"], jv(VELOCITY, -VELOCITY))


def test_the_first_position_of_a_stream_is_one_that_the_arm_can_reach_from_how_it_moves() -> None:
    rig = Rig(EngineOptions(limits=LimitPolicy(max_step=0.02))).enabled()
    from_rest = 0.5 * 10.0 * 0.04**2
    rig.servo(1.01 * from_rest, 0.0)
    rig.cycle()
    assert not rig.written
    assert rig.told.refusals[-1].reason is Reason.STEP_TOO_LARGE
    assert "begin with a jump" in str(rig.told.refusals[-1])
    rig.servo(0.99 * from_rest, 0.0)
    rig.cycle()
    here = rig.written[-1].values[0]
    for _ in range(4):  # a stream that runs may go on as fast as its joints may be
        here += 0.01
        rig.servo(here, 0.0)
        rig.cycle()
    assert rig.written[-1].values[0] == here
    rig.cycle(30)  # it has ended, and the arm stands
    rig.servo(here + 1.01 * from_rest, 0.0)
    rig.cycle()
    assert rig.written[-1].values[0] == here


@given(
    st.floats(1e-9, 1e308) | st.just(math.inf),
    st.floats(1e-3, 1e6) | st.just(math.inf),
    st.floats(1e-3, 1.0),
)
def test_a_joint_that_is_slow_enough_stops_within_its_room(
    room: float, deceleration: float, delay: float
) -> None:
    speed = stoppable_speed(room, deceleration, delay)
    assert speed > 0.0  # and a number
    if speed < 1e150 and math.isfinite(room):
        assert braking_way(speed, deceleration, delay) == pytest.approx(room, rel=1e-6)


@pytest.mark.parametrize("outward", [0.0, 1e-15])
def test_a_joint_outside_its_range_that_has_no_part_in_a_twist_does_not_stop_it(
    outward: float,
) -> None:
    class Turned(SlideAndTurn):
        def jacobian(self, joints: Vector) -> Array:
            return np.eye(6)[:, [0, 5]] - outward * np.eye(6)[:, [5, 0]]

    gate = SetpointLimiter(two_joints(), POLICY, "here", Turned)
    at = vector((0.0, UPPER + 1e-6))

    def sent(*twist: float) -> list[float]:
        setpoint = Setpoint(Mode.CARTESIAN_VELOCITY, vector(twist))
        return gate.judge("servo_cv", setpoint, at).setpoint.values.tolist()

    assert sent(0.1, 0, 0, 0, 0, 0)[0] == 0.1
    assert sent(0, 0, 0, 0, 0, 0.1) == [0.0] * 6
    assert sent(0, 0, 0, 0, 0, -0.1)[5] == -0.1
