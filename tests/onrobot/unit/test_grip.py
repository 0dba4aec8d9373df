"""When a command goes out, when it counts as taken, and what the fingers then do."""

from __future__ import annotations

import pytest

from crtk_driver_onrobot.grip import EDGE, LAG, STUCK, TRIES, Grip
from crtk_driver_onrobot.registers import Command
from crtk_drivers.kit.gripping import Doing


def to(opening: float) -> Command:
    return Command(0, b"", opening)


def stopping() -> Command:
    return Command(2, b"")


@pytest.fixture
def grip() -> Grip:
    """Fingers that rest at 50 mm."""
    made = Grip(stopping, inside=False)
    made.see(0.05, 0.0, busy=False, grips=False)
    return made


def send(grip: Grip, opening: float, now: float) -> Command:
    """Have a command acknowledged."""
    command = to(opening)
    grip.go(command, now, at_once=True)
    assert grip.next is command
    grip.delivered(command, now)
    return command


def test_a_motion_is_done_when_busy_has_come_and_gone(grip: Grip) -> None:
    send(grip, 0.02, 1.0)
    grip.see(0.05, 1.01, busy=False, grips=False)
    assert not grip.rests, "busy comes later than the command"
    grip.see(0.04, 1.05, busy=True, grips=False)
    assert grip.doing is Doing.MOVING
    grip.see(0.02, 1.2, busy=False, grips=False)
    assert grip.rests
    assert grip.doing is Doing.THERE


def test_a_motion_that_was_too_short_to_be_seen_is_done_all_the_same(grip: Grip) -> None:
    send(grip, 0.0501, 1.0)
    grip.see(0.0501, 1.0 + 2 * LAG, busy=False, grips=False)
    assert grip.rests
    assert grip.doing is Doing.THERE


def test_a_command_waits_while_they_are_busy(grip: Grip) -> None:
    grip.see(0.05, 1.0, busy=True, grips=False)
    command = to(0.02)
    grip.go(command, 1.0, at_once=False)
    assert grip.next is None
    grip.see(0.05, 1.1, busy=False, grips=False)
    assert grip.next is command


def test_a_motion_is_stopped_for_one_that_shall_begin_at_once(grip: Grip) -> None:
    send(grip, 0.02, 1.0)
    grip.see(0.04, 1.05, busy=True, grips=False)
    command = to(0.06)
    grip.go(command, 1.1, at_once=True)
    halt = grip.next
    assert halt is not None
    assert halt.opening is None
    grip.delivered(halt, 1.1)
    assert grip.next is None, "it is still busy"
    grip.see(0.035, 1.15, busy=False, grips=False)
    assert grip.next is command


def test_an_ignored_command_is_not_sent_again_after_a_stop(grip: Grip) -> None:
    """Its effect is missed between the stop and its acknowledgement."""
    command = send(grip, 0.02, 1.0)
    halt = grip.stop(1.0 + 0.9 * EDGE)
    assert halt is not None
    grip.see(0.05, 1.0 + 1.1 * EDGE, busy=False, grips=False)
    assert grip.next is halt
    grip.delivered(halt, 1.0 + 1.2 * EDGE)
    grip.see(0.05, 1.0 + 2.0 * EDGE, busy=False, grips=False)
    assert grip.next is not command
    assert grip.next is None
    assert grip.rests


def test_an_ignored_command_is_sent_again_and_then_given_up(grip: Grip) -> None:
    command, now = send(grip, 0.02, 1.0), 1.0
    for _ in range(TRIES - 1):
        now += 1.1 * EDGE
        grip.see(0.05, now, busy=False, grips=False)
        assert grip.next is command
        grip.delivered(command, now)
    now += 1.1 * EDGE
    grip.see(0.05, now, busy=False, grips=False)
    assert grip.next is None
    assert "no command" in grip.refused
    assert grip.ignored == TRIES


def test_a_newer_command_takes_the_place_of_an_ignored_one(grip: Grip) -> None:
    send(grip, 0.02, 1.0)
    newer = to(0.03)
    grip.go(newer, 1.1, at_once=False)
    grip.see(0.05, 1.0 + 1.1 * EDGE, busy=False, grips=False)
    assert grip.next is newer


def held(grip: Grip) -> None:
    send(grip, 0.0, 1.0)
    grip.see(0.04, 1.1, busy=True, grips=False)
    grip.see(0.03, 1.3, busy=False, grips=True)
    assert grip.doing is Doing.HOLDS


def test_an_ignored_opening_is_not_taken_for_done_because_it_still_grips(grip: Grip) -> None:
    held(grip)
    command = send(grip, 0.06, 2.0)
    grip.see(0.03, 2.0 + 2 * LAG, busy=False, grips=True)
    assert not grip.rests
    grip.see(0.03, 2.0 + 1.1 * EDGE, busy=False, grips=True)
    assert grip.next is command


def test_gripping_again_what_is_gripped_is_done(grip: Grip) -> None:
    held(grip)
    send(grip, 0.0, 2.0)
    grip.see(0.03, 2.0 + 2 * LAG, busy=False, grips=True)
    assert grip.rests
    assert grip.doing is Doing.HOLDS


def test_what_is_gone_is_told_until_the_next_command(grip: Grip) -> None:
    held(grip)
    grip.see(0.03, 2.0, busy=True, grips=False)
    grip.see(0.0, 2.2, busy=False, grips=False)
    assert grip.doing is Doing.LOST
    assert not grip.taken_over
    send(grip, 0.05, 3.0)
    assert grip.doing is Doing.MOVING


def test_letting_go_by_command_loses_nothing(grip: Grip) -> None:
    held(grip)
    send(grip, 0.05, 2.0)
    grip.see(0.035, 2.1, busy=True, grips=False)
    grip.see(0.05, 2.3, busy=False, grips=False)
    assert grip.doing is Doing.THERE


@pytest.mark.parametrize("holds", [True, False])
def test_a_motion_of_nobody_here_is_another_program(grip: Grip, holds: bool) -> None:
    if holds:
        held(grip)
    grip.see(0.04, 2.0, busy=True, grips=False)
    grip.see(0.05, 2.1, busy=True, grips=False)
    assert grip.taken_over
    grip.adopt()
    assert not grip.taken_over


def test_a_stop_between_a_command_and_its_busy_is_sent_again(grip: Grip) -> None:
    """The first one was ignored: they did not move yet."""
    send(grip, 0.02, 1.0)
    first = grip.stop(1.01)
    assert first is not None
    grip.delivered(first, 1.01)
    grip.see(0.05, 1.02, busy=True, grips=False)
    grip.see(0.049, 1.01 + 1.5 * LAG, busy=True, grips=False)
    second = grip.next
    assert second is not None
    assert second is not first
    grip.delivered(second, 1.3)
    grip.see(0.045, 1.35, busy=False, grips=False)
    assert grip.rests
    assert grip.doing is Doing.STOPPED
    assert not grip.taken_over


def test_a_stop_at_rest_sends_nothing(grip: Grip) -> None:
    held(grip)
    assert grip.stop(2.0) is None
    assert grip.rests


def test_a_stop_follows_a_command_of_which_nobody_knows_whether_it_came(grip: Grip) -> None:
    """Its acknowledgement was late or lost: that it rests now says nothing."""
    command = to(0.02)
    grip.go(command, 1.0, at_once=True)
    grip.tried(command)
    halt = grip.stop(1.01)
    assert halt is not None
    grip.see(0.05, 1.02, busy=False, grips=False)
    assert not grip.rests
    assert grip.next is halt
    grip.see(0.049, 1.03, busy=True, grips=False)
    assert not grip.taken_over, "it is ours"
    grip.delivered(halt, 1.04)
    assert not grip.rests
    grip.see(0.048, 1.05, busy=False, grips=False)
    assert grip.rests


def test_what_stays_busy_is_told(grip: Grip) -> None:
    send(grip, 0.02, 1.0)
    grip.see(0.04, 1.1, busy=True, grips=False)
    grip.go(to(0.06), 1.2, at_once=True)
    halt = grip.next
    assert halt is not None
    grip.delivered(halt, 1.2)
    grip.see(0.04, 1.3 + STUCK, busy=True, grips=False)
    assert "stays busy" in grip.refused


def test_what_is_found_gripped_is_known() -> None:
    grip = Grip(stopping, inside=False)
    grip.see(0.03, 0.0, busy=False, grips=True)
    assert grip.doing is Doing.HOLDS


def test_a_command_that_came_while_they_had_begun_to_move_by_themselves_is_sent_again(
    grip: Grip,
) -> None:
    """As after an object was lost: they go on to where they were sent before, and ignore it."""
    command = send(grip, 0.06, 1.0)
    grip.see(0.048, 1.02, busy=True, grips=False)
    grip.see(0.02, 1.2, busy=False, grips=False)
    assert grip.next is command
    assert grip.ignored == 1


def test_a_motion_that_somebody_stops_is_not_begun_again(grip: Grip) -> None:
    send(grip, 0.02, 1.0)
    grip.see(0.045, 1.05, busy=True, grips=False)
    grip.see(0.04, 1.1, busy=False, grips=False)
    assert grip.next is None
    assert grip.doing is Doing.STOPPED
