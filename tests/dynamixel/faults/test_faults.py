"""Faults of servos, bus, adapter and driver process: what state follows, and that nothing moves by itself.

The faults are every kind of the simulator, and those of the table F1 to F20 in the documentation that
concern this driver.
"""

import itertools
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from crtk_driver_dynamixel import part, preparation
from crtk_drivers.commands import Kind
from crtk_drivers.errors import CommandRefused, ConnectionFailed, MotionAborted, TransitionFailed
from crtk_sim_backends.dynamixel.injection import stuffing_values
from rigs.dynamixel_bench import (
    COUNT,
    HARMLESS,
    LONG,
    PATIENT,
    WEIGHTLESS,
    DynamixelBench,
    arm_values,
    driver_at,
    dynamixel_bench,
    eventually,
    opened,
    set_upright,
    sim_for,
    writes_of,
)

VALUES = arm_values(joints={"waist": {"velocity": 1.0}})
FAR = [2.5, 0.0, 0.0, 0.0, 0.0, 0.0]
ID = 5
JOINT = "joint wrist_angle (servo 5 on main)"
OTHERS = (1, 2, 3, 4, 6, 7)


WATCHDOG = 1.0

LENIENT = 1.0
"""Seconds that looking at the simulator may take on a busy machine."""


@pytest.fixture(scope="module")
def shared():
    with sim_for(VALUES, servos=WEIGHTLESS) as sim:
        yield sim


@pytest.fixture
def sim(shared):
    set_upright(shared)
    return shared


@pytest.fixture(scope="module")
def shared_bench():
    values = {**VALUES, "fast_read": False}
    with (
        patch.object(preparation, "REBOOT_TIME", 1.0),
        dynamixel_bench(values, servos=WEIGHTLESS) as bench,
    ):
        yield bench


@pytest.fixture
def bench(shared_bench):
    """A driver that reads servo by servo, for what happens to the replies of one of them."""
    shared_bench.sim.control.clear()
    shared_bench.until_connected()
    if abs(shared_bench.angles()[0]) > 0.3:  # by hand, sooner than it could move there
        shared_bench.arm.disable(timeout=LONG)
        shared_bench.place(joint_1=0.0)
        shared_bench.cycles()
    shared_bench.reset()
    return shared_bench


def start_moving(bench: DynamixelBench):
    move = bench.arm.move_jp(FAR)
    eventually(lambda: bench.servos()[1]["velocity"] > 0.2, "it moves")
    return move


def assert_stopped_by(bench: DynamixelBench, move, detail: str) -> None:
    """FAULT must name the reason, end the move, and leave the arm standing and the gripper alone."""
    bench.until_state("FAULT", detail)
    assert not bench.status.is_busy
    with pytest.raises(MotionAborted):
        move.wait(LONG)
    bench.until_still()
    assert bench.servos()[1]["angle"] < FAR[0] - 0.1
    with pytest.raises(CommandRefused, match="FAULT"):
        bench.arm.move_jp(FAR)


def assert_gripper_goes_on(bench: DynamixelBench) -> None:
    gripper = bench.arm.gripper
    assert gripper.is_enabled()
    goal = gripper.measured_js().position + 0.004
    assert gripper.move_jp(goal).wait(LONG)
    eventually(lambda: abs(gripper.measured_js().position - goal).max() < 3e-4, "it moves")


def assert_enables_at_rest(bench: DynamixelBench, ids=OTHERS) -> None:
    with bench.nothing_moves(ids=ids):
        bench.arm.enable(timeout=LONG)
        bench.cycles(5)
    assert all(bench.torques())
    assert bench.arm.measured_js(extra=True)[1] > 0.0
    assert bench.arm.move_jr([-0.1, 0.0, 0.0, 0.0, 0.1, 0.0]).wait(LONG)


# F12: a servo says that something is wrong with it.


@dataclass(frozen=True)
class ServoFault:
    """`lasts`: a restart does not clear it; `torque`: whether the servo goes on holding."""

    kind: str
    detail: str
    parameters: dict = field(default_factory=dict)
    lasts: bool = False
    torque: bool = False


SERVO_FAULTS = (
    ServoFault("overload", "overload"),
    ServoFault("overheat", "overheating", {"temperature": 95.0}, lasts=True),
    ServoFault("voltage", "input voltage out of range", {"volts": 8.0}, lasts=True, torque=True),
    ServoFault("hardware_error", "motor encoder", {"bit": 3}, torque=True),
    ServoFault("hardware_error", "electrical shock", {"bit": 4}),
    ServoFault("power_off", "does not answer", lasts=True),
)


@pytest.mark.sweep(3)
@pytest.mark.parametrize("fault", SERVO_FAULTS, ids=lambda f: f"{f.kind} {f.detail}")
def test_f12_servo_fault_under_motion(bench, fault):
    move = start_moving(bench)
    bench.sim.control.inject(fault.kind, id=ID, **fault.parameters)
    assert_stopped_by(bench, move, f"{JOINT}")
    assert fault.detail in bench.status.detail
    assert bench.torques() == [id != ID or fault.torque for id in range(1, 8)]
    assert_gripper_goes_on(bench)
    if fault.lasts:
        with bench.nothing_moves(ids=OTHERS), pytest.raises(TransitionFailed, match="wrist_angle"):
            bench.arm.enable(timeout=LONG)
        assert bench.status.state == "FAULT"
    with bench.nothing_moves(ids=OTHERS):
        bench.sim.control.clear()
        bench.cycles(30)
        assert bench.status.state == "FAULT", "only a command leads back"
    assert_enables_at_rest(bench)


@pytest.mark.parametrize("every", [1000, 3])
def test_f12_torque_is_taken_from_the_others_if_so_configured(sim, every):
    """Also when some of the instructions are not heard."""
    with driver_at(sim, {**VALUES, "on_servo_fault": "torque_off"}) as bench:
        bench.enable()
        sim.control.inject("lost", every=every)
        sim.control.inject("overload", id=ID)
        bench.until_state("FAULT", f"{JOINT}: overload")
        eventually(lambda: bench.torques() == [False] * 6 + [True], "the arm lets go")
        sim.control.clear("lost")
        bench.cycles(20)
        assert bench.torques() == [False] * 6 + [True]
        bench.arm.enable()
        assert all(bench.torques())


def test_a_servo_that_does_not_answer_may_hear_that_its_effort_is_over(bench):
    bench.sim.control.inject("stuck", id=ID)
    bench.stream(
        "servo_jf", [0, 0, 0, 0, 0.4, 0], lambda: bench.servos()[ID]["torque_applied"] > 0.3
    )
    bench.sim.control.inject("drop", id=ID)
    bench.until_state("FAULT", f"{JOINT} does not answer")
    eventually(lambda: abs(bench.servos()[ID]["torque_applied"]) < 0.01, "it exerts nothing")
    bench.sim.control.clear()
    assert_enables_at_rest(bench)


def test_a_blocked_joint_does_not_strain_until_it_becomes_an_overload(bench):
    bench.sim.control.inject("stuck", id=ID)
    bench.arm.move_jp([0, 0, 0, 0, 0.5, 0])
    bench.until_state("FAULT", "wrist_angle")
    eventually(lambda: abs(bench.servos()[ID]["torque_applied"]) < 0.1, "it does not push on")
    assert "overload" not in bench.status.detail
    bench.sim.control.clear()
    assert_enables_at_rest(bench)


# F5, F6: a servo that cannot be heard, and one that can only now and then.


@dataclass(frozen=True)
class WireFault:
    """Something that happens on the wire of one servo."""

    kind: str
    parameters: dict = field(default_factory=dict)


DEAF = {
    "stalls": WireFault("silent", {"chain": "stalls"}),
    "goes on": WireFault("silent", {"chain": "goes_on"}),
    "drop": WireFault("drop"),
    "crc": WireFault("crc"),
    "truncate": WireFault("truncate"),
    "duplicate_id": WireFault("duplicate_id"),
}


@pytest.mark.sweep(3)
@pytest.mark.parametrize("fault", DEAF.values(), ids=DEAF)
def test_f6_a_servo_that_cannot_be_heard_costs_its_own_data_only(bench, fault):
    check_deafness(bench, fault)


def test_f6_with_fast_reads(sim):
    with driver_at(sim, VALUES) as bench:
        bench.enable()
        check_deafness(bench, DEAF["stalls"])


def check_deafness(bench: DynamixelBench, fault: WireFault) -> None:
    move = start_moving(bench)
    bench.sim.control.inject(fault.kind, id=ID, **fault.parameters)
    assert_stopped_by(bench, move, f"{JOINT} does not answer")
    assert bench.arm.measured_js(age=0, extra=True)[1] == 0.0, "old data has no stamp"
    assert_gripper_goes_on(bench)
    with bench.nothing_moves():
        bench.sim.control.clear()
        eventually(lambda: bench.arm.measured_js(age=0, extra=True)[1] > 0.0, "heard again")
        assert bench.status.state == "FAULT", "only a command leads back"
        assert all(bench.torques())
    assert_enables_at_rest(bench)


NOW_AND_THEN = {
    "drop": {"every": 5},
    "crc": {"every": 5},
    "corrupt": {"every": 5},
    "truncate": {"every": 5},
    "noise": {"every": 3},
    "late": {"every": 29, "seconds": 0.03},
    "lost": {"every": 7},  # not 5: goals are sent again every 25 instructions
    "echo": {},
    "latency": {"milliseconds": 4.0},
}
DAMAGED = ("drop", "crc", "truncate", "late")


@pytest.mark.sweep(3)
@pytest.mark.parametrize("kind", NOW_AND_THEN)
def test_f5_a_bad_wire_is_worked_around(bench, kind):
    before = bench.arm.health()
    bench.sim.control.inject(kind, **NOW_AND_THEN[kind])
    check_work(bench)
    after = bench.arm.health()
    if kind in DAMAGED:
        names = ("timeouts", "corrupt")
        assert sum(after.device[name] - before.device[name] for name in names) > 0
    bench.sim.control.clear()
    here = [servo["angle"] for servo in bench.servos().values()]
    bench.cycles(2)
    assert bench.arm.measured_js().position == pytest.approx(here[:6], abs=2 * COUNT)


@pytest.mark.parametrize("kind", ["corrupt", "late"])
def test_f5_with_fast_reads(sim, kind):
    with driver_at(sim, VALUES) as bench:
        bench.enable()
        bench.sim.control.inject(kind, **NOW_AND_THEN[kind])
        check_work(bench)


def check_work(bench: DynamixelBench) -> None:
    """The arm must move, change its mode, be disabled and enabled again."""
    assert bench.arm.move_jp([0.1, 0, 0, 0, 0.1, 0]).wait(LONG)
    bench.stream("servo_jv", [0.0] * 6, lambda: bench.device.part.kind is Kind.VELOCITY)
    eventually(lambda: not bench.arm.health().stream, "the stream ends")
    eventually(lambda: bench.device.takes_setpoints, "it holds")
    assert bench.status.state == "ENABLED", bench.status
    bench.arm.disable()
    bench.arm.enable()
    bench.until_still()


@pytest.mark.parametrize("fast_read", [True, False])
def test_what_an_adapter_held_back_never_counts_as_new(fast_read):
    """However long: what comes after its time is from before, and has no new stamp."""
    values = {**PATIENT, "fast_read": fast_read, "latency_budget": 0.004}
    values |= {"silent_timeout": 9.0, "sample_timeout": 10.0}
    values["joints"] = {"pan": {"id": 1, "model": "xm430-w350"}}
    with dynamixel_bench(values) as bench:
        samples = []

        def keep():
            joints, stamp = bench.engine.feedback("measured_js")
            samples.append((stamp.monotonic, float(joints.position[0])))

        def after(placed, angle):
            found = [position for at, position in samples if at > placed]
            assert found == pytest.approx([angle] * len(found), abs=2 * COUNT)
            return found

        bench.engine.on_sample = keep
        for angle in (0.1, 0.2, 0.3):
            bench.cycles(3)
            bench.sim.control.inject("stall")
            until_misses(bench, 5)
            placed = put(bench, angle)
            bench.sim.control.clear("stall")
            bench.cycles(5)
            assert len(after(placed, angle)) > 1
        for number in range(12):
            bench.sim.control.inject("late", seconds=0.1 + 0.004 * number)
            until_misses(bench, 5)
            placed = put(bench, 0.1 * number)
            until_misses(bench, 12)
            after(placed, 0.1 * number)


def put(bench: DynamixelBench, angle: float) -> float:
    """Put the joint somewhere; return a time from which on every reading begins after that."""
    bench.place(joint_1=angle)
    until_misses(bench, 2)
    return time.monotonic()


def until_misses(bench: DynamixelBench, count: int) -> None:
    """Wait until so many more answers were missed."""
    goal = bench.arm.health().device["timeouts"] + count
    eventually(lambda: bench.arm.health().device["timeouts"] >= goal, f"{count} misses")


def test_values_that_need_stuffing_arrive_as_they_are(sim):
    values = {**VALUES, "fast_read": False, "latency_budget": 0.5}
    values |= {"silent_timeout": 9.0, "sample_timeout": 10.0}
    with driver_at(sim, values) as bench:
        before = bench.arm.health().device
        sim.control.inject("stuffing", id=ID, seed=3)
        told = {
            (current, velocity, position)
            for current, velocity, position in itertools.islice(stuffing_values(3), 2000)
        }
        link, seen = bench.device.link, set()

        def enough():
            frame = link.frame
            seen.add(tuple(int(x[ID - 1]) for x in (frame.effort, frame.velocity, frame.position)))
            return len(seen) > 30

        eventually(enough, "values of its own")
        strange = {value for value in seen if value not in told}
        assert len(strange) <= 1, "only what came before the fault"
        after = bench.arm.health().device
        assert after["corrupt"] == before["corrupt"]
        assert after["timeouts"] == before["timeouts"]


def slowly(link, places):
    for _ in range(200):
        yield
    yield from preparation.recover(link, places)


def test_a_watchdog_that_tripped_is_recognised(sim, monkeypatch):
    values = {**VALUES, "watchdog": WATCHDOG, "silent_timeout": 5.0, "sample_timeout": 10.0}
    with driver_at(sim, values) as bench:
        bench.enable()
        move = start_moving(bench)
        sim.control.inject("lost")
        eventually(
            lambda: {servo["bus_watchdog"] for servo in bench.servos().values()} == {-1},
            "all watchdogs trip",
        )
        sim.control.clear()
        assert_stopped_by(bench, move, "its bus watchdog has stopped it")
        assert all(bench.torques())
        gripper = bench.session.children["gripper"]
        bench.until_state("FAULT", "its bus watchdog has stopped it", gripper)
        bench.arm.gripper.enable()
        # The goals of before, which the servos refused, are none any more, however long it takes to enable.
        monkeypatch.setattr(part, "recover", slowly)
        assert_enables_at_rest(bench)


# F7: the adapter.


def test_f7_unplugged_and_plugged_in_again(bench):
    reconnects = bench.arm.health().reconnects
    move = start_moving(bench)
    bench.sim.control.inject("unplug")
    assert "cable" in bench.until_state("FAULT", "the adapter is gone")
    with pytest.raises(MotionAborted):
        move.wait(LONG)
    eventually(lambda: bench.arm.measured_js(age=0, extra=True)[1] == 0.0, "no stamp")
    bench.until_still()
    assert all(bench.torques()), "they hold"
    with bench.nothing_moves():
        mark = bench.mark()
        bench.sim.control.clear()
        bench.until_state("DISABLED")
        bench.until_connected()
        bench.cycles(20)
        assert {entry["code"] for entry in bench.trace(mark)} <= HARMLESS
        assert all(bench.torques())
    assert bench.arm.health().reconnects == reconnects + 1
    eventually(lambda: bench.session.children["gripper"].connected, "the gripper too")
    assert_enables_at_rest(bench)


def test_f7_power_of_the_whole_arm(bench):
    start_moving(bench)
    bench.sim.control.inject("power_off")
    bench.until_state("FAULT")
    eventually(lambda: not bench.engine.connected, "the link is given up")
    assert "power" in bench.status.detail or "answer" in bench.status.detail
    bench.sim.control.clear()
    bench.until_state("DISABLED")
    bench.until_connected()
    assert not any(bench.torques())
    with bench.nothing_moves():
        bench.enable()
    assert all(bench.torques())


# F15: the stream of setpoints ends.


@pytest.mark.parametrize(("policy", "state"), [("pause", "PAUSED"), ("fault", "FAULT")])
def test_f15_a_stream_that_stops_in_motion(sim, policy, state):
    values = {**VALUES, "on_stream_timeout": policy, "stream_timeout": 0.8}
    with driver_at(sim, values) as bench:
        bench.enable()
        value = [0.5, 0, 0, 0, 0, 0]
        bench.stream("servo_jv", value, lambda: bench.servos()[1]["velocity"] > 0.3)
        bench.until_state(state, "servo_jv stopped")
        eventually(lambda: bench.device.takes_setpoints, "it holds")
        bench.until_still()
        with bench.nothing_moves(counts=2):
            bench.cycles(20)
        assert all(bench.torques())


# F16, F17, F19, F20: processes.

DRIVER = """
import sys, time
sys.path[:0] = {path!r}
from rigs.dynamixel_bench import driver_at

class Sim:
    ttys = {ttys!r}

with driver_at(Sim(), {values!r}) as bench:
    bench.enable()
    bench.arm.move_jp([0.6, 0.0, 0.0, 0.0, 0.0, 0.0]).wait()
    while True:
        bench.arm.servo_jv([-0.4, 0.0, 0.0, 0.0, 0.0, 0.0])
        time.sleep(0.01)
"""


def driver_process(sim) -> subprocess.Popen:
    """A driver in a process of its own: it moves there, and back with a velocity that nothing ends."""
    path = [str(Path(__file__).parents[2]), *filter(None, sys.path)]
    values = {**VALUES, "watchdog": WATCHDOG, "joints": {"waist": {"velocity": 0.5}}}
    text = DRIVER.format(path=path, ttys=sim.ttys, values=values)
    return subprocess.Popen([sys.executable, "-c", text])


@pytest.mark.slow
@pytest.mark.parametrize("sent", [signal.SIGSTOP, signal.SIGKILL], ids=["frozen", "killed"])
def test_f16_the_servos_stop_when_the_process_is(sim, sent):
    with driver_at(sim, VALUES, start=False) as bench:
        process = driver_process(sim)
        try:
            eventually(lambda: bench.servos()[1]["velocity"] > 0.4, "it moves")
            if sent == signal.SIGSTOP:
                in_use = rf"in use by process {process.pid} \("
                with pytest.raises(ConnectionFailed, match=in_use), opened(sim, VALUES):
                    pass  # F20
            else:
                check_no_burst_after_a_pause(bench, process)
            eventually(lambda: bench.servos()[1]["velocity"] < -0.3, "it moves by velocity")
            process.send_signal(sent)
            before = bench.servos()[1]["angle"]
            bench.until_still()
            assert before - bench.servos()[1]["angle"] < 0.5 * (WATCHDOG + LENIENT)
            assert all(bench.torques()), "they hold"
        finally:
            process.kill()
            process.wait()
        with bench.nothing_moves():
            bench.session.start()
            bench.until_connected()
            assert bench.status.state == "DISABLED"
            assert bench.watch(0.1) < 5e-3, "F19: nothing moves because of a restart"
        assert_enables_at_rest(bench)


def check_no_burst_after_a_pause(bench: DynamixelBench, process: subprocess.Popen) -> None:
    """F17: a process that got no time for a while goes on as if nothing had been."""
    mark = bench.mark()
    eventually(lambda: goal_times(bench, mark), "a goal")
    process.send_signal(signal.SIGSTOP)
    time.sleep(0.05)  # the fault itself
    process.send_signal(signal.SIGCONT)
    eventually(lambda: len(goal_times(bench, mark)) > 30, "it goes on")
    times = goal_times(bench, mark)
    gaps = np.diff([at for at, _ in times])
    longest = int(np.argmax(gaps))
    assert gaps[longest] > 0.03
    after = [at for at, _ in times[longest + 1 :]]
    soon = [at for at in after if at < after[0] + 0.05]
    assert len(soon) <= 0.05 * PATIENT["rate"] + 2, "cycles are not caught up"
    steps = np.abs(np.diff([goal for _, goal in times])) * COUNT
    assert steps[longest] <= 0.5 * (gaps[longest] + 0.02) + 2 * COUNT


def goal_times(bench, mark):
    """When and which goals servo 1 was sent."""
    return [
        (entry["time_ns"] * 1e-9, write.get("goal_position"))
        for entry in bench.trace(mark)
        for write in writes_of(entry)
        if write.id == 1 and write.get("goal_position") is not None
    ]


@pytest.mark.real_time  # who has a port open is looked up in /proc
def test_f20_a_second_driver_in_this_process(bench):
    with driver_at(bench.sim, VALUES, start=False) as second, bench.nothing_moves():
        second.session.start()
        assert f"process {os.getpid()} (" in second.until_state("FAULT", "in use")
        assert bench.status.state == "ENABLED"
