"""What takes over from a motion of the hardware's own begins where that comes to rest."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from crtk_drivers.device import Condition, Mode, MoveProgress
from crtk_drivers.engine import EngineOptions
from crtk_drivers.errors import CommandRefused, MotionAborted, Reason
from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from crtk_drivers.motion.executor import REST_TIMEOUT
from crtk_drivers.motion.move import Move
from crtk_drivers.options import LimitPolicy
from crtk_drivers.samples import Flag, Value, vector
from crtk_drivers.state import OperatingState
from rigs.scripted_arm import BENT, PERIOD, ArmRig, cs, js, step, twist
from rigs.scripted_engine import jf, jp, jv

ALL = (Mode.JOINT_POSITION, Mode.JOINT_VELOCITY, Mode.JOINT_EFFORT)
TOUCH = step(0.001, 0, 0, 0, 0, 0)


def moving(options: EngineOptions | None = None, **changes: Any) -> tuple[ArmRig, Move]:
    """Return a rig whose hardware moves by itself, and needs time to stop."""
    native = {"native_moves": frozenset({"move_jp", "move_cp"}), **changes}
    rig = ArmRig(*ALL, options=options, **native).enabled()
    move = rig.engine.submit("move_jp", jp(*(BENT + 0.3)))
    assert move is not None
    rig.cycle(3)
    rig.device.ready = False
    return rig, move


def rest(rig: ArmRig) -> np.ndarray:
    """The hardware has come to rest, a little further."""
    rig.device.position = BENT + 0.1
    rig.device.ready = True
    return rig.device.position.copy()


STREAMS: dict[str, Callable[[], Value]] = {
    "servo_jp": lambda: jp(*(BENT + 0.1)),
    "servo_jr": lambda: jp(*[0.001] * 6),
    "servo_jv": lambda: jv(*[0.1] * 6),
    "servo_jf": lambda: jf(*[1.0] * 6),
    "servo_cr": lambda: TOUCH,
    "servo_cv": lambda: twist(0.1, 0, 0, 0, 0, 0),
    "body/servo_cv": lambda: twist(0.1, 0, 0, 0, 0, 0),
    "servo_js": lambda: js("NVNNNN", velocity=[0.1] * 6),
    "servo_cs": lambda: cs("VNNNNN", rate=twist(0.1, 0, 0, 0, 0, 0)),
    "interpolate_jp": lambda: jp(*(BENT + 0.1)),
    "interpolate_jr": lambda: jp(*[0.001] * 6),
    "interpolate_jv": lambda: jv(*[0.1] * 6),
    "interpolate_cr": lambda: TOUCH,
    "interpolate_cv": lambda: twist(0.1, 0, 0, 0, 0, 0),
}


@pytest.mark.parametrize("name", STREAMS)
def test_a_stream_begins_when_the_hardware_is_at_rest(name: str) -> None:
    rig, move = moving()
    rig.engine.submit(name, STREAMS[name]())
    rig.cycle()
    assert rig.device.calls.count("stop") == 1
    with pytest.raises(MotionAborted, match=f"pre-empted: by {name}"):
        move.wait(0.0)
    assert not rig.engine.status.is_busy
    rig.cycle(5)
    assert rig.written == []
    assert rig.device.calls.count("stop") == 1
    rest(rig)
    rig.cycle()
    assert len(rig.written) == 1
    assert rig.engine.health().stream == name
    assert rig.told.refusals == []


def test_hardware_that_is_ready_at_once_is_not_waited_for() -> None:
    rig, _ = moving()
    rig.device.ready = True
    rig.engine.submit("servo_jp", jp(*BENT))
    rig.cycle()
    assert rig.device.calls[-2:] == ["stop", "write"]


def test_increments_that_arrive_meanwhile_are_all_there() -> None:
    rig, _ = moving()
    for _ in range(20):
        rig.engine.submit("servo_jr", jp(*[0.001] * 6))
        rig.cycle()
    place = rest(rig)
    rig.engine.submit("servo_jr", jp(*[0.001] * 6))
    rig.cycle()
    assert rig.written[-1].values == pytest.approx(place + 0.021)


@pytest.mark.parametrize("name", ["servo_cr", "interpolate_cr", "body/servo_cr"])
def test_displacements_that_arrive_meanwhile_are_all_there(name: str) -> None:
    rig, _ = moving()
    for _ in range(10):
        rig.engine.submit(name, TOUCH)
        rig.cycle()
    rest(rig)
    start = rig.device.pose
    rig.cycle(150)
    axis = np.array((1.0, 0, 0))
    if name.startswith("body"):
        axis = matrix_from_quaternion(start.orientation)[:, 0]
    assert rig.device.pose.position - start.position == pytest.approx(0.01 * axis, abs=1e-8)


def test_of_absolute_commands_the_newest_counts() -> None:
    rig, _ = moving()
    for offset in (0.08, 0.09, 0.11):
        rig.engine.submit("servo_jp", jp(*(BENT + offset)), stamp_ns=int(offset * 1000))
        rig.cycle()
    rest(rig)
    rig.cycle()
    assert [list(setpoint.values) for setpoint in rig.written] == [list(BENT + 0.11)]
    assert rig.value("setpoint_js")[1] == 110


def test_another_kind_of_stream_takes_the_place_of_the_one_that_waits() -> None:
    rig, _ = moving()
    rig.engine.submit("servo_jp", jp(*BENT))
    rig.cycle(30)
    rig.engine.submit("servo_jv", jv(*[0.1] * 6))
    rig.cycle(2)
    rest(rig)
    rig.cycle()
    assert [setpoint.mode for setpoint in rig.written] == [Mode.JOINT_VELOCITY]


@pytest.mark.parametrize("what", ["hold", "move", "disable", "pause", "fault", "silence"])
def test_what_else_comes_cancels_the_wait(what: str) -> None:
    rig, _ = moving()
    rig.engine.submit("servo_jp", jp(*(BENT + 0.1)))
    rig.cycle(2)
    if what == "hold":
        rig.engine.submit("hold")
    elif what == "move":
        rig.engine.submit("move_jp", jp(*(BENT - 0.3)))
    elif what == "silence":
        rig.engine.alarm("late")
    elif what == "fault":
        rig.device.reported = Condition(OperatingState.FAULT, "bumped")
    else:
        rig.engine.state_command(what)
    rig.cycle(2)
    rest(rig)
    rig.cycle(3)
    assert rig.written == []
    assert rig.device.calls.count("move") == (2 if what == "move" else 1)
    assert rig.engine.status.is_busy is (what == "move")
    if what in ("disable", "pause", "fault", "silence"):
        rig.device.reported = Condition()
        rig.command("resume" if what == "pause" else "enable")
        rig.cycle(3)
        assert rig.written == [], "nothing moves because of enable"


def test_hardware_that_never_comes_to_rest_gets_nothing_and_the_client_a_reason() -> None:
    rig, _ = moving()
    for index in range(4):
        rig.engine.submit("servo_jp", jp(*(BENT + 0.01 * index)), stamp_ns=index + 1)
        rig.cycle(1 if index < 3 else 0)
    for _ in range(int((REST_TIMEOUT - 4 * PERIOD) / PERIOD)):
        rig.engine.submit("servo_jp", jp(*BENT), stamp_ns=4)
        rig.cycle()
    assert rig.told.refusals == []
    rig.cycle(6)
    assert [(told.command, told.reason) for told in rig.told.refusals] == [
        ("servo_jp", Reason.TRANSITION_RUNNING)
    ]
    assert rig.told.refusals[0].stamp_ns == 4
    rest(rig)
    rig.cycle(3)
    assert rig.written == []
    assert rig.state is OperatingState.ENABLED


def test_a_refused_first_command_leaves_the_move_running() -> None:
    rig, move = moving()
    with pytest.raises(CommandRefused):
        rig.engine.submit("servo_jp", jp(*(BENT + 1.0)))
    rig.device.ready = True
    rig.engine.submit("servo_jp", jp(*BENT))
    rig.device.position = BENT + 0.25  # by then it has moved on
    rig.cycle()
    assert [told.reason for told in rig.told.refusals] == [Reason.STEP_TOO_LARGE] * 2
    _goes_on(rig, move)


def test_increments_that_are_refused_leave_the_move_running() -> None:
    options = EngineOptions(limits=LimitPolicy(clamp_servo=False))
    rig, move = moving(options)
    for _ in range(3):
        rig.engine.submit("servo_jr", jp(*[0.09] * 6))
    rig.cycle()
    assert [told.reason for told in rig.told.refusals] == [Reason.STEP_TOO_LARGE]
    _goes_on(rig, move)


def test_a_stream_that_has_waited_is_refused_once_if_the_hardware_rests_too_far_from_it() -> None:
    rig, _ = moving()
    rig.engine.submit("servo_jp", jp(*BENT))
    rig.cycle()
    rig.device.position = BENT + 0.5
    rig.device.ready = True
    rig.cycle(5)
    assert [told.reason for told in rig.told.refusals] == [Reason.STEP_TOO_LARGE]
    assert rig.written == []
    place = rig.device.position.copy()
    rig.stream("servo_jp", jp(*place), 2)
    assert rig.written[-1].values == pytest.approx(place)


def _goes_on(rig: ArmRig, move: Move) -> None:
    assert "stop" not in rig.device.calls
    assert rig.engine.status.is_busy
    rig.device.progress = MoveProgress.DONE
    rig.cycle()
    assert move.wait(0.0)
    assert rig.written == []


MODES = {
    "servo_jp": (Mode.JOINT_POSITION, lambda rig: jp(*rig.device.position)),
    "servo_jv": (Mode.JOINT_VELOCITY, lambda rig: jv(*[0.1] * 6)),
    "servo_jf": (Mode.JOINT_EFFORT, lambda rig: jf(*[1.0] * 6)),
}


@pytest.mark.parametrize("second", MODES)
@pytest.mark.parametrize("first", MODES)
def test_hardware_that_stops_between_modes_is_stopped_and_waited_for(
    first: str, second: str
) -> None:
    options = EngineOptions(mode_switch_dwell=0.0)
    rig = ArmRig(*ALL, stops_between_modes=True, options=options).enabled()
    rig.engine.submit(first, MODES[first][1](rig))
    rig.cycle()
    rig.device.calls.clear()
    if first == second:
        rig.engine.submit(second, MODES[second][1](rig))
        rig.cycle()
        assert rig.device.calls == ["write"]
        return
    rig.device.ready = False
    rig.engine.submit(second, MODES[second][1](rig))
    rig.cycle(3)
    assert rig.device.calls == ["stop"]
    rig.device.ready = True
    rig.cycle()
    assert rig.written[-1].mode is MODES[second][0]


def test_other_hardware_goes_from_mode_to_mode_at_once() -> None:
    options = EngineOptions(mode_switch_dwell=0.0)
    rig = ArmRig(*ALL, options=options).enabled()
    for name in ("servo_jp", "servo_jv", "servo_jf", "servo_jp"):
        rig.engine.submit(name, MODES[name][1](rig))
        rig.cycle()
        assert rig.written[-1].mode is MODES[name][0]
    assert "stop" not in rig.device.calls


# ------------------------------------------------------------------------------- trajectories of our own

OURS = {"native_moves": frozenset({"move_jp"})}


def test_a_line_of_ours_waits_for_a_move_of_the_hardware() -> None:
    rig, first = moving(**OURS)
    goal = rig.device.solver.forward(vector(BENT + 0.05))
    line = rig.engine.submit("move_cp", goal)
    assert line is not None
    rig.cycle(5)
    assert rig.written == []
    assert rig.device.calls.count("stop") == 1
    with pytest.raises(MotionAborted, match="pre-empted: by move_cp"):
        first.wait(0.0)
    assert rig.engine.status.is_busy
    assert not line.wait(0.0)
    place = rest(rig)
    rig.cycle()
    assert rig.written[0].values == pytest.approx(place, abs=1e-3)
    rig.cycle(500)
    assert line.wait(0.0)
    assert not rig.engine.status.is_busy
    assert rig.written[-1].values == pytest.approx(BENT + 0.05)


@pytest.mark.parametrize("what", ["servo_jp", "hold", "move_jp", "move_cp", "disable", "never"])
def test_a_line_that_waits_ends_its_handle_however_it_ends(what: str) -> None:
    rig, _ = moving(**OURS)
    goal = rig.device.solver.forward(vector(BENT + 0.05))
    line = rig.engine.submit("move_cp", goal, stamp_ns=5)
    assert line is not None
    rig.cycle(2)
    values: dict[str, Any] = {"servo_jp": jp(*BENT), "move_jp": jp(*BENT), "move_cp": goal}
    if what == "disable":
        rig.command("disable")
    elif what == "never":
        rig.cycle(int(REST_TIMEOUT / PERIOD) + 3)
        assert rig.told.refusals[-1].stamp_ns == 5
    else:
        rig.engine.submit(what, values.get(what))
        rig.cycle(2)
    with pytest.raises(MotionAborted):
        line.wait(0.0)
    assert rig.engine.status.is_busy is what.startswith("move")
    assert rig.written == []


def test_hardware_that_stops_between_modes_does_so_before_a_move_too() -> None:
    rig = ArmRig(*ALL, stops_between_modes=True).enabled()
    rig.stream("servo_jv", jv(*[0.5] * 6), 20)
    count = len(rig.written)
    rig.device.ready = False
    move = rig.engine.submit("move_jp", jp(*(BENT - 0.2)))
    rig.cycle(10)
    assert len(rig.written) == count
    assert rig.device.calls[-1] == "stop"
    rig.device.ready = True
    rig.cycle(400)
    assert move is not None
    assert move.wait(0.0)
    assert rig.written[-1].values == pytest.approx(BENT - 0.2)


# ------------------------------------------------------------------------------------------ free drive


def test_a_stream_after_free_drive_waits_too() -> None:
    rig = ArmRig(*ALL, has_free=True).enabled()
    rig.engine.submit("free")
    rig.cycle(3)
    rig.device.ready = False
    rig.engine.submit("servo_jp", jp(*BENT))
    rig.cycle(3)
    assert rig.device.calls.count("stop") == 1
    assert rig.written == []
    rig.device.ready = True
    rig.cycle()
    assert len(rig.written) == 1


# ---------------------------------------------------------------------------------- gravity compensation


@pytest.mark.parametrize("state", ["DISABLED", "ENABLED", "PAUSED", "FAULT"])
def test_gravity_compensation_is_switched_in_any_state_and_by_the_io_thread(state: str) -> None:
    rig = ArmRig(*ALL, has_gravity_compensation=True).connect()
    if state in ("ENABLED", "PAUSED"):
        rig.command("enable")
    if state == "PAUSED":
        rig.command("pause")
    if state == "FAULT":
        rig.device.reported = Condition(OperatingState.FAULT, "bumped")
        rig.cycle()
    assert rig.state == state
    rig.engine.submit("use_gravity_compensation", Flag(True))
    assert rig.device.gravity == [], "not in the client's thread"
    rig.cycle()
    assert rig.device.gravity == [True]
    rig.engine.submit("use_gravity_compensation", Flag(True))
    rig.engine.submit("use_gravity_compensation", Flag(False))
    rig.cycle(3)
    assert rig.device.gravity[-1] is False
    assert rig.state == state


def test_gravity_compensation_and_a_stream_do_not_displace_each_other() -> None:
    rig = ArmRig(*ALL, has_gravity_compensation=True).enabled()
    expected = []
    for index in range(10):
        on = index % 2 == 0
        rig.engine.submit("servo_jf", jf(*[1.0 + index] * 6))
        rig.engine.submit("use_gravity_compensation", Flag(on))
        rig.engine.submit("servo_jf", jf(*[2.0 + index] * 6))
        expected.append(on)
        rig.cycle()
        assert rig.written[-1].values == pytest.approx([2.0 + index] * 6)
    assert rig.device.gravity == expected
    assert len(rig.written) == 10


def test_a_device_that_refuses_gravity_compensation_says_so_and_nothing_stops() -> None:
    rig = ArmRig(*ALL, has_gravity_compensation=True).enabled()
    rig.device.fail["use_gravity_compensation"] = CommandRefused(
        "use_gravity_compensation", Reason.LOCAL_CONTROL, "by hand only"
    )
    move = rig.engine.submit("move_jp", jp(*(BENT + 0.01)))
    rig.cycle()
    rig.engine.submit("use_gravity_compensation", Flag(True))
    rig.cycle(100)
    assert [told.reason for told in rig.told.refusals] == [Reason.LOCAL_CONTROL]
    assert move is not None
    assert move.wait(0.0)


@pytest.mark.parametrize("name", STREAMS)
def test_a_stream_that_falls_silent_while_it_waits_moves_nothing_later(name: str) -> None:
    rig, move = moving()
    rig.device.ready = False
    rig.engine.submit(name, STREAMS[name](), stamp_ns=7)
    rig.cycle(150)  # 0.6 s
    rest(rig)
    rig.cycle(10)
    assert not move.is_busy()
    assert rig.written == []
    assert rig.state is OperatingState.ENABLED
    assert [(told.command, told.reason, told.stamp_ns) for told in rig.told.refusals] == [
        (name, Reason.TOO_OLD, 7)
    ]
