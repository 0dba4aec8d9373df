"""Moves, cycle by cycle, on a clock of its own."""

import itertools
import threading

import numpy as np
import pytest

from crtk_drivers.device import Condition
from crtk_drivers.engine import EngineOptions
from crtk_drivers.errors import (
    CommandRefused,
    DeviceFault,
    MotionAborted,
    Reason,
)
from crtk_drivers.motion.move import Outcome
from crtk_drivers.samples import JointState, Sample, Stamp, vector
from crtk_drivers.state import OperatingState
from rigs.scripted_engine import PERIOD, Rig, jf, jp, two_joints
from rigs.waiting import LONG

S = OperatingState


def test_a_move_raises_busy_reaches_its_goal_and_latches_it() -> None:
    rig = Rig().enabled()
    move = rig.engine.submit("move_jp", jp(0.1, -0.1))
    assert move is not None
    assert rig.engine.status.is_busy
    assert rig.told.goals == ["goal_js", "goal_cp"]
    rig.cycle(100)
    assert move.wait(0.0)
    assert not rig.engine.status.is_busy
    assert rig.written[-1].values.tolist() == [0.1, -0.1]
    found = rig.engine.latched("goal_js")
    assert found is not None
    assert isinstance(found[0], JointState)
    assert found[0].position.tolist() == [0.1, -0.1]
    assert found[0].name == ("slide", "turn")
    assert found[1].wall_ns != 0


def test_busy_rises_and_falls_for_a_move_that_goes_nowhere_and_for_one_that_is_refused() -> None:
    rig = Rig().enabled()
    before = len(rig.told.statuses)
    rig.engine.submit("move_jp", jp(0.0, 0.0))
    rig.cycle(2)
    assert rig.told.busy[before:] == [True, False]
    with pytest.raises(CommandRefused):
        rig.engine.submit("move_jp", jp(9.0, 0.0))
    assert rig.told.busy[before:] == [True, False, True, False]


def test_every_announcement_has_a_later_stamp_than_the_one_before() -> None:
    rig = Rig().enabled()
    for _ in range(20):
        rig.engine.submit("move_jp", jp(0.0, 0.0))
        rig.cycle(2)
        with pytest.raises(CommandRefused):
            rig.engine.submit("move_jp", jp(9.0, 0.0))
        rig.engine.state_command("enable")
    stamps = [stamp.wall_ns for _, stamp in rig.told.statuses]
    assert len(stamps) > 80
    assert all(later > earlier for earlier, later in itertools.pairwise(stamps))


@pytest.mark.parametrize("cycles", [0, 5])
@pytest.mark.parametrize(
    ("name", "value"),
    [("servo_jp", None), ("hold", None), ("free", None), ("move_jp", jp(-0.1, 0.0))],
)
def test_what_pre_empts_a_move_ends_its_handle_and_leaves_busy_right(
    name: str, value: object, cycles: int
) -> None:
    rig = Rig().enabled()
    move = rig.engine.submit("move_jp", jp(0.2, 0.0))
    assert move is not None
    rig.cycle(cycles)  # it waits, or it runs
    if name == "servo_jp":
        value = JointState(position=rig.value("setpoint_js")[0].position)
    second = rig.engine.submit(name, value)  # type: ignore[arg-type]
    rig.cycle()
    assert move.outcome is Outcome.PREEMPTED
    with pytest.raises(MotionAborted, match=f"pre-empted: by {name}"):
        move.wait(0.0)
    assert rig.engine.status.is_busy is (second is not None)
    rig.cycle(100)
    assert not rig.engine.status.is_busy


def test_a_move_accepted_as_the_one_before_ends_keeps_busy_up_in_between() -> None:
    rig = Rig().enabled()
    first = rig.engine.submit("move_jp", jp(0.0, 0.0))
    assert first is not None
    announced = len(rig.told.statuses)
    finish = first.finish

    def accept_the_next(outcome: Outcome, reason: str = "") -> None:
        rig.engine.submit("move_jp", jp(0.1, 0.0))
        finish(outcome, reason)

    first.finish = accept_the_next  # type: ignore[method-assign]
    rig.cycle()
    assert first.wait(0.0)
    assert rig.engine.status.is_busy
    rig.cycle(100)
    assert rig.told.busy[announced:] == [False]


def test_an_effort_is_let_go_when_nobody_sees_any_more_where_it_takes_the_joints() -> None:
    rig = Rig().enabled()
    rig.engine.submit("servo_jf", jf(1.0, 0.0))
    rig.cycle()
    rig.device.silent = True
    rig.device.calls.clear()
    for _ in range(round(0.15 / PERIOD)):
        rig.engine.submit("servo_jf", jf(1.0, 0.0))
        rig.cycle()
    assert "stop" in rig.device.calls
    assert {told.reason for told in rig.told.refusals} == {Reason.NOT_MEASURED}
    written = len(rig.device.written)
    rig.engine.submit("servo_jf", jf(1.0, 0.0))
    rig.cycle(3)
    assert len(rig.device.written) == written, "none is sent until joints are measured again"
    rig.device.silent = False
    rig.cycle(20)
    rig.engine.submit("servo_jf", jf(0.5, 0.0))
    rig.cycle()
    assert rig.device.written[-1].values.tolist() == [0.5, 0.0]


@pytest.mark.parametrize("what", ["poses alone", "what was read last, as invalid"])
def test_a_sample_without_new_joints_does_not_show_where_an_effort_takes_them(
    monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    rig = Rig().enabled()
    last = rig.device.read(0.0)
    assert last is not None

    def read(_: float) -> Sample:
        now = rig.clock.stamp()
        if what == "poses alone":
            return Sample(now, {"measured_cp": last.values["measured_cp"]})
        return Sample(Stamp(0, now.monotonic), last.values)

    monkeypatch.setattr(rig.device, "read", read)
    for _ in range(round(0.15 / PERIOD)):
        rig.engine.submit("servo_jf", jf(1.0, 0.0))
        rig.cycle()
    assert "stop" in rig.device.calls
    assert {told.reason for told in rig.told.refusals} == {Reason.NOT_MEASURED}


def test_how_far_an_unseen_joint_may_have_gone_on_counts_towards_the_end_of_its_range(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = Rig().enabled()
    upper = rig.device.capabilities.limits[0].upper
    seen = JointState(vector((upper - 0.16, 0.0)), vector((0.5, 0.0)))
    stamp = rig.clock.stamp()
    monkeypatch.setattr(rig.device, "read", lambda _: Sample(stamp, {"measured_js": seen}))
    rig.engine.submit("servo_jf", jf(0.0, 0.0))
    rig.cycle()
    assert not rig.told.refusals
    rig.cycle(round(0.08 / PERIOD))
    assert [told.reason for told in rig.told.refusals] == [Reason.OUT_OF_RANGE]


def test_a_move_that_is_taken_in_the_cycle_in_which_an_effort_is_refused_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = Rig().enabled()
    rig.engine.submit("servo_jf", jf(1.0, 0.0))
    rig.cycle()
    state, stamp = JointState(vector((0.0, 0.0)), vector((5.0, 0.0))), rig.clock.stamp
    monkeypatch.setattr(rig.device, "read", lambda _: Sample(stamp(), {"measured_js": state}))
    move = rig.engine.submit("move_jp", jp(0.1, 0.0))
    assert move is not None
    rig.cycle()
    assert rig.told.refusals[-1].reason is Reason.OUT_OF_RANGE
    assert move.outcome is Outcome.ABORTED
    assert not rig.engine.status.is_busy


def test_a_move_that_ends_while_it_is_still_being_accepted_leaves_nothing_busy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = Rig().enabled()
    take, lies_there, has_cycled = rig.engine._arbiter.take, threading.Event(), threading.Event()
    here = jp(*rig.device.position)
    client = threading.Thread(target=rig.engine.submit, args=("move_jp", here))

    def accepted_so_far(name: str) -> None:
        lies_there.set()
        has_cycled.wait(0.5)  # in vain: the cycle waits for the client to have told that it is busy

    def take_it() -> object:
        client.start()
        assert lies_there.wait(LONG)
        return take()

    monkeypatch.setattr(rig.told, "latched", accepted_so_far)
    monkeypatch.setattr(rig.engine._arbiter, "take", take_it)
    rig.cycle()
    has_cycled.set()
    client.join(LONG)
    assert rig.told.busy[-2:] == [True, False]


def test_a_stream_that_replaces_a_move_before_it_begins_leaves_nothing_busy() -> None:
    rig = Rig().enabled()
    rig.engine.submit("interpolate_jp", jp(0.1, 0.0))
    rig.cycle(3)
    move = rig.engine.submit("move_jp", jp(0.2, 0.0))
    rig.engine.submit("interpolate_jp", jp(0.1, 0.0))
    rig.cycle()
    assert move is not None
    assert move.outcome is Outcome.PREEMPTED
    assert not rig.engine.status.is_busy


def test_a_move_goes_on_after_a_late_cycle_without_burst_or_jump() -> None:
    rig = Rig().enabled()
    rig.engine.submit("move_jp", jp(0.5, 0.0))
    rig.cycle(20)
    before, writes = rig.written[-1].values[0], len(rig.written)
    rig.cycle(period=0.15)
    assert len(rig.written) == writes + 1
    assert rig.written[-1].values[0] - before <= 2.0 * PERIOD * 1.0 + 1e-9
    rig.cycle(100)
    assert rig.written[-1].values.tolist() == [0.5, 0.0]


def test_a_move_of_a_device_with_few_cycles_is_not_refused_after_a_late_one() -> None:
    """Two periods further would be further than a step may be."""
    rig = Rig(EngineOptions(), two_joints(rate=30.0)).enabled()
    move = rig.engine.submit("move_jp", jp(0.9, 0.0))
    assert move is not None
    rig.cycle(60, period=0.15)
    assert move.outcome is Outcome.REACHED


LEAVING = {
    "disable": S.DISABLED,
    "pause": S.PAUSED,
    "condition": S.FAULT,
    "alarm": S.FAULT,
    "disconnect": S.FAULT,
    "shut down": S.DISABLED,
    "fault": S.FAULT,
}


@pytest.mark.parametrize("cycles", [0, 5])
@pytest.mark.parametrize("way", LEAVING)
def test_a_move_ends_however_enabled_is_left(way: str, cycles: int) -> None:
    rig = Rig().enabled()
    move = rig.engine.submit("move_jp", jp(0.2, 0.0))
    assert move is not None
    rig.cycle(cycles)
    if way in ("disable", "pause"):
        rig.command(way)
    elif way == "condition":
        rig.device.reported = Condition(S.FAULT, "protective stop")
        rig.cycle()
    elif way == "alarm":
        rig.engine.alarm("stuck")
    elif way == "disconnect":
        rig.disconnect("lost")
    elif way == "shut down":
        rig.engine.shut_down()
    else:
        rig.device.fail["write"] = DeviceFault("overload")
        rig.cycle(2)
    assert move.outcome is Outcome.ABORTED
    assert move.reason
    with pytest.raises(MotionAborted):
        move.wait()
    assert rig.state is LEAVING[way]
    assert not rig.engine.status.is_busy
    assert "stop" in rig.device.calls


def test_no_move_is_accepted_while_enabled_is_being_left() -> None:
    """A client that is quicker than the I/O thread must not leave a move that nobody will end."""
    rig = Rig().enabled()
    end, outcomes = rig.engine._motion.end, []

    def end_and_submit(reason: str) -> None:
        end(reason)
        try:
            rig.engine.submit("move_jp", jp(0.1, 0.0))
        except CommandRefused as refusal:
            outcomes.append(refusal.reason)

    rig.engine._motion.end = end_and_submit  # type: ignore[method-assign]
    rig.device.reported = Condition(S.FAULT, "e-stop")
    rig.cycle()
    assert outcomes == [Reason.NOT_ENABLED]
    assert not rig.engine.status.is_busy


@pytest.mark.parametrize(
    "error", [DeviceFault("broken"), CommandRefused("move_jp", Reason.LOCAL_CONTROL, "pendant")]
)
def test_a_native_move_that_the_hardware_does_not_start_ends_its_handle(error: Exception) -> None:
    rig = Rig(capabilities=two_joints(native_moves=frozenset({"move_jp"}))).enabled()
    rig.device.fail["move"] = error
    move = rig.engine.submit("move_jp", jp(0.1, 0.0))
    assert move is not None
    rig.cycle()
    assert move.outcome is Outcome.ABORTED
    assert not rig.engine.status.is_busy
    assert "stop" in rig.device.calls
    assert rig.state is (S.FAULT if isinstance(error, DeviceFault) else S.ENABLED)


def test_a_move_that_is_refused_on_its_way_ends_and_is_refused_once() -> None:
    rig = Rig().enabled()
    move = rig.engine.submit("move_jp", jp(0.5, 0.0))
    assert move is not None
    rig.cycle(5)
    rig.device.fail["write"] = CommandRefused("move_jp", Reason.LOCAL_CONTROL, "pendant")
    rig.cycle(10)
    assert move.outcome is Outcome.ABORTED
    assert len(rig.told.refusals) == 1
    assert not rig.engine.status.is_busy


def test_a_move_brings_back_a_joint_that_lies_outside_its_limits() -> None:
    rig = Rig().connect()
    rig.device.position = np.array([1.5, 0.0])
    rig.cycle()
    rig.enabled()
    move = rig.engine.submit("move_jp", jp(0.5, 0.0))
    assert move is not None
    rig.cycle(400)
    assert move.wait(0.0)
    path = [1.5, *(setpoint.values[0] for setpoint in rig.written)]
    assert max(path) == 1.5
    assert max(abs(b - a) for a, b in itertools.pairwise(path)) < 2 * PERIOD


def test_a_servo_command_refused_in_the_io_thread_leaves_a_move_running() -> None:
    rig = Rig().enabled()
    move = rig.engine.submit("move_jp", jp(0.5, 0.0))
    assert move is not None
    rig.cycle(5)
    for _ in range(3):
        rig.engine.submit("servo_jr", jp(0.09, 0.0))
    rig.cycle()
    assert rig.told.refusals[-1].reason is Reason.STEP_TOO_LARGE
    rig.cycle(150)
    assert move.wait(0.0)
