"""What a hostile world does to a coupled leader and follower: nothing moves of itself, and nothing jumps."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from crtk_drivers.motion.teleop import Heard, Phase, Side
from crtk_drivers.samples import Pose, Twist, Wrench, vector
from rigs.teleop_hand import PERIOD, Hand, assert_same, moved, pose, settings_of


@pytest.mark.parametrize("pedal", ["engage", "clutch"])
def test_a_pedal_that_is_first_heard_where_it_couples_couples_nothing(pedal: str) -> None:
    hand = Hand(settings_of(**{pedal: {"topic": "/pedal"}}))
    couples = pedal == "engage"

    def steps(pressed: bool | None, seconds: float = 0.2) -> None:
        for _ in range(round(seconds / PERIOD)):
            heard = None if pressed is None else Heard(pressed, hand.now)
            hand.step(replace(hand.inputs(engage=None), **{pedal: heard}))

    steps(None)  # DDS has not found it yet
    steps(couples)
    assert hand.coupled.phase is Phase.HELD
    steps(not couples)
    steps(couples)
    assert hand.coupled.phase is Phase.FOLLOWING
    steps(None)  # and it is unplugged, and plugged in again while a foot is on it
    assert hand.coupled.phase is Phase.HELD
    assert sum(each.hold_follower and each.hold_leader for each in hand.sent) == 1
    steps(couples, 1.0)
    assert hand.coupled.phase is Phase.HELD
    assert not any(each.follower for each in hand.sent[-200:])


def test_a_pedal_of_which_two_programs_tell_holds_both() -> None:
    hand = Hand(settings_of())
    hand.engage()
    commands = hand.step(hand.inputs(doubt="/pedal is told by 2 publishers"))
    assert hand.coupled.trouble == "/pedal is told by 2 publishers"
    assert (commands.hold_follower, commands.hold_leader) == (True, True)


def test_a_setpoint_that_is_not_told_any_more_is_no_place_to_begin() -> None:
    hand = Hand(settings_of())
    old = Heard(moved(hand.follower, (0.009, 0, 0, 0, 0, 0.04)), hand.now)
    for pressed in (False, True):
        hand.pressed = pressed
        for _ in range(40):
            before = hand.follower
            heard = hand.inputs()
            follower = replace(heard.follower, setpoint=old)
            commands = hand.step(replace(heard, follower=follower))
            if commands.follower is not None:
                break
    assert hand.coupled.phase is Phase.FOLLOWING
    assert_same(commands.follower, before)


def test_a_follower_that_falls_silent_while_it_moves_does_not_stand() -> None:
    hand = Hand(settings_of(timeout=1.0))
    hand.steps(0.2)
    hand.pressed = True
    for count in range(10):  # somebody else moves it
        hand.follower = pose(0.5 + 0.002 * count)
        hand.step()
    assert hand.coupled.phase is Phase.ALIGNING
    last = Heard(hand.follower, hand.now)
    for _ in range(100):
        heard = hand.inputs()
        hand.step(replace(heard, follower=replace(heard.follower, pose=last)))
    assert hand.coupled.phase is Phase.ALIGNING
    assert hand.coupled.reason == "arm still moves"


def test_a_program_that_was_suspended_while_it_was_uncoupled_couples_nothing() -> None:
    hand = Hand(settings_of())
    hand.steps(0.2)
    assert hand.coupled.phase is Phase.RELEASED
    hand.now += 10.0
    hand.pressed = True  # what it hears first was said long ago
    hand.steps(0.5)
    assert hand.coupled.phase is Phase.HELD
    assert not any(each.follower for each in hand.sent)


@pytest.mark.parametrize("source", ["measured_cf", "body/measured_cf"])
def test_a_force_beyond_all_numbers_is_none(source: str) -> None:
    force = {"gain": 10.0, "turn_gain": 10.0, "ramp": 0.001, "source": source}
    hand = Hand(settings_of(force=force, leader_rpy=(0.3, -1.0, 2.0)))
    hand.engage()
    for numbers in ([1.7e308] * 6, [-1.7e308, 1.7e308, 1e308, 1e300, 5.0, -1.7e308]):
        heard = hand.inputs()
        wrench = Heard(Wrench(vector(numbers[:3]), vector(numbers[3:])), hand.now)
        side = replace(heard.follower, wrench=wrench)
        sent = hand.step(replace(heard, follower=side)).leader
        assert np.isfinite(sent.vector).all()
        assert np.linalg.norm(sent.force) <= hand.settings.force.most * (1 + 1e-9)
        assert np.linalg.norm(sent.torque) <= hand.settings.force.most_torque * (1 + 1e-9)


def test_a_velocity_beyond_all_numbers_is_none() -> None:
    hand = Hand(settings_of(mode="velocity", scale=100.0, leader_rpy=(0.3, -1.0, 2.0)))
    hand.engage()
    twist = Twist(vector((1.7e308, -1.7e308, 1.7e308)), vector((1.7e308, 1.7e308, -1.7e308)))
    heard = hand.inputs()
    leader = replace(heard.leader, twist=Heard(twist, hand.now))
    sent: Any = hand.step(replace(heard, leader=leader)).follower
    assert hand.coupled.reason == "hand tells what is no velocity"
    assert not sent.vector.any()


@pytest.mark.parametrize("which", ["leader", "follower"])
def test_other_axes_of_either_side_end_it(which: str) -> None:
    hand = Hand(settings_of())
    hand.engage()
    heard = hand.inputs()
    side: Side = getattr(heard, which)
    assert side.pose is not None
    other = replace(side.pose.value, frame_id="other")
    turned = replace(side, pose=Heard(other, hand.now))
    hand.step(replace(heard, **{which: turned}))
    assert hand.coupled.phase is Phase.HELD
    assert "in the axes of 'other', and before of 'base'" in hand.coupled.reason


# ------------------------------------------------------------------------------------- what held


def test_signs_of_quaternions_and_half_turns_move_nothing() -> None:
    half = pose(turn=(math.pi, 0.0, 0.0))
    hand = Hand(settings_of(), leader=half)
    hand.engage()
    before = hand.follower
    for sign in (-1.0, 1.0, -1.0):
        hand.leader = Pose(half.position, vector(sign * half.orientation), "base")
        hand.step()
        turned = abs(float(np.dot(hand.follower.orientation, before.orientation)))
        assert turned == pytest.approx(1.0, abs=1e-12)


def test_a_hand_that_turns_all_the_way_round_turns_the_follower_with_it() -> None:
    hand = Hand(settings_of(limits={"turn_speed": 20.0}))
    hand.engage()
    start = hand.follower
    for count in range(1, 401):
        before = hand.follower
        hand.leader = pose(turn=(0.0, 0.0, 4.0 * math.pi * count / 400))
        hand.step()
        assert np.dot(hand.follower.orientation, before.orientation) > 0.99, "and keeps its sign"
        assert hand.coupled.phase is Phase.FOLLOWING
    assert abs(float(np.dot(hand.follower.orientation, start.orientation))) == pytest.approx(1.0)
