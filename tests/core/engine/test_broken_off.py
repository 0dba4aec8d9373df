"""What moves without being ENABLED, an `enable` or a service that says so, is ended by every stop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from typing_extensions import override

from crtk_drivers.device import Answer, Condition, Service, Steps, StopPolicy
from crtk_drivers.engine import Engine
from crtk_drivers.engine.borrowed_state import Follower
from crtk_drivers.errors import (
    CommandRefused,
    ConnectionLost,
    Reason,
    StopUnconfirmed,
    TransitionFailed,
)
from crtk_drivers.motion.move import Outcome
from crtk_drivers.samples import JointState
from crtk_drivers.state import OperatingState as S
from rigs.scripted_engine import LONG_STEPS, Recorder, Rig, ScriptedDevice, jp, two_joints


class Sweeping(ScriptedDevice):
    """It has two services that take long, and one of them moves it; `is_moving` says what its fingers do.

    `meanwhile` is what others do in the only step of ``turn``; a stop is read back where it `tells`.
    """

    is_moving = False
    tells = True
    meanwhile: Callable[[], object] = int

    @property
    @override
    def services(self) -> Mapping[str, Service]:
        return {
            "sweep": Service("moves", lambda: self._serve("sweep"), moves=True),
            "look": Service("moves nothing", lambda: self._serve("look")),
            "fail": Service("moves, and fails", lambda: self._serve("fail"), moves=True),
            "stumble": Service("moves, and has a bug", lambda: self._serve("stumble"), moves=True),
            "refuse": Service("moves, but not now", self._refuse, moves=True),
            "turn": Service("moves at once", self._turn, moves=True, undo=self._undo),
            "halt": Service("a stop of its own", self._halt, stops=True),
        }

    @property
    @override
    def has_stopped(self) -> bool:
        return self.tells

    @override
    def left(self) -> None:
        self.calls.append("left")

    def _turn(self) -> Answer:
        self.is_moving = True
        self.meanwhile()
        yield from ()
        return "turned"

    def _refuse(self) -> Answer:
        raise CommandRefused("refuse", Reason.LOCAL_CONTROL, "not now")

    def _undo(self) -> None:
        self.calls.append("undo")

    def _serve(self, name: str) -> Answer:
        self.calls.append(name)
        for _ in range(20):
            self.is_moving |= name != "look"
            yield
            if name == "fail":
                raise TransitionFailed("it did not")
            if name == "stumble":
                raise ZeroDivisionError("a mean of nothing")
        return "done"

    def _halt(self) -> Answer:
        self.calls.append("halt")
        yield
        return "halted"

    def sweep(self) -> Any:
        for _ in range(20):
            self.is_moving = True
            yield

    @override
    def stop(self) -> None:
        super().stop()
        self.is_moving = False


class SweepingRig(Rig):
    def __init__(self, *, enable_moves: bool = True, needs_homing: bool = False) -> None:
        super().__init__()
        capabilities = two_joints(
            enable_moves=enable_moves,
            needs_homing=needs_homing,
            stop=StopPolicy(0.05, "", time=60.0),
        )
        self.device: Sweeping = Sweeping(self.clock, capabilities)
        self.engine = Engine(self.device, "rig", LONG_STEPS, self.clock, self.clock.advance)
        self.told = Recorder()
        self.engine.add_observer(self.told)
        self.device.procedures["enable"] = self.device.sweep
        self.connect()

    def enabled_after(self, cycles: int) -> SweepingRig:
        self.engine.state_command("enable")
        self.cycle(cycles)
        assert self.state is S.ENABLED
        return self


def pause(rig: Rig) -> None:
    with pytest.raises(CommandRefused):  # of DISABLED; it stops all the same
        rig.engine.state_command("pause")


def lose(rig: Rig) -> None:
    rig.engine.lose("gone")


STOPS: Mapping[str, Callable[[Rig], object]] = {
    "hold": lambda rig: rig.engine.submit("hold"),
    "disable": lambda rig: rig.engine.state_command("disable"),
    "pause": pause,
    "alarm": lambda rig: rig.engine.alarm("late"),
    "lost": lose,
    "shut down": lambda rig: rig.engine.shut_down(),
}
every_stop = pytest.mark.parametrize("stop", STOPS)


@every_stop
def test_a_stop_ends_an_enable_that_moves(stop: str) -> None:
    rig = SweepingRig()
    rig.engine.state_command("enable")
    rig.cycle(5)
    assert rig.device.is_moving
    STOPS[stop](rig)
    if rig.engine.connected:
        rig.cycle(30)
        assert rig.engine.transition_ended
        assert rig.state is (S.FAULT if stop == "alarm" else S.DISABLED)
    assert not rig.device.is_moving
    assert "stop" in rig.device.calls


@every_stop
def test_a_stop_ends_a_service_that_moves(stop: str) -> None:
    rig = SweepingRig()
    asked = rig.engine.request("sweep")
    rig.cycle(5)
    assert rig.device.is_moving
    STOPS[stop](rig)
    if rig.engine.connected:
        rig.cycle(30)
    assert not rig.device.is_moving
    assert "stop" in rig.device.calls
    with pytest.raises(TransitionFailed, match="sweep was broken off"):
        asked.wait(0.0)


def test_an_alarm_in_the_midst_of_a_service_stops_what_is_sent_after_it() -> None:
    rig = SweepingRig()

    def late() -> None:
        rig.engine.alarm("late")
        rig.device.is_moving = True

    rig.device.meanwhile = late
    rig.engine.request("turn")
    rig.cycle()
    assert rig.state is S.FAULT
    assert not rig.device.is_moving


def overdue_stop() -> SweepingRig:
    """Return a rig whose stop has not been carried out in its time."""
    rig = SweepingRig().enabled_after(25)
    rig.device.tells = False
    rig.engine.submit("hold")
    rig.cycle()
    rig.cycle(700, period=0.1)
    assert rig.state is S.FAULT
    return rig


def test_a_stop_as_a_service_is_about_to_begin_is_watched_on() -> None:
    """One that was overdue: nothing has begun that would end it."""
    rig = overdue_stop()
    requests = rig.engine._requests
    step = requests.step

    def stopped_before(*arguments: Any) -> bool:
        rig.engine.submit("hold")
        return step(*arguments)

    requests.step = stopped_before  # type: ignore[method-assign]
    rig.engine.request("sweep")
    rig.cycle(20)
    assert not rig.engine._stopping.confirmed
    assert "sweep" not in rig.device.calls


def test_a_service_that_refuses_itself_leaves_an_overdue_stop_watched() -> None:
    rig = overdue_stop()
    asked = rig.engine.request("refuse")
    rig.cycle()
    with pytest.raises(CommandRefused, match="not now"):
        asked.wait(0.0)
    assert not rig.engine._stopping.confirmed
    rig.device.calls.clear()
    rig.cycle(20)
    assert "stop" in rig.device.calls, "it is sent again"
    rig.engine.request("sweep")
    rig.cycle()
    assert rig.engine._stopping.confirmed, "it moves on purpose"


def test_an_enable_that_refuses_itself_leaves_an_overdue_stop_watched() -> None:
    rig = overdue_stop()

    def refused() -> Steps:
        raise CommandRefused("enable", Reason.LOCAL_CONTROL, "not now")

    rig.device.procedures["enable"] = refused
    rig.engine.state_command("enable")
    rig.cycle(3)
    assert rig.engine.transition_ended
    assert not rig.engine._stopping.confirmed
    rig.device.calls.clear()
    rig.cycle(20)
    assert "stop" in rig.device.calls


def test_who_enables_is_told_that_a_stop_has_broken_it_off() -> None:
    rig = SweepingRig()
    rig.engine.state_command("enable", stamp_ns=7)
    rig.cycle(5)
    told = len(rig.told.statuses)
    rig.engine.submit("hold")
    (answer,) = rig.told.refusals
    assert (answer.reason, answer.stamp_ns) == (Reason.FAILED, 7)
    assert rig.engine.transition_outcome.state is S.DISABLED
    assert rig.engine.transition_outcome.detail == "broken off by hold"
    assert rig.told.warnings == ["enable was broken off by hold"]
    assert len(rig.told.statuses) > told


def test_after_a_service_that_moved_the_setpoint_is_measured() -> None:
    """A move would begin where the joints were before, and throw them back there."""
    rig = SweepingRig().enabled_after(25)
    move = rig.engine.submit("move_jp", jp(0.1, 0.0))
    assert move is not None
    rig.cycle(300)
    assert move.outcome is Outcome.REACHED

    def moved() -> None:
        rig.device.position = np.array([0.5, 0.2])

    rig.device.meanwhile = moved
    rig.engine.request("turn")
    rig.cycle(3)
    found = rig.engine.feedback("setpoint_js")
    assert found is not None
    assert isinstance(found[0], JointState)
    assert found[0].position.tolist() == [0.5, 0.2]
    written = len(rig.written)
    rig.engine.submit("move_jr", jp(0.0, 0.1))
    rig.cycle(300)
    assert all(abs(each.values[0] - 0.5) < 1e-9 for each in rig.written[written:])
    assert rig.written[-1].values.tolist() == pytest.approx([0.5, 0.3])


def test_a_move_is_ended_before_a_service_that_moves() -> None:
    rig = SweepingRig().enabled_after(25)
    move = rig.engine.submit("move_jp", jp(0.5, 0.0))
    assert move is not None
    rig.cycle(5)
    rig.engine.request("turn")
    rig.cycle()
    assert move.outcome is Outcome.ABORTED
    assert "by a service that moves" in move.reason
    assert rig.device.calls[-1] != "turn"
    written = len(rig.written)
    rig.cycle(5)
    assert rig.device.is_moving
    assert len(rig.written) == written


def test_a_service_that_moves_nothing_outlives_a_stop() -> None:
    rig = SweepingRig()
    asked = rig.engine.request("look")
    rig.cycle(5)
    rig.engine.submit("hold")
    rig.engine.state_command("disable")
    rig.cycle(30)
    assert asked.wait(0.0) == "done"


@pytest.mark.parametrize("stop", ["disable", "pause", "lost", "alarm"])
@pytest.mark.parametrize("state", [S.DISABLED, S.ENABLED])
def test_a_stop_of_the_device_in_front_ends_a_service_behind(state: S, stop: str) -> None:
    """A gripper is activated while neither is ENABLED, so that no change of the state would tell."""
    front, behind = SweepingRig(enable_moves=False), SweepingRig()
    if state is S.ENABLED:
        front.enabled_after(25)
    follower = Follower(front.engine, behind.engine)
    asked = behind.engine.request("sweep")
    behind.cycle(5)
    assert behind.device.is_moving
    if state is S.ENABLED and stop == "pause":
        front.engine.state_command("pause")
    else:
        STOPS[stop](front)
    if front.engine.connected:
        front.cycle(5)
    behind.cycle()
    follower.look()
    assert not behind.device.is_moving
    with pytest.raises(TransitionFailed, match="sweep was broken off"):
        asked.wait(0.0)


def test_what_is_no_stop_of_the_device_in_front_ends_no_service_behind() -> None:
    front, behind = SweepingRig(enable_moves=False), SweepingRig()
    front.engine.lose("gone")
    follower = Follower(front.engine, behind.engine)
    asked = behind.engine.request("sweep")
    behind.cycle(2)
    front.connect()
    front.engine.submit("hold")
    front.cycle(5)
    follower.look()
    behind.cycle(30)
    assert asked.wait(0.0) == "done"


@pytest.mark.parametrize("running", ["sweep", "look"])
def test_a_service_that_is_a_stop_takes_the_place_of_any(running: str) -> None:
    rig = SweepingRig()
    asked = rig.engine.request(running)
    rig.cycle(5)
    halt = rig.engine.request("halt")
    assert rig.engine.request("halt") is halt, "one is enough"
    with pytest.raises(CommandRefused, match=f"{running} is running"):
        rig.engine.request("sweep")
    rig.cycle(5)
    assert halt.wait(0.0) == "halted"
    assert not rig.device.is_moving
    assert rig.device.calls.count("halt") == 1
    with pytest.raises(TransitionFailed, match=f"{running} was broken off: by halt"):
        asked.wait(0.0)
    assert rig.engine.request("look") is not None


def test_a_service_that_is_a_stop_ends_an_enable_that_moves_and_is_answered_where_the_link_is_lost() -> (
    None
):
    rig = SweepingRig()
    rig.engine.state_command("enable")
    rig.cycle(5)
    rig.engine.request("look")
    rig.cycle()
    halt = rig.engine.request("halt")
    assert rig.engine.transition_outcome.detail == "broken off by halt"
    rig.engine.lose("gone")
    with pytest.raises(ConnectionLost):
        halt.wait(0.0)


def test_a_service_that_was_not_begun_before_a_stop_never_begins_and_one_after_it_does() -> None:
    rig = SweepingRig()
    first = rig.engine.request("sweep")
    rig.engine.submit("hold")
    rig.cycle()
    assert "sweep" not in rig.device.calls
    with pytest.raises(TransitionFailed, match="by hold"):
        first.wait(0.0)
    rig.engine.submit("hold")
    second = rig.engine.request("sweep")
    rig.cycle(30)
    assert second.wait(0.0) == "done"


@pytest.mark.parametrize("of", ["service", "enable"])
def test_what_moves_and_fails_on_its_way_is_stopped(of: str) -> None:
    rig = SweepingRig()
    rig.device.procedures["enable"] = lambda: rig.device._serve("fail")
    if of == "service":
        rig.engine.request("fail")
    else:
        rig.engine.state_command("enable")
    rig.cycle(5)
    assert "fail" in rig.device.calls
    assert rig.device.calls[-1] == "stop"
    assert not rig.device.is_moving


def test_a_fault_ends_a_service_that_moves_and_a_worse_state_of_its_own_doing_does_not() -> None:
    rig = SweepingRig().enabled_after(25)
    rig.command("pause")
    asked = rig.engine.request("sweep")
    rig.cycle(2)
    rig.device.reported = Condition(S.DISABLED, "it is not activated")
    rig.cycle(2)
    assert rig.state is S.DISABLED
    assert rig.device.is_moving
    rig.device.reported = Condition(S.FAULT, "overcurrent")
    rig.cycle()
    assert not rig.device.is_moving
    with pytest.raises(TransitionFailed, match="broken off: overcurrent"):
        asked.wait(0.0)


def test_closing_in_a_sweep_waits_for_the_stop() -> None:
    rig = SweepingRig()
    rig.engine.state_command("enable")
    rig.cycle(5)
    rig.device.stamp = rig.device.clock.stamp()  # no sample comes that shows it standing
    with pytest.raises(StopUnconfirmed):
        rig.engine.shut_down()


def test_a_service_that_moves_and_has_a_bug_is_stopped() -> None:
    rig = SweepingRig()
    asked = rig.engine.request("stumble")
    rig.cycle(3)
    assert not rig.device.is_moving
    assert "stop" in rig.device.calls
    assert rig.state is S.FAULT
    with pytest.raises(TransitionFailed, match="mean of nothing"):
        asked.wait(0.0)


def test_a_stop_that_comes_as_the_service_ends_is_sent() -> None:
    rig = SweepingRig()
    rig.device.meanwhile = lambda: rig.engine.submit("hold")
    asked = rig.engine.request("turn")
    rig.cycle(2)
    assert not rig.device.is_moving
    assert rig.device.calls.index("undo") < rig.device.calls.index("stop")
    assert asked.wait(0.0) == "turned"


def test_what_ends_before_a_stop_comes_is_not_undone() -> None:
    rig = SweepingRig()
    rig.engine.request("turn")
    rig.cycle(2)
    rig.engine.submit("hold")
    rig.cycle(2)
    assert "undo" not in rig.device.calls


@pytest.mark.parametrize("stop", ["hold", "pause"])
def test_a_stop_ends_an_enable_that_waits_for_a_disable(stop: str) -> None:
    rig = SweepingRig()
    rig.device.procedures["disable"] = rig.device.sweep
    rig.engine.state_command("disable")
    rig.cycle(3)
    rig.engine.state_command("enable")
    STOPS[stop](rig)
    rig.cycle(60)
    assert rig.engine.transition_ended
    assert rig.state is S.DISABLED
    assert "enable" not in rig.device.calls
    assert rig.told.warnings == [f"enable was broken off by {stop}"]


def test_a_service_that_moves_waits_until_a_stop_was_read_back() -> None:
    rig = SweepingRig().enabled_after(25)
    rig.device.tells = False
    rig.engine.submit("hold")
    rig.cycle(2)
    asked = rig.engine.request("sweep")
    rig.cycle(5)
    assert "sweep" not in rig.device.calls
    rig.device.tells = True
    rig.cycle(30)
    assert asked.wait(0.0) == "done"
    assert rig.state is S.ENABLED


def test_a_service_that_moves_is_refused_where_a_stop_takes_long() -> None:
    rig = SweepingRig().enabled_after(25)
    rig.device.tells = False
    rig.engine.submit("hold")
    asked = rig.engine.request("sweep")
    rig.cycle(600)
    rig.device.tells = True
    rig.cycle(5)
    assert "sweep" not in rig.device.calls
    with pytest.raises(CommandRefused, match="a stop is still being carried out"):
        asked.wait(0.0)


def test_a_service_that_moves_begins_only_after_a_disable_that_runs() -> None:
    rig = SweepingRig().enabled_after(25)
    rig.device.procedures["disable"] = lambda: rig.device._serve("look")
    rig.engine.state_command("disable")
    rig.cycle(5)
    assert "look" in rig.device.calls
    rig.device.calls.clear()
    asked = rig.engine.request("sweep")
    rig.cycle(5)
    assert not rig.engine.transition_ended
    assert "sweep" not in rig.device.calls
    rig.cycle(60)
    assert asked.wait(0.0) == "done"
    assert rig.state is S.DISABLED


def refuse_on_the_way(device: Sweeping) -> Steps:
    device.is_moving = True
    yield
    raise CommandRefused("state_command", Reason.LOCAL_CONTROL, "somebody has taken it")


def test_an_enable_that_is_refused_on_its_way_is_stopped() -> None:
    rig = SweepingRig()
    rig.device.procedures["enable"] = lambda: refuse_on_the_way(rig.device)
    rig.engine.state_command("enable")
    rig.cycle(5)
    assert not rig.device.is_moving
    assert rig.state is S.DISABLED


@pytest.mark.parametrize("end", ["disable", "failure", "refusal"])
def test_what_was_half_enabled_is_told_that_it_is_not(end: str) -> None:
    """Also where that moves nothing: forces are on, or a pedal is down."""
    rig = SweepingRig(enable_moves=False)
    ends: Mapping[str, Callable[[], Steps]] = {
        "failure": lambda: rig.device._serve("fail"),
        "refusal": lambda: refuse_on_the_way(rig.device),
    }
    rig.device.procedures["enable"] = ends.get(end, rig.device.sweep)
    rig.engine.state_command("enable")
    rig.cycle(5)
    if end == "disable":
        rig.engine.state_command("disable")
        rig.cycle(5)
    assert "left" in rig.device.calls


def broken(*arguments: object) -> None:
    raise OSError("no such pedal")


@pytest.mark.parametrize("way", ["fault", "alarm", "enable that fails"])
def test_a_device_that_fails_as_it_is_told_that_it_is_not_enabled_is_stopped(way: str) -> None:
    rig = SweepingRig()
    rig.device.left = broken  # type: ignore[method-assign]
    if way == "enable that fails":
        rig.device.procedures["enable"] = lambda: rig.device._serve("fail")
        rig.engine.state_command("enable")
    else:
        rig.enabled_after(25)
        rig.device.reported = Condition(S.FAULT, "overload")
    rig.device.calls.clear()
    if way == "alarm":
        rig.engine.alarm("late")
    else:
        rig.cycle(5)
    assert rig.state is S.FAULT
    assert "stop" in rig.device.calls
    assert rig.engine.connected


def test_a_home_that_is_refused_on_its_way_is_stopped() -> None:
    rig = SweepingRig(needs_homing=True).enabled_after(25)
    rig.device.procedures["home"] = lambda: refuse_on_the_way(rig.device)
    rig.engine.state_command("home")
    rig.cycle(5)
    assert "home" in rig.device.calls
    assert rig.device.calls[-1] == "stop"
    assert not rig.device.is_moving
    assert rig.state is S.ENABLED


def test_a_service_does_not_outlive_a_link_whose_device_cannot_be_stopped() -> None:
    rig = SweepingRig().enabled_after(25)
    asked = rig.engine.request("look")
    rig.cycle(2)
    rig.device.stop = broken  # type: ignore[method-assign]
    with pytest.raises(OSError, match="pedal"):
        rig.engine.lose("gone")
    with pytest.raises(ConnectionLost, match="gone"):
        asked.wait(0.0)
