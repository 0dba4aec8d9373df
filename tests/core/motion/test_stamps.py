"""The stamps of commands: in what is set, in goals, and in refusals."""

from collections.abc import Callable

import pytest

from crtk_drivers.device import Mode
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.samples import Pose, Value, Vector, vector
from rigs.scripted_arm import BENT, ArmRig, cs, js, step, twist, wrench
from rigs.scripted_engine import jf, jp, jv

ALL = (Mode.JOINT_POSITION, Mode.JOINT_VELOCITY, Mode.JOINT_EFFORT)
STAMP = 1_234_567_890
Make = Callable[[ArmRig], Value]

SERVO: dict[str, Make] = {
    "servo_jp": lambda rig: jp(*(BENT + 0.01)),
    "servo_jr": lambda rig: jp(*[0.001] * 6),
    "servo_jv": lambda rig: jv(*[0.1] * 6),
    "servo_jf": lambda rig: jf(*[1.0] * 6),
    "servo_cp": lambda rig: rig.device.pose,
    "servo_cr": lambda rig: step(0.001, 0, 0, 0, 0, 0),
    "servo_cv": lambda rig: twist(0.05, 0, 0, 0, 0, 0),
    "servo_cf": lambda rig: wrench(1.0, 0, 0, 0, 0, 0),
    "body/servo_cr": lambda rig: step(0.001, 0, 0, 0, 0, 0),
    "body/servo_cv": lambda rig: twist(0.05, 0, 0, 0, 0, 0),
    "body/servo_cf": lambda rig: wrench(1.0, 0, 0, 0, 0, 0),
    "servo_js": lambda rig: js("PVNNNN", BENT, [0.1] * 6),
    "servo_cs": lambda rig: cs("VNNNNN", rate=twist(0.05, 0, 0, 0, 0, 0)),
}
SLOW: dict[str, Make] = {
    "interpolate_jp": lambda rig: jp(*(BENT + 0.01)),
    "interpolate_jr": lambda rig: jp(*[0.001] * 6),
    "interpolate_jv": lambda rig: jv(*[0.1] * 6),
    "interpolate_cp": lambda rig: rig.device.pose,
    "interpolate_cv": lambda rig: twist(0.05, 0, 0, 0, 0, 0),
}
MOVES: dict[str, Make] = {
    "move_jp": lambda rig: jp(*(BENT + 0.1)),
    "move_jr": lambda rig: jp(*[0.1] * 6),
    "move_cp": lambda rig: rig.device.pose,
    "body/move_cr": lambda rig: step(0.01, 0, 0, 0, 0, 0),
}
SETPOINTS = ("setpoint_js", "setpoint_cp", "setpoint_cv", "setpoint_cf")


def stamps(rig: ArmRig) -> set[int]:
    """Of those setpoints that are valid."""
    return {rig.value(name)[1] for name in SETPOINTS} - {0}


@pytest.mark.parametrize("name", SERVO)
def test_what_is_set_carries_the_stamp_of_the_servo_command_while_the_stream_runs(
    name: str,
) -> None:
    rig = ArmRig(*ALL).enabled()
    for index in range(5):
        rig.engine.submit(name, SERVO[name](rig), stamp_ns=STAMP + index)
        rig.cycle()
        assert stamps(rig) == {STAMP + index}
    rig.cycle(5)
    assert stamps(rig) == {STAMP + 4}, "until the next one, or silence"
    rig.cycle(60)
    assert rig.engine.health().stream == ""
    assert stamps(rig) == {rig.value("measured_js")[1]}


@pytest.mark.parametrize("name", SERVO)
def test_a_command_without_a_stamp_echoes_none(name: str) -> None:
    rig = ArmRig(*ALL).enabled()
    rig.engine.submit(name, SERVO[name](rig), stamp_ns=STAMP)
    rig.cycle()
    rig.engine.submit(name, SERVO[name](rig))
    rig.cycle()
    assert stamps(rig) == {rig.value("measured_js")[1]}


def test_of_two_commands_in_one_cycle_it_is_the_newer_ones() -> None:
    rig = ArmRig(*ALL).enabled()
    for name in ("servo_jp", "servo_jr"):
        rig.engine.submit("hold")
        rig.cycle()
        rig.engine.submit(name, SERVO[name](rig), stamp_ns=STAMP)
        rig.engine.submit(name, SERVO[name](rig), stamp_ns=STAMP + 1)
        rig.cycle()
        assert stamps(rig) == {STAMP + 1}


@pytest.mark.parametrize("name", SERVO)
@pytest.mark.parametrize("what", ["hold", "move_jp", "pause"])
def test_what_ends_a_stream_ends_its_stamp(what: str, name: str) -> None:
    rig = ArmRig(*ALL).enabled()
    rig.engine.submit(name, SERVO[name](rig), stamp_ns=STAMP)
    rig.cycle()
    if what == "pause":
        rig.command("pause")
    else:
        rig.engine.submit(what, jp(*(BENT + 0.2)) if what == "move_jp" else None, stamp_ns=STAMP)
    rig.cycle(2)
    assert stamps(rig) == {rig.value("measured_js")[1]}


@pytest.mark.parametrize("name", SLOW)
def test_a_smoothed_stream_stamps_its_goals_and_not_what_is_set(name: str) -> None:
    rig = ArmRig(*ALL).enabled()
    rig.engine.submit(name, SLOW[name](rig), stamp_ns=STAMP)
    rig.cycle(3)
    goals = [rig.engine.latched(goal) for goal in ("goal_js", "goal_cp", "goal_cv")]
    assert {goal[1].wall_ns for goal in goals if goal is not None} == {STAMP}
    assert stamps(rig) == {rig.value("measured_js")[1]}


@pytest.mark.parametrize("name", MOVES)
def test_a_move_stamps_its_goals_at_once_and_not_what_is_set(name: str) -> None:
    rig = ArmRig(*ALL).enabled()
    rig.engine.submit(name, MOVES[name](rig), stamp_ns=STAMP)
    for goal in ("goal_js", "goal_cp"):
        found = rig.engine.latched(goal)
        assert found is not None
        assert found[1].wall_ns == STAMP
    rig.cycle(3)
    assert stamps(rig) == {rig.value("measured_js")[1]}
    rig.engine.submit(name, MOVES[name](rig))
    found = rig.engine.latched("goal_js")
    assert found is not None
    assert found[1].wall_ns not in (0, STAMP), "accepted now"


def test_a_refusal_carries_the_stamp_of_its_command() -> None:
    rig = ArmRig(*ALL).enabled()
    with pytest.raises(CommandRefused) as caught:
        rig.engine.submit("servo_jp", jp(0.0), stamp_ns=STAMP)
    assert caught.value.stamp_ns == STAMP
    assert rig.told.refusals[-1].stamp_ns == STAMP
    with pytest.raises(CommandRefused) as caught:
        rig.engine.submit("servo_jp", jp(0.0))
    assert caught.value.stamp_ns == 0


@pytest.mark.parametrize("name", ["servo_jr", "servo_cr"])
def test_so_does_a_refusal_in_the_io_thread(name: str) -> None:
    rig = ArmRig(*ALL).enabled()
    far = {"servo_jr": jp(*[0.15] * 6), "servo_cr": step(0.04, 0, 0, 0, 0, 0)}[name]
    rig.engine.submit(name, far, stamp_ns=STAMP)
    rig.engine.submit(name, far, stamp_ns=STAMP + 1)
    assert rig.told.refusals == []
    rig.cycle()
    assert [(told.reason, told.stamp_ns) for told in rig.told.refusals] == [
        (Reason.STEP_TOO_LARGE, STAMP + 1)
    ]
    assert rig.written == []


def test_so_does_a_refusal_that_ends_a_stream_on_its_way() -> None:
    rig = ArmRig(*ALL).enabled()
    rig.engine.submit("interpolate_cr", step(0.01, 0, 0, 0, 0, 0), stamp_ns=STAMP)
    rig.cycle()
    rig.engine.submit("interpolate_cr", step(0.1, 0, 0, 0, 0, 0), stamp_ns=STAMP + 7)
    rig.cycle(2)
    solve = rig.device.solver.inverse

    def other_branch(pose: Pose, near: Vector) -> Vector:
        return vector(solve(pose, near) + 0.05)

    rig.device.solver.inverse = other_branch  # type: ignore[method-assign]
    rig.cycle(3)
    assert [(told.command, told.stamp_ns) for told in rig.told.refusals] == [
        ("interpolate_cr", STAMP + 7)
    ]
