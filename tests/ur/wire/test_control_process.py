"""The control process against the simulated controller, through the unmodified vendor library."""

import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from unittest.mock import patch

import pytest

from crtk_driver_ur.control_options import ControlOptions, MotionOptions
from crtk_driver_ur.control_requests import Reply
from crtk_driver_ur.library import supervisor
from crtk_driver_ur.library.packets import (
    Event,
    EventKind,
    FrameError,
    MotionCommand,
    MotionKind,
    encode,
)
from crtk_driver_ur.library.supervisor import ControlSupervisor, Notice
from crtk_drivers.errors import ConnectionLost
from rigs import ur_watchdog
from rigs.ur_bench import LENIENT, LONG, QUICK_WATCHDOG, brisk_sim
from rigs.waiting import eventually

pytest.importorskip("rtde_control")

STOPPED, PLAYING = 1, 2
REGISTER = "input_int_register_0"
SPEED_J, SERVO_J, SPEED_STOP, SERVO_STOP, STOP_J, SET_WATCHDOG = 9, 11, 15, 16, 34, 35
MOVE_J, STOP_SCRIPT = 1, 255
PATIENT = ControlOptions(watchdog_frequency=ur_watchdog.FREQUENCY)
"""As that of the bench: a process that gets no time for a while is no reason to end the program."""
QUICK = replace(PATIENT, watchdog_frequency=QUICK_WATCHDOG)
"""Where the controller's watchdog is waited for."""
NO_DOUBT = 0.8
"""Seconds of silence after which a process counts as hung that the test has stopped itself."""


class Driver:
    """A supervisor with one simulated controller, and what both have said so far."""

    def __init__(self, sim, options: ControlOptions) -> None:
        self.sim = sim
        self.supervisor = ControlSupervisor(sim.host, options)
        self.notices: list[Notice] = []
        self._traced: list[dict] = []

    def until(self, happened: Callable[[], object], what: str) -> None:
        deadline = time.monotonic() + LONG
        while not happened():
            if time.monotonic() > deadline:
                state = self.supervisor.status
                pytest.fail(f"never: {what}; {state}; {self.notices}")
            self.notices += self.supervisor.poll()
            time.sleep(0.002)

    def run(self, seconds: float, action: Callable[[], object] = lambda: None) -> None:
        """Poll for a while, doing `action` at about 200 Hz."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            action()
            self.notices += self.supervisor.poll()
            time.sleep(0.005)

    def until_code(self, code: int) -> None:
        """Wait until a command is the one that the controller has."""
        self.until(lambda: self.codes()[-1:] == [code], f"command {code}")

    def reply(self, sequence: int) -> Reply:
        def found() -> list[Reply]:
            return [n for n in self.notices if isinstance(n, Reply) and n.sequence == sequence]

        self.until(found, f"reply {sequence}")
        return found()[0]

    def ask(self, name: str, **arguments) -> object:
        reply = self.reply(self.supervisor.request(name, **arguments))
        assert reply.error is None, reply
        return reply.value

    def event(self, kind: EventKind, sequence: int | None = None) -> Event:
        def found() -> list[Event]:
            return [
                n
                for n in self.notices
                if isinstance(n, Event) and n.kind is kind and sequence in (None, n.sequence)
            ]

        self.until(found, f"{kind} {sequence or ''}")
        return found()[0]

    def connect(self) -> None:
        reply = self.reply(self.supervisor.connect())
        assert reply.error is None, reply
        self.until(lambda: self.supervisor.status.heartbeat.program_running, "program running")

    def outputs(self, name: str):
        return self.sim.control.outputs(name)[name]

    def stands(self) -> bool:
        return max(map(abs, self.outputs("target_qd"))) < 1e-4

    def codes(self) -> list[int]:
        """Command codes that reached the controller, in order, without idling and repetition."""
        codes: list[int] = []
        for entry in self.trace():
            code = entry["values"].get(REGISTER, 0)
            if code and (not codes or codes[-1] != code):
                codes.append(code)
        return codes

    def trace(self) -> list[dict]:
        """Everything traced; in parts, for an answer has a limited length.

        What is known is not asked for again: on a busy machine the process would miss its driver meanwhile,
        and stop the arm.
        """
        known = self._traced
        while part := self.sim.control.trace(after=known[-1]["number"] if known else 0):
            known += part
        return known


@contextmanager
def started(sim, options: ControlOptions | None = None) -> Iterator[Driver]:
    driver = Driver(sim, options or PATIENT)
    driver.supervisor.start()
    try:
        yield driver
    finally:
        driver.supervisor.close()


@pytest.fixture
def sim() -> Iterator[object]:
    with brisk_sim(model="ur5e") as running, patch.object(supervisor, "SILENCE_ALLOWED", LENIENT):
        yield running


@pytest.fixture
def process(sim) -> Iterator[Driver]:
    """A started control process that is not connected yet."""
    with started(sim) as driver:
        yield driver


@pytest.fixture
def driver(process) -> Driver:
    """A connected control process."""
    process.connect()
    return process


def shifted(q, joint: int, angle: float) -> list[float]:
    result = list(q)
    result[joint] += angle
    return result


# Connecting


def test_connect_starts_the_program_and_moves_nothing(driver):
    assert driver.outputs("runtime_state") == PLAYING
    assert driver.codes() == [SET_WATCHDOG]
    assert driver.stands()
    driver.run(1.25 / ur_watchdog.FREQUENCY)
    assert driver.outputs("runtime_state") == PLAYING, "the watchdog is not fed at rest"


def test_connect_in_local_control_says_what_to_do():
    with brisk_sim(model="ur5e", remote=False) as local, started(local) as driver:
        reply = driver.reply(driver.supervisor.connect())
        assert reply.error is not None
        assert "remote control" in reply.error.hint
        assert driver.ask("is_in_remote_control") is False


def test_connect_to_nobody_says_what_to_do():
    with brisk_sim(model="ur5e") as doomed, started(doomed) as driver:
        doomed.kill()
        reply = driver.reply(driver.supervisor.connect())
        assert reply.error is not None
        assert "Check the address" in reply.error.hint
        assert driver.supervisor.status.alive


def test_second_control_client_is_told_that_registers_are_claimed(driver):
    with started(driver.sim) as second:
        reply = second.reply(second.supervisor.connect())
    assert reply.error is not None
    assert "already in use" in reply.error.text
    assert "upper_range_registers" in reply.error.hint


def test_missing_library_names_the_command_that_installs_it(sim, tmp_path, monkeypatch):
    (tmp_path / "rtde_control.py").write_text("raise ImportError('not there')\n")
    monkeypatch.syspath_prepend(tmp_path)
    with started(sim) as driver:
        reply = driver.reply(driver.supervisor.connect())
    assert reply.error is not None
    assert reply.error.hint == "pip install 'crtk-drivers[ur]'"


# Motion


def test_move_joint_arrives_and_is_reported(driver):
    goal = shifted(driver.outputs("actual_q"), 0, 0.2)
    sequence = driver.supervisor.move_joint(goal, 1.5, 5.0)
    driver.event(EventKind.MOVE_DONE, sequence)
    assert driver.outputs("target_q") == pytest.approx(goal, abs=1e-3)


def test_move_linear_arrives_and_is_reported(driver):
    goal = shifted(driver.outputs("actual_TCP_pose"), 2, 0.03)
    sequence = driver.supervisor.move_linear(goal, 0.25, 1.0)
    driver.event(EventKind.MOVE_DONE, sequence)
    assert driver.outputs("target_TCP_pose")[:3] == pytest.approx(goal[:3], abs=1e-3)


def test_move_to_where_the_arm_is_ends_at_once(driver):
    sequence = driver.supervisor.move_joint(driver.outputs("target_q"), 1.0, 2.0)
    driver.event(EventKind.MOVE_DONE, sequence)


def test_stop_ends_a_move(driver):
    goal = shifted(driver.outputs("actual_q"), 0, 1.5)
    move = driver.supervisor.move_joint(goal, 0.5, 2.0)
    driver.until(lambda: not driver.stands(), "motion")
    stop = driver.supervisor.stop()
    driver.event(EventKind.STOPPED, stop)
    driver.event(EventKind.INTERRUPTED, move)
    assert driver.stands()
    assert driver.outputs("target_q")[0] < goal[0] - 0.5
    assert driver.outputs("runtime_state") == PLAYING


def test_servo_stream_is_followed_and_held_when_it_pauses(driver):
    start = driver.outputs("actual_q")
    goal = shifted(start, 0, 0.1)
    begun = time.monotonic()

    def stream() -> None:
        angle = 0.1 * min(1.0, (time.monotonic() - begun) / 0.5)
        driver.supervisor.send_servo_joint(shifted(start, 0, angle))

    driver.run(0.7, stream)
    driver.supervisor.send_servo_joint(goal)
    driver.run(1.0)
    assert driver.outputs("runtime_state") == PLAYING
    driver.until(lambda: driver.outputs("target_q") == pytest.approx(goal, abs=2e-3), "the goal")
    driver.until(driver.stands, "the arm stands")
    assert driver.outputs("runtime_state") == PLAYING
    assert driver.supervisor.status.heartbeat.motion is MotionKind.SERVO_JOINT


def test_speed_that_is_not_repeated_expires(driver):
    before = driver.outputs("target_q")[0]

    def moved() -> float:
        driver.supervisor.send_speed_joint([0.3, 0, 0, 0, 0, 0], 2.0, 0.1)
        return driver.outputs("target_q")[0] - before

    driver.until(lambda: moved() > 0.05, "motion")
    driver.event(EventKind.SPEED_EXPIRED)
    driver.event(EventKind.STOPPED)
    driver.until(driver.stands, "the arm stands")
    assert driver.outputs("runtime_state") == PLAYING
    assert driver.outputs("target_q")[0] - before < 0.5


def test_every_speed_command_carries_a_time(driver):
    def speeds() -> list[dict]:
        driver.supervisor.send_speed_joint([0.1, 0, 0, 0, 0, 0], 1.0, 0.1)
        return [e["values"] for e in driver.trace() if e["values"].get(REGISTER) == SPEED_J]

    driver.until(lambda: len(speeds()) > 5, "speeds")
    assert all(values["input_double_register_7"] > 0.0 for values in speeds())


def test_cartesian_speed(driver):

    def speed() -> float:
        driver.supervisor.send_speed_cartesian([0, 0, 0.05, 0, 0, 0], 1.0, 0.2)
        return float(driver.outputs("target_TCP_speed")[2])

    driver.until(lambda: speed() == pytest.approx(0.05, abs=5e-3), "the speed")
    driver.event(EventKind.STOPPED, driver.supervisor.stop())
    assert driver.stands()


def test_freedrive_begins_and_ends(driver):
    driver.supervisor.freedrive()
    driver.until(
        lambda: driver.supervisor.status.heartbeat.motion is MotionKind.FREEDRIVE, "freedrive"
    )
    driver.event(EventKind.STOPPED, driver.supervisor.stop())
    assert driver.outputs("runtime_state") == PLAYING


SERVO = (lambda s, q: s.send_servo_joint(q), SERVO_J, SERVO_STOP)
SPEED = (lambda s, q: s.send_speed_joint([0.2, 0, 0, 0, 0, 0], 2.0, LONG), SPEED_J, SPEED_STOP)
MOVE = (lambda s, q: s.move_joint(shifted(q, 0, 1.0), 0.5, 2.0), MOVE_J, STOP_J)


@pytest.mark.sweep(3)
@pytest.mark.parametrize(
    ("first", "second"),
    [
        pytest.param(SERVO, SPEED, id="servo-speed"),
        pytest.param(SERVO, MOVE, id="servo-move"),
        pytest.param(SPEED, SERVO, id="speed-servo"),
        pytest.param(SPEED, MOVE, id="speed-move"),
        pytest.param(MOVE, SERVO, id="move-servo"),
        pytest.param(MOVE, SPEED, id="move-speed"),
        pytest.param(MOVE, MOVE, id="move-move"),
    ],
)
def test_a_motion_is_stopped_before_the_next(driver, first, second):
    first[0](driver.supervisor, driver.outputs("target_q"))
    driver.until_code(first[1])
    driver.run(0.1)
    second[0](driver.supervisor, driver.outputs("target_q"))

    def after_the_first() -> list[int]:
        codes = driver.codes()
        return codes[codes.index(first[1]) + 1 :]

    driver.until(lambda: second[1] in after_the_first(), "the second motion")
    codes = after_the_first()
    assert first[2] in codes[: codes.index(second[1])]
    driver.run(0.2)
    assert driver.outputs("runtime_state") == PLAYING, "two motions at once ended the program"


def test_of_two_waiting_commands_the_newest_is_carried_out(sim):
    """They wait for more than a second, until a speed has been slowed down."""
    slow = replace(PATIENT, motion=MotionOptions(linear_deceleration=0.08))
    with started(sim, slow) as driver:
        driver.connect()
        q = driver.outputs("actual_q")
        driver.supervisor.send_speed_cartesian([0, 0, 0.1, 0, 0, 0], 1.0, LONG)
        driver.until(lambda: driver.outputs("target_TCP_speed")[2] > 0.09, "motion")
        waiting = driver.supervisor.move_joint(shifted(q, 0, 1.0), 0.5, 2.0)
        driver.until(lambda: driver.supervisor.status.heartbeat.settling, "settling")
        newest = driver.supervisor.move_joint(shifted(q, 1, 0.1), 1.0, 5.0)
        driver.event(EventKind.INTERRUPTED, waiting)
        driver.event(EventKind.MOVE_DONE, newest)
        assert driver.outputs("target_q")[0] == pytest.approx(q[0], abs=2e-3)


def test_refusal_of_the_library_is_reported_and_the_arm_goes_on(driver):
    q = driver.outputs("actual_q")
    failed = driver.event(EventKind.MOTION_FAILED, driver.supervisor.move_joint(q, 9.0, 2.0))
    assert failed.error.call == "moveJ"
    assert "3.14" in failed.error.text
    driver.event(EventKind.MOVE_DONE, driver.supervisor.move_joint(shifted(q, 5, 0.1), 1.0, 5.0))


def test_stop_from_another_thread(driver):
    driver.supervisor.move_joint(shifted(driver.outputs("actual_q"), 0, 1.5), 0.5, 2.0)
    driver.until(lambda: not driver.stands(), "motion")
    thread = threading.Thread(target=driver.supervisor.stop)
    thread.start()
    driver.event(EventKind.STOPPED)
    thread.join()
    assert driver.stands()


# Bad input


def test_motion_before_connecting_fails_with_a_remedy(process):
    failed = process.event(EventKind.MOTION_FAILED, process.supervisor.send_servo_joint([0] * 6))
    assert failed.error.hint == "Enable the arm first."


@pytest.mark.parametrize("values", [[math.nan] * 6, [0.0] * 5, [0.0] * 7, [math.inf] * 6])
def test_bad_values_are_refused_by_the_supervisor(process, values):
    with pytest.raises(FrameError, match="six finite numbers"):
        process.supervisor.send_servo_joint(values)


def test_bad_frames_are_refused_by_the_process(driver):
    peer = driver.supervisor._peer
    values = (math.nan, *[0.0] * 5)
    for packet in (
        encode(MotionCommand(1, MotionKind.SERVO_JOINT, values)),
        b"\x00",
        b"\xff" * 100,
        encode(Event(EventKind.STOPPED)),
    ):
        driver.notices.clear()
        peer.send(packet)
        assert driver.event(EventKind.BAD_FRAME).error.text
    assert driver.codes() == [SET_WATCHDOG]
    assert driver.supervisor.status.alive


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("dance", {}),
        ("set_tcp", {"pose": [0.0] * 5}),
        ("set_payload", {"mass": "heavy", "center_of_gravity": [0, 0, 0]}),
        ("set_gravity", {}),
        ("popup", {}),
    ],
)
def test_bad_requests_are_refused(driver, name, arguments):
    reply = driver.reply(driver.supervisor.request(name, **arguments))
    assert reply.error is not None
    assert driver.outputs("runtime_state") == PLAYING


# Requests


def test_payload_and_tcp_reach_the_controller(driver):
    driver.ask("set_payload", mass=1.5, center_of_gravity=[0.0, 0.0, 0.05])
    driver.ask("set_tcp", pose=[0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    driver.ask("set_gravity", direction=[0.0, 0.0, 9.82])
    driver.until(lambda: driver.outputs("payload") == pytest.approx(1.5), "payload")
    tool = [0, 0, 0.1, 0, 0, 0]
    driver.until(lambda: driver.outputs("tcp_offset") == pytest.approx(tool), "the tool")


def test_speed_slider_and_digital_output(driver):
    driver.ask("write_inputs", values={"speed_slider_mask": 1, "speed_slider_fraction": 0.5})
    driver.until(lambda: driver.outputs("target_speed_fraction") == pytest.approx(0.5), "slider")
    driver.ask(
        "write_inputs",
        values={"standard_digital_output_mask": 8, "standard_digital_output": 8},
    )
    driver.until(lambda: driver.outputs("actual_digital_output_bits") == 8, "output 3")


def test_power_cycle_by_dashboard():
    with brisk_sim(model="ur5e", powered_on=False) as cold, started(cold) as driver:
        assert "5.12.4" in str(driver.ask("polyscope_version"))
        driver.ask("power_on")
        driver.ask("brake_release")
        driver.until(lambda: driver.outputs("robot_mode") == 7, "running")
        driver.connect()
        driver.ask("power_off")
        driver.event(EventKind.PROGRAM_STOPPED)


def test_slow_dashboard_does_not_starve_the_watchdog(sim):
    """The answer takes three delays, which is longer than the watchdog waits."""
    with started(sim, QUICK) as driver:
        driver.connect()
        driver.sim.control.inject("delay", port="dashboard", seconds=0.5 / QUICK_WATCHDOG)
        reply = driver.reply(driver.supervisor.request("robot_mode"))
        assert reply.error is None
        assert driver.outputs("runtime_state") == PLAYING


def test_program_stopped_on_the_pendant_is_reported_and_uploaded_again(driver):
    q = driver.outputs("actual_q")
    driver.supervisor.send_servo_joint(q)
    driver.until(lambda: driver.supervisor.status.heartbeat.motion, "servo")
    driver.sim.control.inject("stop_program")
    driver.event(EventKind.PROGRAM_STOPPED)
    assert driver.supervisor.status.heartbeat.motion is not None
    refused = driver.event(EventKind.MOTION_FAILED, driver.supervisor.send_servo_joint(q))
    assert "enable again" in refused.error.hint
    reply = driver.reply(driver.supervisor.upload_script())
    assert reply.error is None
    assert driver.outputs("runtime_state") == PLAYING
    assert driver.codes()[-1] == SET_WATCHDOG
    driver.run(0.5)
    assert driver.stands()
    assert driver.outputs("runtime_state") == PLAYING


# Ends and failures


def test_close_stops_the_arm_and_the_program(process):
    process.connect()
    process.supervisor.send_speed_joint([0.3, 0, 0, 0, 0, 0], 2.0, LONG)
    process.until(lambda: not process.stands(), "motion")
    pid = process.supervisor.status.pid
    process.supervisor.close()
    assert not os.path.exists(f"/proc/{pid}")
    process.until(process.stands, "the arm stands")
    process.until(lambda: process.outputs("runtime_state") == STOPPED, "program stopped")
    assert SPEED_STOP in process.codes()
    assert process.codes()[-1] == STOP_SCRIPT


DRIVER_PROGRAM = """
import sys, time
from crtk_driver_ur.control_options import ControlOptions
from crtk_driver_ur.library.supervisor import (ControlSupervisor,)
supervisor = ControlSupervisor(sys.argv[1], ControlOptions(watchdog_frequency=float(sys.argv[2])))
supervisor.start()
supervisor.connect()
while not supervisor.status.heartbeat.program_running:
    supervisor.poll()
    time.sleep(0.01)
while True:
    supervisor.send_speed_joint([0.2, 0, 0, 0, 0, 0], 2.0, 5.0)
    supervisor.poll()
    print(supervisor.status.pid, flush=True)
    time.sleep(0.01)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_death_or_freeze_of_the_driver_stops_the_arm(sim, number):
    program = subprocess.Popen(
        [sys.executable, "-c", DRIVER_PROGRAM, sim.host, str(QUICK_WATCHDOG)],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    driver = Driver(sim, PATIENT)
    try:
        assert program.stdout is not None
        pid = int(program.stdout.readline())
        eventually(lambda: not driver.stands(), "motion")
        program.send_signal(number)
        eventually(driver.stands, "the arm stands")
        if number is signal.SIGKILL:
            eventually(lambda: driver.outputs("runtime_state") == STOPPED, "program stopped")
            eventually(lambda: not is_running(pid), "the control process is gone")
    finally:
        program.kill()
        program.wait()
        program.stdout.close()
    eventually(lambda: not is_running(pid), "the control process is gone")


def is_running(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_killed_process_is_noticed_replaced_and_the_arm_stops(sim):
    with started(sim, QUICK) as driver:
        driver.connect()
        driver.supervisor.send_speed_joint([0.2, 0, 0, 0, 0, 0], 2.0, LONG)
        driver.until(lambda: not driver.stands(), "motion")
        os.kill(driver.supervisor.status.pid, signal.SIGKILL)
        died = driver.event(EventKind.PROCESS_DIED)
        assert "control process" in died.error.text
        assert not driver.supervisor.status.alive
        with pytest.raises(ConnectionLost, match="no control process"):
            driver.supervisor.stop()
        driver.until(driver.stands, "the watchdog of the controller stops the arm")
        driver.until(lambda: driver.outputs("runtime_state") == STOPPED, "program stopped")
        driver.supervisor.replace()
        driver.connect()
        assert driver.stands()
        assert driver.supervisor.status.starts == 2


def test_hung_process_is_unresponsive_and_replaced_without_waiting(driver):
    pid = driver.supervisor.status.pid
    with patch.object(supervisor, "SILENCE_ALLOWED", NO_DOUBT):
        driver.until(lambda: driver.supervisor._allowed == NO_DOUBT, "it was heard since then")
        os.kill(pid, signal.SIGSTOP)
        driver.until(lambda: not driver.supervisor.status.responsive, "silence")
        driver.supervisor.replace()
        driver.until(lambda: driver.supervisor.status.responsive, "the new one")
    assert driver.supervisor.status.pid != pid
    driver.until(lambda: not os.path.exists(f"/proc/{pid}"), "the old one is reaped")
    driver.connect()


def test_a_process_that_does_not_read_is_an_error_not_a_wait(driver):
    os.kill(driver.supervisor.status.pid, signal.SIGSTOP)

    def flood() -> None:
        for _ in range(100_000):
            driver.supervisor.send_servo_joint([0.0] * 6)

    with pytest.raises(ConnectionLost, match="does not read its commands"):
        flood()
    driver.supervisor.kill()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_for_the_group_are_left_to_the_driver(driver, number):
    pid = driver.supervisor.status.pid
    assert os.getsid(pid) == pid, "Ctrl-C in the terminal must not reach it"
    os.kill(pid, number)
    driver.run(0.3)
    driver.until(lambda: driver.supervisor.status.responsive, "it answers")
    assert driver.supervisor.status.pid == pid
    assert driver.outputs("runtime_state") == PLAYING


def test_lost_controller_ends_the_process_before_the_library_crashes(driver):
    driver.sim.kill()
    lost = driver.event(EventKind.CONNECTION_LOST)
    assert lost.error.hint
    driver.event(EventKind.PROCESS_DIED)


def test_stalled_controller_ends_the_process_before_the_library_crashes(driver):
    driver.sim.control.inject("stall")
    driver.event(EventKind.CONNECTION_LOST)
    died = driver.event(EventKind.PROCESS_DIED)
    assert "signal" not in died.error.text
    driver.sim.control.clear("stall")
    driver.supervisor.replace()
    driver.connect()
    assert driver.stands()


def test_silent_driver_stops_the_arm(driver):
    driver.supervisor.move_joint(shifted(driver.outputs("actual_q"), 0, 2.0), 0.3, 2.0)
    eventually(lambda: not driver.stands(), "motion")
    eventually(driver.stands, "the arm stands although nobody said stop")
    driver.event(EventKind.DRIVER_SILENT)
    assert abs(driver.outputs("target_q")[0] - driver.outputs("actual_q")[0]) < 1e-2
    assert driver.outputs("runtime_state") == PLAYING
