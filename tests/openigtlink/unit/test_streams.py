"""Who moves a device, among connections: by a clock that the test moves."""

from __future__ import annotations

import pytest

from crtk_drivers.commands import Command, find
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.front.openigtlink.peer_streams import SILENCE, Ownership

ONE, OTHER = "one", "other"
SERVO, MOVE, FREE = find("servo_jp"), find("move_jp"), find("free")


class Rig:
    """An ownership and its clock."""

    def __init__(self) -> None:
        self.now = 100.0
        self.it = Ownership("arm", lambda: self.now)

    def streams(self, owner: str) -> None:
        self.it.claim(owner, SERVO)
        self.it.began(owner, None)


class Moving:
    """The handle of a move."""

    def __init__(self) -> None:
        self.busy = True

    def is_busy(self) -> bool:
        return self.busy


@pytest.fixture
def rig() -> Rig:
    return Rig()


def refusal(rig: Rig, owner: str) -> Reason:
    with pytest.raises(CommandRefused) as caught:
        rig.it.claim(owner, SERVO)
    return caught.value.reason


def test_a_stream_has_an_owner_until_it_was_silent(rig: Rig) -> None:
    rig.streams(ONE)
    rig.now += 0.9 * SILENCE
    rig.streams(ONE)
    assert refusal(rig, OTHER) is Reason.STREAM_OWNED
    rig.now += 1.1 * SILENCE
    rig.streams(OTHER)
    assert refusal(rig, ONE) is Reason.STREAM_OWNED


def test_a_move_is_owned_until_it_has_ended(rig: Rig) -> None:
    move = Moving()
    rig.it.claim(ONE, MOVE)
    rig.it.began(ONE, move)
    rig.now += 100.0 * SILENCE
    assert refusal(rig, OTHER) is Reason.STREAM_OWNED
    move.busy = False
    rig.streams(OTHER)


def test_free_drive_is_owned_until_something_else_is_asked_for(rig: Rig) -> None:
    rig.it.claim(ONE, FREE)
    rig.it.began(ONE, None)
    rig.now += 1e6
    assert refusal(rig, OTHER) is Reason.STREAM_OWNED
    assert rig.it.leave(ONE)


def test_who_goes_on_after_anothers_hold_is_refused_until_it_was_silent(rig: Rig) -> None:
    rig.streams(ONE)
    rig.it.hold(OTHER)
    for _ in range(10):
        rig.now += 0.9 * SILENCE
        assert refusal(rig, ONE) is Reason.STREAM_ENDED
    rig.now += 1.1 * SILENCE
    rig.streams(ONE)


def test_after_its_own_hold_anybody_may_begin(rig: Rig) -> None:
    rig.streams(ONE)
    rig.it.hold(ONE)
    rig.streams(OTHER)


def test_who_leaves_is_to_be_held_only_while_it_moves_the_device(rig: Rig) -> None:
    assert not rig.it.leave(ONE)
    rig.streams(ONE)
    assert not rig.it.leave(OTHER)
    assert rig.it.leave(ONE)
    assert not rig.it.leave(ONE)
    rig.streams(ONE)
    rig.now += 1.1 * SILENCE
    assert not rig.it.leave(ONE)
    rig.streams(ONE)
    rig.it.hold(OTHER)
    assert not rig.it.leave(ONE)


def test_what_was_refused_is_not_held_when_its_sender_leaves(rig: Rig) -> None:
    rig.it.claim(ONE, SERVO)  # and the device says that somebody on ROS moves it
    rig.it.refused(ONE)
    assert not rig.it.leave(ONE)
    rig.streams(OTHER)


@pytest.mark.parametrize("refused", [SERVO, MOVE])
@pytest.mark.parametrize("begun", [MOVE, FREE])
def test_what_it_has_begun_is_its_own_after_a_refusal_too(
    rig: Rig, begun: Command, refused: Command
) -> None:
    rig.it.claim(ONE, begun)
    rig.it.began(ONE, Moving() if begun is MOVE else None)
    rig.it.claim(ONE, refused)  # and it is out of range
    rig.it.refused(ONE)
    rig.now += 1.1 * SILENCE
    assert refusal(rig, OTHER) is Reason.STREAM_OWNED
    assert rig.it.leave(ONE)


def test_a_hold_counts_that_came_while_something_was_refused(rig: Rig) -> None:
    rig.streams(ONE)
    rig.it.claim(ONE, SERVO)
    rig.it.hold(OTHER)
    rig.it.refused(ONE)
    assert refusal(rig, ONE) is Reason.STREAM_ENDED


def test_what_is_refused_later_gives_way_to_what_was_begun_before_and_not_to_what_came_after(
    rig: Rig,
) -> None:
    first, second, third = Moving(), Moving(), Moving()
    for move in (first, second):
        rig.it.claim(ONE, MOVE)
        rig.it.began(ONE, move)
    second.busy = False
    rig.it.refused(ONE, second)
    rig.now += 1.1 * SILENCE
    assert refusal(rig, OTHER) is Reason.STREAM_OWNED, "the first goes on"
    rig.it.claim(ONE, MOVE)
    rig.it.began(ONE, third)
    rig.it.refused(ONE, second)
    first.busy = False
    rig.now += 1.1 * SILENCE
    assert rig.it.leave(ONE), "the third goes on"
