"""Whatever is lost on the way to a stop, the servos stop, and it is said where that cannot be read back.

One message, exactly one, is lost, doubled or late: each of those on every way out of a motion in turn.
"""

import time
from collections.abc import Callable
from contextlib import suppress

import numpy as np
import pytest

from crtk_drivers.commands import Kind
from crtk_drivers.errors import CommandRefused, Reason
from rigs import dynamixel_bench
from rigs.dynamixel_bench import (
    FAST_SYNC_READ,
    LONG,
    READ,
    SYNC_WRITE,
    WEIGHTLESS,
    DynamixelBench,
    arm_values,
    driver_at,
    eventually,
    set_upright,
    sim_for,
)

VALUES = arm_values(mode_switch_dwell=0.0, stream_timeout=0.1, silent_timeout=0.5)
MOVING = {"servo_jv": [0.5, 0, 0, 0, 0, 0], "servo_jf": [0.6, 0, 0, 0, 0, 0]}
WAYS = {
    "hold": ("lost", "doubled", "late"),
    "disable": ("lost", "doubled"),
    "pause": ("lost",),
    "silence": ("lost",),
}
"""Ways out of a motion, each with what happens to a message. On a line no message overtakes another; where
one is late with `hold`, and undoes the torque, that must be told."""
HELD_UP = 0.03
"""Seconds from one sample to the next above which the driver was held up, and a joint went on by itself."""
MOST = 30
"""More messages than any way to a stop has."""


@pytest.fixture(scope="module")
def shared():
    with sim_for(VALUES, servos=WEIGHTLESS) as sim:
        yield sim


@pytest.fixture(scope="module")
def shared_bench(shared):
    set_upright(shared)
    with driver_at(shared, VALUES) as bench:
        yield bench


@pytest.fixture
def bench(shared_bench):
    shared_bench.sim.control.clear()
    return shared_bench


def waist(bench: DynamixelBench) -> dict:
    return bench.servos()[1]


def turn(bench: DynamixelBench, name: str) -> None:
    """Have the waist turn, from its middle on."""
    if bench.status.state == "PAUSED":
        bench.arm.resume()
    elif bench.status.state != "ENABLED":
        bench.enable()
    if abs(waist(bench)["angle"]) > 0.3:
        assert bench.arm.move_jp([0.0] * 6).wait(LONG)
        bench.until_still()
    bench.stream(name, MOVING[name], lambda: waist(bench)["velocity"] > 0.25)


def tampered(bench: DynamixelBench) -> int:
    return bench.sim.control.status()["buses"]["bus1"]["tampered"]


def inject_in_motion(bench: DynamixelBench, name: str, **parameters: object) -> None:
    """Have something happen to messages that are yet to come, while the waist turns."""
    while True:
        turn(bench, name)
        bench.sim.control.inject("message", **parameters)
        if bench.arm.health().stream:
            return
        bench.sim.control.clear()  # whoever was held up comes after the way to the stop


def leave(bench: DynamixelBench, way: str) -> None:
    if way == "silence":
        eventually(lambda: not bench.arm.health().stream, "the stream ends")
    else:
        getattr(bench.arm, way)()


def assert_stopped(bench: DynamixelBench, way: str) -> None:
    """It stands, which was read back, and holds; a torque that was lost is told."""
    eventually(lambda: bench.device.has_stopped, "it is read back")
    bench.until_still()
    with bench.nothing_moves(counts=4):
        bench.cycles(6)
    torques, wanted = bench.torques()[:6], [way != "disable"] * 6
    if torques != wanted:
        bench.until_state("FAULT", "its torque is off")


@pytest.mark.sweep(7)
@pytest.mark.parametrize(("way", "effect"), [(w, e) for w in WAYS for e in WAYS[w]])
@pytest.mark.parametrize("name", MOVING)
def test_one_message_on_the_way_to_a_stop(bench, name, way, effect):
    for number in range(1, MOST):
        before = tampered(bench)
        inject_in_motion(bench, name, code=SYNC_WRITE, number=number, effect=effect)
        leave(bench, way)
        assert_stopped(bench, way)
        was_hit = tampered(bench) > before
        bench.sim.control.clear()
        if not was_hit:
            break
    assert number > 2, "messages were hit"
    assert not was_hit, "all of them"


@pytest.mark.parametrize("code", [FAST_SYNC_READ, READ])
def test_one_answer_on_the_way_to_a_stop(bench, code):
    for number in range(1, 6):
        inject_in_motion(bench, "servo_jv", code=code, number=number)
        leave(bench, "hold")
        assert_stopped(bench, "hold")
        bench.sim.control.clear()


def enable_at(bench: DynamixelBench, angle: float) -> float:
    """Enable with the waist at an angle, and return the upper end of its range."""
    bench.arm.disable(timeout=LONG)
    bench.place(joint_1=angle)
    bench.cycles()
    bench.enable()
    bench.log.refusals.clear()
    upper: float = bench.engine.capabilities.limits[0].upper
    return upper


def beyond_the_range(bench: DynamixelBench) -> list[CommandRefused]:
    """Return what was refused because of where it leads."""
    return [told for told in list(bench.log.refusals) if told.reason is Reason.OUT_OF_RANGE]


@pytest.mark.parametrize("begins_at", [2.9, 3.06, 3.12, 3.135])
def test_an_effort_that_goes_on_and_on_does_not_drive_a_joint_out_of_its_range(bench, begins_at):
    upper = enable_at(bench, begins_at)
    looked: list[float] = []
    bench.engine.on_sample = lambda: looked.append(time.monotonic())
    begin, farthest, fastest = time.monotonic(), 0.0, 0.0
    while time.monotonic() < begin + (1.0 if beyond_the_range(bench) else LONG):
        with suppress(CommandRefused):
            bench.arm.servo_jf([0.3, 0, 0, 0, 0, 0])
        now = waist(bench)
        farthest, fastest = max(farthest, now["angle"]), max(fastest, now["velocity"])
        time.sleep(0.005)
    bench.until_still()
    bench.engine.on_sample = None
    farthest = max(farthest, waist(bench)["angle"])
    bench.arm.disable(timeout=LONG)
    bench.place(joint_1=0.0)
    unseen = max(0.0, np.diff(looked).max() - HELD_UP)
    assert begins_at < farthest < upper + 0.03 + fastest * unseen
    assert "waist" in beyond_the_range(bench)[0].detail


@pytest.mark.parametrize("begins_at", [2.9, 3.04, 3.08])
def test_an_effort_whose_way_nobody_sees_any_more_is_let_go(bench, begins_at):
    """Answers stay away, commands arrive, and the servos' watchdogs hear them: only the driver can end it."""
    upper = enable_at(bench, begins_at)
    is_silent, farthest = False, begins_at
    deadline = time.monotonic() + LONG
    while bench.engine.connected:
        assert time.monotonic() < deadline, "the link is never given up"
        with suppress(CommandRefused):
            bench.arm.servo_jf([0.3, 0, 0, 0, 0, 0])
        now = waist(bench)
        farthest = max(farthest, now["angle"])
        if not is_silent and now["velocity"] > 0.1 and now["torque_applied"] > 0.2:
            bench.sim.control.inject("stall")
            is_silent = True
        time.sleep(0.005)
    bench.sim.control.clear()
    eventually(lambda: bench.status.state == "DISABLED", "the arm answers again")
    eventually(lambda: bench.engine._stopping.confirmed, "it is seen to stand")
    bench.place(joint_1=0.0)
    # Two cycles without an answer take up to 0.26 s; as long as `silent_timeout` it was 0.3 to 0.43 rad.
    assert farthest < upper + 0.1
    assert bench.log.refusals[0].reason in (Reason.NOT_MEASURED, Reason.OUT_OF_RANGE)


def test_a_servo_that_is_silent_during_a_stop_holds_by_position_as_the_others_when_it_is_back(
    monkeypatch,
):
    # That a stop takes long is told, as FAULT, which is not what this is about.
    monkeypatch.setattr(dynamixel_bench, "STOP_TIME", LONG)
    values = {**VALUES, "fast_read": False}
    with sim_for(values, servos=WEIGHTLESS) as sim:
        set_upright(sim)
        with driver_at(sim, values) as bench:
            part = bench.device.part
            for name in MOVING:
                turn(bench, name)
                sim.control.inject("drop", id=1)
                bench.engine.state_command("pause")
                eventually(lambda: part.kind not in (Kind.VELOCITY, Kind.EFFORT), "modes change")
                eventually(lambda: part.kind is Kind.POSITION, "the others hold by position")
                sim.control.clear()
                bench.until_state("PAUSED")
                eventually(lambda: bench.device.has_stopped, "it is read back")
                bench.arm.resume()
                assert bench.arm.move_jp([0.2, 0, 0, 0, 0, 0]).wait(LONG)


JOINT = 4
SILENCES = {
    "nothing of any servo is heard": ("stall", {}),
    "one servo is not heard": ("drop", {"id": JOINT}),
    "one servo hears nothing": ("silent", {"id": JOINT}),
}


@pytest.fixture(scope="module")
def one_by_one():
    values = {**VALUES, "fast_read": False}
    with sim_for(values, servos=WEIGHTLESS) as sim:
        set_upright(sim)
        with driver_at(sim, values) as bench:
            yield bench


@pytest.mark.parametrize("silence", SILENCES)
def test_a_silent_joint_never_goes_back(one_by_one, silence):
    """Where it was seen last is no place to hold it: setpoints have gone on, and it with them."""
    bench = one_by_one
    bench.reset()
    bench.enable()
    assert bench.arm.move_jp([0, 0, 0, -2.5, 0, 0]).wait(LONG)
    bench.arm.move_jp([0, 0, 0, 2.5, 0, 0])
    angles = [bench.servos()[JOINT]["angle"]]

    def looking(until: Callable[[], object], what: str) -> None:
        eventually(lambda: (angles.append(bench.servos()[JOINT]["angle"]), until())[1], what)

    looking(lambda: angles[-1] > -2.3, "it moves")
    kind, parameters = SILENCES[silence]
    bench.sim.control.inject(kind, **parameters)
    looking(lambda: bench.status.state == "FAULT", "it is told")
    end = time.monotonic() + 0.3
    looking(lambda: time.monotonic() > end and bench.stands(), "it stands")
    with bench.nothing_moves():
        bench.sim.control.clear()
        bench.until_connected()
        bench.cycles(20)
        eventually(lambda: bench.device.has_stopped, "it is read back")
    back = np.maximum.accumulate(angles) - angles
    assert back.max() < 0.03
