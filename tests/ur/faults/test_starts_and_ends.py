"""Faults of a UR arm while its driver begins, ends, or is killed: each with a simulator of its own.

The faults are those of the table F1 to F20 in the documentation that concern this driver.
"""

import math
import os
import signal
import socket
import threading
import time

import pytest

from bench.reliability.activities import Plan
from crtk_driver_ur import robot
from crtk_drivers.errors import (
    CommandRefused,
    DeviceError,
    MotionAborted,
    StopUnconfirmed,
    TransitionFailed,
)
from rigs import victims
from rigs.ur_bench import LONG, PATIENT, WAYS, brisk_sim, driver_at, eventually, ur_bench
from rigs.ur_faults import (
    CONFIG,
    IDLE,
    PLAYING,
    POWER_OFF,
    POWER_ON,
    RUNNING,
    STOPPED,
    assert_enables_at_rest,
    dashboard,
    start_moving,
    travel_after_death,
)

pytestmark = pytest.mark.sweep(2)

both_ways = pytest.mark.parametrize("control", WAYS)


# F1, F2, F3, F12: what it begins with.


@both_ways
def test_enable_unlocks_where_the_configuration_says_so(control):
    with ur_bench({**CONFIG, "control": control, "enable_unlocks": True}) as bench:
        bench.enable()
        bench.sim.control.inject("protective_stop")
        bench.until_state("FAULT", "protective stop")
        assert_enables_at_rest(bench)


def test_f3_a_peer_that_never_answers_is_told_and_tried_again(caplog):
    with ur_bench({"open_timeout": 0.5}, start=False) as bench:
        bench.inject("no_answer", port="rtde")
        bench.session.start()
        status = bench.until_state("FAULT", "is not answered")
        told = f"{bench.sim.host}:30004: FAULT: {status.detail}"
        eventually(lambda: told in caplog.text, "it is logged")
        assert "Check" in status.detail, "what to do"
        with bench.refused("not_connected", "state_command"):
            bench.arm.enable()
        bench.sim.control.clear()
        bench.until_state("DISABLED")


@pytest.mark.parametrize("fault", ["no_answer", "silence"])
def test_f3_closing_does_not_wait_for_a_peer_that_never_answers(fault):
    with ur_bench({"open_timeout": 60.0}, start=False) as bench:
        bench.inject(fault, port="rtde")
        bench.session.start()
        eventually(lambda: bench.device._opening, "it tries to connect")
        bench.arm.close()  # raises if its thread does not end
        assert not [t for t in threading.enumerate() if bench.sim.host in t.name]


def test_f3_a_controller_that_comes_later_is_found(caplog):
    with brisk_sim() as sim:
        host = sim.host
        sim.kill()
        with driver_at(sim, start=False) as bench:
            bench.session.start()
            status = bench.until_state("FAULT", "cannot connect")
            told = f"{host}:30004: FAULT: {status.detail}"
            eventually(lambda: told in caplog.text, "it is logged")
            with brisk_sim(host=host) as second:
                bench.sim = second
                bench.until_state("DISABLED")
                bench.enable()
                bench.arm.disable()  # when `second` has gone, no stop could be confirmed


@pytest.mark.parametrize(
    ("lost_in", "told"),
    [((POWER_ON, IDLE), "lost its power while it came up"), ((POWER_OFF,), "did not begin")],
)
def test_power_that_is_lost_while_it_comes_ends_enable_at_once(monkeypatch, lost_in, told):
    monkeypatch.setattr(robot, "POWER_BEGINS", 1.2)
    # A quarter of it until it shows: so long who takes the power away may be held up.
    with ur_bench(CONFIG, powered_on=False, power_seconds=2.0) as bench:
        bench.engine.state_command("enable")

        def failed():
            if bench.outputs("robot_mode") in lost_in:
                bench.sim.control.inject("power_loss")
            return bench.engine.transition_ended

        eventually(failed, "enable ends")
        assert bench.arm.operating_state().state == "FAULT"
        assert told in bench.engine.status.detail
        assert_enables_at_rest(bench)


# F16: processes that die or freeze. What stops the arm then is the controller's own watchdog.


@pytest.mark.real_time  # the vendor's library
def test_f16_a_program_left_by_an_interrupted_start_is_stopped_by_the_next_enable():
    """Killed between upload and watchdog, the process leaves a program that nothing ends by itself."""
    with ur_bench({**CONFIG, "control": "ur_rtde"}) as bench:

        def is_left() -> bool:
            """Begin, and kill it in between; a busy machine may do so too early or too late."""
            bench.until_outputs(runtime_state=(STOPPED,))
            before = len(bench.sim.control.status()["scripts"])
            eventually(lambda: bench.child, "a control process")
            bench.engine.state_command("enable")
            eventually(lambda: len(bench.sim.control.status()["scripts"]) > before, "an upload")
            os.kill(bench.child, signal.SIGKILL)
            bench.until_state("FAULT", "the control process")
            runs_out = bench.outputs("timestamp") + 1.5 / bench.session.config.watchdog_frequency
            eventually(lambda: bench.outputs("timestamp") > runs_out, "a watchdog has acted")
            return bool(bench.outputs("runtime_state") == PLAYING)

        bench.until_connected()
        eventually(is_left, "a program that no watchdog ends")
        assert_enables_at_rest(bench)


@pytest.mark.slow
@both_ways
@pytest.mark.parametrize("activity", ["move_jp", "servo_jp"])
def test_f16_f19_killed_driver_and_its_restart(control, activity):
    config = {**CONFIG, "control": control, "watchdog_frequency": PATIENT["watchdog_frequency"]}
    with brisk_sim() as sim, driver_at(sim, config, start=False) as bench:
        with victims.victim("ur", bench.session.config, Plan(0.8, 2.5), activity):
            bench.until_moving()
            speed = max(bench.outputs("target_qd")[0], 1.0 if activity == "servo_jp" else 2.0)
        before = bench.q()[0]
        bench.until_still()
        assert bench.q()[0] - before < travel_after_death(bench, speed)
        assert bench.outputs("robot_mode") == RUNNING, "the arm holds"
        with bench.nothing_moves():
            bench.session.start()
            bench.until_connected()
            bench.until_state("DISABLED")
            assert bench.watch(0.5) < 1e-3, "nothing moves because of a restart"
        assert_enables_at_rest(bench)


@both_ways
def test_f16_dead_robot_under_motion_is_a_fault_and_close_is_quick(control):
    with brisk_sim() as sim:
        with driver_at(sim, {**CONFIG, "control": control}) as bench:
            bench.enable()
            move = start_moving(bench)
            sim.suspend()
            bench.until_state("FAULT")
            with pytest.raises(MotionAborted, match="aborted"):
                move.wait(LONG)
            began = time.monotonic()
            with pytest.raises(StopUnconfirmed, match="could not be read back"):
                bench.arm.close()
            # The library alone would block for 301 s (facts of ur_rtde); the promise is 2 s.
            assert time.monotonic() - began < 10.0
        assert not [t for t in threading.enumerate() if sim.host in t.name]


@both_ways
def test_f16_robot_without_power_under_motion(control):
    with brisk_sim() as sim, driver_at(sim, {**CONFIG, "control": control}) as bench:
        bench.enable()
        move = start_moving(bench)
        sim.kill()
        bench.until_state("FAULT")
        with pytest.raises(MotionAborted, match="aborted"):
            move.wait(LONG)
        assert bench.arm.measured_js(age=0, extra=True)[1] == 0.0
        with pytest.raises(StopUnconfirmed, match="could not be read back"):
            bench.arm.close()


# F20


@pytest.mark.slow
@both_ways
def test_f20_a_second_writer_is_refused_by_name_of_the_cause(control):
    with (
        brisk_sim() as sim,
        driver_at(sim, {**CONFIG, "control": control}) as first,
        driver_at(sim, {**CONFIG, "control": control}) as second,
    ):
        first.enable()
        with first.nothing_moves():
            with pytest.raises((CommandRefused, DeviceError), match="another program"):
                second.enable()
            assert first.status.state == "ENABLED"
        first.arm.pause(timeout=LONG)
        assert first.arm.measured_js().position.size == 6
        # Its program gone, its registers still claimed.
        first.sim.control.inject("stop_program")
        first.until_outputs(runtime_state=(1,))
        with pytest.raises(TransitionFailed, match="in use"):
            second.enable()
        assert "close it" in second.until_state("FAULT").detail
        first.enable()
        assert math.isclose(first.arm.setpoint_jp()[0], first.q()[0], abs_tol=1e-3)


@both_ways
def test_f20_a_program_that_takes_the_place_of_ours_is_noticed(control):
    """Anybody may send a program; ours is gone then, and its commands would go nowhere.

    With ur-rtde it is seen by the one state in which no program runs, however few states become samples.
    """
    with ur_bench({**CONFIG, "control": control, "frequency": 125.0}) as bench:
        bench.enable()
        with socket.create_connection((bench.sim.host, 30002), LONG) as peer:
            peer.sendall(b"def other():\n  while True:\n    sync()\n  end\nend\n")
            bench.until_state("PAUSED", "control program was stopped")
        with bench.refused("not_enabled", "servo_jp"):
            bench.arm.servo_jp(bench.arm.measured_jp())
        assert dashboard(bench, "stop") == "Stopped"
        assert_enables_at_rest(bench)
