"""A gripper that leads a jaw: it never leaps, and who presses the pedal with an open hand drops nothing."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from crtk_drivers.motion.teleop import Heard, Phase, Side
from crtk_drivers.samples import JointState, vector
from crtk_drivers.state import OperatingState, Status
from rigs.teleop_hand import PERIOD, Hand, gripper, settings_of

CLOSED, OPEN, SPEED = -0.2, 1.0, 2.0
"""Of the jaw, in rad and rad/s. The leader's gripper goes the other way: 0.5 is closed, -0.1 open."""
GRIPPER: dict[str, Any] = {
    "leader_closed": 0.5,
    "leader_open": -0.1,
    "follower_closed": CLOSED,
    "follower_open": OPEN,
    "speed": SPEED,
}
SQUEEZED, LOOSE = 0.5, -0.1


def hand_of(**given: Any) -> Hand:
    return Hand(settings_of(gripper={**GRIPPER, **given}), grip=SQUEEZED, jaw=CLOSED)


def sent_to_the_jaw(hand: Hand, seconds: float) -> list[float]:
    before = len(hand.sent)
    hand.steps(seconds)
    return [each.jaw for each in hand.sent[before:] if each.jaw is not None]


def test_the_jaw_goes_with_the_hand_no_faster_than_its_speed() -> None:
    hand = hand_of()
    hand.engage()
    hand.grip = LOOSE
    hand.steps(0.1)
    assert hand.jaw == pytest.approx(CLOSED + 0.1 * SPEED, abs=0.02)
    hand.steps(1.0)
    assert hand.jaw == OPEN
    hand.grip = 0.2
    hand.steps(1.0)
    assert hand.jaw == pytest.approx(0.4), "half open, as the hand is"


def test_who_presses_the_pedal_with_an_open_hand_drops_nothing() -> None:
    hand = hand_of()
    hand.grip = LOOSE
    hand.engage()
    assert hand.coupled.phase is Phase.FOLLOWING
    assert sent_to_the_jaw(hand, 0.5) == []
    hand.grip = SQUEEZED
    assert sent_to_the_jaw(hand, 0.1) == [CLOSED] * round(0.1 / PERIOD)
    hand.grip = LOOSE
    hand.steps(1.0)
    assert hand.jaw == OPEN


def test_a_hand_that_passes_where_the_jaw_is_within_one_step_leads_it() -> None:
    hand = hand_of()
    hand.jaw = 0.4
    hand.engage()
    assert sent_to_the_jaw(hand, 0.1) == []
    hand.grip = LOOSE
    first = sent_to_the_jaw(hand, PERIOD)
    assert first == pytest.approx([0.4 + SPEED * PERIOD])


@pytest.mark.parametrize(("jaw", "grip"), [(OPEN + 0.3, LOOSE), (CLOSED - 0.3, SQUEEZED)])
def test_a_jaw_beyond_its_ends_is_led_from_the_nearer_one(jaw: float, grip: float) -> None:
    hand = hand_of()
    hand.jaw, hand.grip = jaw, 0.2
    hand.engage()
    assert sent_to_the_jaw(hand, 0.1) == []
    hand.grip = grip
    assert abs(sent_to_the_jaw(hand, PERIOD)[0] - jaw) <= SPEED * PERIOD * (1.0 + 1e-9)


def test_what_is_held_is_led_from_where_the_jaw_was_sent_not_from_where_its_fingers_are() -> None:
    hand = hand_of()
    hand.engage()
    hand.pressed = False
    hand.steps(0.15)
    hand.pressed = True
    hand.grip = LOOSE
    held = gripper(0.3, hand.now + PERIOD, setpoint=CLOSED)
    hand.step(replace(hand.inputs(), jaw=held))
    assert hand.coupled.jaw is not None
    assert hand.coupled.jaw.at == CLOSED
    no_setpoint = replace(held, joint_setpoint=None)
    hand.pressed = False
    hand.steps(0.15)
    hand.pressed = True
    hand.step(replace(hand.inputs(), jaw=no_setpoint))
    assert hand.coupled.jaw.at == 0.3


grips = st.lists(st.tuples(st.floats(-1.0, 1.0), st.booleans()), min_size=1, max_size=30)


@settings(max_examples=50)
@given(grips, st.floats(-1.0, 2.0))
def test_whatever_hand_and_pedal_do_the_jaw_never_leaps(
    way: list[tuple[float, bool]], start: float
) -> None:
    hand = hand_of()
    hand.jaw = start
    hand.engage()
    last = hand.jaw
    for grip, pressed in way:
        hand.grip, hand.pressed = grip, pressed
        for _ in range(8):
            sent = hand.step().jaw
            if sent is not None:
                assert abs(sent - last) <= SPEED * PERIOD * (1.0 + 1e-6)
                assert min(CLOSED, start) <= sent <= max(OPEN, start)
                last = sent


LOST: dict[str, Any] = {
    "nobody publishes": lambda side, now: replace(side, lost="nobody publishes it"),
    "FAULT": lambda side, now: replace(side, status=Status(OperatingState.FAULT, True)),
    "not been heard": lambda side, now: replace(side, joint=replace(side.joint, since=now - 0.6)),
    "no valid measured_js": lambda side, now: replace(side, joint=None),
    "no position of one joint": lambda side, now: replace(
        side, joint=Heard(JointState(vector((math.nan,))), now)
    ),
}


@pytest.mark.parametrize(("which", "name"), [("leader_gripper", "hand"), ("jaw", "arm")])
@pytest.mark.parametrize("what", LOST)
def test_a_gripper_or_a_jaw_that_is_lost_holds_both(which: str, name: str, what: str) -> None:
    hand = hand_of()
    hand.engage()
    heard = hand.inputs()
    side: Side = LOST[what](getattr(heard, which), hand.now)
    commands = hand.step(replace(heard, **{which: side}))
    assert hand.coupled.phase is Phase.HELD
    assert hand.coupled.trouble.startswith(f"{name}/gripper ")
    assert what in hand.coupled.trouble
    assert commands.hold_follower
    assert commands.jaw is None


def test_what_the_jaw_refuses_ends_it() -> None:
    hand = hand_of()
    hand.engage()
    heard = hand.inputs()
    hand.step(replace(heard, jaw=replace(heard.jaw, refusal="not enabled")))
    assert hand.coupled.trouble == "arm/gripper refused: not enabled"


def test_without_a_gripper_in_the_settings_none_is_looked_at() -> None:
    hand = Hand(settings_of())
    hand.engage()
    hand.step(replace(hand.inputs(), jaw=Side("gone"), leader_gripper=Side("gone")))
    assert hand.coupled.phase is Phase.FOLLOWING


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"leader_open": 0.5}, "one and the same"),
        ({"follower_closed": OPEN}, "one and the same"),
        ({"speed": 0.0}, "greater than 0"),
        ({"leader_open": math.nan}, "finite number"),
        ({"follower": "Jaw!"}, "pattern"),
    ],
)
def test_settings_that_lead_nowhere_are_refused(wrong: dict[str, Any], text: str) -> None:
    with pytest.raises(ValidationError, match=text):
        settings_of(gripper={**GRIPPER, **wrong})
