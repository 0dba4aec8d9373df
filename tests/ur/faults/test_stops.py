"""Stops of a UR arm: read back, by a second way where the first is gone, and what the driver leaves."""

import math
import os
import signal
import socket
import threading
import time
from contextlib import suppress

import numpy as np
import pytest

from crtk_driver_ur.library.sequencer import LONGEST_STEP
from crtk_driver_ur.models import JOINT_NAMES, model_named
from crtk_driver_ur.native import registers
from crtk_driver_ur.native.link import STOP_TIMEOUT
from crtk_drivers.engine import cycle
from crtk_drivers.errors import CommandRefused, ConfigError, DeviceError, MotionAborted
from rigs.ur_bench import (
    FAR,
    HOME,
    LATE_STATE,
    LONG,
    PATIENT,
    QUICK_WATCHDOG,
    WAYS,
    UrBench,
    brisk_sim,
    driver_at,
    eventually,
    ur_bench,
)
from rigs.ur_clients import RtdeClient

pytestmark = pytest.mark.sweep(2)

POWER_OFF, IDLE, RUNNING = 3, 5, 7
STOPPED, PLAYING, PAUSED = 1, 2, 4
SERVO_J = 11
CONFIG = {"open_timeout": 5.0, "watchdog_frequency": QUICK_WATCHDOG}
RELEASED = "its brakes were already released"
STOP_DECELERATION = 10.0  # rad/s^2, of an arm whose program has ended

both_ways = pytest.mark.parametrize("control", WAYS)


@pytest.fixture(scope="module", params=WAYS)
def shared(request):
    with ur_bench({**CONFIG, "control": request.param}) as bench:
        yield bench


@pytest.fixture
def bench(shared: UrBench) -> UrBench:
    shared.reset()
    return shared


# What is read back.


def stopping(bench: UrBench, monkeypatch) -> list[bool]:
    """Return whether each stop that the core sends from now on counts as carried out at once."""
    stop, told = bench.device.stop, []

    def told_stop() -> None:
        stop()
        told.append(bench.device.has_stopped)

    monkeypatch.setattr(bench.device, "stop", told_stop)
    return told


def test_a_stop_counts_when_the_controller_has_carried_it_out(bench, monkeypatch):
    told = stopping(bench, monkeypatch)
    bench.arm.move_jp(FAR)
    bench.until_moving(speed=1.0)
    bench.arm.hold()
    eventually(lambda: told, "it is sent")
    assert told[0] is False, "it was only sent"
    eventually(lambda: bench.engine._stopping.confirmed, "it is carried out")
    assert bench.device.has_stopped
    assert max(map(abs, bench.outputs("target_qd"))) < 1e-3
    assert bench.outputs("runtime_state") == PLAYING, "by the program, which goes on"


def test_a_stop_that_is_repeated_faster_than_it_is_answered_is_believed(bench, monkeypatch):
    told = stopping(bench, monkeypatch)
    bench.arm.move_jp(FAR)
    bench.until_moving(speed=1.0)
    bench.inject("delay", port="rtde", seconds=0.1)
    bench.arm.hold()
    eventually(lambda: len(told) > 1, "it is repeated")
    eventually(lambda: bench.engine._stopping.confirmed, "it is read back")
    bench.sim.control.clear()
    assert bench.status.state == "ENABLED"
    bench.until_still()


@pytest.mark.slow  # the same of other streams is in test_native.py
def test_a_twist_that_grows_while_nothing_is_measured_does_not_take_a_joint_out_of_its_range(bench):
    """States stay away, and commands arrive."""
    near = [5.9, *HOME[1:]]
    limit = bench.engine.capabilities.limits[0]
    move = bench.arm.move_jp(near)
    assert move.wait(LONG)
    tool = bench.device.kinematics.jacobian(np.array(near))[:, 0]  # of the first joint alone

    def at(begin: float, speed: float) -> bool:
        bench.arm.servo_cv((speed * tool).tolist())
        return bench.q()[0] > begin

    eventually(lambda: at(5.98, 0.1), "it moves")
    bench.inject("drop", port="rtde", direction="out", every=1)
    farthest = 0.0
    with suppress(CommandRefused):
        while bench.status.state == "ENABLED":
            at(0.0, 1.5)
            farthest = max(farthest, bench.q()[0])
    bench.sim.control.clear()
    bench.until_connected()
    assert near[0] < farthest < limit.upper - 0.02


@pytest.mark.slow
@pytest.mark.parametrize("shared", ["native"], indirect=True)
def test_a_stop_that_the_speed_slider_slows_down_is_not_overdue(bench):
    bench.arm.move_jp(FAR)
    bench.until_moving(speed=1.0)
    bench.inject("speed_slider", fraction=0.03)
    eventually(lambda: bench.device.pace < 0.1, "the slider is seen")
    bench.arm.hold()
    began = time.monotonic()
    eventually(lambda: not bench.engine._stopping.confirmed, "it is sent")
    eventually(lambda: bench.engine._stopping.confirmed, "it is carried out")
    assert time.monotonic() - began > bench.engine.capabilities.stop.time, "slower than declared"
    assert bench.status.state == "ENABLED"
    bench.sim.control.clear("speed_slider")
    bench.until_still()


# By another way.


def let_a_stop_grow_old(bench):
    """Wait until a stop that was sent now would count as unanswered, by the controller's time."""
    late = bench.outputs("timestamp") + 1.1 * STOP_TIMEOUT
    eventually(lambda: bench.outputs("timestamp") > late, "time of the controller")


def is_answered_by_the_program(bench):
    """A stop is carried out, and the program was not ended for it."""
    eventually(lambda: bench.device.has_stopped, "it is answered")
    bench.cycles(2)
    assert bench.outputs("runtime_state") == PLAYING, "by the program, which goes on"
    assert bench.status.state == "ENABLED"


@pytest.mark.parametrize("shared", ["native"], indirect=True)
def test_a_stop_whose_answer_was_not_looked_for_is_not_repeated_another_way(bench):
    """The I/O thread was held up: the states that tell of the answer wait to be read."""
    held_up = threading.Event()

    def stop_late() -> None:
        bench.engine.on_sample = None
        bench.device.stop()
        let_a_stop_grow_old(bench)
        bench.device.stop()
        held_up.set()

    bench.engine.on_sample = stop_late
    assert held_up.wait(LONG)
    is_answered_by_the_program(bench)


@pytest.mark.parametrize("shared", ["native"], indirect=True)
def test_a_stop_that_was_sent_late_is_not_repeated_another_way(bench, monkeypatch):
    """The I/O thread was held up before it was sent: states from before that tell of no answer."""
    channel, held_up = bench.device._link._channel, threading.Event()
    send = channel.stop

    def send_late() -> int:
        monkeypatch.undo()
        let_a_stop_grow_old(bench)
        return send()

    def stop_late() -> None:
        bench.engine.on_sample = None
        bench.device.stop()
        bench.device.read(time.monotonic() + LONG)
        bench.device.stop()
        held_up.set()

    monkeypatch.setattr(channel, "stop", send_late)
    bench.engine.on_sample = stop_late
    assert held_up.wait(LONG)
    is_answered_by_the_program(bench)


@pytest.mark.parametrize("shared", ["native"], indirect=True)
def test_a_stop_does_not_wait_for_a_thread_that_hangs_in_the_connection(
    bench, monkeypatch, record_property
):
    """The lock of the channel is never given back: a program that only stops takes the place of ours."""
    bench.arm.move_jp(FAR)
    bench.until_moving(speed=1.0)
    channel = bench.device._link._channel
    channel._lock.acquire()
    monkeypatch.setattr(registers, "LOCK_TIMEOUT", 0.5)  # nobody gives it back
    try:
        began = time.monotonic()
        stopper = threading.Thread(target=bench.device.stop)
        stopper.start()
        stopper.join(LONG)
        took = time.monotonic() - began
        bench.until_still()
        record_property("until it stands (s)", time.monotonic() - began)
        assert took < LONG / 2.0, "it waited"
    finally:
        channel._lock.release()
    assert bench.q()[0] < FAR[0] - 0.1
    bench.until_outputs(runtime_state=(STOPPED,))
    with bench.nothing_moves():
        eventually(lambda: bench.status.state != "ENABLED", "it is told")


@pytest.mark.parametrize("shared", ["ur_rtde"], indirect=True)
def test_what_waited_for_the_control_process_is_no_jump(bench):
    """The process stands still for 200 ms in a stream of 1 rad/s, and takes only the newest position."""

    def sent() -> np.ndarray:
        asked = [v for v in bench.sent_since(mark) if v["input_int_register_0"] == SERVO_J]
        return np.array([values["input_double_register_0"] for values in asked])

    def arrived() -> bool:
        bench.arm.servo_jp([1.0, *HOME[1:]])
        return sent()[-1] == pytest.approx(1.0)

    mark = bench.mark()
    resume = threading.Timer(0.2, os.kill, (bench.child, signal.SIGCONT))
    for step in range(200):
        bench.arm.servo_jp([0.005 * step, *HOME[1:]])
        if step == 100:
            os.kill(bench.child, signal.SIGSTOP)
            resume.start()
        time.sleep(0.005)
    resume.join()
    eventually(arrived, "the end of the stream is sent")
    positions = sent()
    fastest = model_named("ur5e").velocity_limits[0]
    assert np.abs(np.diff(positions)).max() < fastest * LONGEST_STEP * 1.001
    bench.arm.hold()
    bench.until_still()


@pytest.mark.parametrize("shared", ["ur_rtde"], indirect=True)
def test_a_move_goes_on_for_its_watchdog_alone_while_the_control_process_stands_still(bench):
    """As far as docs/ur.md tells: its speed for the time of the watchdog, and the controller's own stop."""
    bench.arm.move_jp(FAR)
    bench.until_moving(speed=0.5)
    child = bench.child
    os.kill(child, signal.SIGSTOP)
    try:
        begin, fastest = bench.q()[0], 0.0
        deadline = time.monotonic() + LONG
        while not bench.stands():
            fastest = max(fastest, bench.outputs("target_qd")[0])
            assert time.monotonic() < deadline, "it goes on"
        bench.until_outputs(runtime_state=(STOPPED,))
        assert bench.outputs("safety_mode") == 1, "no protective stop"
        assert bench.q()[0] < FAR[0] - 0.1
        watchdog = bench.session.config.watchdog_frequency
        way = fastest / watchdog + fastest**2 / (2.0 * STOP_DECELERATION)
        assert bench.q()[0] - begin < way + 0.05
    finally:
        with suppress(ProcessLookupError):
            os.kill(child, signal.SIGCONT)


@pytest.mark.real_time  # the vendor's library
def test_a_move_that_the_control_process_stopped_as_it_heard_nothing_says_so():
    move = {**PATIENT["move"], "planned_by": "controller"}
    with ur_bench({"control": "ur_rtde", "move": move}) as bench:
        bench.enable()
        move = bench.arm.move_jp(FAR)
        bench.until_moving()

        def be_held_up() -> None:
            bench.engine.on_sample = None
            bench.until_still()

        bench.engine.on_sample = be_held_up
        with pytest.raises(MotionAborted, match="heard nothing of the driver"):
            move.wait(LONG)
        assert bench.q()[0] < FAR[0] - 0.1
        assert bench.arm.move_jr([-0.1, 0.0, 0.0, 0.0, 0.0, 0.0]).wait(LONG)


# Ranges.


def test_the_ranges_of_the_safety_configuration_hold_and_are_told():
    """Narrower there than in the model: the program stops a velocity before the controller stops the arm."""
    with ur_bench(CONFIG, position_limit=110.0) as bench:
        bench.enable()
        notes = {note.key: note.text for note in bench.engine.health().notes}
        assert "1.920" in notes["wrist_3_joint"]
        deadline = time.monotonic() + LONG
        while bench.q()[5] < 1.85:
            assert time.monotonic() < deadline, "never: the end of the range"
            bench.arm.servo_jv([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
            time.sleep(0.02)
        for _ in range(50):
            bench.arm.servo_jv([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
            time.sleep(0.02)
        assert bench.q()[5] <= math.radians(110.0)
        assert bench.status.state == "ENABLED", "the controller saw nothing to stop"
        bench.arm.hold()
        bench.until_still()


def test_ranges_of_the_configuration_are_those_of_the_device():
    joints = {"wrist_3_joint": {"upper": 0.5, "velocity": 1.0}, "elbow_joint": {"lower": 0.0}}
    with ur_bench({**CONFIG, "joints": joints}) as bench:
        limits = dict(zip(JOINT_NAMES, bench.engine.capabilities.limits, strict=True))
        assert (limits["wrist_3_joint"].upper, limits["wrist_3_joint"].velocity) == (0.5, 1.0)
        assert limits["elbow_joint"].lower == 0.0
        bench.enable()
        with bench.refused("out_of_range", "move_jp"):
            bench.arm.move_jp([*HOME[:5], 0.6])
        assert bench.arm.move_jp([*HOME[:5], 0.4]).wait(LONG)


@pytest.mark.parametrize(
    "joints",
    [
        {"wrist_3": {"upper": 0.5}},
        {"elbow_joint": {"lower": 1.0, "upper": 0.5}},
        {"elbow_joint": {"lower": 7.0}},
        {"elbow_joint": {"velocity": 0.0}},
        {"elbow_joint": {"velocity": float("nan")}},
        {"elbow_joint": {"upper": float("nan")}},
    ],
)
def test_ranges_that_cannot_be_are_refused(joints):
    with pytest.raises(ConfigError, match="joints"), ur_bench({"joints": joints}, start=False):
        pass


# What is found, and what is left.


@both_ways
def test_what_the_arm_is_found_in_is_told_and_disable_ends_it(control):
    with brisk_sim() as sim:
        with driver_at(sim, {**CONFIG, "control": control}) as bench:
            assert RELEASED in bench.until_state("DISABLED").detail, "the simulated arm wakes up so"
            assert bench.outputs("robot_mode") == RUNNING
            bench.arm.disable(timeout=LONG)
            bench.until_outputs(robot_mode=(POWER_OFF,))
            with bench.nothing_moves():
                bench.arm.disable(timeout=LONG)
        with driver_at(sim, {**CONFIG, "control": control}) as bench:
            assert RELEASED not in bench.until_state("DISABLED").detail


def test_a_program_that_runs_is_found():
    with brisk_sim() as sim:
        with socket.create_connection((sim.host, 30002), LONG) as peer:
            peer.sendall(b"def other():\n  while True:\n    sync()\n  end\nend\n")
            eventually(lambda: sim.control.status()["program"] != "", "it runs")
        with driver_at(sim, CONFIG) as bench:
            assert "a program runs" in bench.until_state("DISABLED").detail


@both_ways
@pytest.mark.parametrize(("on_close", "mode"), [("hold", RUNNING), ("power_off", POWER_OFF)])
@pytest.mark.parametrize("moving", [False, True], ids=["at rest", "in motion"])
def test_closing_stops_first_and_leaves_the_arm_as_it_is_configured(
    control, on_close, mode, moving
):
    with ur_bench({**CONFIG, "control": control, "on_close": on_close}) as bench:
        bench.enable()
        if moving:
            bench.arm.move_jp(FAR)
            bench.until_moving(speed=1.0)
        watch = Watch(bench)
        bench.arm.close()
        watch.end()
        bench.until_outputs(robot_mode=(mode,), runtime_state=(STOPPED,))
        bench.until_still()
        assert bench.q()[0] < FAR[0] - 0.1
        assert watch.standing_when_power_went, "it stands before its power goes"


def test_power_goes_though_the_thread_that_closes_was_held_up(monkeypatch):
    with ur_bench({**CONFIG, "on_close": "power_off"}) as bench:
        bench.enable()
        close = bench.device.close

        def late() -> None:
            time.sleep(2.0 * LATE_STATE)
            close()

        monkeypatch.setattr(bench.device, "close", late)
        bench.arm.close()
        bench.until_outputs(robot_mode=(POWER_OFF,), runtime_state=(STOPPED,))


@both_ways
def test_a_disable_is_carried_out_though_the_driver_is_closed_meanwhile(control, monkeypatch):
    with ur_bench({**CONFIG, "control": control}) as bench:
        bench.enable()
        bench.engine.state_command("disable")
        monkeypatch.setattr(cycle, "TIME_TO_DISABLE", LONG)
        bench.arm.close()
        bench.until_outputs(robot_mode=(POWER_OFF,))


@both_ways
def test_a_paused_program_does_not_outlive_the_driver(control):
    with ur_bench({**CONFIG, "control": control}) as bench:
        bench.enable()
        bench.arm.move_jp(FAR)
        bench.until_moving(speed=1.0)
        bench.inject("drop", port="dashboard", every=1, direction="in")
        bench.inject("pause_program")
        bench.until_state("PAUSED", "paused")
        bench.until_outputs(runtime_state=(PAUSED,))
        bench.sim.control.clear("drop")
        bench.arm.close()
        bench.until_outputs(runtime_state=(STOPPED,))
        with bench.nothing_moves():
            bench.sim.control.clear()


@both_ways
def test_a_program_that_is_paused_while_it_starts_does_not_outlive_the_driver(control):
    with ur_bench({**CONFIG, "control": control}) as bench:
        bench.engine.state_command("enable")
        bench.until_outputs(runtime_state=(PLAYING,))
        bench.inject("pause_program")
        bench.arm.close()
        bench.until_outputs(runtime_state=(STOPPED,))


@both_ways
def test_a_program_that_cannot_be_ended_is_told_of(control):
    with ur_bench({**CONFIG, "control": control}) as bench:
        bench.enable()
        bench.inject("drop", port="dashboard", every=1, direction="in")
        bench.inject("pause_program")
        bench.until_state("PAUSED", "paused")
        with pytest.raises(DeviceError, match="dashboard"):
            bench.arm.close()


class Watch:
    """Looks at each state of the controller beside what a test does."""

    def __init__(self, bench: UrBench) -> None:
        self._bench = bench
        self._client = RtdeClient(bench.sim.host)
        self._client.setup_outputs("timestamp,robot_mode,target_qd")
        assert self._client.start()
        self._until = math.inf
        self.standing_when_power_went = True
        self._thread = threading.Thread(target=self._look)
        self._thread.start()

    def _look(self) -> None:
        now, before = 0.0, 0.0
        while now < self._until:
            now, mode, *speeds = self._client.data()
            if mode != RUNNING and before > 0.5:
                self.standing_when_power_went = False
            before = max(map(abs, speeds)) if mode == RUNNING else 0.0

    def end(self) -> None:
        self._until = self._bench.outputs("timestamp")
        self._thread.join()
        self._client.close()


def test_an_arm_that_was_not_enabled_keeps_its_power_whatever_is_configured():
    with brisk_sim() as sim:
        with driver_at(sim, {**CONFIG, "on_close": "power_off"}) as bench:
            bench.until_state("DISABLED")
        with driver_at(sim, CONFIG, start=False) as bench:
            assert bench.outputs("robot_mode") == RUNNING
