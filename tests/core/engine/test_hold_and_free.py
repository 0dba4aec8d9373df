"""Hold, and free drive, cycle by cycle, on a clock of its own."""

import time
from collections.abc import Callable

import numpy as np
import pytest

from crtk_drivers.device import Condition
from crtk_drivers.errors import (
    CommandRefused,
    Reason,
)
from crtk_drivers.samples import Pose, Vector
from crtk_drivers.state import OperatingState
from rigs.scripted_engine import Rig, SlideAndTurn, jp, jv, pose, two_joints

S = OperatingState
HOUR_NS = 3600 * 10**9


@pytest.mark.parametrize("state", [S.DISABLED, S.PAUSED, S.FAULT])
def test_hold_is_welcome_where_nothing_moves_and_leaves_nothing_behind(
    state: OperatingState,
) -> None:
    rig = Rig().enabled()
    rig.device.reported = Condition(state)
    rig.cycle()
    calls = list(rig.device.calls)
    rig.engine.submit("hold")
    rig.cycle(2)
    assert rig.device.calls == calls
    rig.device.reported = Condition()
    rig.engine.state_command("disable")
    rig.cycle()
    calls = list(rig.device.calls)
    rig.enabled()
    rig.cycle(3)
    assert rig.device.calls == [*calls, "enable"], "no hold from before reaches an enabled device"


def test_hold_ends_homing_and_is_refused_only_where_nobody_is_there_to_obey() -> None:
    rig = Rig(capabilities=two_joints(needs_homing=True)).enabled()
    rig.device.procedures["home"] = lambda: (None for _ in range(50))
    rig.command("home")
    assert rig.engine.status.is_busy
    del rig.device.calls[:]
    rig.engine.submit("hold")
    rig.cycle()
    assert rig.device.calls == ["stop"]
    assert rig.engine.transition_ended
    assert not rig.engine.status.is_busy
    assert rig.state is S.ENABLED
    rig.disconnect("gone")
    with pytest.raises(CommandRefused, match="gone") as caught:
        rig.engine.submit("hold")
    assert caught.value.reason is Reason.NOT_CONNECTED


def test_pause_ends_homing() -> None:
    rig = Rig(capabilities=two_joints(needs_homing=True)).enabled()
    rig.device.procedures["home"] = lambda: (None for _ in range(50))
    rig.command("home")
    rig.command("pause")
    assert rig.state is S.PAUSED
    assert not rig.engine.status.is_busy


@pytest.mark.parametrize("running", ["enable", "unhome", "pause", "disable"])
def test_hold_is_welcome_during_every_other_state_command(running: str) -> None:
    rig = Rig(capabilities=two_joints(needs_homing=True))
    rig.device.homed = True
    rig.connect()
    if running != "enable":
        rig.enabled()
    rig.device.procedures[running] = lambda: (None for _ in range(5))
    rig.command(running)
    assert not rig.engine.transition_ended
    rig.engine.submit("hold")
    rig.cycle(10)
    assert rig.engine.transition_ended


def test_hold_stops_a_velocity_and_the_setpoint_says_so() -> None:
    rig = Rig().enabled()
    rig.engine.submit("servo_jv", jv(0.1, 0.0))
    rig.cycle()
    rig.engine.submit("hold")
    rig.cycle()
    assert rig.device.calls[-1] == "stop"
    assert rig.setpoint()["velocity"] == []
    assert rig.engine.health().stream == ""
    rig.cycle(20)
    assert rig.engine.health().stream_timeouts == 0


def test_a_freed_arm_is_stopped_before_it_obeys_again() -> None:
    rig = Rig().enabled()
    closed: list[bool] = []

    def procedure() -> object:
        try:
            while True:
                yield
        finally:
            closed.append(True)

    rig.device.procedures["free"] = procedure  # type: ignore[assignment]
    rig.engine.submit("free")
    rig.cycle(3)
    rig.device.position = np.array([0.7, 0.0])
    rig.cycle()
    assert rig.setpoint()["position"] == [0.7, 0.0], "the setpoint follows the hand"
    rig.servo(0.71, 0.0)
    rig.cycle()
    assert closed == [True]
    assert rig.device.calls[-2:] == ["stop", "write"]


class JudgedSlowly(SlideAndTurn):
    """Kinematics that take long: `meanwhile` is what another client does before they have an answer."""

    def __init__(self, meanwhile: Callable[[], None]) -> None:
        self._meanwhile = meanwhile

    def inverse(self, pose: Pose, reference: Vector) -> Vector:
        meanwhile, self._meanwhile = self._meanwhile, lambda: None
        meanwhile()
        return super().inverse(pose, reference)


def _pauses(rig: Rig) -> None:
    rig.command("pause")
    rig.command("resume")


def _faults(rig: Rig) -> None:
    rig.device.reported = Condition(OperatingState.FAULT, "e-stop")
    rig.cycle()
    rig.device.reported = Condition()
    rig.command("enable")


@pytest.mark.parametrize("stop", [lambda rig: rig.engine.submit("hold"), _pauses, _faults])
@pytest.mark.parametrize("name", ["move_cp", "servo_cp"])
def test_nothing_begins_after_a_stop_that_came_while_it_was_judged(
    name: str, stop: Callable[[Rig], None]
) -> None:
    rig = Rig().enabled()
    rig.device.solver = JudgedSlowly(lambda: stop(rig))
    with pytest.raises(CommandRefused, match="a stop came while") as caught:
        rig.engine.submit(name, pose(0.01))
    assert caught.value.reason is Reason.TOO_OLD
    rig.cycle(5)
    assert not rig.written
    assert (rig.state, rig.engine.status.is_busy) == (OperatingState.ENABLED, False)
    rig.engine.submit(name, pose(0.01))
    rig.cycle()
    assert rig.written


def test_what_came_before_a_stop_is_not_carried_out_after() -> None:
    rig = Rig().enabled()
    now = time.time_ns() - 1000
    rig.engine.submit("hold", sent_ns=now)
    with pytest.raises(CommandRefused, match="before it was carried out") as caught:
        rig.engine.submit("servo_jv", jv(0.1, 0.0), sent_ns=now - 1)
    assert caught.value.reason is Reason.TOO_OLD
    rig.engine.submit("servo_jv", jv(0.1, 0.0), sent_ns=now + 1)


def test_what_came_before_enable_is_not_carried_out_after() -> None:
    rig = Rig().enabled()
    rig.command("disable")
    now = time.time_ns()
    rig.engine.state_command("enable", received_ns=now)
    for _ in range(2):  # while it is carried out, and after
        with pytest.raises(CommandRefused, match="before it was carried out"):
            rig.engine.submit("move_jp", jp(0.1, 0.0), sent_ns=now - 1)
        rig.cycle(2)
    assert rig.state is S.ENABLED


def test_enable_again_makes_no_command_old() -> None:
    rig = Rig().enabled()
    now = time.time_ns()
    rig.engine.state_command("enable", received_ns=now)
    rig.engine.submit("servo_jv", jv(0.1, 0.0), sent_ns=now - 1)


@pytest.mark.parametrize("step", [-HOUR_NS, HOUR_NS])
def test_a_clock_that_is_set_moves_no_stop(monkeypatch: pytest.MonkeyPatch, step: int) -> None:
    rig = Rig().enabled()
    rig.engine.submit("hold", sent_ns=time.time_ns())
    here = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: here() + step)
    with pytest.raises(CommandRefused, match="before it was carried out"):
        rig.engine.submit("servo_jv", jv(0.1, 0.0), sent_ns=time.time_ns() - 10**9)
    rig.engine.submit("servo_jv", jv(0.1, 0.0), sent_ns=time.time_ns())


def test_a_stop_by_a_clock_of_before_comes_now() -> None:
    rig = Rig().enabled()
    rig.engine.submit("hold", sent_ns=time.time_ns() + HOUR_NS)
    rig.engine.submit("servo_jv", jv(0.1, 0.0), sent_ns=time.time_ns())


def test_enable_that_was_sent_before_a_stop_is_refused() -> None:
    rig = Rig().enabled()
    rig.command("disable")
    sent = time.time_ns()
    rig.engine.state_command("disable")
    rig.cycle(2)
    with pytest.raises(CommandRefused, match="a stop came after this enable was sent") as caught:
        rig.engine.state_command("enable", sent_ns=sent)
    assert caught.value.reason is Reason.TOO_OLD
    assert rig.state is S.DISABLED
    rig.engine.state_command("enable", sent_ns=time.time_ns())


def test_enable_after_the_enable_of_another_client_is_heard() -> None:
    rig = Rig()
    sent = time.time_ns()
    rig.enabled()
    rig.engine.state_command("enable", sent_ns=sent)
