"""Faults of a UR arm, its network and its driver: what state follows, and that nothing moves.

The faults are those of the table F1 to F20 in the documentation that concern this driver.
"""

import logging
import os
import re
import signal
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
import pytest

from crtk_driver_ur.library import supervisor
from crtk_drivers.errors import (
    CommandRefused,
    ConnectionLost,
    DeviceError,
    MotionAborted,
    TransitionFailed,
)
from rigs.ur_bench import HOME, LONG, WAYS, UrBench, eventually, ur_bench
from rigs.ur_faults import (
    CONFIG,
    FAR,
    POWER_OFF,
    SAMPLE_TIMEOUT,
    assert_enables_at_rest,
    restart_safety,
    start_moving,
    travel_after_death,
    unlock,
)

pytestmark = pytest.mark.sweep(2)

NEAR = [1.0, *HOME[1:]]
NO_DOUBT = 0.8
"""Seconds of silence after which a process counts as hung that the test has stopped itself."""


@pytest.fixture(scope="module", params=WAYS)
def shared(request):
    with ur_bench({**CONFIG, "control": request.param}) as bench:
        yield bench


by_ur_rtde = pytest.mark.parametrize("shared", ["ur_rtde"], indirect=True)
"""For what concerns the control process only."""

by_native = pytest.mark.parametrize("shared", ["native"], indirect=True)
"""For what is the same either way, or what test_matrix.py has of ur-rtde in motion."""


@pytest.fixture
def bench(shared: UrBench) -> UrBench:
    shared.reset()
    return shared


def start_streaming(bench: UrBench) -> None:
    deadline = time.monotonic() + LONG
    while abs(bench.outputs("actual_qd")[0]) < 0.1:
        assert time.monotonic() < deadline, "never: the arm follows the stream"
        bench.arm.servo_jr([0.004, 0.0, 0.0, 0.0, 0.0, 0.0])
        time.sleep(0.005)


def until_out_of_action(bench: UrBench) -> None:
    """Wait for DISABLED, or with ur-rtde for a protective stop.

    The library's program follows at once what a network or a stall held up, on a busy machine into that.
    """

    def reached() -> bool:
        status = bench.status
        stopped = bench.control == "ur_rtde" and "protective stop" in status.detail
        return status.state == "DISABLED" or stopped

    eventually(reached, "the link is back, and the arm out of action")


# F12, F13, F14: the robot stops by itself, or somebody at the teach pendant takes over.


@dataclass(frozen=True)
class RobotFault:
    """Something that happens to the robot while it moves, and what must follow.

    `state` and `detail` are expected at once; `premature` says whether the state command that leads
    back is refused while the fault lasts; `repair` is what a person does besides removing the cause.
    """

    kind: str
    state: str
    detail: str
    premature: bool = False
    repair: object = None


ROBOT_FAULTS = (
    RobotFault("protective_stop", "FAULT", "protective stop", premature=True, repair=unlock),
    RobotFault("emergency_stop", "FAULT", "emergency stop", premature=True),
    RobotFault("safeguard_stop", "PAUSED", "safeguard", premature=True),
    RobotFault("local_control", "PAUSED", "teach pendant has control", premature=True),
    RobotFault("stop_program", "PAUSED", "control program was stopped"),
    RobotFault("pause_program", "PAUSED", "program was paused"),
    RobotFault("script_error", "PAUSED", "control program was stopped"),
    RobotFault("violation", "FAULT", "safety violation", repair=restart_safety),
    RobotFault("safety_fault", "FAULT", "safety fault", repair=restart_safety),
    RobotFault("power_loss", "DISABLED", "no power"),
)


NOT_BY_ENABLE = {
    "protective_stop": ("FAULT", "protective stop"),
    "emergency_stop": ("FAULT", "emergency stop"),
    "system_emergency_stop": ("FAULT", "emergency stop"),
    "violation": ("FAULT", "safety violation"),
    "safety_fault": ("FAULT", "safety fault"),
    "recovery_mode": ("FAULT", "recovery mode"),
    "safeguard_stop": ("PAUSED", "safeguard"),
    "local_control": ("PAUSED", "teach pendant has control"),
}
"""Stops that no enable clears, with state and detail."""


@pytest.mark.slow  # test_matrix.py has it
@by_native
@pytest.mark.parametrize("fault", ROBOT_FAULTS, ids=lambda fault: fault.kind)
def test_robot_fault_under_motion(bench, fault):
    robot_fault_under_motion(bench, fault)


@pytest.mark.slow
@by_ur_rtde
@pytest.mark.parametrize("kind", ["protective_stop", "script_error"])
def test_robot_fault_that_the_matrix_has_at_rest(bench, kind):
    robot_fault_under_motion(bench, next(fault for fault in ROBOT_FAULTS if fault.kind == kind))


def robot_fault_under_motion(bench: UrBench, fault: RobotFault) -> None:
    move = start_moving(bench)
    bench.sim.control.inject(fault.kind)
    status = bench.until_state(fault.state, fault.detail)
    assert not status.is_busy
    with pytest.raises(MotionAborted, match="aborted"):
        move.wait(LONG)
    bench.until_still()
    assert bench.q()[0] < FAR[0] - 0.1
    with bench.refused("not_enabled", "move_jp"):
        bench.arm.move_jp(HOME)
    if fault.premature or fault.repair:
        with (
            bench.nothing_moves(),
            pytest.raises((TransitionFailed, CommandRefused), match=fault.detail),
        ):
            bench.enable()
        assert bench.status.state == fault.state
    with bench.nothing_moves():
        bench.sim.control.clear()
        if fault.repair:
            fault.repair(bench)
        assert bench.watch(0.3) < 1e-3, "nothing moves because the fault is gone"
        assert bench.status.state == fault.state, "only a command leads back"
    assert_enables_at_rest(bench)
    assert fault.state in bench.log.states


RESTARTED = {"violation", "safety_fault"}
"""Of these, what only a restart of the safety system ends."""


@pytest.mark.sweep(4)
@pytest.mark.parametrize("kind", NOT_BY_ENABLE)
def test_a_stop_is_not_cleared_by_enable(bench, kind):
    """As the table in docs/ur.md says."""
    bench.sim.control.inject(kind)
    bench.until_state(*NOT_BY_ENABLE[kind])
    for _ in range(3):
        with bench.nothing_moves(), pytest.raises((DeviceError, CommandRefused)):
            bench.enable()
    assert bench.status.state == NOT_BY_ENABLE[kind][0]
    bench.sim.control.clear()
    if kind in RESTARTED:
        restart_safety(bench)


def test_a_stream_is_cut_off_by_an_emergency_stop(bench):
    start_streaming(bench)
    bench.sim.control.inject("emergency_stop")
    bench.until_state("FAULT", "emergency stop")
    bench.until_still()
    with bench.refused("not_enabled", "servo_jr"):
        bench.arm.servo_jr([0.001] * 6)
    bench.until_outputs(robot_mode=(POWER_OFF,))
    bench.sim.control.clear()
    with bench.nothing_moves():
        bench.enable()


@pytest.mark.parametrize(
    ("servo", "value"),
    [
        ("servo_jr", [0.004, 0.0, 0.0, 0.0, 0.0, 0.0]),
        ("servo_jv", [0.5, 0.0, 0.0, 0.0, 0.0, 0.0]),
        ("servo_cv", [0.0, 0.2, 0.0, 0.0, 0.0, 0.5]),
    ],
)
def test_nothing_of_a_stream_is_carried_out_by_the_next_program(bench, servo, value):
    deadline = time.monotonic() + LONG
    while np.abs(bench.outputs("actual_qd")).max() < 0.1:
        assert time.monotonic() < deadline, "never: the arm follows the stream"
        getattr(bench.arm, servo)(value)
        time.sleep(0.005)
    bench.sim.control.inject("stop_program")
    bench.until_state("PAUSED", "control program was stopped")
    bench.until_still()
    with bench.nothing_moves():
        bench.arm.resume(timeout=LONG)
        assert bench.watch(0.3) < 1e-3


# F1, F2, F5: the network.


@dataclass(frozen=True)
class LinkFault:
    """Something that happens to the connections while the arm moves; `detail` of the FAULT."""

    kind: str
    detail: str
    parameters: dict = field(default_factory=dict)


LINK_FAULTS = {
    "F1 closed by the controller": LinkFault("disconnect", "closed", {"port": "rtde"}),
    "F1 closed, and closed again for a while": LinkFault(
        "disconnect", "closed", {"port": "all", "duration": 1.5}
    ),
    "F2 silent": LinkFault("silence", "", {"port": "rtde", "duration": 3.0}),
    "F2 the controller hangs": LinkFault("stall", "", {"duration": 3.0}),
    "F5 corrupt": LinkFault(
        "corrupt", "", {"port": "rtde", "every": 1, "direction": "out", "duration": 60.0}
    ),
}


@pytest.mark.slow  # test_matrix.py has it
@by_native
@pytest.mark.parametrize("fault", LINK_FAULTS.values(), ids=LINK_FAULTS)
def test_link_fault_under_motion(bench, fault):
    link_fault_under_motion(bench, fault)


@pytest.mark.slow
@by_ur_rtde
@pytest.mark.parametrize(
    "name",
    [
        "F1 closed by the controller",
        "F1 closed, and closed again for a while",
        "F2 the controller hangs",
    ],
)
def test_link_fault_that_the_matrix_has_at_rest_or_not_always(bench, name):
    link_fault_under_motion(bench, LINK_FAULTS[name])


def link_fault_under_motion(bench: UrBench, fault: LinkFault) -> None:
    move = start_moving(bench)
    _, stamp = bench.arm.measured_js(extra=True)
    assert stamp > 0.0
    losses = bench.arm.health().reconnects
    bench.sim.control.inject(fault.kind, **fault.parameters)
    bench.until_state("FAULT", fault.detail)
    with pytest.raises(MotionAborted, match="aborted"):
        move.wait(LONG)
    eventually(lambda: bench.arm.health().reconnects > losses, "the link is given up")
    if bench.status.state == "FAULT" and not bench.engine.connected:
        _, stamp = bench.arm.measured_js(age=0, extra=True)
        assert stamp == 0.0 or bench.engine.connected, "old data is not stamped as fresh"
    if fault.kind == "corrupt":
        bench.sim.control.clear()  # RTDE has no checksum: it goes on until a header is hit
    bench.until_connected()
    until_out_of_action(bench)
    bench.sim.control.clear()
    bench.until_still()
    assert bench.q()[0] < FAR[0] - 0.1
    with bench.nothing_moves():
        assert bench.watch(0.3) < 1e-3
        with bench.refused("not_enabled", "move_jp"):
            bench.arm.move_jp(HOME)
    eventually(lambda: bench.arm.measured_js(extra=True)[1] > 0.0, "valid again")
    assert_enables_at_rest(bench)


@pytest.mark.slow  # test_rtde_stream.py has it of the stream alone
@by_native
@pytest.mark.parametrize(
    ("variable", "value"),
    [("actual_q", "nan"), ("actual_q", "1e308"), ("target_q", "inf"), ("actual_TCP_force", "nan")],
)
def test_f5_a_state_that_is_not_finite_is_never_told(bench, variable, value):
    """One field that is no number: no sample, FAULT past its age, and the arm stops."""
    move = start_moving(bench)
    bench.sim.control.inject("spoiled_output", variable=variable, index=2, value=value)
    bench.until_state("FAULT")
    with pytest.raises(MotionAborted):
        move.wait(LONG)
    bench.until_still()
    assert bench.arm.measured_js(age=0, extra=True)[1] == 0.0
    for name in ("measured_js", "measured_cp", "measured_cv", "measured_cf", "setpoint_js"):
        told = getattr(bench.arm, name)(age=0)
        fields = (getattr(told, field) for field in type(told).__dataclass_fields__)
        arrays = [field for field in fields if isinstance(field, np.ndarray)]
        assert all(np.isfinite(array).all() for array in arrays), name
    eventually(lambda: variable in "".join(note.text for note in bench.device.notes), "it is named")
    bench.sim.control.clear()
    eventually(lambda: bench.arm.measured_js(age=0, extra=True)[1] > 0.0, "valid again")
    bench.until_state("DISABLED")
    assert_enables_at_rest(bench)


def test_f1_every_command_says_that_there_is_no_connection(bench):
    bench.sim.control.inject("disconnect", port="rtde", duration=60.0)
    bench.until_state("FAULT")
    eventually(lambda: not bench.engine.connected, "the link is given up")
    with bench.refused("not_connected", "state_command"):
        bench.arm.enable()
    with bench.refused("not_enabled", "move_jp"):
        bench.arm.move_jp(HOME)
    assert "connected" in str(bench.log.refusals[-2])
    bench.sim.control.clear()
    bench.until_state("DISABLED")
    assert bench.arm.health().reconnects >= 1
    told = r"the link was lost \(.+\) and is back; not under our control: its brakes were already released"
    assert re.match(told, bench.status.detail)


@by_native
@pytest.mark.parametrize("size", [1, 7, 64])
def test_f4_packages_in_pieces_are_the_same_packages(bench, size):
    bench.inject("split", port="rtde", size=size, direction="out")
    before = bench.arm.health().device
    samples = bench.arm.health().samples
    eventually(lambda: bench.arm.health().samples > samples + 50, "samples go on")
    np.testing.assert_allclose(bench.arm.measured_jp(), bench.q(), atol=1e-4)
    assert bench.arm.health().device["packages malformed"] == before["packages malformed"]
    assert bench.status.state == "ENABLED"
    assert bench.arm.move_jp([0.1, *HOME[1:]]).wait(LONG)


def test_a_lump_of_packages_is_no_burst_of_commands(bench):
    bench.inject("coalesce", port="rtde", seconds=0.05, direction="out")
    assert bench.arm.move_jp([0.2, *HOME[1:]]).wait(LONG)
    assert bench.status.state == "ENABLED"
    assert bench.arm.health().device["packages skipped"] > 0


@pytest.mark.slow  # test_services_dashboard.py has it of services
def test_a_silent_dashboard_fails_enable_and_not_the_driver(bench):
    bench.arm.disable(timeout=LONG)
    bench.inject("silence", port="dashboard")
    with bench.nothing_moves(), pytest.raises(TransitionFailed):
        bench.arm.enable(timeout=LONG)
    bench.until_state("FAULT")
    assert bench.engine.connected
    bench.sim.control.clear()
    assert_enables_at_rest(bench)


# F16: processes that die or freeze. What stops the arm then is the controller's own watchdog.


@by_ur_rtde
@pytest.mark.parametrize("moving", [start_moving, start_streaming])
def test_f16_killed_control_process(bench, moving):
    move = moving(bench)
    child = bench.child
    speed = max(bench.outputs("target_qd")[0], 2.0 if move else 1.0)
    os.kill(child, signal.SIGKILL)
    before = bench.q()[0]
    status = bench.until_state("FAULT", "the control process")
    assert "enabled again" in status.detail
    if move is not None:
        with pytest.raises(MotionAborted, match="the control process"):
            move.wait(LONG)
    bench.until_still()
    assert bench.q()[0] - before < travel_after_death(bench, speed)
    assert bench.engine.connected, "the state stream lives on"
    eventually(lambda: bench.child not in (0, child), "another control process")
    assert_enables_at_rest(bench)


@pytest.mark.slow  # one that is killed is its quick brother
@by_ur_rtde
@pytest.mark.parametrize("is_full", [False, True])
def test_f16_frozen_control_process(bench, is_full, caplog):
    """Once the way to it is full, neither a stop nor a sign of life gets through: that is told once."""
    move = start_moving(bench)
    child = bench.child
    os.kill(child, signal.SIGSTOP)
    with suppress(ConnectionLost):
        while is_full:
            bench.device._link.process.stop()
    bench.until_state("FAULT", "control process")
    with pytest.raises(MotionAborted, match="aborted"):
        move.wait(LONG)
    bench.until_still()
    eventually(lambda: bench.child not in (0, child), "another control process")
    told = [record for record in caplog.records if "control process" in record.getMessage()]
    told = [record.getMessage() for record in told if record.levelno >= logging.WARNING]
    assert len(told) <= 6, told
    assert_enables_at_rest(bench)


@by_ur_rtde
def test_f16_disable_reaches_power_off_although_the_control_process_hangs(bench, monkeypatch):
    process = bench.device._link.process
    monkeypatch.setattr(supervisor, "SILENCE_ALLOWED", NO_DOUBT)
    eventually(lambda: process._allowed == NO_DOUBT, "it was heard since then")
    os.kill(bench.child, signal.SIGSTOP)
    bench.arm.state_command("disable", timeout=0)
    bench.until_state("DISABLED")
    monkeypatch.undo()
    bench.until_outputs(robot_mode=(POWER_OFF,))
    assert_enables_at_rest(bench)


@by_ur_rtde
def test_f16_a_control_process_that_dies_again_and_again_is_started_slowly(bench):
    starts = bench.arm.health().device["control process starts"]
    began = time.monotonic()
    for _ in range(3):
        eventually(lambda: bench.child, "a control process")
        child = bench.child
        os.kill(child, signal.SIGKILL)
        eventually(lambda c=child: bench.child != c, "its death is noticed")
    eventually(lambda: bench.child, "a control process")
    taken = time.monotonic() - began
    assert bench.arm.health().device["control process starts"] - starts <= 1.0 + taken
    bench.until_state("FAULT")
    assert_enables_at_rest(bench)


# F17, F18: the driver's own threads and clock.


@pytest.mark.slow  # test_matrix.py has it
def test_f17_stuck_io_thread_is_a_fault_and_the_arm_stops(bench, monkeypatch):
    move = start_moving(bench)
    release = threading.Event()
    read = bench.device.read

    def stuck(deadline):
        release.wait(LONG)
        return read(deadline)

    monkeypatch.setattr(bench.device, "read", stuck)
    try:
        bench.until_state("FAULT", "stuck")
        with pytest.raises(MotionAborted, match="stuck"):
            move.wait(LONG)
        bench.until_still()
        assert bench.q()[0] < FAR[0] - 0.1
        bench.arm.measured_js(age=0)
        assert bench.arm.measured_js(age=0, extra=True)[1] == 0.0
        # Longer than a sample may be old: what comes first is of that time, and no reason to connect anew.
        longest = SAMPLE_TIMEOUT + 0.2
        eventually(lambda: bench.arm.health().sample_age > longest, "stuck for so long")
    finally:
        monkeypatch.undo()
        release.set()
    assert bench.watch(0.3) < 1e-3
    eventually(lambda: bench.arm.measured_js(age=0, extra=True)[1] > 0.0, "samples again")
    assert bench.status.state == "FAULT"
    assert_enables_at_rest(bench)


@by_native
def test_f17_an_error_in_the_io_thread_is_a_fault_and_it_goes_on(bench, monkeypatch):
    def broken(deadline):
        raise RuntimeError("a defect")

    start_moving(bench)
    monkeypatch.setattr(bench.device, "read", broken)
    bench.until_state("FAULT", "a defect")
    monkeypatch.undo()
    bench.until_state("DISABLED")
    bench.until_still()
    assert bench.q()[0] < FAR[0] - 0.1
    assert_enables_at_rest(bench)


@by_native
@pytest.mark.parametrize("jump", [3600.0, -3600.0])
def test_f18_clock_jump(bench, monkeypatch, jump):
    move = start_moving(bench, NEAR)
    wall = time.time_ns
    _, before = bench.arm.measured_js(extra=True)
    monkeypatch.setattr(time, "time_ns", lambda: wall() + int(jump * 1e9))
    eventually(
        lambda: abs(bench.arm.measured_js(extra=True)[1] - before - jump) < 60.0, "stamps jump"
    )
    assert move.wait(LONG), "monotonic deadlines are untouched"
    assert bench.arm.wait_for_busy(False, LONG)
    bench.arm.pause(timeout=LONG)
    bench.arm.resume(timeout=LONG)
    assert bench.status.state == "ENABLED"
    assert bench.log.stamps == sorted(set(bench.log.stamps)), "of operating_state, increasing"
