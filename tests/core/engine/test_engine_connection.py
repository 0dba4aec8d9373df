"""Connecting, and losing, one device, cycle by cycle, on a clock of its own."""

import re

import numpy as np
import pytest

from crtk_drivers.engine import EngineOptions
from crtk_drivers.errors import (
    CommandRefused,
    ConnectionFailed,
    ConnectionLost,
    Reason,
)
from crtk_drivers.samples import Sample
from crtk_drivers.state import OperatingState
from rigs.scripted_engine import Rig, ScriptedDevice

S = OperatingState


def test_before_the_first_connection_it_is_connecting_and_says_where_and_since_when(
    caplog: pytest.LogCaptureFixture,
) -> None:
    rig = Rig()
    assert rig.state is S.FAULT
    assert rig.engine.status.connecting
    assert re.fullmatch(r"connecting to nowhere:1 since \d\d:\d\d:\d\d", rig.engine.status.detail)
    assert not caplog.records
    with pytest.raises(CommandRefused) as caught:
        rig.engine.state_command("enable")
    assert caught.value.reason is Reason.NOT_CONNECTED
    assert caught.value.where == "rig nowhere:1"


def test_a_connection_ends_in_disabled_with_nothing_written() -> None:
    rig = Rig().connect()
    rig.cycle(5)
    assert rig.state is S.DISABLED
    assert not rig.engine.status.connecting
    assert rig.device.calls == ["open"]


def test_a_failed_connection_is_a_fault_with_the_reason() -> None:
    rig = Rig()
    rig.device.fail["open"] = ConnectionFailed("no answer", where="nowhere:1")
    rig.connect()
    assert rig.state is S.FAULT
    assert "no answer" in rig.engine.status.detail
    assert not rig.engine.status.connecting
    assert not rig.engine.connected


def test_a_reconnection_ends_disabled_with_nothing_written_and_enable_starts_from_the_new_place() -> (
    None
):
    rig = Rig().enabled()
    rig.servo(0.05, 0.0)
    rig.cycle()
    writes = len(rig.written)
    rig.disconnect("cable pulled")
    assert rig.state is S.FAULT
    assert rig.device.calls[-2:] == ["stop", "close"]
    assert rig.value("measured_js")[1] == 0
    rig.device.position = np.array([0.5, 0.5])  # moved by hand in the meantime
    rig.connect()
    rig.cycle(20)
    assert rig.state is S.DISABLED
    assert len(rig.written) == writes
    rig.enabled()
    assert rig.setpoint()["position"] == [0.5, 0.5]
    assert len(rig.written) == writes
    assert rig.engine.health().reconnects == 1


def test_after_a_reconnection_the_reason_names_the_loss_and_what_was_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(ScriptedDevice, "found", "torque is on")
    rig = Rig().connect()
    assert rig.engine.status.detail == "torque is on"
    rig.disconnect("rig nowhere:1: cable pulled.", remedy="Plug it in.")
    rig.device.fail["open"] = ConnectionFailed("no answer", where="nowhere:1")
    rig.connect()
    del rig.device.fail["open"]
    rig.connect()
    lost = "the link was lost (cable pulled) and is back"
    assert rig.engine.status.detail == f"{lost}; torque is on"
    monkeypatch.setattr(ScriptedDevice, "found", "")
    rig.disconnect("cable pulled")
    rig.connect()
    assert rig.engine.status.detail == lost
    rig.command("disable")
    assert not rig.engine.status.detail, "somebody has seen it"


def test_the_reason_names_no_loss_that_came_before_a_close() -> None:
    rig = Rig().connect()
    rig.disconnect("cable pulled")
    rig.engine.shut_down()
    rig.connect()
    assert not rig.engine.status.detail


def test_enable_waits_for_a_sample_of_this_connection() -> None:
    rig = Rig().enabled()
    rig.disconnect("cable pulled")
    rig.device.position, rig.device.silent = np.array([0.5, 0.5]), True
    rig.engine.connect(rig.clock() + 1.0)
    rig.engine.state_command("enable")
    rig.cycle(3)
    assert rig.state is S.DISABLED, "the setpoint would be a position from before the reconnection"
    rig.device.silent = False
    rig.cycle(2)  # in the first of them it is seen to stand
    assert rig.state is S.ENABLED
    assert rig.setpoint()["position"] == [0.5, 0.5]


def test_a_silent_device_is_lost_after_the_sample_timeout_and_its_stamps_are_zero_before() -> None:
    rig = Rig(EngineOptions(sample_timeout=0.2)).connect()
    assert rig.value("measured_js")[1] > 0
    rig.device.silent = True
    rig.cycle(6)
    _, stamp = rig.value("measured_js")
    assert stamp == 0
    with pytest.raises(ConnectionLost, match="old"):
        rig.cycle(20)


def test_a_device_that_repeats_an_old_sample_is_lost_too() -> None:
    rig = Rig(EngineOptions(sample_timeout=0.2)).connect()
    rig.device.stamp = rig.clock.stamp()
    rig.cycle(6)
    assert rig.value("measured_cp")[1] == 0
    with pytest.raises(ConnectionLost):
        rig.cycle(20)


def test_feedback_of_one_sample_carries_one_stamp() -> None:
    rig = Rig().connect()
    stamps = {rig.value(name)[1] for name in ("measured_js", "measured_cp", "jacobian")}
    assert len(stamps) == 1
    assert stamps != {0}


def test_a_link_that_is_lost_in_the_midst_of_a_procedure_is_lost_and_no_mere_fault() -> None:
    rig = Rig().connect()
    rig.device.fail["enable"] = ConnectionLost("reset by peer")
    rig.engine.state_command("enable")
    with pytest.raises(ConnectionLost):
        rig.cycle()
    rig.disconnect("reset by peer")
    assert rig.engine.transition_ended
    assert rig.state is S.FAULT


def test_a_device_that_fails_to_close_is_in_fault_all_the_same() -> None:
    rig = Rig().enabled()
    rig.device.fail |= {"stop": ConnectionLost("gone"), "close": OSError("bad descriptor")}
    with pytest.raises(OSError, match="bad descriptor"):
        rig.disconnect("cable pulled")
    assert (rig.state, rig.engine.status.detail) == (S.FAULT, "cable pulled")
    assert not rig.engine.connected


SAMPLES_HALF_A_SECOND = EngineOptions(sample_timeout=0.5)


def test_a_thread_that_was_stuck_takes_what_it_finds_for_new_and_looks_for_more() -> None:
    rig = Rig(SAMPLES_HALF_A_SECOND).enabled()
    old = rig.clock.stamp()
    rig.device.silent = True
    rig.cycle(period=2.0)  # it was stuck, and finds nothing at first
    rig.device.silent, rig.device.stamp = False, old
    rig.cycle(10)  # what was made meanwhile
    assert rig.engine.connected
    rig.device.stamp = None
    rig.cycle(100)
    assert rig.engine.connected


def test_a_thread_that_is_stuck_again_and_again_is_excused_by_each_sample_made_since() -> None:
    """It is held up between what it reads and what it does with that."""
    rig = Rig(SAMPLES_HALF_A_SECOND).enabled()
    read = rig.device.read

    def held_up(deadline: float) -> Sample | None:
        sample = read(deadline)
        rig.clock.advance(2.0)
        return sample

    rig.device.read = held_up  # type: ignore[method-assign]
    rig.cycle(3)
    assert rig.engine.connected


@pytest.mark.parametrize("brings", ["nothing", "old samples"])
def test_a_thread_that_was_stuck_is_excused_once(brings: str) -> None:
    rig = Rig(SAMPLES_HALF_A_SECOND).enabled()
    rig.device.silent, rig.device.stamp = brings == "nothing", rig.clock.stamp()
    rig.cycle(period=2.0)
    begin = rig.clock()
    with pytest.raises(ConnectionLost, match="the newest sample is"):
        rig.cycle(100)
    assert rig.clock() - begin == pytest.approx(0.5, abs=0.02)


def test_cycles_that_are_all_too_slow_do_not_hide_that_nothing_comes() -> None:
    rig = Rig(SAMPLES_HALF_A_SECOND).enabled()
    rig.device.silent = True
    with pytest.raises(ConnectionLost, match="the newest sample is"):
        rig.cycle(3, period=0.6)
