"""Services of the UR driver: dashboard commands and the force sensor, against a simulated controller."""

from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

import pytest

from crtk_driver_ur import dashboard, robot
from crtk_drivers.errors import CommandRefused, DeviceFault, Reason, TransitionFailed
from rigs.ur_bench import FAR, LONG, UrBench, brisk_sim, driver_at, eventually, ur_bench

UNLOCK_AFTER = robot.UNLOCK_AFTER
"""As it is without a bench."""

POWER_OFF, IDLE, RUNNING = 3, 5, 7
NORMAL, PROTECTIVE_STOP, VIOLATION = 1, 3, 8
ACTING = (
    "unlock_protective_stop",
    "restart_safety",
    "power_on",
    "brake_release",
    "power_off",
    "close_popup",
    "close_safety_popup",
    "zero_force_sensor",
)


@pytest.fixture(scope="module")
def shared():
    with ur_bench() as bench:
        yield bench


@pytest.fixture
def bench(shared: UrBench) -> UrBench:
    shared.reset()
    return shared


@contextmanager
def without_power(power_seconds: float) -> Iterator[UrBench]:
    """A driver that was not enabled, at an arm without power."""
    with (
        brisk_sim(model="ur5e", powered_on=False, power_seconds=power_seconds) as sim,
        driver_at(sim) as bench,
    ):
        yield bench


@pytest.fixture
def idle():
    """The same, whose power takes long enough for something to come in between."""
    with without_power(0.8) as bench:
        yield bench


def refused(call, reason: Reason, words: str) -> None:
    with pytest.raises(CommandRefused, match=words) as caught:
        call(timeout=LONG)
    assert caught.value.reason is reason
    assert caught.value.where


def test_power_goes_up_and_down_step_by_step_and_moves_nothing():
    with without_power(0.1) as idle, idle.nothing_moves():
        arm = idle.arm
        assert arm.power_on(timeout=LONG) == "IDLE"
        assert idle.outputs("robot_mode") == IDLE
        assert arm.power_on(timeout=LONG) == "IDLE"
        assert arm.brake_release(timeout=LONG) == "RUNNING"
        assert idle.outputs("robot_mode") == RUNNING
        assert idle.status.state == "DISABLED"
        assert arm.power_off(timeout=LONG) == "POWER_OFF"
        assert idle.outputs("robot_mode") == POWER_OFF
        assert arm.brake_release(timeout=LONG) == "RUNNING"
        arm.enable(timeout=LONG)


@pytest.mark.slow
@pytest.mark.parametrize("stop", ["hold", "disable"])
def test_no_brakes_are_released_after_a_stop_that_came_while_the_power_did(stop):
    with (
        brisk_sim(model="ur5e", powered_on=False, power_seconds=4.0) as sim,
        driver_at(sim) as idle,
    ):
        asked = idle.engine.request("brake_release")
        idle.until_outputs(robot_mode=(4,))
        getattr(idle.arm, stop)()
        with pytest.raises(TransitionFailed, match="brake_release was broken off"):
            asked.wait(LONG)
        idle.until_outputs(robot_mode=(IDLE,) if stop == "hold" else (POWER_OFF,))
        assert idle.watch(0.5) < 1e-3
        assert idle.outputs("robot_mode") in (POWER_OFF, IDLE)
        assert idle.status.state == "DISABLED"
        idle.arm.enable(timeout=LONG)


def test_power_off_is_refused_while_the_arm_is_under_control(bench):
    with bench.nothing_moves():
        refused(bench.arm.power_off, Reason.INVALID_TRANSITION, "disable")
    assert bench.outputs("robot_mode") == RUNNING
    assert bench.status.state == "ENABLED"


def test_power_off_is_refused_while_the_arm_is_being_enabled(idle):
    idle.arm.state_command("enable", timeout=0)
    idle.until_outputs(robot_mode=(4, IDLE, RUNNING))
    refused(idle.arm.power_off, Reason.INVALID_TRANSITION, "taking it")
    idle.until_state("ENABLED")


def test_a_protective_stop_is_unlocked_without_enabling_after_the_five_seconds_of_a_controller():
    with ur_bench(lock_seconds=5.0) as bench, patch.object(robot, "UNLOCK_AFTER", UNLOCK_AFTER):
        bench.enable()
        refused(bench.arm.unlock_protective_stop, Reason.INVALID_TRANSITION, "NORMAL")
        bench.sim.control.inject("protective_stop")
        bench.until_state("FAULT", "protective stop")
        assert bench.arm.safety_mode(timeout=LONG) == "PROTECTIVE_STOP"
        with bench.nothing_moves():
            assert "NORMAL" in bench.arm.unlock_protective_stop(timeout=LONG)
        assert bench.outputs("safety_mode") == NORMAL
        assert bench.status.state == "FAULT"
        bench.arm.enable(timeout=LONG)


def test_the_safety_system_is_restarted_after_a_violation_only(bench):
    refused(bench.arm.restart_safety, Reason.INVALID_TRANSITION, "NORMAL")
    bench.sim.control.inject("violation")
    bench.until_state("FAULT", "violation")
    with pytest.raises(DeviceFault, match="violation"):
        bench.arm.power_on(timeout=LONG)
    assert "NORMAL" in bench.arm.restart_safety(timeout=LONG)
    assert bench.outputs("safety_mode") == NORMAL
    bench.arm.enable(timeout=LONG)


def test_in_an_emergency_stop_no_power_comes_on(idle):
    idle.inject("emergency_stop")
    idle.until_outputs(safety_mode=(7,))
    idle.cycles(2)  # the first of these may have been on its way
    for service in ("power_on", "brake_release"):
        with pytest.raises(DeviceFault, match="emergency stop"):
            getattr(idle.arm, service)(timeout=LONG)
    assert idle.outputs("robot_mode") == POWER_OFF


def test_popups_are_closed(bench):
    assert bench.arm.close_popup(timeout=LONG) == "closed"
    assert bench.arm.close_safety_popup(timeout=LONG) == "closed"
    assert "close popup" in str(bench.sim.control.status())


def test_answers(bench):
    assert bench.arm.robot_mode(timeout=LONG) == "RUNNING"
    assert bench.arm.safety_mode(timeout=LONG) == "NORMAL"
    assert bench.arm.program_state(timeout=LONG).startswith("PLAYING")
    assert "rogram" in bench.arm.loaded_program(timeout=LONG)


def test_the_teach_pendant_keeps_control(idle):
    idle.inject("local_control")
    for service in ("power_on", "brake_release", "power_off", "close_popup"):
        refused(getattr(idle.arm, service), Reason.LOCAL_CONTROL, "teach pendant")
    assert idle.outputs("robot_mode") == POWER_OFF
    assert idle.arm.robot_mode(timeout=LONG) == "POWER_OFF"


def test_a_service_and_a_transition_get_their_own_answers(idle):
    """Both wait for the control process at the same time."""
    idle.arm.state_command("enable", timeout=0)
    answers = []
    while not idle.engine.transition_ended:
        answers.append(idle.arm.program_state(timeout=LONG))
    assert answers
    assert all(answer.split()[0] in ("STOPPED", "PLAYING") for answer in answers)
    idle.until_state("ENABLED")


# The force sensor


def test_zeroing_takes_the_load_off(bench):
    bench.inject("external_force", wrench=[10.0, 0.0, 30.0, 0.0, 0.0, 0.0])
    eventually(lambda: abs(bench.arm.measured_cf().force[2] - 30.0) < 1.0, "the load is measured")
    with bench.nothing_moves():
        answer = bench.arm.zero_force_sensor(timeout=LONG)
    assert "30.00" in answer
    assert abs(bench.arm.measured_cf().force).max() < 0.1
    bench.sim.control.clear("external_force")
    eventually(lambda: bench.arm.measured_cf().force[2] < -29.0, "it was taken for zero")
    bench.arm.zero_force_sensor(timeout=LONG)


def test_a_load_that_changes_meanwhile_is_found_out(bench, monkeypatch):
    ask = bench.device._link.ask

    def ask_and_push(name, **arguments):
        answer = yield from ask(name, **arguments)
        torque = 4.0  # which stops no arm, as a force would
        bench.sim.control.inject("external_force", wrench=[0.0] * 5 + [torque])
        return answer

    monkeypatch.setattr(bench.device._link, "ask", ask_and_push)
    with pytest.raises(TransitionFailed, match="measures"):
        bench.arm.zero_force_sensor(timeout=LONG)
    monkeypatch.undo()
    bench.sim.control.clear("external_force")
    bench.arm.zero_force_sensor(timeout=LONG)


def test_zeroing_is_refused_while_the_arm_moves_or_is_not_under_control(bench):
    bench.arm.move_jp(FAR)
    bench.until_moving()
    refused(bench.arm.zero_force_sensor, Reason.INVALID_TRANSITION, "moves")
    bench.arm.hold()
    bench.until_still()
    bench.arm.pause(timeout=LONG)
    refused(bench.arm.zero_force_sensor, Reason.NOT_ENABLED, "enable")


def test_a_cb3_arm_has_no_force_sensor():
    with ur_bench(model="ur5", version="3.15.8") as bench:
        refused(bench.arm.zero_force_sensor, Reason.UNSUPPORTED, "no force sensor")
        assert bench.arm.program_state(timeout=LONG)


def test_a_dashboard_that_is_silent_does_not_disturb_the_stream(bench, monkeypatch):
    bench.inject("silence", port="dashboard")
    soon = dashboard.REQUESTS["loaded_program"]._replace(timeout=1.0)
    monkeypatch.setattr(dashboard, "REQUESTS", {**dashboard.REQUESTS, "loaded_program": soon})
    try:
        began = bench.engine.health().samples
        with pytest.raises(TransitionFailed):
            bench.arm.loaded_program(timeout=LONG)
        eventually(lambda: bench.engine.health().samples > began + 100, "samples flow")
        assert bench.status.state == "ENABLED"
    finally:
        bench.sim.control.clear()
