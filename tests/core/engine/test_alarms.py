"""Conditions, faults, alarms and the end, cycle by cycle, on a clock of its own."""

import threading
from contextlib import nullcontext

import pytest

from crtk_drivers.device import Condition, Setpoint
from crtk_drivers.errors import (
    CommandRefused,
    ConnectionFailed,
    ConnectionLost,
    DeviceFault,
    MotionAborted,
)
from crtk_drivers.samples import Stamp
from crtk_drivers.state import OperatingState
from crtk_drivers.testing.clock import FakeClock
from rigs.scripted_engine import Rig, jp, jv, two_joints
from rigs.waiting import LONG

S = OperatingState


def test_the_hardware_can_only_make_the_state_worse() -> None:
    rig = Rig().enabled()
    for state in (S.PAUSED, S.DISABLED, S.FAULT):
        rig.device.reported = Condition(state, f"is {state}")
        rig.cycle()
        assert (rig.state, rig.engine.status.detail) == (state, f"is {state}")
    rig.device.reported = Condition()
    rig.cycle(50)
    assert rig.state is S.FAULT, "a fault is never cleared by itself"
    assert rig.engine.status.detail == "is FAULT"


def test_an_emergency_stop_ends_homing() -> None:
    rig = Rig(capabilities=two_joints(needs_homing=True)).enabled()
    rig.device.procedures["home"] = lambda: (None for _ in range(90))
    rig.command("home")
    assert rig.engine.status.is_busy
    rig.device.reported = Condition(S.FAULT, "e-stop")
    rig.cycle(2)
    assert rig.state is S.FAULT
    assert not rig.engine.status.is_busy
    assert not rig.engine.status.is_homed
    assert rig.device.calls[-1] == "stop"
    assert rig.engine.transition_ended


def test_a_fault_while_writing_stops_the_device() -> None:
    rig = Rig().enabled()
    rig.device.fail["write"] = DeviceFault("joint 2 is too hot")
    rig.servo(0.01, 0.0)
    rig.cycle()
    assert (rig.state, rig.engine.status.detail) == (S.FAULT, "joint 2 is too hot")
    assert rig.device.calls[-1] == "stop"
    del rig.device.fail["write"]
    rig.cycle(5)
    assert rig.written == []


def test_an_alarm_is_a_fault_that_stops_the_device_and_survives_the_return_of_the_thread() -> None:
    rig = Rig().enabled()
    rig.engine.submit("servo_jv", jv(0.1, 0.0))
    rig.cycle()
    writes = len(rig.written)
    rig.engine.alarm("the I/O thread is stuck")
    assert (rig.state, rig.engine.status.detail) == (S.FAULT, "the I/O thread is stuck")
    assert rig.device.calls[-1] == "stop"
    rig.cycle(30)
    assert rig.state is S.FAULT
    assert len(rig.written) == writes
    assert rig.engine.health().stream == ""
    rig.enabled()


def test_an_alarm_in_the_midst_of_a_cycle_keeps_the_rest_of_it_from_the_device() -> None:
    rig = Rig().enabled()
    rig.engine.submit("move_jp", jp(0.5, 0.0))
    rig.cycle(5)
    writes = len(rig.written)
    limit = rig.engine._motion._limiter.limit

    def alarm_then_limit(*arguments: object) -> object:
        rig.engine.alarm("stuck")
        return limit(*arguments)  # type: ignore[arg-type]

    rig.engine._motion._limiter.limit = alarm_then_limit  # type: ignore[assignment,method-assign]
    rig.cycle()
    assert len(rig.written) == writes
    assert rig.state is S.FAULT


@pytest.mark.parametrize("held_up", ["as it is told", "before the lock"])
def test_an_alarm_stops_the_device_though_somebody_is_held_up_as_he_tells_of_it(
    held_up: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A log that nobody reads any more, under the lock: the I/O thread waits for that as well."""
    rig = Rig().enabled()
    rig.engine.submit("servo_jv", jv(0.1, 0.0))
    rig.cycle()
    stopped, goes_on = threading.Event(), threading.Event()
    monkeypatch.setattr(rig.device, "stop", stopped.set)
    if held_up == "as it is told":
        monkeypatch.setattr(rig.told, "status_changed", lambda *ignored: goes_on.wait(20.0))
    alarm = threading.Thread(target=rig.engine.alarm, args=("stuck",))
    with rig.engine._board.lock if held_up == "before the lock" else nullcontext():
        alarm.start()
        assert stopped.wait(20.0)
        if held_up == "before the lock":
            alarm.join(20.0)
            assert not alarm.is_alive()
            assert rig.state is S.ENABLED
    goes_on.set()
    alarm.join(20.0)
    stopped.clear()
    rig.cycle()
    assert (rig.state, rig.engine.status.detail) == (S.FAULT, "stuck")
    assert stopped.is_set()


@pytest.mark.parametrize("is_told", [True, False])
def test_a_setpoint_that_goes_out_after_the_stop_of_an_alarm_is_stopped_too(is_told: bool) -> None:
    """It was found to be ENABLED just before."""
    rig = Rig().enabled()
    rig.engine.submit("servo_jv", jv(0.1, 0.0))
    write, lock = rig.device.write, rig.engine._board.lock
    alarm = threading.Thread(target=rig.engine.alarm, args=("stuck",))

    def write_late(setpoint: Setpoint) -> None:
        with nullcontext() if is_told else lock:
            alarm.start()
            alarm.join()
        write(setpoint)

    rig.device.write = write_late  # type: ignore[method-assign]
    rig.cycle()
    assert rig.state is S.FAULT
    written = rig.device.calls.index("write")
    assert rig.device.calls[written - 1 : written + 2] == ["stop", "write", "stop"]


@pytest.mark.parametrize("when", ["before", "meanwhile"])
def test_an_alarm_as_a_move_of_the_hardware_begins_leaves_none(when: str) -> None:
    """It begins nothing after the alarm; what was being sent is stopped in the same cycle."""
    rig = Rig(capabilities=two_joints(native_moves=frozenset({"move_jp"}))).enabled()
    rig.engine.submit("move_jp", jp(0.5, 0.0))
    hook, name = (rig.engine._arbiter, "take") if when == "before" else (rig.device, "move")
    do = getattr(hook, name)

    def alarmed(*arguments: object) -> object:
        try:
            return do(*arguments)
        finally:
            rig.engine.alarm("stuck")
            rig.device.calls.append("what was on its way")

    setattr(hook, name, alarmed)
    rig.cycle()
    assert rig.state is S.FAULT
    assert rig.device.calls[-1] == "stop"
    assert len(rig.device.goals) == (when == "meanwhile")


def test_an_alarm_announces_the_fault_though_the_device_cannot_stop() -> None:
    rig = Rig().enabled()
    rig.device.fail["stop"] = OSError("no")
    with pytest.raises(OSError, match="no"):
        rig.engine.alarm("stuck")
    assert rig.state is S.FAULT


def test_an_observer_that_fails_harms_nobody() -> None:
    class Broken(type(Rig().told)):  # type: ignore[misc]
        def status_changed(self, status: object, stamp: Stamp) -> None:
            raise RuntimeError("my fault")

    rig = Rig()
    rig.engine.add_observer(Broken())
    last = type(rig.told)()
    rig.engine.add_observer(last)
    rig.enabled()
    assert rig.state is S.ENABLED
    assert last.states == rig.told.states


def test_shutting_down_stops_an_enabled_device_and_closes_it_even_if_that_fails() -> None:
    rig = Rig().enabled()
    rig.device.fail["stop"] = ConnectionLost("gone")
    with pytest.raises(ConnectionLost):
        rig.engine.shut_down()
    assert rig.device.calls[-2:] == ["stop", "close"]
    assert not rig.engine.connected
    rig = Rig().connect()
    rig.engine.shut_down()
    assert rig.device.calls == ["open", "close"]


def test_a_waiting_client_is_released_by_the_shutdown() -> None:
    rig = Rig().enabled()
    move = rig.engine.submit("move_jp", jp(0.5, 0.0))
    assert move is not None
    ended: list[BaseException] = []

    def wait() -> None:
        try:
            move.wait()
        except MotionAborted as error:
            ended.append(error)

    client = threading.Thread(target=wait)
    client.start()
    rig.engine.shut_down()
    client.join(LONG)
    assert "shut down" in str(ended[0])


def test_late_cycles_are_counted() -> None:
    rig = Rig().connect()
    rig.cycle(50)
    assert rig.engine.health().late_cycles == 0
    rig.cycle(period=0.1)
    health = rig.engine.health()
    assert health.late_cycles == 1
    assert health.worst_cycle == pytest.approx(0.1)
    assert health.rate_expected == 100.0
    assert FakeClock(5.0)() == 5.0


def test_what_is_told_of_a_device_names_it_once_and_says_once_what_to_do(
    caplog: pytest.LogCaptureFixture,
) -> None:
    rig = Rig()
    where, remedy = rig.engine.where, "Check the address."
    lost = ConnectionFailed("cannot connect: refused", where=where, remedy=remedy)
    rig.device.fail["open"] = lost
    with pytest.raises(ConnectionFailed):
        rig.engine.connect(rig.clock() + 1.0)
    status = rig.engine.status
    assert status.detail == "cannot connect: refused. Check the address."
    assert (status.cause, status.remedy) == ("cannot connect: refused", remedy)
    assert [record.getMessage() for record in caplog.records] == [
        f"{where}: FAULT: {status.detail}"
    ]
    with pytest.raises(CommandRefused) as refused:
        rig.engine.submit("servo_jp", jp(0.0, 0.0))
    assert str(refused.value) == (
        f"{where}: servo_jp refused (not_enabled): the device is FAULT (cannot connect: refused). "
        "Remove the cause, then enable it: enable() in Python, state_command in ROS."
    )
    assert where not in rig.engine.health().last_refusal
    rig.disconnect(lost.statement, lost.remedy)
    assert rig.engine.status == status, "the same again is no news"
