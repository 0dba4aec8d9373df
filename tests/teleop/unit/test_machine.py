"""One step after another of a leader and a follower: what is promised, for any movement of the hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crtk_drivers.geometry.quaternions import quaternion_from_rotvec, quaternion_product
from crtk_drivers.motion.teleop import Commands, Heard, Inputs, Phase, Side
from crtk_drivers.motion.teleop.coupling import distances
from crtk_drivers.motion.teleop.machine import TRANSITIONS, Event
from crtk_drivers.samples import Pose, Twist, Wrench, vector
from crtk_drivers.state import OperatingState, Status
from rigs.examples import examples
from rigs.teleop_hand import PERIOD, Hand, assert_same, moved, pose, settings_of

ways = st.lists(
    st.tuples(*[st.floats(-0.03, 0.03)] * 3, *[st.floats(-0.3, 0.3)] * 3, st.booleans()),
    min_size=1,
    max_size=30,
)
scales = st.floats(0.05, 5.0)
axes = st.tuples(*[st.floats(-3.0, 3.0)] * 3)


@settings(max_examples=examples(25))
@given(ways, scales, axes)
def test_whatever_the_hand_and_the_pedal_do_no_step_is_longer_than_the_speeds_allow(
    way, scale, rpy
):
    hand = Hand(settings_of(scale=scale, leader_rpy=rpy))
    hand.engage()
    limits = hand.settings.limits
    last = hand.follower
    for each in way:
        hand.leader, hand.pressed = moved(hand.leader, each), each[6]
        for _ in range(8):
            commands = hand.step()
            if commands.follower is not None:
                step_way, step_turn = distances(commands.follower, last)
                assert step_way <= limits.speed * PERIOD * (1.0 + 1e-6)
                assert step_turn <= limits.turn_speed * PERIOD * (1.0 + 1e-6) + 1e-7
                last = commands.follower


@settings(max_examples=examples(25))
@given(ways, scales, axes)
def test_the_clutch_never_jumps(way, scale, rpy):
    hand = Hand(settings_of(scale=scale, leader_rpy=rpy))
    for each in way:
        hand.leader = moved(pose(), tuple(30.0 * number for number in each[:6]))
        before = hand.follower
        hand.engage()
        assert hand.coupled.phase is Phase.FOLLOWING
        first = hand.sent[-1].follower
        assert_same(first, before)


@settings(max_examples=examples(25))
@given(st.tuples(*[st.floats(-0.04, 0.04)] * 3), scales)
def test_the_scale_is_exact(way, scale):
    hand = Hand(settings_of(scale=scale, orientation="locked", limits={"lag": 1.0}))
    hand.engage()
    start = hand.follower
    hand.leader = pose(*(0.7 * number for number in way))
    hand.steps(1.0)
    expected = start.position + scale * hand.leader.position
    assert hand.follower.position.tolist() == expected.tolist()
    assert hand.follower.orientation.tolist() == start.orientation.tolist(), "the lock is exact"


@settings(max_examples=examples(25))
@given(ways)
def test_what_is_locked_stays_to_the_last_bit(way):
    turning = Hand(settings_of(translation="locked"))
    moving = Hand(settings_of(orientation="locked"))
    for hand in (turning, moving):
        hand.engage()
        start = hand.follower
        for each in way:
            hand.leader = moved(pose(), each)
            hand.step()
        if hand is turning:
            assert hand.follower.position.tolist() == start.position.tolist()
        else:
            assert hand.follower.orientation.tolist() == start.orientation.tolist()


def test_the_axes_of_the_leader_are_turned():
    quarter = math.pi / 2.0
    hand = Hand(settings_of(leader_rpy=(0.0, 0.0, quarter)))
    hand.engage()
    start = hand.follower
    hand.leader = pose(0.02, 0.0, 0.0, (0.1, 0.0, 0.0))
    hand.steps(0.5)
    np.testing.assert_allclose(
        hand.follower.position - start.position, [0.0, 0.02, 0.0], atol=1e-12
    )
    turned = quaternion_product(quaternion_from_rotvec(vector((0.0, 0.1, 0.0))), start.orientation)
    np.testing.assert_allclose(hand.follower.orientation, turned, atol=1e-12)


LOST = {
    "nobody publishes": lambda side, now: replace(side, lost="nobody publishes it"),
    "FAULT": lambda side, now: replace(side, status=Status(OperatingState.FAULT, True)),
    "PAUSED": lambda side, now: replace(side, status=Status(OperatingState.PAUSED, True)),
    "not homed": lambda side, now: replace(side, status=Status(OperatingState.ENABLED, False)),
    "not been heard": lambda side, now: replace(side, pose=replace(side.pose, since=now - 0.11)),
    "no valid measured_cp": lambda side, now: replace(side, pose=None),
    "no pose": lambda side, now: replace(side, pose=replace(side.pose, value=pose(math.nan))),
}


@pytest.mark.parametrize("which", ["leader", "follower"])
@pytest.mark.parametrize("what", LOST)
def test_the_loss_of_either_side_holds_both_until_the_pedal_was_let_go(which, what):
    hand = Hand(settings_of(force={}))
    hand.engage()
    heard = hand.inputs()
    side = LOST[what](getattr(heard, which), hand.now)
    commands = hand.step(replace(heard, **{which: side}))
    assert hand.coupled.phase is Phase.HELD
    assert what in hand.coupled.reason
    assert (commands.hold_follower, commands.hold_leader) == (True, True)
    assert commands.follower is commands.leader is None, "no stream fights the hold"

    hand.leader = pose(0.4)  # the hand has moved on meanwhile
    hand.steps(0.2)
    assert hand.coupled.phase is Phase.HELD, "all is well again, and the pedal is still pressed"
    assert not any(each.follower for each in hand.sent[-30:])
    before = hand.follower
    hand.engage()
    assert_same(hand.sent[-1].follower, before)


def test_a_pedal_that_is_pressed_at_the_start_couples_nothing():
    hand = Hand(settings_of(), pressed=True)
    hand.steps(0.5)
    assert hand.coupled.phase is Phase.HELD
    assert "let the pedal go" in hand.coupled.reason
    assert not any(each.follower for each in hand.sent)


@pytest.mark.parametrize("pedal", ["clutch", "engage"])
def test_a_pedal_that_falls_silent_holds_both(pedal):
    hand = Hand(settings_of(**{pedal: {"topic": "/pedal", "timeout": 0.2}}))
    at_rest, coupled = (False, True) if pedal == "engage" else (True, False)

    def heard(pressed: bool, since: float) -> Inputs:
        return (
            hand.inputs(engage=None, clutch=None)
            if since < 0
            else replace(hand.inputs(engage=None), **{pedal: Heard(pressed, since)})
        )

    for _ in range(30):
        hand.step(heard(at_rest, hand.now))
    hand.step(heard(coupled, hand.now))
    assert hand.coupled.phase is Phase.FOLLOWING
    pressed_at = hand.now
    for _ in range(38):
        hand.step(heard(coupled, pressed_at))
    assert hand.coupled.phase is Phase.FOLLOWING
    for _ in range(4):
        commands = hand.step(heard(coupled, pressed_at))
    assert hand.coupled.phase is Phase.HELD
    assert "/pedal is not heard" in hand.coupled.reason
    assert any(each.hold_follower and each.hold_leader for each in hand.sent[-4:])
    assert commands.follower is None


def test_a_pedal_that_tells_changes_only_may_be_silent():
    hand = Hand(settings_of(engage={"topic": "/footpedals/coag", "repeats": False}))
    hand.engage()
    since = hand.now
    for _ in range(400):
        hand.step(replace(hand.inputs(), engage=Heard(True, since)))
    assert hand.coupled.phase is Phase.FOLLOWING
    hand.step(replace(hand.inputs(), engage=None))  # its publisher is gone
    assert hand.coupled.phase is Phase.HELD


def test_a_leader_that_jumps_ends_it():
    hand = Hand(settings_of())
    hand.engage()
    hand.leader = pose(0.06)
    commands = hand.step()
    assert "hand jumped by 60 mm" in hand.coupled.reason
    assert commands.hold_follower


def test_a_leader_that_stays_ahead_ends_it():
    hand = Hand(settings_of(scale=10.0))
    hand.engage()
    for count in range(6):
        hand.leader = pose(0.01 * count)
        hand.step()
    assert hand.coupled.phase is Phase.HELD
    assert "ahead of what the speed limits allow" in hand.coupled.reason


def test_a_follower_that_does_not_follow_ends_it():
    hand = Hand(settings_of())
    stays = hand.follower
    hand.engage()
    for count in range(200):
        hand.leader, hand.follower = pose(0.001 * count), stays
        hand.step()
    assert hand.coupled.phase is Phase.HELD
    assert "arm is 1" in hand.coupled.reason
    assert "from where it was sent" in hand.coupled.reason


def test_a_refusal_ends_it():
    hand = Hand(settings_of())
    hand.engage()
    heard = hand.inputs()
    hand.step(replace(heard, follower=replace(heard.follower, refusal="out of reach")))
    assert hand.coupled.phase is Phase.HELD
    assert "arm refused: out of reach" in hand.coupled.reason


def test_a_program_that_was_suspended_does_not_go_on():
    hand = Hand(settings_of())
    hand.engage()
    hand.now += 3.0
    commands = hand.step()
    assert "stood still for 3.0" in hand.coupled.reason
    assert commands.hold_follower


def test_a_step_that_comes_late_is_no_longer_than_two_in_time():
    hand = Hand(settings_of(limits={"speed": 0.25}))
    hand.engage()
    before = hand.follower
    hand.leader = pose(0.04)
    hand.now += 0.08
    hand.step()
    way, _ = distances(hand.follower, before)
    assert way == pytest.approx(0.25 * 2.0 * PERIOD)


def test_it_waits_until_the_follower_stands():
    hand = Hand(settings_of())
    hand.steps(0.2)
    hand.pressed = True
    for count in range(20):
        hand.follower = pose(0.5 + 0.002 * count)
        hand.step()
    assert hand.coupled.phase is Phase.ALIGNING
    assert hand.coupled.reason == "arm still moves"
    hand.steps(0.15)
    assert hand.coupled.phase is Phase.FOLLOWING


def test_aligned_waits_for_the_hand_to_turn():
    hand = Hand(settings_of(orientation="aligned", tool_rpy=(0.0, 0.0, 0.5)))
    hand.follower = pose(0.5, turn=(0.0, 0.0, 1.0))
    hand.engage()
    assert hand.coupled.reason == "turn hand by 29° to arm"
    hand.leader = pose(turn=(0.0, 0.0, 0.5))
    hand.step()
    assert hand.coupled.phase is Phase.FOLLOWING


def test_it_begins_at_the_setpoint_if_that_is_near():
    for off, begins in ((0.004, True), (0.02, False)):
        hand = Hand(settings_of())
        hand.steps(0.15)
        hand.pressed = True
        setpoint = moved(hand.follower, (off, 0, 0, 0, 0, 0))
        heard = hand.inputs()
        side = replace(heard.follower, setpoint=Heard(setpoint, hand.now))
        expected = setpoint if begins else hand.follower
        commands = hand.step(replace(heard, follower=side))
        assert_same(commands.follower, expected)


# ----------------------------------------------------------------------------------- velocities


@settings(max_examples=examples(25))
@given(ways, scales, st.sampled_from(["rate", "velocity"]))
def test_velocities_and_their_changes_are_bounded(way, scale, mode):
    hand = Hand(settings_of(mode=mode, scale=scale))
    hand.engage()
    limits, last = hand.settings.limits, np.zeros(6)
    for each in way:
        hand.leader, hand.pressed = moved(hand.leader, each), each[6]
        twist = Twist(vector(np.array(each[:3]) * 40.0), vector(np.array(each[3:6]) * 40.0))
        heard = hand.inputs()
        leader = replace(heard.leader, twist=Heard(twist, hand.now))
        commands = hand.step(replace(heard, leader=leader))
        if commands.hold_follower:
            assert not commands.follower.vector.any()
            last = np.zeros(6)
        elif commands.follower is not None:
            new = commands.follower.vector
            assert np.linalg.norm(new[:3]) <= limits.speed * (1 + 1e-9)
            assert np.linalg.norm(new[3:]) <= limits.turn_speed * (1 + 1e-9)
            assert np.linalg.norm((new - last)[:3]) <= limits.acceleration * PERIOD * (1 + 1e-6)
            assert np.linalg.norm((new - last)[3:]) <= limits.turn_acceleration * PERIOD * (
                1 + 1e-6
            )
            last = new


def test_of_rate_the_way_beyond_the_deadband_is_the_speed():
    hand = Hand(settings_of(mode="rate", scale=2.0, deadband=0.01, turn_scale=0.5))
    hand.engage()
    hand.leader = pose(0.04, turn=(0.0, 0.0, 0.25))
    hand.steps(0.5)
    sent = hand.sent[-1].follower
    np.testing.assert_allclose(sent.linear, [0.06, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(sent.angular, [0.0, 0.0, 0.1], atol=1e-12)


def test_a_leader_of_velocity_needs_no_pose():
    hand = Hand(settings_of(mode="velocity", scale=0.5, orientation="locked"))

    def heard() -> Inputs:
        twist = Twist(vector((0.1, 0.0, 0.0)), vector((1.0, 0.0, 0.0)))
        return replace(hand.inputs(), leader=Side(twist=Heard(twist, hand.now)))

    for _ in range(40):
        hand.step(heard())
    hand.pressed = True
    for _ in range(100):
        commands = hand.step(heard())
    np.testing.assert_allclose(commands.follower.vector, [0.05, 0, 0, 0, 0, 0], atol=1e-12)


# -------------------------------------------------------------------------------------- forces


@settings(max_examples=examples(25))
@given(st.tuples(*[st.floats(-1e4, 1e4)] * 6), st.floats(0.0, 10.0), axes)
def test_forces_are_scaled_turned_and_clipped_by_magnitude(numbers, gain, rpy):
    hand = Hand(settings_of(force={"gain": gain, "turn_gain": gain, "ramp": 0.05}, leader_rpy=rpy))
    hand.engage()
    force = hand.settings.force
    wrench = Wrench(vector(numbers[:3]), vector(numbers[3:]))

    def felt() -> Commands:
        heard = hand.inputs()
        return hand.step(
            replace(heard, follower=replace(heard.follower, wrench=Heard(wrench, hand.now)))
        )

    first = felt().leader
    strength = gain * np.linalg.norm(numbers[:3])
    assert np.linalg.norm(first.force) <= 0.11 * strength + 1e-9, "it comes slowly"
    for _ in range(20):
        commands = felt()
    assert np.linalg.norm(commands.leader.force) == pytest.approx(
        min(strength, force.most), rel=1e-9, abs=1e-9
    )
    assert np.linalg.norm(commands.leader.torque) <= force.most_torque * (1 + 1e-9)


def test_no_force_without_coupling_and_none_of_an_old_measurement():
    hand = Hand(settings_of(force={}))
    hand.steps(0.2)
    assert not hand.sent[-1].leader.vector.any()
    hand.engage()
    heard = hand.inputs()
    for age, felt in ((0.0, True), (0.2, False), (math.nan, False)):
        value = Wrench(vector((0.0, 0.0, 2.0 if age == age else math.nan)), vector((0, 0, 0)))
        since = hand.now - (age if age == age else 0.0)
        hand.steps(0.01)
        heard = hand.inputs()
        side = replace(heard.follower, wrench=Heard(value, since))
        assert bool(hand.step(replace(heard, follower=side)).leader.vector.any()) is felt


def test_body_wrenches_are_turned_with_the_tool():
    hand = Hand(settings_of(force={"source": "body/measured_cf", "gain": 1.0, "ramp": 0.001}))
    hand.follower = pose(turn=(math.pi / 2.0, 0.0, 0.0))
    hand.engage()
    hand.step()
    heard = hand.inputs()
    wrench = Wrench(vector((0.0, 0.0, 2.0)), vector((0, 0, 0)))
    side = replace(heard.follower, wrench=Heard(wrench, hand.now))
    sent = hand.step(replace(heard, follower=side)).leader
    np.testing.assert_allclose(sent.force, [0.0, -2.0, 0.0], atol=1e-12)


def test_a_leader_that_is_freed_is_freed_when_it_is_uncoupled_only():
    hand = Hand(settings_of(free_leader=True))
    hand.engage()
    hand.pressed = False
    hand.steps(0.1)
    assert [each.free_leader for each in hand.sent].count(True) == 2


def test_every_phase_knows_every_event():
    assert set(TRANSITIONS) == set(Phase)
    assert all(set(row) == set(Event) for row in TRANSITIONS.values())


@settings(max_examples=examples(25))
@given(st.data())
def test_nothing_that_is_heard_raises(data):
    numbers = st.floats(allow_nan=True, allow_infinity=True)
    poses = st.builds(
        lambda p, q: Pose(vector(p), vector(q)),
        st.lists(numbers, min_size=3, max_size=3),
        st.lists(numbers, min_size=4, max_size=4),
    )
    twists = st.builds(
        lambda p, q: Twist(vector(p), vector(q)), *[st.lists(numbers, min_size=3, max_size=3)] * 2
    )
    wrenches = st.builds(
        lambda p, q: Wrench(vector(p), vector(q)), *[st.lists(numbers, min_size=3, max_size=3)] * 2
    )
    since = st.floats(99.9, 101.0)
    sides = st.builds(
        Side,
        st.sampled_from(["", "gone"]),
        st.none() | st.builds(Status, st.sampled_from(OperatingState), st.booleans()),
        st.none() | st.builds(Heard, poses, since),
        st.none() | st.builds(Heard, twists, since),
        st.none() | st.builds(Heard, wrenches, since),
        st.none() | st.builds(Heard, poses, since),
        st.sampled_from(["", "no"]),
    )
    mode = data.draw(st.sampled_from(["position", "rate", "velocity"]))
    hand = Hand(settings_of(mode=mode, force={}, clutch={"topic": "/c"}, engage={"key": "e"}))
    for _ in range(data.draw(st.integers(1, 6))):
        heard = Inputs(
            hand.now,
            data.draw(st.just(hand.inputs().leader) | sides),
            data.draw(st.just(hand.inputs().follower) | sides),
            data.draw(st.none() | st.builds(Heard, st.booleans(), since)),
            data.draw(st.none() | st.builds(Heard, st.booleans(), since)),
        )
        commands = hand.step(heard)
        if commands.follower is not None:
            values = commands.follower
            numbers_sent = values.vector if isinstance(values, Twist) else values.position
            assert np.isfinite(numbers_sent).all()
