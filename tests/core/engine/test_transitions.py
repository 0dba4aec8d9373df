"""State commands while they are carried out."""

import sys
import threading
from collections.abc import Iterator

import pytest

from crtk_drivers.device import Condition, Steps
from crtk_drivers.engine import Observer
from crtk_drivers.errors import CommandRefused, DeviceFault, Reason, TransitionFailed
from crtk_drivers.samples import Stamp
from crtk_drivers.state import OperatingState, StateCommand, Status
from rigs.scripted_engine import Rig, ScriptedDevice, jp, jv, two_joints

S = OperatingState


def for_ever() -> Steps:
    while True:
        yield


def cycles(count: int) -> Steps:
    for _ in range(count):
        yield


def raising(error: Exception) -> Steps:
    yield
    raise error


def test_what_a_command_ended_in_is_known_after_the_device_has_told_less() -> None:
    rig = Rig().connect()
    fault = DeviceFault("overload", remedy="Switch its supply off and on.")
    rig.device.procedures["enable"] = lambda: raising(fault)
    rig.engine.state_command("enable")
    rig.cycle(2)
    rig.device.reported = Condition(S.FAULT, "overload")
    rig.cycle(3)
    assert rig.engine.status.detail == "overload"
    assert rig.engine.transition_outcome.remedy == "Switch its supply off and on."
    rig.device.reported = Condition()
    rig.device.procedures.clear()
    rig.engine.state_command("enable")
    rig.cycle(3)
    assert rig.engine.transition_outcome.state is S.ENABLED
    rig.engine.state_command("enable")
    assert rig.engine.transition_outcome is rig.engine.status, "there is nothing to do"


def test_the_reached_state_is_announced_when_it_is_reached_and_not_before() -> None:
    rig = Rig().connect()
    rig.device.procedures["enable"] = lambda: cycles(5)
    rig.command("enable")
    for _ in range(4):
        assert rig.state is S.DISABLED
        assert not rig.engine.transition_ended
        rig.cycle()
    rig.cycle()
    assert rig.state is S.ENABLED
    assert rig.engine.transition_ended
    assert rig.told.states == [S.DISABLED, S.ENABLED]


def test_motion_and_state_commands_are_refused_meanwhile() -> None:
    rig = Rig().enabled()
    rig.device.procedures["pause"] = lambda: cycles(5)
    rig.command("pause")
    refusal = rig.refused("servo_jp", jp(0.0, 0.0))
    assert refusal.reason is Reason.TRANSITION_RUNNING
    assert "pause is running" in refusal.message
    for text in ("enable", "resume", "home"):
        with pytest.raises(CommandRefused, match="pause is running") as caught:
            rig.engine.state_command(text)
        assert caught.value.reason is Reason.TRANSITION_RUNNING
    rig.engine.state_command("pause")  # a stop is never refused
    rig.cycle(5)
    assert rig.state is S.PAUSED


@pytest.mark.parametrize(
    ("commands", "states"),
    [
        (["enable"], [S.ENABLED]),
        (["disable"], [S.DISABLED]),
        (["enable", "enable"], [S.ENABLED, S.ENABLED]),
        (["enable", "pause", "pause", "resume"], [S.ENABLED, S.PAUSED, S.PAUSED, S.ENABLED]),
        (["enable", "pause", "disable"], [S.ENABLED, S.PAUSED, S.DISABLED]),
        (["enable", "home"], [S.ENABLED, S.ENABLED, S.ENABLED]),  # busy, and done
        (["unhome"], [S.DISABLED]),
    ],
)
def test_every_state_command_is_answered_with_the_state(
    commands: list[str], states: list[OperatingState]
) -> None:
    rig = Rig(capabilities=two_joints(needs_homing=True)).connect()
    before = len(rig.told.statuses)
    for command in commands:
        rig.command(command)
    assert rig.told.states[before:] == states


def test_a_transition_that_does_not_end_is_a_fault_after_its_time() -> None:
    rig = Rig(capabilities=two_joints(transition_timeout=1.0)).connect()
    closed: list[bool] = []

    def hanging() -> Iterator[None]:
        try:
            while True:
                yield
        finally:
            closed.append(True)

    rig.device.procedures["enable"] = hanging  # type: ignore[assignment]
    rig.command("enable")
    rig.cycle(99)
    assert rig.state is S.DISABLED
    rig.cycle(3)
    assert rig.state is S.FAULT
    assert rig.engine.status.detail == "enable did not finish in 1 s"
    assert closed == [True]
    assert rig.engine.transition_ended


def test_disable_replaces_an_enable_that_hangs_and_closes_it_in_the_io_thread() -> None:
    rig = Rig().connect()
    closed: list[bool] = []

    def hanging() -> Iterator[None]:
        try:
            while True:
                yield
        finally:
            closed.append(True)

    rig.device.procedures["enable"] = hanging  # type: ignore[assignment]
    rig.command("enable")
    rig.cycle(5)
    rig.engine.state_command("disable")
    assert closed == [], "not in the client's thread"
    rig.cycle()
    assert closed == [True]
    assert rig.state is S.DISABLED
    assert rig.engine.transition_ended
    assert rig.device.calls == ["open", "enable", "disable"]


def test_disable_is_not_lost_if_the_enable_that_it_replaces_fails_at_that_moment() -> None:
    rig = Rig().connect()

    def interrupted() -> Steps:
        yield
        rig.engine.state_command("disable")  # another thread, in the midst of the step
        raise TransitionFailed("no power")

    rig.device.procedures["enable"] = interrupted
    rig.command("enable")
    rig.cycle(2)
    assert rig.state is S.DISABLED
    assert rig.device.calls[-1] == "disable"


def test_a_second_disable_does_not_start_it_again() -> None:
    rig = Rig().enabled()
    rig.device.procedures["disable"] = lambda: cycles(9)
    for _ in range(4):
        rig.command("disable")
    rig.cycle(5)
    assert rig.state is S.DISABLED
    assert rig.device.calls.count("disable") == 1


def test_enable_waits_for_a_disable_that_changes_nothing() -> None:
    rig = Rig().connect()
    rig.device.procedures["disable"] = lambda: cycles(3)
    rig.engine.state_command("disable")
    rig.engine.state_command("enable")
    rig.cycle(2)
    assert rig.state is S.DISABLED
    rig.cycle(5)
    assert rig.state is S.ENABLED
    assert not rig.told.refusals
    rig.command("disable")
    rig.cycle(5)
    rig.engine.state_command("disable")
    rig.engine.state_command("enable")
    rig.engine.state_command("disable")  # the newest counts
    rig.cycle(10)
    assert rig.state is S.DISABLED


def test_disable_is_carried_out_in_every_state() -> None:
    """After a connection DISABLED says nothing of the hardware: there may be power, and torque."""
    rig = Rig()
    type(rig.device).found = property(lambda self: "torque is on")  # type: ignore[method-assign,assignment]
    try:
        rig.connect()
    finally:
        del type(rig.device).found
    assert (rig.state, rig.engine.status.detail) == (S.DISABLED, "torque is on")
    rig.command("disable")
    assert rig.device.calls[-1] == "disable"
    assert not rig.engine.status.detail, "it is not so any more"
    assert rig.state is S.DISABLED


def test_an_alarm_in_the_midst_of_a_step_wins() -> None:
    rig = Rig().connect()

    def alarmed() -> Steps:
        yield
        rig.engine.alarm("stuck")

    rig.device.procedures["enable"] = alarmed
    rig.command("enable")
    rig.cycle(3)
    assert (rig.state, rig.engine.status.detail) == (S.FAULT, "stuck")


@pytest.mark.parametrize("error", [DeviceFault("brake stuck"), TransitionFailed("no power")])
def test_a_transition_that_fails_is_a_fault_with_the_reason(error: Exception) -> None:
    rig = Rig().connect()
    rig.device.procedures["enable"] = lambda: raising(error)
    rig.command("enable")
    rig.cycle(2)
    assert rig.state is S.FAULT
    assert rig.engine.status.detail == f"enable: {error}"
    del rig.device.procedures["enable"]
    rig.cycle(20)
    assert rig.state is S.FAULT
    rig.command("enable")
    assert rig.state is S.ENABLED, "enable is a retry"
    assert rig.engine.status.detail == ""


def test_a_transition_that_is_refused_leaves_the_state() -> None:
    rig = Rig().connect()
    refusal = CommandRefused("state_command", Reason.LOCAL_CONTROL, "pendant has control")
    rig.device.procedures["enable"] = lambda: raising(refusal)
    before = len(rig.told.statuses)
    rig.command("enable")
    rig.cycle(2)
    assert rig.state is S.DISABLED
    assert [(told.reason, told.detail) for told in rig.told.refusals] == [
        (refusal.reason, refusal.detail)
    ]
    assert rig.told.states[before:] == [S.DISABLED]


def test_refusal_carries_the_refused_state_command() -> None:
    rig = Rig()

    def refused(command: str) -> tuple[str, Reason]:
        with pytest.raises(CommandRefused) as caught:
            rig.engine.state_command(command)
        assert rig.told.refusals[-1].state_command == caught.value.state_command
        return caught.value.state_command, caught.value.reason

    assert refused("enable") == ("enable", Reason.NOT_CONNECTED)
    assert refused("up" * 100) == (("up" * 100)[:80], Reason.UNKNOWN_COMMAND)
    rig.connect()
    assert refused("resume") == ("resume", Reason.INVALID_TRANSITION)
    assert refused("unhome") == ("unhome", Reason.NO_EFFECT)
    refusal = CommandRefused("state_command", Reason.LOCAL_CONTROL, "pendant has control")
    rig.device.procedures["enable"] = lambda: raising(refusal)
    rig.command("enable")
    rig.cycle(2)
    assert rig.told.refusals[-1].state_command == "enable"
    with pytest.raises(CommandRefused) as caught:
        rig.engine.submit("move_jp", None)
    assert caught.value.state_command == ""


@pytest.mark.parametrize("command", ["disable", "pause", "home"])
def test_motion_is_stopped_before_the_procedure_begins(command: str) -> None:
    rig = Rig(capabilities=two_joints(needs_homing=True)).enabled()
    rig.engine.submit("servo_jv", jv(0.1, 0.0))
    rig.cycle()
    rig.command(command)
    assert rig.device.calls[-2:] == ["stop", command]
    rig.cycle(30)
    assert rig.engine.health().stream_timeouts == 0


def test_homing_that_fails_or_hangs_is_stopped() -> None:
    for procedure in (for_ever, lambda: raising(DeviceFault("no index mark"))):
        rig = Rig(capabilities=two_joints(needs_homing=True)).enabled()
        rig.device.procedures["home"] = procedure
        rig.command("home")
        rig.cycle(110)
        assert rig.state is S.FAULT
        assert rig.device.calls[-1] == "stop"
        assert not rig.engine.status.is_busy


def test_homing_sets_is_homed_and_is_busy_meanwhile() -> None:
    rig = Rig(capabilities=two_joints(needs_homing=True)).enabled()
    assert not rig.engine.status.is_homed
    before = len(rig.told.statuses)
    rig.device.procedures["home"] = lambda: cycles(3)
    rig.command("home")
    rig.cycle(4)
    assert rig.told.busy[before:] == [True, False]
    assert rig.engine.status.is_homed
    rig.command("unhome")
    assert not rig.engine.status.is_homed


@pytest.mark.parametrize("needs_homing", [False, True])
def test_home_has_nothing_to_do_on_a_homed_device_and_disturbs_nothing(needs_homing: bool) -> None:
    rig = Rig(capabilities=two_joints(needs_homing=needs_homing))
    rig.device.homed = needs_homing
    rig.enabled()
    move = rig.engine.submit("move_jp", jp(0.3, 0.0))
    rig.cycle(3)
    before = len(rig.told.statuses)
    rig.engine.state_command("home")
    assert rig.told.states[before:] == [S.ENABLED], "it is answered at once"
    assert rig.engine.transition_ended
    rig.cycle(200)
    assert move is not None
    assert move.wait(0.0), "and the move goes on"
    assert "home" not in rig.device.calls
    rig.engine.state_command("pause")
    rig.cycle(2)
    with pytest.raises(CommandRefused, match="home is invalid in PAUSED"):
        rig.engine.state_command("home")


def test_home_and_enable_have_nothing_to_add_to_what_leads_there() -> None:
    rig = Rig(capabilities=two_joints(needs_homing=True))
    rig.device.homed = True
    rig.connect()
    rig.device.procedures["enable"] = lambda: cycles(3)
    rig.command("enable")
    rig.engine.state_command("home")
    rig.cycle(5)
    assert rig.state is S.ENABLED
    rig.command("unhome")
    rig.device.procedures["home"] = lambda: cycles(3)
    rig.command("home")
    rig.engine.state_command("enable")
    rig.cycle(5)
    assert rig.engine.status.is_homed
    assert rig.told.refusals == []


def test_home_waits_for_no_unhome_that_runs() -> None:
    rig = Rig(capabilities=two_joints(needs_homing=True))
    rig.device.homed = True
    rig.enabled()
    rig.device.procedures["unhome"] = lambda: cycles(3)
    rig.command("unhome")
    with pytest.raises(CommandRefused, match="unhome is running"):
        rig.engine.state_command("home")


def test_unhome_says_why_it_has_no_effect() -> None:
    rig = Rig().enabled()
    stops = rig.device.calls.count("stop")
    with pytest.raises(CommandRefused, match="needs no homing") as caught:
        rig.engine.state_command("unhome", 7)
    assert (caught.value.reason, caught.value.stamp_ns) == (Reason.NO_EFFECT, 7)
    rig.cycle(3)
    assert rig.device.calls.count("stop") == stops
    assert not rig.engine.status.is_busy


def test_a_command_whose_procedure_is_refused_or_had_no_effect_is_told_with_its_stamp(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = Rig(capabilities=two_joints(needs_homing=True))
    rig.device.homed = True
    rig.enabled()
    refusal = CommandRefused("state_command", Reason.LOCAL_CONTROL, "pendant has control")
    rig.device.procedures["unhome"] = lambda: raising(refusal)
    rig.engine.state_command("unhome", 11)
    rig.cycle(4)
    (told,) = rig.told.refusals
    assert (told.reason, told.detail) == (refusal.reason, refusal.detail)
    assert (told.stamp_ns, told.where) == (11, rig.engine.where)
    assert (refusal.stamp_ns, refusal.where) == (0, ""), "what the device raised is as it was"
    del rig.device.procedures["unhome"]
    monkeypatch.setattr(ScriptedDevice, "is_homed", True)
    rig.engine.state_command("unhome", 12)
    rig.cycle(4)
    assert rig.engine.status.is_homed
    assert rig.told.refusals[-1].reason is Reason.NO_EFFECT
    assert "is homed still" in str(rig.told.refusals[-1])
    assert rig.told.refusals[-1].stamp_ns == 12
    assert not rig.engine.status.is_busy
    assert rig.state is S.ENABLED


def test_unhome_keeps_the_reason_of_a_fault() -> None:
    rig = Rig(capabilities=two_joints(needs_homing=True))
    rig.device.homed = True
    rig.enabled()
    rig.engine.alarm("stuck")
    rig.command("unhome")
    rig.cycle()
    assert (rig.state, rig.engine.status.detail) == (S.FAULT, "stuck")
    assert not rig.engine.status.is_homed


@pytest.mark.parametrize("running", ["pause", "resume", "home", "unhome"])
def test_pause_ends_whatever_goes_on(running: str) -> None:
    rig = Rig(capabilities=two_joints(needs_homing=True))
    rig.device.homed = running == "unhome"
    rig.enabled()
    if running == "resume":
        rig.command("pause")
    rig.device.procedures[running] = lambda: cycles(5)
    rig.command(running)
    rig.engine.state_command("pause")
    rig.cycle(8)
    assert rig.state is S.PAUSED
    assert rig.engine.transition_ended
    told = [(refusal.reason, refusal.detail) for refusal in rig.told.refusals]
    broken_off = (Reason.FAILED, f"{running}: broken off by pause")  # for its sender
    assert told == ([] if running == "pause" else [broken_off])


def test_hold_is_never_refused_while_the_state_changes() -> None:
    rig = Rig().enabled()
    refused: list[CommandRefused] = []
    ended = threading.Event()

    def hold() -> None:
        while not ended.is_set():
            try:
                rig.engine.submit("hold")
            except CommandRefused as refusal:
                refused.append(refusal)

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    thread = threading.Thread(target=hold)
    thread.start()
    try:
        for _ in range(400):
            rig.command("pause")
            rig.command("resume")
    finally:
        ended.set()
        thread.join()
        sys.setswitchinterval(interval)
    assert refused == []


@pytest.mark.parametrize("way", ["disconnect", "shut_down"])
def test_a_procedure_that_is_ended_cleans_up_before_the_device_is_closed(way: str) -> None:
    rig = Rig().connect()

    def with_an_end() -> Steps:
        try:
            yield from for_ever()
        finally:
            rig.device.calls.append("cleaned up")

    rig.device.procedures["enable"] = with_an_end
    rig.command("enable")
    if way == "disconnect":
        rig.disconnect("the link is gone")
    else:
        rig.engine.shut_down()
    assert rig.device.calls[-2:] == ["cleaned up", "close"]


def test_what_was_asked_for_while_the_link_was_being_lost_is_not_done_after_it() -> None:
    rig = Rig().enabled()

    class EnablesAtOnce(Observer):
        def status_changed(self, status: Status, stamp: Stamp) -> None:
            if status.state is S.FAULT:
                rig.engine._transitions.accept(StateCommand.ENABLE)

    rig.engine.add_observer(EnablesAtOnce())
    rig.disconnect("the link is gone")
    rig.engine.connect(rig.clock() + 1.0)
    rig.cycle(10)
    assert rig.state is S.DISABLED
    assert rig.engine.transition_ended


def test_a_stop_that_fails_again_and_again_in_fault_is_announced_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(ScriptedDevice, "has_stopped", False)
    rig = Rig().enabled()
    rig.servo(0.01, 0.0)
    rig.cycle()
    rig.device.fail["stop"] = DeviceFault("the brake does not answer")
    rig.device.reported = Condition(S.FAULT, "bumped")
    rig.cycle(100)
    assert rig.device.calls.count("stop") > 10
    assert len(rig.told.states) <= 4
    assert rig.state is S.FAULT
