"""Scale, faults, and what a status means over time."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_robotiq.config import RobotiqConfig
from crtk_driver_robotiq.faults import CONTROLLER, GRIPPER, fault_of
from crtk_driver_robotiq.grip import LAG, Grip
from crtk_driver_robotiq.registers import Activation, Command, Contact, Status
from crtk_driver_robotiq.scale import Scale
from crtk_drivers.config import from_values, load
from crtk_drivers.errors import ConfigError
from crtk_drivers.kit.gripping import HELD, Doing, Weight
from crtk_drivers.kit.gripping.echo import OTHERS

SCALE = Scale(3, 230, 0.085, (0.02, 0.15))


def test_openings_are_those_of_the_band_and_end_with_it() -> None:
    assert SCALE.opening(3) == pytest.approx(0.085)
    assert SCALE.opening(230) == 0.0
    assert SCALE.opening(0) == pytest.approx(0.085)
    assert SCALE.opening(255) == 0.0
    assert SCALE.opening(116) == pytest.approx(0.085 * 114 / 227)


def test_at_both_ends_the_last_count_is_sent() -> None:
    assert SCALE.position(0.0) == 255
    assert SCALE.position(0.085) == 0


@given(st.floats(0.001, 0.084))
def test_an_opening_is_sent_to_half_a_count(opening: float) -> None:
    count = SCALE.position(opening)
    assert 3 <= count <= 230
    assert abs(SCALE.opening(count) - opening) <= 0.5 * SCALE.step + 1e-9


@pytest.mark.parametrize(
    ("speed", "count"), [(0.0, 0), (0.02, 0), (0.085, 128), (0.15, 255), (9.0, 255)]
)
def test_speeds_have_a_least_and_a_greatest(speed: float, count: int) -> None:
    assert SCALE.speed(speed) == count


@pytest.mark.parametrize(
    ("requested", "position", "stop"),
    [(255, 100, 104), (0, 100, 96), (102, 100, 102), (99, 100, 99), (100, 100, 100)],
)
def test_a_stop_is_ahead_of_the_fingers_and_not_beyond_their_goal(
    requested: int, position: int, stop: int
) -> None:
    assert replace(HOLDS, requested=requested, position=position).ahead(4) == stop


def test_fingers_go_on_at_the_speed_that_was_sent() -> None:
    assert SCALE.gone(255, 0.01) == 5
    assert SCALE.gone(0, 0.01) == 1
    assert SCALE.gone(0, 0.0) == 0


def test_the_fault_table_has_each_code_of_the_manual() -> None:
    assert set(GRIPPER) == {5, 7, 8, 9, *range(0xA, 0x10)}
    assert all(GRIPPER[code].weight is Weight.RESET for code in range(0xA, 0x10))
    assert set(CONTROLLER) == {4, 5, 9, 0xC, 0xE}
    assert all(
        fault.remedy for fault in (*GRIPPER.values(), *CONTROLLER.values()) if fault != GRIPPER[9]
    )


HOLDS = Status(
    activated=True,
    goes=True,
    activation=Activation.DONE,
    contact=Contact.WHILE_CLOSING,
    fault=0,
    controller_fault=0,
    requested=255,
    position=120,
    current=0.0,
)
CLOSE = Command(go=True, position=255)


def test_the_controllers_fault_counts_first_and_an_unknown_one_stops() -> None:
    assert fault_of(HOLDS) is None
    assert fault_of(replace(HOLDS, fault=0xE, controller_fault=0xC)) is CONTROLLER[0xC]
    unknown = fault_of(replace(HOLDS, fault=3))
    assert unknown is not None
    assert unknown.weight is Weight.STOPS
    assert "3" in unknown.text


def test_what_it_holds_when_a_connection_begins_is_known() -> None:
    grip = Grip()
    grip.see(HOLDS, 0.0)
    assert grip.doing is Doing.HOLDS


def test_gobj_counts_after_the_echo_only() -> None:
    """The answer to a write still shows what was before."""
    grip = Grip()
    grip.delivered(CLOSE, 0.0)
    grip.see(replace(HOLDS, requested=0, contact=Contact.AT_REQUEST), 0.01)
    assert grip.doing is Doing.MOVING


def test_gobj_may_lag_behind_the_echo() -> None:
    grip = Grip()
    grip.delivered(CLOSE, 0.0)
    late = replace(HOLDS, contact=Contact.AT_REQUEST)
    grip.see(late, 0.01)
    assert grip.doing is Doing.MOVING
    grip.see(late, LAG + 0.01)
    assert grip.doing is Doing.THERE, "a short move may never show that it moves"


def test_gobj_counts_at_once_after_motion_was_seen() -> None:
    grip = Grip()
    grip.delivered(CLOSE, 0.0)
    grip.see(replace(HOLDS, contact=Contact.MOVING), 0.02)
    grip.see(HOLDS, 0.03)
    assert grip.doing in HELD


@pytest.mark.parametrize(
    ("contact", "requested"),
    [
        (Contact.AT_REQUEST, 200),
        (Contact.WHILE_CLOSING, 0),
        (Contact.WHILE_OPENING, 200),
    ],
)
def test_end_of_the_motion_before_is_not_believed(contact: Contact, requested: int) -> None:
    """It ended as the next command came: gOBJ tells late that it moves, and then that it has ended."""
    grip = Grip()
    grip.delivered(Command(go=True, position=requested), 0.0)
    late = replace(HOLDS, requested=requested, contact=Contact.MOVING)
    grip.see(late, 0.01)
    grip.see(replace(late, contact=contact), 0.02)
    assert grip.doing is Doing.MOVING
    grip.see(replace(late, contact=contact), LAG + 0.01)
    assert grip.doing is not Doing.MOVING


def test_gobj_lags_behind_the_echo_of_others_too() -> None:
    grip = Grip()
    grip.see(replace(HOLDS, requested=10, contact=Contact.AT_REQUEST), 0.0)
    assert grip.doing is Doing.THERE
    grip.see(replace(HOLDS, contact=Contact.AT_REQUEST), 0.1)
    assert grip.doing is Doing.MOVING


def test_without_gto_gobj_does_not_count() -> None:
    grip = Grip()
    grip.see(replace(HOLDS, goes=False), 0.0)
    assert grip.doing is Doing.STOPPED
    assert grip.doing not in HELD


def test_an_object_that_is_gone_is_told_until_the_next_command() -> None:
    grip = Grip()
    grip.see(HOLDS, 0.0)
    grip.see(replace(HOLDS, contact=Contact.MOVING), 0.1)
    assert grip.doing is Doing.LOST
    grip.see(replace(HOLDS, contact=Contact.AT_REQUEST), 0.2)
    assert grip.doing is Doing.LOST
    grip.delivered(replace(CLOSE, position=0), 0.3)
    grip.see(replace(HOLDS, contact=Contact.MOVING, requested=0), 0.4)
    assert grip.doing is Doing.MOVING


def test_fingers_that_close_where_something_was_move() -> None:
    grip = Grip()
    grip.see(HOLDS, 0.0)
    assert not grip.moves
    grip.see(replace(HOLDS, contact=Contact.MOVING), 0.1)
    assert (grip.doing, grip.moves) == (Doing.LOST, True)
    grip.see(replace(HOLDS, contact=Contact.AT_REQUEST), 0.2)
    assert (grip.doing, grip.moves) == (Doing.LOST, False)


def test_letting_go_by_command_loses_nothing() -> None:
    grip = Grip()
    grip.see(HOLDS, 0.0)
    grip.delivered(replace(CLOSE, position=0), 0.1)
    for contact, at in ((Contact.MOVING, 0.2), (Contact.AT_REQUEST, 0.5)):
        grip.see(replace(HOLDS, contact=contact, requested=0), at)
        assert grip.doing is not Doing.LOST
    assert grip.doing is Doing.THERE


def test_an_echo_of_somebody_else_is_another_master() -> None:
    grip = Grip()
    grip.delivered(CLOSE, 0.0)
    other = replace(HOLDS, requested=10)
    grip.see(other, 0.1)
    assert not grip.echo.taken_over, "an echo may be late"
    grip.see(other, 0.1 + 2 * OTHERS)
    assert grip.echo.taken_over
    grip.echo.adopt()
    grip.see(other, 1.0)
    assert not grip.echo.taken_over


@pytest.mark.parametrize("reconnects", [False, True])
@pytest.mark.parametrize("newer", [1, 2, 20])
def test_any_late_command_of_ours_stays_ours(newer: int, reconnects: bool) -> None:
    """A gateway may double one of a stream, and others have come since."""
    grip, period = Grip(), 0.02
    for number in range(newer + 1):
        if reconnects and number == newer:
            grip.begin()
        grip.delivered(replace(CLOSE, position=number), number * period)
    doubled, now = replace(HOLDS, requested=0), newer * period
    grip.see(doubled, now + 0.1)
    grip.see(doubled, now + 0.1 + 2 * OTHERS)
    assert grip.echo.taken_over
    assert not grip.echo.is_others


def test_what_we_sent_long_ago_is_another_master() -> None:
    grip = Grip()
    for number, at in ((0, 0.0), (1, 1.0), (2, 2.0)):
        grip.delivered(replace(CLOSE, position=number), at)
    old = replace(HOLDS, requested=0)
    grip.see(old, 2.5)
    grip.see(old, 2.5 + 2 * OTHERS)
    assert grip.echo.is_others


def test_radians_are_a_choice() -> None:
    assert RobotiqConfig(unit="rad").travel == 0.8
    assert RobotiqConfig(model="hand-e", unit="rad", stroke=1.0).travel == 1.0
    with pytest.raises(ConfigError, match="do not turn"):
        load(RobotiqConfig, from_values({"model": "hand-e", "unit": "rad"}))


@pytest.mark.parametrize(
    "values",
    [
        {"open_count": 200, "closed_count": 100},
        {"force": 50.0},
        {"force": float("nan")},
        {"speed": 0.0},
        {"model": "3f"},
        {"port": "https://x"},
        {"address": 0},
    ],
)
def test_a_configuration_that_cannot_be_is_refused(values: dict[str, object]) -> None:
    with pytest.raises(ConfigError):
        load(RobotiqConfig, from_values(values))
