"""The control program of our own: on a simulated controller alone, and under the driver."""

import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pytest
from typing_extensions import override

from crtk_driver_ur.models import Limits
from crtk_driver_ur.native import link
from crtk_driver_ur.native.program import (
    SERVOJ_LOOKAHEAD,
    Kind,
    Phase,
    ProgramOptions,
    Setting,
    program_text,
)
from crtk_driver_ur.native.registers import ControlChannel
from crtk_driver_ur.program_settings import AXES
from crtk_driver_ur.rtde.codec import DataPackage
from crtk_driver_ur.rtde.state_sample import StateSample
from crtk_driver_ur.rtde.stream import RtdeStream
from crtk_drivers.errors import ConfigError, ConnectionFailed, MotionAborted, TransitionFailed
from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from crtk_sim_backends.ur import RunningSim
from rigs.ur_bench import (
    FAR,
    HOME,
    LONG,
    QUICK_WATCHDOG,
    UrBench,
    brisk_sim,
    eventually,
    ur_bench,
)

STOPPED, PLAYING = 1, 2
NORMAL = 1
OUTWARDS = np.array([-0.392, 0.0, 0.425]) / np.hypot(0.392, 0.425)
"""From the shoulder to the wrist at HOME, in base axes: the elbow ends up straight."""
MINE, OTHER = 77, 78
PATIENCE = 0.1
"""Hz of a watchdog that is not what a test is about."""
LOOKAHEAD = 0.1
ACCELERATION = 5.0
SPEEDS = (3.14,) * 6
RANGES = Limits((-6.28,) * 6, (6.28,) * 5 + (0.5,))
SLIDER_RAMP = 0.25
"""Seconds that the controller takes at most until it is as slow as the slider says."""
NATIVE = {"control": "native"}


class EveryState(RtdeStream):
    """Gives each state that comes, also where its reader was held up; others are older than the newest."""

    @override
    def _read_packages(self) -> tuple[DataPackage | None, int]:
        packages = self._early
        if not packages:
            packages = [message for message in self._read() if isinstance(message, DataPackage)]
        first, self._early = packages[:1], packages[1:]
        return (first[0], 1) if first else (None, 0)


class Rig:
    """The program on a simulated controller, without the driver; every state is kept."""

    def __init__(self, sim: RunningSim, first: int) -> None:
        self.sim = sim
        self.first = first
        self.channel = ControlChannel(sim.host, first)
        self.states: list[StateSample] = []
        self._stream = EveryState(sim.host)
        self._stream.open(time.monotonic() + LONG)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self) -> None:
        while not self._ended.is_set():
            state = self._stream.receive(time.monotonic() + 0.1)
            if state is not None:
                self.states.append(state)

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self._stream.close()
        self.channel.close()

    def start(self, watchdog_frequency: float = PATIENCE) -> None:
        options = ProgramOptions(
            (5, 12),
            self.first,
            watchdog_frequency,
            0.002,
            5.0,
            2.0,
            LOOKAHEAD,
            ACCELERATION,
            SPEEDS,
            RANGES,
        )
        self.channel.address(MINE)
        with socket.create_connection((self.sim.host, 30001), LONG) as peer:
            peer.recv(1)
            peer.sendall(program_text(options, MINE).encode())
            self.until(lambda state: self.registers(state)[0] == MINE)

    def registers(self, state: StateSample) -> tuple[int, ...]:
        found = state.control_registers(self.first)
        assert found is not None
        return found

    def until(self, test, begin: int | None = None) -> StateSample:
        """Return the first state that passes, from now on or from number `begin` on."""
        seen = max(0, len(self.states) - 1) if begin is None else begin

        def found() -> StateSample | None:
            nonlocal seen
            unseen = self.states[seen:]
            seen += len(unseen)
            return next((state for state in unseen if test(state)), None)

        state: StateSample = eventually(
            found, lambda: f"that state; the last was {self.states[-1]}"
        )
        return state

    def pass_time(self, seconds: float) -> None:
        """Wait for so many seconds of the controller."""
        begin = self.states[-1].timestamp
        self.until(lambda state: state.timestamp > begin + seconds)

    def slow_down(self, slider: float) -> None:
        """Move the speed slider, as the driver sees it, and wait until the controller follows."""
        self.sim.control.inject("speed_slider", fraction=slider)
        self.until(lambda state: state.combined_speed_scaling == pytest.approx(slider))
        self.channel.scaling = slider
        self.pass_time(SLIDER_RAMP)

    def until_done(self, sequence: int) -> StateSample:
        """Return the first state in which a command was carried out."""
        return self.until(
            lambda state: self.registers(state)[1:3] == (sequence, int(Phase.STANDING))
        )


@contextmanager
def rig_at(first: int = 0) -> Iterator[Rig]:
    with brisk_sim(trace_size=2000) as sim:
        rig = Rig(sim, first)
        try:
            yield rig
        finally:
            rig.close()


@pytest.fixture
def rig() -> Iterator[Rig]:
    with rig_at() as rig:
        yield rig


@pytest.fixture(scope="module")
def shared() -> Iterator[UrBench]:
    with ur_bench(NATIVE) as bench:
        yield bench


@pytest.fixture
def bench(shared: UrBench) -> UrBench:
    shared.reset()
    return shared


# The program alone


@pytest.mark.parametrize("first", [0, 24])
def test_a_move_is_carried_out_and_told(first):
    with rig_at(first) as rig:
        rig.start()
        goal = (0.2, *HOME[1:])
        sequence = rig.channel.command(Kind.MOVE_JOINT, goal, 2.0, 6.0)
        done = rig.until_done(sequence)
        np.testing.assert_allclose(done.target_q, goal, atol=1e-6)
        assert max(map(abs, done.target_qd)) < 1e-3
        phases = {rig.registers(state)[2] for state in rig.states}
        assert Phase.MOVING in phases


def test_a_command_for_another_program_is_not_carried_out(rig):
    rig.start()
    rig.channel.address(OTHER)
    rig.channel.command(Kind.MOVE_JOINT, FAR, 2.0, 6.0)
    rig.channel.set(Setting.PAYLOAD, (3.0, 0.0, 0.0, 0.0))
    cycle = rig.registers(rig.states[-1])[4]
    state = rig.until(lambda state: rig.registers(state)[4] > cycle + 100)
    assert rig.registers(state)[1:4] == (0, Phase.STANDING, 0)
    np.testing.assert_allclose(state.target_q, HOME, atol=1e-9)
    assert state.payload == 0.0


def test_what_an_earlier_program_left_in_the_registers_is_not_carried_out():
    with rig_at() as rig:
        rig.channel.address(OTHER)
        for _ in range(3):
            rig.channel.command(Kind.SPEED_JOINT, [1.0] * 6, 5.0, LONG)
        rig.start()
        cycle = rig.registers(rig.states[-1])[4]
        state = rig.until(lambda state: rig.registers(state)[4] > cycle + 100)
        np.testing.assert_allclose(state.target_q, HOME, atol=1e-9)


@pytest.mark.parametrize("kind", [Kind.SPEED_JOINT, Kind.SPEED_CARTESIAN])
def test_a_speed_expires_on_the_controller_although_the_watchdog_is_fed(rig, kind):
    rig.start()
    begin = len(rig.states)
    sequence = rig.channel.command(kind, (0.0, 0.0, 0.0, 0.0, 0.0, 0.3), 5.0, 0.2)
    moving = rig.until(lambda state: abs(state.target_qd[5]) > 0.29, begin)
    rig.channel.feed()
    done = rig.until_done(sequence)
    assert max(map(abs, done.target_qd)) < 1e-3
    assert done.timestamp > moving.timestamp
    assert done.runtime_state == PLAYING
    assert abs(done.target_q[5]) < 0.3


@pytest.mark.sweep(5)
@pytest.mark.parametrize("kind", [Kind.SPEED_JOINT, Kind.SPEED_CARTESIAN, Kind.SERVO_JOINT])
@pytest.mark.parametrize("slider", [1.0, 0.5, 0.1, 0.01, 0.0])
def test_the_program_goes_on_in_each_cycle_however_low_the_speed_slider_is(rig, kind, slider):
    """With it down a speed of one period takes many, and at zero it does not end."""
    rig.start()
    rig.slow_down(slider)
    values = (*HOME[:5], 0.4) if kind is Kind.SERVO_JOINT else (0.0, 0.0, 0.0, 0.0, 0.0, 0.4)
    lasts = 0.4
    begin = len(rig.states)
    rig.channel.command(kind, values, 300.0 if kind is Kind.SERVO_JOINT else 5.0, lasts)
    first = rig.until(lambda state: rig.registers(state)[2] == Phase.MOVING, begin)
    if kind is Kind.SERVO_JOINT:
        rig.pass_time(lasts)
        rig.channel.command(Kind.REST)
    ended = lambda state: rig.registers(state)[2] != Phase.MOVING  # noqa: E731
    end = rig.until(lambda state: state.timestamp > first.timestamp and ended(state), begin)
    moving = [state for state in rig.states[begin:] if rig.registers(state)[2] == Phase.MOVING]
    counted = rig.registers(end)[4] - rig.registers(moving[0])[4]
    seconds = end.timestamp - moving[0].timestamp
    assert counted == pytest.approx(500.0 * seconds, abs=2.0)
    fastest = max(abs(state.target_qd[5]) for state in moving)
    if kind is not Kind.SERVO_JOINT:
        late = 0.002 * (1 + moving[0].lost + end.lost)
        assert seconds == pytest.approx(lasts, abs=0.004 + late), "a speed expires in real time"
        assert fastest == pytest.approx(slider * min(0.4, 5.0 * lasts * slider), abs=0.01)
    rig.sim.control.clear("speed_slider")
    done = rig.until(lambda state: rig.registers(state)[2] == Phase.STANDING)
    assert max(map(abs, done.target_qd)) < 1e-3
    assert done.runtime_state == PLAYING


@pytest.mark.parametrize("slider", [0.1, 0.01, 0.0])
def test_a_speed_slider_that_jumps_down_in_motion_stops_nothing(rig, slider):
    """It is told at once, and the arm gets slower by and by: it does not run away meanwhile."""
    rig.start()
    turn = (0.0, 0.0, 0.0, 0.0, 0.0, -0.3)
    rig.channel.command(Kind.SPEED_CARTESIAN, turn, 5.0, LONG)
    rig.until(lambda state: state.target_qd[5] == pytest.approx(0.3, abs=0.01))
    begin = len(rig.states)
    rig.sim.control.inject("speed_slider", fraction=slider)
    rig.until(lambda state: state.combined_speed_scaling == pytest.approx(slider))
    rig.channel.scaling = slider
    rig.channel.command(Kind.SPEED_CARTESIAN, turn, 5.0, LONG)
    rig.pass_time(2.0 * SLIDER_RAMP)
    assert {rig.registers(state)[2] for state in rig.states[begin:]} == {Phase.MOVING}
    assert rig.states[-1].target_qd[5] == pytest.approx(0.3 * slider, abs=1e-3)


@pytest.mark.parametrize("told", [0.0, 1.0])
def test_an_arm_that_the_slider_held_back_does_not_leap_after_its_target(rig, told):
    """Whether the driver hears of the slider while it is down, or does not."""
    rig.start()
    goal = (2.5, *HOME[1:])
    begin = len(rig.states)
    rig.channel.command(Kind.SERVO_JOINT, goal, 300.0)
    rig.until(lambda state: state.target_qd[0] > 1.0, begin)
    rig.sim.control.inject("speed_slider", fraction=0.0)
    rig.channel.scaling = told
    rig.channel.command(Kind.SERVO_JOINT, goal, 300.0)
    rig.until(lambda state: not any(state.target_qd))
    rig.pass_time(1.0)
    rig.channel.scaling = 1.0
    rig.channel.command(Kind.SERVO_JOINT, goal, 300.0)
    rig.sim.control.clear("speed_slider")
    begin = len(rig.states)
    there = rig.until(lambda state: abs(state.target_q[0] - goal[0]) < 1e-3)
    assert there.runtime_state == PLAYING
    assert max(state.target_qd[0] for state in rig.states[begin:]) <= SPEEDS[0] * 1.001


@pytest.mark.sweep(4)
@pytest.mark.parametrize("kind", [Kind.SPEED_CARTESIAN, Kind.SPEED_JOINT])
@pytest.mark.parametrize("slider", [0.5, 0.1])
def test_a_slow_arm_stops_before_the_end_of_a_range_as_well(rig, kind, slider):
    """The way of a stop is as long at any slider, though the arm is seen to be slower."""
    rig.start()
    rig.slow_down(slider)
    down = kind is Kind.SPEED_CARTESIAN
    speed = (0.0, 0.0, 0.0, 0.0, 0.0, -1.5 if down else 1.5)  # at HOME the tool points down
    rig.channel.command(kind, speed, 5.0, LONG)
    rig.until(lambda state: state.target_q[5] > 0.3)
    rig.until(lambda state: max(map(abs, state.target_qd)) < 1e-3)
    farthest = max(state.target_q[5] for state in rig.states)
    assert 0.4 < farthest < RANGES.upper[5] + 1e-3


def test_a_setting_does_not_disturb_a_motion(rig):
    rig.start()
    goal = (2.5, *HOME[1:])
    sequence = rig.channel.command(Kind.MOVE_JOINT, goal, 2.0, 4.0)
    rig.until(lambda state: state.target_qd[0] > 0.5)
    number = rig.channel.set(Setting.PAYLOAD, (1.25, 0.01, 0.0, 0.02))
    taken = rig.until(lambda state: rig.registers(state)[3] == number)
    assert taken.payload == 1.25
    assert rig.registers(taken)[2] == Phase.MOVING
    np.testing.assert_allclose(rig.until_done(sequence).target_q, goal, atol=1e-6)


def test_a_newer_command_of_another_kind_begins_from_rest(rig):
    rig.start()
    rig.channel.command(Kind.MOVE_JOINT, FAR, 1.0, 4.0)
    rig.until(lambda state: state.target_qd[0] > 0.5)
    start = len(rig.states) - 1
    sequence = rig.channel.command(Kind.MOVE_JOINT, HOME, 1.0, 4.0)
    rig.until_done(sequence)
    states = rig.states[start:]
    phases = [rig.registers(state)[2] for state in states]
    assert phases.index(Phase.STOPPING) < len(phases) - 1 - phases[::-1].index(Phase.MOVING)
    steps = np.abs(np.diff([state.target_qd[0] for state in states]))
    times = np.diff([state.timestamp for state in states])
    assert (steps / times).max() < 6.0, "no jump of the speed"


@dataclass(frozen=True)
class Streamed:
    """What a stream of 1 rad/s made of the first axis, on the controller's clock."""

    speeds: np.ndarray
    accelerations: np.ndarray
    longest_step: float
    """rad; between two targets that the program took, one after the other."""


def stream_through_stalls(rig: Rig, seconds: float, lump: float) -> Streamed:
    """Stream 1 rad/s while what is sent arrives in lumps of so many seconds."""
    rig.start()
    start = len(rig.states)
    rig.sim.control.inject("coalesce", port="rtde", seconds=lump, direction="in")
    began, end = time.monotonic(), rig.states[-1].timestamp + seconds
    sent: dict[int, float] = {}
    while rig.states[-1].timestamp < end:
        now = time.monotonic() - began
        assert now < LONG, "the controller stands still"
        sent[rig.channel.command(Kind.SERVO_JOINT, (now, *HOME[1:]), 300.0)] = now
        time.sleep(0.002)
    rig.sim.control.clear()
    rig.until_done(rig.channel.command(Kind.REST))
    states = rig.states[start:]
    speeds = np.array([state.target_qd[0] for state in states])
    accelerations = np.diff(speeds) / np.diff([state.timestamp for state in states])
    taken = [sent[sequence] for state in states if (sequence := rig.registers(state)[1]) in sent]
    return Streamed(speeds, accelerations, max(np.diff(taken)))


def test_commands_that_arrive_late_are_no_jump(rig):
    """Without bounds in the program the arm takes up to 2.4 rad/s, and accelerates with 40 rad/s².

    How fast it catches up depends on when the first lump ends: the equations give 1.35 to 1.65 rad/s.
    """
    lump = 0.15
    streamed = stream_through_stalls(rig, 1.5, lump)
    fastest = streamed.speeds.max()
    assert fastest > 0.5, "it follows the stream"
    assert streamed.accelerations.max() < ACCELERATION * 1.05
    # What it takes to stop at the last target from where the smoothing is behind it.
    needed = 0.5 * fastest / (LOOKAHEAD - SERVOJ_LOOKAHEAD)
    assert streamed.accelerations.min() > -1.1 * max(ACCELERATION, needed)
    # A sender or a simulator that was held up itself makes the lump longer, and there is more to make up for:
    # at most as fast as one gets, on this way and that of catching up with 1 rad/s, without slowing down.
    step = streamed.longest_step
    held_up = step > 1.2 * lump
    extra = np.sqrt(2.0 * ACCELERATION * step + 1.0) if held_up else 0.65 * max(1.0, step / lump)
    assert fastest < 1.0 + extra


def test_the_program_goes_no_further_than_it_was_told_and_as_fast_as_it_may(rig):
    rig.start()
    goal = (2.0, *HOME[1:])
    rig.channel.command(Kind.SERVO_JOINT, goal, 300.0)
    rig.until(lambda state: abs(state.target_q[0] - 2.0) < 1e-3 and state.target_qd[0] < 1e-3)
    assert max(state.target_q[0] for state in rig.states) < 2.0 + 1e-4
    assert max(state.target_qd[0] for state in rig.states) <= SPEEDS[0] * 1.001


@pytest.mark.parametrize("kind", [Kind.SERVO_JOINT, Kind.SPEED_JOINT, Kind.SPEED_CARTESIAN])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -1e308])
def test_what_cannot_be_meant_stops_the_arm(rig, kind, bad):
    rig.start()
    moving = {
        Kind.SERVO_JOINT: (1.0, *HOME[1:]),
        Kind.SPEED_JOINT: (0.5, 0.0, 0.0, 0.0, 0.0, 0.0),
        Kind.SPEED_CARTESIAN: (0.0, 0.0, 0.1, 0.0, 0.0, 0.3),
    }[kind]
    begin = len(rig.states)
    rig.channel.command(kind, moving, 1.0, LONG)
    rig.until(lambda state: max(map(abs, state.target_qd)) > 0.2, begin)
    done = rig.until_done(rig.channel.command(kind, (bad, *moving[1:]), 1.0, LONG))
    assert max(map(abs, done.target_qd)) < 1e-3
    assert done.runtime_state == PLAYING


@pytest.mark.sweep(3)
@pytest.mark.parametrize(
    ("kind", "values"),
    [
        (Kind.SERVO_JOINT, (*HOME[:5], 1.0)),
        (Kind.SPEED_JOINT, (0.0, 0.0, 0.0, 0.0, 0.0, 1.5)),
        (Kind.SPEED_CARTESIAN, (0.0, 0.0, 0.0, 0.0, 0.0, -1.5)),
    ],
)
def test_no_joint_leaves_its_range_whatever_is_commanded(rig, kind, values):
    """The second line behind the driver: the program knows the ranges itself."""
    rig.start()
    for _ in range(60):
        rig.channel.command(kind, values, 300.0 if kind is Kind.SERVO_JOINT else 5.0, 300.0)
        time.sleep(0.02)
    rig.until_done(rig.channel.command(Kind.REST))
    farthest = max(state.target_q[5] for state in rig.states)
    assert 0.4 < farthest < RANGES.upper[5] + 1e-3


@pytest.mark.parametrize("kind", [Kind.SPEED_CARTESIAN, Kind.FORCE])
def test_a_twist_into_a_singularity_stops_before_the_controller_trips(rig, kind):
    """The driver slows a twist down there; one that stays in force while its thread gets no time does not."""
    rig.start()
    if kind is Kind.FORCE:
        for setting, values in (
            (Setting.FORCE_AXES, (1.0,) * 6 + (0.0,)),
            (Setting.FORCE_LIMITS, (1.5,) * 3 + (0.5,) * 3),
        ):
            taken = rig.channel.set(setting, values)
            rig.until(lambda state, taken=taken: rig.registers(state)[3] == taken)
    outwards = {Kind.SPEED_CARTESIAN: 0.25, Kind.FORCE: 60.0}[kind] * OUTWARDS
    begin = len(rig.states)
    rig.channel.command(kind, (*outwards, 0.0, 0.0, 0.0), 2.0, LONG)
    rig.until(lambda state: rig.registers(state)[2] == Phase.STOPPING, begin)
    done = rig.until(lambda state: rig.registers(state)[2] == Phase.STANDING)
    assert max(map(abs, done.target_qd)) < 1e-3
    assert (done.safety_mode, done.runtime_state) == (NORMAL, PLAYING)
    assert 1.0 < max(abs(state.target_qd[2]) for state in rig.states) < SPEEDS[2] * 1.06


def test_quit_stops_and_ends_the_program(rig):
    rig.start()
    begin = len(rig.states)
    rig.channel.command(Kind.SERVO_JOINT, FAR, 300.0)
    rig.until(lambda state: state.target_qd[0] > 0.1, begin)
    rig.channel.command(Kind.QUIT)
    ended = rig.until(lambda state: state.runtime_state == STOPPED)
    assert max(map(abs, ended.target_qd)) < 1e-3
    assert ended.target_q[0] < FAR[0] - 0.1


def test_the_arm_stops_a_declared_time_after_the_last_package():
    """Measured at the controller, on its own clock: from its cycle of the package to the program's end."""
    frequency = (
        1.0  # or a test that is held up finds that it has ended before it was given anything
    )
    with rig_at() as rig:
        rig.start(frequency)
        sent = len(rig.states)
        rig.channel.command(Kind.SPEED_JOINT, (0.5, 0.0, 0.0, 0.0, 0.0, 0.0), 5.0, LONG)
        begin = rig.until(lambda state: rig.registers(state)[1] == 1, sent).timestamp
        rig.channel.close()
        end = rig.until(lambda state: state.runtime_state != PLAYING, sent)
        late = (end.lost + 1) / 500.0
        # The driver's last package is at most so old when its link breaks.
        assert 1.0 / frequency - 0.01 < end.timestamp - begin < 1.0 / frequency + 0.01 + late
        still = rig.until(lambda state: state.runtime_state == STOPPED)
        assert max(map(abs, still.target_qd)) < 1e-3


def test_registers_that_another_client_has_are_named():
    names = b"input_int_register_0"
    with (
        brisk_sim() as sim,
        socket.create_connection((sim.host, 30004), LONG) as other,
    ):
        other.sendall(struct.pack(">HBH", 5, ord("V"), 2))
        assert other.recv(4) == b"\x00\x04V\x01"
        other.sendall(struct.pack(">HB", 3 + len(names), ord("I")) + names)
        assert other.recv(64)[3] > 0
        with pytest.raises(ConnectionFailed, match=r"input_int_register_0.*in use") as caught:
            ControlChannel(sim.host, 0)
        assert "upper_range_registers" in caught.value.remedy
        ControlChannel(sim.host, 24).close()


# Under the driver


def test_the_upper_registers_serve_as_well():
    with ur_bench({**NATIVE, "upper_range_registers": True}) as bench:
        bench.enable()
        assert bench.arm.move_jp([0.1, *HOME[1:]]).wait(LONG)
        bench.arm.payload_mass(1.5)
        bench.until_outputs(payload=(1.5,))


def test_a_lost_connection_for_commands_is_a_fault_and_the_arm_stops():
    with ur_bench({**NATIVE, "watchdog_frequency": QUICK_WATCHDOG}) as bench:
        bench.enable()
        move = bench.arm.move_jp(FAR)
        bench.until_moving()
        bench.device._link._channel.close()
        status = bench.until_state("FAULT", "the connection for commands is lost")
        assert not status.is_busy
        with pytest.raises(MotionAborted, match="connection for commands"):
            move.wait(LONG)
        bench.until_still()
        bench.until_outputs(runtime_state=(STOPPED,))
        assert bench.engine.connected, "the state stream lives on"
        with bench.nothing_moves():
            bench.enable()
        assert bench.arm.move_jp(HOME).wait(LONG)


def test_a_program_that_does_not_compile_is_told_in_the_controllers_words(bench, monkeypatch):
    bench.arm.disable(timeout=LONG)
    text = "def crtk_control():\n  no_such_function()\nend\n"
    monkeypatch.setattr(link, "program_text", lambda options, program: text)
    with bench.nothing_moves(), pytest.raises(TransitionFailed, match="no_such_function"):
        bench.enable()
    monkeypatch.undo()
    with bench.nothing_moves():
        bench.enable()


def test_why_the_program_ended_is_told(bench, monkeypatch):
    bench.device._link._channel.set(Setting.PAYLOAD, (-1.0, 0.0, 0.0, 0.0))
    bench.until_state("PAUSED", "The controller says: ")
    assert "payload" in eventually(lambda: bench.status.detail, "a reason")
    with bench.nothing_moves():
        bench.enable()


def test_the_force_sensor_is_zeroed_at_rest(bench):
    bench.arm.payload_mass(2.25)
    bench.until_outputs(payload=(2.25,))
    bench.inject("external_force", wrench=[0.0, 0.0, 30.0, 0.0, 0.0, 0.0])
    eventually(lambda: abs(bench.arm.measured_cf().force[2] - 30.0) < 3.0, "the load is measured")
    assert "left over" in bench.arm.zero_force_sensor(timeout=LONG)
    bench.sim.control.clear()
    eventually(lambda: bench.arm.measured_cf().force[2] < -27.0, "it was taken for zero")
    bench.arm.zero_force_sensor(timeout=LONG)


def test_the_registers_are_free_again_after_disable(bench):
    bench.arm.disable(timeout=LONG)
    eventually(lambda: not bench.device._link.connected, "the connection is closed")
    ControlChannel(bench.sim.host, 0).close()
    bench.enable()


def test_a_stream_of_samples_too_slow_for_the_watchdog_is_refused():
    with (
        pytest.raises(ConfigError, match="too slow to feed the watchdog"),
        ur_bench({**NATIVE, "frequency": 10.0, "watchdog_frequency": 5.0}, start=False),
    ):
        pass


# Force mode and freedrive


def tool(bench: UrBench) -> np.ndarray:
    return np.array(bench.outputs("actual_TCP_pose")[:3])


def press(bench: UrBench, wrench, until, what: str) -> None:
    deadline = time.monotonic() + LONG
    while not until():
        assert time.monotonic() < deadline, f"never: {what}"
        bench.arm.servo_cf(wrench)
        time.sleep(0.004)


def choose(bench: UrBench, kind: str, *axes: str) -> None:
    names = {axis: f"{kind}_axis_{axis}" for axis in AXES}
    for axis, name in names.items():
        getattr(bench.arm, name)(axis in axes)
    request, arguments = bench.device._settings._chosen_axes(kind)
    assert arguments["axes"] == [float(axis in axes) for axis in AXES]
    changing = bench.device._inputs.is_changing
    eventually(lambda: not any(map(changing, names.values())), f"{request} is taken")


def test_servo_cf_presses_along_the_chosen_axes_and_ends_with_its_stream(bench):
    choose(bench, "force", "z")
    before, wrench = tool(bench), [20.0, 0.0, 20.0, 0.0, 0.0, 0.0]

    def told() -> bool:
        return np.array_equal(bench.arm.setpoint_cf(age=0).vector, wrench)

    press(bench, wrench, lambda: told() and tool(bench)[2] > before[2] + 0.02, "it gives way")
    eventually(lambda: not bench.arm.health().stream, "the stream has ended")
    bench.until_still()
    np.testing.assert_allclose(tool(bench)[:2], before[:2], atol=1e-3)
    with bench.nothing_moves():
        bench.sim.control.inject("external_force", wrench=[0.0, 0.0, 50.0, 0.0, 0.0, 0.0])
        assert bench.watch(0.3) < 1e-3, "no force mode without a stream"
    assert bench.status.state == "ENABLED"
    assert bench.arm.move_jp(HOME).wait(LONG), "a move after force mode"
    choose(bench, "force", *AXES)


def test_a_move_straight_out_of_a_force_arrives(bench):
    press(
        bench,
        [20.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        lambda: max(map(abs, bench.outputs("target_qd"))) > 0.03,
        "it gives way",
    )
    assert bench.arm.move_jp(HOME).wait(LONG)
    np.testing.assert_allclose(bench.q(), HOME, atol=1e-3)


def test_an_axis_that_is_not_chosen_is_held_against_a_push(bench):
    choose(bench, "force", "y")
    before = tool(bench)
    bench.inject("external_force", wrench=[40.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    press(
        bench,
        [0.0, 15.0, 0.0, 0.0, 0.0, 0.0],
        lambda: tool(bench)[1] > before[1] + 0.02,
        "it gives way",
    )
    assert abs(tool(bench)[0] - before[0]) < 2e-3
    bench.sim.control.clear()
    bench.arm.hold()
    bench.until_still()
    choose(bench, "force", *AXES)


def test_forces_beyond_the_configured_ones_are_refused(bench):
    with bench.nothing_sent(), bench.refused("out_of_range", "servo_cf"):
        bench.arm.servo_cf([0.0, 0.0, 51.0, 0.0, 0.0, 0.0])


def test_freedrive_lets_go_of_the_chosen_axes(bench):
    choose(bench, "free", "y")
    before = tool(bench)
    bench.arm.free()
    bench.inject("external_force", wrench=[40.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert bench.watch(0.3) < 1e-3
    bench.inject("external_force", wrench=[0.0, 40.0, 0.0, 0.0, 0.0, 0.0])
    eventually(lambda: tool(bench)[1] > before[1] + 0.02, "it gives way")
    bench.sim.control.clear()
    bench.arm.hold()
    bench.until_still()
    assert abs(tool(bench)[0] - before[0]) < 2e-3
    choose(bench, "free", *AXES)


def turned(bench: UrBench) -> np.ndarray:
    """Turn the tool until its axes are none of the base, and return them (3x3) in the base."""
    assert bench.arm.move_jp([0.5, *HOME[1:4], -1.2, 0.4]).wait(LONG)
    bench.until_still()
    return matrix_from_quaternion(bench.arm.measured_cp().orientation)


def test_force_mode_gives_way_along_axes_of_the_tool(bench):
    axes = turned(bench)
    bench.arm.force_of_tool(True)
    choose(bench, "force", "x")
    before = tool(bench)
    # In base axes, as always: along the tool's x and y.
    wrench = [*(20.0 * axes[:, 0] + 20.0 * axes[:, 1]), 0.0, 0.0, 0.0]

    def way() -> np.ndarray:
        return axes.T @ (tool(bench) - before)

    press(bench, wrench, lambda: way()[0] > 0.02, "it gives way")
    bench.until_still()
    np.testing.assert_allclose(way()[1:], 0.0, atol=2e-3)
    bench.arm.force_of_tool(False)
    choose(bench, "force", *AXES)


def test_force_mode_is_tuned_at_run_time(bench):
    """The arm gives way no faster than it may, and stops at once with full damping."""
    choose(bench, "force", "z")
    bench.arm.force_limits([0.02, 0.1])
    bench.arm.force_gain(1.0)
    eventually(lambda: not bench.device._inputs.is_changing("force_gain"), "they are sent")
    before, fastest = tool(bench), 0.0

    def there() -> bool:
        nonlocal fastest
        fastest = max(fastest, abs(bench.outputs("actual_TCP_speed")[2]))
        return bool(tool(bench)[2] > before[2] + 0.01)

    press(bench, [0.0, 0.0, 40.0, 0.0, 0.0, 0.0], there, "it gives way")
    assert fastest < 0.025
    bench.arm.hold()
    bench.until_still()
    for name, value in (("force_limits", [0.1]), ("force_limits", [0.0, 0.5]), ("force_gain", 2.1)):
        with bench.refused("out_of_range", name):
            getattr(bench.arm, name)(value)
    bench.arm.force_limits([0.1, 0.5])
    bench.arm.force_damping(0.025)
    bench.arm.force_gain(0.5)
    choose(bench, "force", *AXES)


def test_freedrive_lets_go_of_axes_of_the_tool(bench):
    axes = turned(bench)
    bench.arm.free_of_tool(True)
    choose(bench, "free", "y")
    before = tool(bench)
    bench.arm.free()
    bench.inject("external_force", wrench=[*(40.0 * axes[:, 0]), 0.0, 0.0, 0.0])
    assert bench.watch(0.3) < 1e-3
    bench.inject("external_force", wrench=[*(40.0 * axes[:, 1]), 0.0, 0.0, 0.0])
    eventually(lambda: (axes.T @ (tool(bench) - before))[1] > 0.02, "it gives way")
    bench.sim.control.clear()
    bench.arm.hold()
    bench.until_still()
    np.testing.assert_allclose((axes.T @ (tool(bench) - before))[[0, 2]], 0.0, atol=2e-3)
    bench.arm.free_of_tool(False)
    choose(bench, "free", *AXES)


def test_the_configured_inertia_and_axes_are_sent_by_enable():
    inertia = [0.01, 0.02, 0.03, 0.0, 0.001, 0.0]
    config = {
        **NATIVE,
        "payload": {"mass": 1.5, "center_of_gravity": [0.0, 0.0, 0.05], "inertia": inertia},
        "force": {"axes": [False, False, True, False, False, False]},
    }
    with ur_bench(config) as bench:
        bench.enable()
        np.testing.assert_allclose(bench.outputs("payload_inertia"), inertia)
        assert bench.outputs("payload") == 1.5
        before = tool(bench)
        press(bench, [9.0, 9.0, 9.0, 0.0, 0.0, 0.0], lambda: tool(bench)[2] > before[2] + 0.01, "z")
        np.testing.assert_allclose(tool(bench)[:2], before[:2], atol=1e-3)


@pytest.mark.parametrize("values", [{"free_axes": [True] * 5 + [False]}, {"free_frame": "tool"}])
def test_what_ur_rtde_has_not_is_refused_for_it(values):
    with (
        pytest.raises(ConfigError, match="native"),
        ur_bench({"control": "ur_rtde", **values}, start=False),
    ):
        pass


def test_ur_rtde_has_no_force_mode():
    with ur_bench({"control": "ur_rtde"}, start=False) as bench:
        with pytest.raises(AttributeError, match="servo_cf"):
            _ = bench.arm.servo_cf
        assert "force_axis_x" not in bench.device.inputs
