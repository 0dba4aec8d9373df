"""A move that comes while a state command is carried out that leads to ENABLED."""

import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

from crtk_drivers.device import Condition, Steps
from crtk_drivers.engine import EngineOptions, intake
from crtk_drivers.errors import CommandRefused, DeviceFault, MotionAborted, Reason
from crtk_drivers.motion.move import Move, Outcome
from crtk_drivers.options import LimitPolicy
from crtk_drivers.samples import JointState, vector
from crtk_drivers.state import OperatingState
from rigs.scripted_engine import Rig, SlideAndTurn, jp, jv, pose, two_joints
from rigs.waiting import LONG

S = OperatingState
SLOW = 5
"""Cycles that a procedure takes."""


def cycles(count: int) -> Steps:
    for _ in range(count):
        yield


def waiting(command: str, *goal: float, **options: Any) -> tuple[Rig, Move]:
    """Return a device in the midst of a state command, and a move that waits for its end."""
    rig = Rig(capabilities=two_joints(needs_homing=True), **options)
    rig.connect()
    if command != "enable":
        rig.enabled()
    if command == "resume":
        rig.command("pause")
    rig.device.procedures[command] = lambda: cycles(SLOW)
    rig.command(command)
    move = rig.engine.submit("move_jp", jp(*(goal or (0.3, 0.0))), stamp_ns=5)
    assert move is not None
    return rig, move


def until(rig: Rig, done: Callable[[], bool]) -> None:
    """Let the device go on until it is so; what waited begins in a thread of its own."""
    for _ in range(3000):
        if done():
            return
        rig.cycle()
        time.sleep(0.0005)
    raise AssertionError(rig.engine.status)


@pytest.mark.parametrize("command", ["enable", "resume", "home"])
def test_it_begins_when_the_state_is_reached_and_busy_has_no_gap(command: str) -> None:
    rig, move = waiting(command)
    before = len(rig.told.statuses)
    assert rig.engine.status.is_busy
    rig.cycle(2)
    assert rig.written == []
    until(rig, lambda: not move.is_busy())
    assert move.wait(0.0)
    assert rig.device.position[0] == pytest.approx(0.3)
    assert rig.told.refusals == []
    busy = rig.told.busy[before:]
    assert busy == [True] * (len(busy) - 1) + [False], "seen as one motion"
    assert rig.engine.status.is_homed is (command == "home")


def test_an_increment_counts_from_where_the_device_is_then() -> None:
    rig = Rig(capabilities=two_joints(needs_homing=True)).enabled()

    def homing() -> Steps:
        yield
        rig.device.position[:] = (0.5, 0.0)
        yield

    rig.device.procedures["home"] = homing
    rig.servo(0.05, 0.0)
    rig.cycle()
    rig.command("home")
    move = rig.engine.submit("move_jr", JointState(position=vector((0.1, 0.0))))
    assert move is not None
    until(rig, lambda: not move.is_busy())
    assert rig.device.position[0] == pytest.approx(0.6)
    goal, _ = rig.engine.latched("goal_js") or (None, None)
    assert isinstance(goal, JointState)
    assert goal.position.tolist() == pytest.approx([0.6, 0.0])


def hold(rig: Rig) -> None:
    rig.engine.submit("hold")


def pause(rig: Rig) -> None:
    rig.engine.state_command("pause")


def disable(rig: Rig) -> None:
    rig.engine.state_command("disable")


def fault(rig: Rig) -> None:
    rig.device.reported = Condition(S.FAULT, "bumped")


def alarm(rig: Rig) -> None:
    rig.engine.alarm("late")


def lost_link(rig: Rig) -> None:
    rig.disconnect("gone")


def shut_down(rig: Rig) -> None:
    rig.engine.shut_down()


def servo(rig: Rig) -> None:
    with pytest.raises(CommandRefused, match="home is running"):
        rig.engine.submit("servo_jv", jv(0.0, 0.0))


@pytest.mark.parametrize("end", [hold, pause, disable, fault, alarm, lost_link, servo])
@pytest.mark.parametrize("cycle", [0, 3])
def test_what_ends_it_ends_it_for_good(end: Callable[[Rig], None], cycle: int) -> None:
    rig, move = waiting("home")
    rig.cycle(cycle)
    end(rig)
    if not rig.engine.connected:
        rig.engine.connect(rig.clock() + 1.0)
    until(rig, lambda: rig.engine.transition_ended)
    rig.cycle(3)
    assert move.outcome is not Outcome.RUNNING
    with pytest.raises(MotionAborted):
        move.wait(0.0)
    until(rig, lambda: not rig.engine.status.is_busy)
    rig.device.reported = Condition()
    for command in ("disable", "enable"):
        rig.engine.state_command(command)
        until(rig, lambda: rig.engine.transition_ended)
    assert rig.state is S.ENABLED
    rig.cycle(20)
    assert rig.written == [], "nothing begins late"


@pytest.mark.parametrize("end", [hold, disable])
def test_what_ends_it_while_its_way_is_looked_for_wins(
    end: Callable[[Rig], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig(capabilities=two_joints(needs_homing=True)).enabled()
    rig.device.procedures["home"] = lambda: cycles(SLOW)
    rig.command("home")
    move = rig.engine.submit("move_cp", pose(0.3))
    assert move is not None
    solve, asked, go_on = SlideAndTurn.inverse, [], threading.Event()

    def slowly(solver: SlideAndTurn, *arguments: Any) -> Any:
        asked.append(threading.current_thread())
        assert go_on.wait(LONG)
        return solve(solver, *arguments)

    monkeypatch.setattr(SlideAndTurn, "inverse", slowly)
    until(rig, lambda: bool(asked))
    end(rig)
    go_on.set()
    asked[0].join(LONG)
    until(rig, lambda: not rig.engine.status.is_busy)
    rig.cycle(20)
    assert rig.written == []
    assert move.outcome is Outcome.PREEMPTED


def assert_it_never_begins(rig: Rig, move: Move) -> None:
    assert move.outcome is Outcome.PREEMPTED
    assert not rig.engine.status.is_busy
    until(rig, lambda: rig.engine.transition_ended)
    rig.cycle(20)
    assert rig.state is S.ENABLED
    assert rig.written == []


@pytest.mark.parametrize("command", ["enable", "resume"])
def test_hold_ends_it_while_nothing_moves_yet(command: str) -> None:
    rig, move = waiting(command)
    rig.engine.submit("hold")
    assert_it_never_begins(rig, move)


def test_pause_ends_it_where_it_is_refused_too() -> None:
    """What is enabled cannot be paused yet; but who says pause wants no motion."""
    rig, move = waiting("enable")
    with pytest.raises(CommandRefused, match="pause: enable is running"):
        rig.engine.state_command("pause")
    assert_it_never_begins(rig, move)


@pytest.mark.parametrize("end", [alarm, lost_link, shut_down])
def test_who_waits_is_released_although_the_io_thread_does_nothing_more(
    end: Callable[[Rig], None],
) -> None:
    rig, move = waiting("home")
    end(rig)
    assert move.outcome is Outcome.ABORTED
    assert rig.told.refusals == []
    assert not rig.engine.status.is_busy


def test_the_next_move_takes_its_place_and_what_is_no_move_does_not() -> None:
    rig, first = waiting("home")
    before = len(rig.told.statuses)
    with pytest.raises(CommandRefused) as caught:
        rig.engine.submit("move_jp", jp(float("nan"), 0.0))
    assert caught.value.reason is Reason.NOT_FINITE
    assert first.is_busy()
    second = rig.engine.submit("move_jp", jp(-0.2, 0.0))
    assert second is not None
    assert first.outcome is Outcome.PREEMPTED
    until(rig, lambda: not second.is_busy())
    assert second.wait(0.0)
    assert rig.device.position[0] == pytest.approx(-0.2)
    assert False not in rig.told.busy[before:-1]


@pytest.mark.parametrize("error", [DeviceFault("no switch"), None])
def test_a_state_command_that_fails_or_is_refused_refuses_it(error: DeviceFault | None) -> None:
    rig = Rig().connect()
    refusal = CommandRefused("state_command", Reason.LOCAL_CONTROL, "pendant has control")

    def failing() -> Steps:
        yield from cycles(SLOW)
        raise error or refusal

    rig.device.procedures["enable"] = failing
    rig.command("enable")
    move = rig.engine.submit("move_jp", jp(0.3, 0.0), stamp_ns=5)
    assert move is not None
    until(rig, lambda: not move.is_busy())
    told = rig.told.refusals[-1]
    assert (told.command, told.reason, told.stamp_ns) == ("move_jp", Reason.NOT_ENABLED, 5)
    assert move.reason == str(told)
    until(rig, lambda: not rig.engine.status.is_busy)


def test_it_is_judged_when_it_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    options = EngineOptions(limits=LimitPolicy(max_command_age=0.5))
    rig = Rig(options, two_joints(needs_homing=True)).enabled()
    rig.device.procedures["home"] = lambda: cycles(SLOW)
    rig.command("home")
    rig.tells_time_to(intake, monkeypatch)
    stamp = rig.wall_ns()
    move = rig.engine.submit("move_jp", jp(0.3, 0.0), stamp_ns=stamp)
    assert move is not None
    rig.clock.advance(0.51)
    until(rig, lambda: not move.is_busy())
    assert rig.told.refusals[-1].reason is Reason.TOO_OLD
    assert rig.told.refusals[-1].stamp_ns == stamp
    until(rig, lambda: not rig.engine.status.is_busy)
    assert rig.written == []
