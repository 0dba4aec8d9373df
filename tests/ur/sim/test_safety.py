"""Power, safety and program states of the simulated UR."""

from __future__ import annotations

import pytest

from crtk_sim_backends.ur.messages import ErrorMessage, KeyMessage, SafetyModeMessage, TextMessage
from crtk_sim_backends.ur.program.programs import ProgramError
from crtk_sim_backends.ur.safety.modes import (
    SAFETY_RULES,
    JointMode,
    ProgramRule,
    RobotMode,
    RuntimeState,
    SafetyMode,
    gravest,
)
from rigs.ur_controller import Bench, apart

FOREVER = "while True:\n sync()\nend"
SPINNING = "while True:\n speedj([0.5, 0, 0, 0, 0, 0], 2, 0.002)\nend"


@pytest.fixture
def bench() -> Bench:
    return Bench()


def modes_passed(bench: Bench, goal: RobotMode) -> list[int]:
    passed: list[int] = []
    while bench.controller.robot_mode != goal:
        bench.ticks(1)
        assert bench.controller.time < 10
        if not passed or passed[-1] != bench["robot_mode"]:
            passed.append(bench["robot_mode"])
    return passed


def moving(bench: Bench) -> None:
    bench.start(SPINNING)
    bench.seconds(0.5)
    assert bench["target_qd"][0] == pytest.approx(0.5)


def test_power_on_and_brake_release_pass_their_stages() -> None:
    bench = Bench(powered_on=False)
    assert bench["robot_mode"] == RobotMode.POWER_OFF
    assert bench["robot_status_bits"] == 0
    assert bench.controller.power_on()
    assert modes_passed(bench, RobotMode.IDLE) == [3, 4, 5]
    assert bench["joint_mode"] == (JointMode.IDLE,) * 6
    assert bench["robot_status_bits"] == 1
    assert bench.controller.brake_release()
    assert modes_passed(bench, RobotMode.RUNNING) == [5, 7]
    assert bench["joint_mode"] == (JointMode.RUNNING,) * 6


def test_brake_release_powers_the_arm_first() -> None:
    bench = Bench(powered_on=False)
    assert bench.controller.brake_release()
    assert modes_passed(bench, RobotMode.RUNNING) == [3, 4, 5, 7]


@pytest.mark.parametrize("seconds", [0.8, 3.0])
def test_power_takes_its_time(seconds: float) -> None:
    bench = Bench(powered_on=False, power_seconds=seconds)
    bench.controller.brake_release()
    bench.seconds(seconds - 0.02)
    assert bench["robot_mode"] == RobotMode.IDLE
    bench.seconds(0.04)
    assert bench["robot_mode"] == RobotMode.RUNNING


def test_a_protective_stop_is_locked_for_as_long_as_it_is_told() -> None:
    bench = Bench(lock_seconds=1.0)
    bench.controller.protective_stop()
    bench.seconds(0.99)
    assert not bench.controller.unlock_protective_stop()
    bench.seconds(0.02)
    assert bench.controller.unlock_protective_stop()


def test_brake_release_during_power_on_goes_all_the_way() -> None:
    bench = Bench(powered_on=False)
    bench.controller.power_on()
    bench.seconds(0.3)
    bench.controller.brake_release()
    assert modes_passed(bench, RobotMode.RUNNING)[-1] == RobotMode.RUNNING


def test_power_off_ends_the_program_and_brakes(bench: Bench) -> None:
    moving(bench)
    assert bench.controller.power_off()
    assert bench.controller.runtime_state == RuntimeState.STOPPING
    bench.seconds(0.5)
    assert bench["robot_mode"] == RobotMode.POWER_OFF
    assert bench["actual_robot_voltage"] == 0.0
    assert bench["target_moment"] == (0.0,) * 6
    assert bench["actual_qd"] == (0.0,) * 6


def test_a_program_does_not_start_without_power() -> None:
    bench = Bench(powered_on=False)
    bench.start(FOREVER)
    assert bench.controller.runtime_state == RuntimeState.STOPPED
    assert "POWER_OFF" in bench.of_type(ErrorMessage)[0].text


def test_protective_stop_stops_within_its_deceleration_and_ends_the_program(bench: Bench) -> None:
    moving(bench)
    bench.controller.protective_stop()
    assert bench.controller.runtime_state == RuntimeState.STOPPING
    bench.ticks(1)
    assert bench["safety_mode"] == 3
    assert bench["safety_status_bits"] == 1 << 2 | 1 << 10
    assert 0.4 < bench["target_qd"][0] < 0.5  # never at once
    bench.seconds(0.1)
    assert bench["target_qd"] == (0.0,) * 6
    assert bench["runtime_state"] == RuntimeState.STOPPED
    assert bench["robot_mode"] == RobotMode.RUNNING
    assert [m.code for m in bench.of_type(ErrorMessage)] == [158]
    assert [m.mode for m in bench.of_type(SafetyModeMessage)] == [3]


def test_protective_stop_is_locked_for_five_seconds(bench: Bench) -> None:
    bench.controller.protective_stop()
    bench.seconds(4.99)
    assert not bench.controller.unlock_protective_stop()
    assert bench["safety_mode"] == 3
    bench.seconds(0.02)
    assert bench.controller.unlock_protective_stop()
    bench.ticks(1)
    assert bench["safety_mode"] == 1
    bench.start(FOREVER)
    assert bench.controller.runtime_state == RuntimeState.PLAYING


def test_a_script_port_unlocks_a_protective_stop_at_once(bench: Bench) -> None:
    """As the tests of UR's client library do, which wait for the dashboard's five seconds alone."""
    bench.controller.protective_stop()
    bench.seconds(0.2)
    assert not bench.controller.unlock_protective_stop()
    bench.controller.run_script("set unlock protective stop\n")
    bench.ticks(1)
    assert bench["safety_mode"] == 1
    assert [m.mode for m in bench.of_type(SafetyModeMessage)] == [3, 1]


def test_a_program_is_refused_in_a_protective_stop(bench: Bench) -> None:
    bench.controller.protective_stop()
    bench.start(FOREVER)
    assert bench.controller.runtime_state == RuntimeState.STOPPED
    assert "PROTECTIVE_STOP" in bench.of_type(ErrorMessage)[-1].text


def test_emergency_stop_while_the_arm_is_powered_up_ends_that() -> None:
    bench = Bench(powered_on=False)
    assert bench.controller.brake_release()
    bench.ticks(1)
    assert bench["robot_mode"] == RobotMode.POWER_OFF
    bench.controller.emergency_stop()
    bench.controller.release_emergency_stop()
    bench.seconds(2.0)
    assert bench["robot_mode"] == RobotMode.POWER_OFF
    assert bench["safety_mode"] == 1
    assert bench.controller.brake_release()
    assert modes_passed(bench, RobotMode.RUNNING)[-1] == RobotMode.RUNNING


def test_emergency_stop_powers_off_and_stays_until_released(bench: Bench) -> None:
    moving(bench)
    bench.controller.emergency_stop()
    bench.seconds(0.5)
    assert bench["safety_mode"] == 7
    assert bench["safety_status_bits"] == 1 << 6 | 1 << 7 | 1 << 10
    assert bench["robot_mode"] == RobotMode.POWER_OFF
    assert not bench.controller.power_on()
    assert not bench.controller.brake_release()
    bench.controller.release_emergency_stop()
    bench.ticks(1)
    assert bench["safety_mode"] == 1
    assert bench["robot_mode"] == RobotMode.POWER_OFF
    assert bench.controller.brake_release()
    assert modes_passed(bench, RobotMode.RUNNING)[-1] == RobotMode.RUNNING


def test_an_emergency_stop_of_a_moment_is_completed_before_power_returns(bench: Bench) -> None:
    moving(bench)
    bench.controller.emergency_stop()
    bench.controller.release_emergency_stop()
    assert not bench.controller.brake_release()
    passed = []
    while bench["robot_mode"] != RobotMode.POWER_OFF or bench["safety_mode"] != 1:
        bench.ticks(1)
        assert bench.controller.time < 2
        state = (bench["safety_mode"], bench["robot_mode"])
        if not passed or passed[-1] != state:
            passed.append(state)
        assert not bench.controller.power_on() or state == (1, RobotMode.POWER_OFF)
    # The mode is NORMAL again only when the power is off.
    assert passed == [(7, RobotMode.RUNNING), (1, RobotMode.POWER_OFF)]
    assert bench["target_qd"] == (0.0,) * 6
    assert modes_passed(bench, RobotMode.IDLE)[-1] == RobotMode.IDLE


def test_power_on_is_refused_while_the_power_is_being_cut(bench: Bench) -> None:
    bench.controller.power_off()
    assert not bench.controller.power_on()
    bench.seconds(0.3)
    assert bench.controller.power_on()


def test_safeguard_stop_pauses_and_play_resumes(bench: Bench) -> None:
    moving(bench)
    bench.controller.safeguard_stop(True)
    bench.seconds(0.5)
    assert bench["safety_mode"] == 5
    assert bench["runtime_state"] == RuntimeState.PAUSED
    assert bench["target_qd"] == (0.0,) * 6
    assert not bench.controller.play()
    bench.controller.safeguard_stop(False)
    bench.seconds(0.5)
    assert bench["runtime_state"] == RuntimeState.PAUSED
    assert bench.controller.play()
    bench.seconds(0.5)
    assert bench["runtime_state"] == RuntimeState.PLAYING
    assert bench["target_qd"][0] == pytest.approx(0.5)


@pytest.mark.parametrize(("event", "mode", "bit"), [("violation", 8, 8), ("fault", 9, 9)])
def test_violation_and_fault_need_a_safety_restart(
    bench: Bench, event: str, mode: int, bit: int
) -> None:
    getattr(bench.controller, event)()
    bench.seconds(0.5)
    assert bench["safety_mode"] == mode
    assert bench["safety_status_bits"] == 1 << bit | 1 << 10
    assert bench["robot_mode"] == RobotMode.POWER_OFF
    assert not bench.controller.power_on()
    assert bench.controller.restart_safety()
    bench.ticks(1)
    assert bench["safety_mode"] == 1
    assert bench.controller.power_on()


def test_reduced_mode_slows_the_program_down(bench: Bench) -> None:
    moving(bench)
    bench.controller.reduced_mode(True)
    bench.seconds(0.5)
    assert bench["safety_mode"] == 2
    assert bench["target_qd"][0] == pytest.approx(0.25)
    bench.controller.reduced_mode(False)
    bench.seconds(0.5)
    assert bench["target_qd"][0] == pytest.approx(0.5)


def test_power_loss_brakes_without_notice(bench: Bench) -> None:
    moving(bench)
    bench.controller.power_loss()
    bench.ticks(1)
    assert bench["robot_mode"] == RobotMode.POWER_OFF
    assert bench["robot_status_bits"] == 0
    bench.seconds(0.3)
    assert bench["actual_qd"] == (0.0,) * 6
    assert bench["actual_q"] == bench["target_q"]


def test_frozen_joint_ends_in_a_protective_stop_and_no_jump_follows(bench: Bench) -> None:
    moving(bench)
    bench.controller.freeze_joint(0)
    bench.until(lambda: bench.controller.safety_mode == SafetyMode.PROTECTIVE_STOP)
    assert [(m.code, m.argument) for m in bench.of_type(ErrorMessage)] == [(153, 0)]
    bench.seconds(5.1)
    where = bench["actual_q"]
    bench.controller.freeze_joint(0, on=False)
    assert bench.controller.unlock_protective_stop()
    bench.seconds(0.5)
    assert bench["actual_q"] == where == bench["target_q"]


def test_the_gravest_cause_shows(bench: Bench) -> None:
    bench.controller.safeguard_stop(True)
    bench.controller.emergency_stop()
    assert bench.controller.safety_mode == SafetyMode.ROBOT_EMERGENCY_STOP
    bench.controller.release_emergency_stop()
    bench.seconds(0.3)
    assert bench.controller.safety_mode == SafetyMode.SAFEGUARD_STOP
    assert gravest({SafetyMode.REDUCED, SafetyMode.FAULT}) == SafetyMode.FAULT
    assert gravest(set()) == SafetyMode.NORMAL


def test_every_safety_mode_that_stops_says_so_in_its_bits() -> None:
    for mode, rule in SAFETY_RULES.items():
        stops = rule.program is not ProgramRule.RUN and mode != SafetyMode.RECOVERY
        assert bool(rule.bits & 1 << 10) == stops, mode


def test_the_system_emergency_stop_has_a_mode_of_its_own(bench: Bench) -> None:
    bench.controller.emergency_stop(SafetyMode.SYSTEM_EMERGENCY_STOP)
    bench.seconds(0.5)
    assert bench["safety_mode"] == 6
    assert bench["safety_status_bits"] == 1 << 5 | 1 << 7 | 1 << 10
    bench.controller.emergency_stop()
    bench.controller.release_emergency_stop(SafetyMode.SYSTEM_EMERGENCY_STOP)
    bench.seconds(0.5)
    assert bench["safety_mode"] == 7
    bench.controller.release_emergency_stop()
    bench.ticks(1)
    assert bench["safety_mode"] == 1


def test_recovery_stops_the_program_and_keeps_power(bench: Bench) -> None:
    moving(bench)
    bench.controller.recovery_mode(True)
    bench.seconds(0.5)
    assert (bench["safety_mode"], bench["robot_mode"]) == (4, RobotMode.RUNNING)
    assert bench["runtime_state"] == RuntimeState.STOPPED
    bench.start(FOREVER)
    assert bench.controller.runtime_state == RuntimeState.STOPPED
    bench.controller.recovery_mode(False)
    bench.start(FOREVER)
    assert bench.controller.runtime_state == RuntimeState.PLAYING


def test_the_automatic_safeguard_counts_in_automatic_mode_alone(bench: Bench) -> None:
    bench.controller.automatic_safeguard_stop(True)
    assert bench.controller.safety_mode == SafetyMode.NORMAL
    bench.controller.set_operational_mode("AUTOMATIC")
    assert bench.controller.safety_mode == SafetyMode.AUTOMATIC_MODE_SAFEGUARD_STOP
    bench.controller.set_operational_mode("MANUAL")
    assert bench.controller.safety_mode == SafetyMode.NORMAL


def test_the_enabling_device_counts_in_manual_mode_alone(bench: Bench) -> None:
    bench.controller.hold_enabling_device(False)
    assert bench.controller.safety_mode == SafetyMode.NORMAL
    bench.controller.set_operational_mode("MANUAL")
    assert bench.controller.safety_mode == SafetyMode.SYSTEM_THREE_POSITION_ENABLING_STOP
    bench.ticks(1)
    assert bench["safety_status_bits"] == 1 << 11 | 1 << 10
    bench.controller.hold_enabling_device(True)
    assert bench.controller.safety_mode == SafetyMode.NORMAL


def test_manual_mode_takes_remote_control_away_and_gives_it_back(bench: Bench) -> None:
    moving(bench)
    assert bench.controller.set_operational_mode("MANUAL")
    assert not bench.controller.remote
    assert bench.controller.runtime_state == RuntimeState.STOPPING
    bench.controller.set_operational_mode("AUTOMATIC")
    assert bench.controller.remote
    assert not bench.controller.set_operational_mode("other")


@pytest.mark.parametrize("remote", [True, False])
@pytest.mark.parametrize(
    ("modes", "shown", "manual"),
    [
        ((), "NONE", False),
        (("NONE",), "NONE", False),
        (("AUTOMATIC",), "AUTOMATIC", False),
        (("AUTOMATIC", "NONE"), "NONE", False),
        (("MANUAL",), "MANUAL", True),
        (("MANUAL", "NONE"), "NONE", True),
        (("MANUAL", "NONE", "AUTOMATIC", "NONE"), "NONE", False),
        (("AUTOMATIC", "MANUAL", "NONE"), "NONE", True),
    ],
)
def test_a_robot_stays_in_the_mode_in_which_clients_leave_it(
    modes: tuple[str, ...], shown: str, manual: bool, remote: bool
) -> None:
    bench = Bench(remote=remote)
    for mode in modes:
        assert bench.controller.set_operational_mode(mode)
    assert bench.controller.operational_mode == shown
    assert bench.controller.remote == (remote and not manual)
    bench.controller.hold_enabling_device(False)
    assert (bench.controller.safety_mode != SafetyMode.NORMAL) == manual


def test_boot_takes_its_time_and_commands_have_to_wait() -> None:
    bench = Bench(powered_on=False, boot_seconds=1.0)
    assert bench["robot_mode"] == RobotMode.DISCONNECTED
    assert not bench.controller.power_on()
    assert modes_passed(bench, RobotMode.POWER_OFF) == [0, 2, 3]
    assert bench.controller.time == pytest.approx(1.0, abs=0.01)
    assert bench.controller.power_on()
    assert modes_passed(bench, RobotMode.IDLE) == [3, 4, 5]


def test_boot_ends_where_the_arm_was_left() -> None:
    bench = Bench(boot_seconds=0.5)
    assert modes_passed(bench, RobotMode.RUNNING) == [0, 2, 3, 4, 5, 7]


def test_key_messages_frame_a_program(bench: Bench) -> None:
    bench.start("sleep(0.01)", name="brief")
    bench.seconds(0.05)
    assert bench.of_type(KeyMessage) == [
        KeyMessage("PROGRAM_XXX_STARTED", "brief"),
        KeyMessage("PROGRAM_XXX_STOPPED", "brief"),
    ]


def test_a_new_program_replaces_the_running_one(bench: Bench) -> None:
    bench.start(FOREVER, name="first")
    bench.start(FOREVER, name="second")
    bench.ticks(1)
    assert bench.controller.outputs["runtime_state"] == RuntimeState.STOPPED, "its end is seen"
    bench.ticks(1)
    assert bench.controller.outputs["runtime_state"] == RuntimeState.PLAYING
    assert [m.text for m in bench.of_type(KeyMessage)] == ["first", "first", "second"]
    assert bench.controller.program_name == "second"


@pytest.mark.parametrize(("model", "accepted"), [("ur5e", False), ("ur5", True)])
def test_local_control_refuses_scripts_on_e_series_alone(model: str, accepted: bool) -> None:
    bench = Bench(model, remote=False)
    bench.start(FOREVER)
    assert (bench.controller.runtime_state == RuntimeState.PLAYING) == accepted
    assert [m.code for m in bench.of_type(ErrorMessage)] == ([] if accepted else [210])
    bench.controller.set_remote(True)
    bench.start(FOREVER)
    bench.ticks(2)
    assert bench.controller.runtime_state == RuntimeState.PLAYING


def test_switching_to_local_control_stops_what_remote_clients_run(bench: Bench) -> None:
    moving(bench)
    bench.controller.run_script("sec beside():\nwhile True:\ntextmsg(1)\nsync()\nend\nend\n")
    bench.ticks(2)
    bench.controller.set_remote(False)
    assert bench.controller.runtime_state == RuntimeState.STOPPING
    bench.messages.clear()
    bench.seconds(0.3)
    assert bench.controller.runtime_state == RuntimeState.STOPPED
    assert bench["target_qd"] == (0.0,) * 6
    assert not bench.of_type(TextMessage)
    bench.controller.load_program("simulation.urp")
    assert bench.controller.play()  # on the pendant


def test_watchdog_stops_the_program_when_its_input_stays_away(bench: Bench) -> None:
    bench.start(f'rtde_set_watchdog("input_int_register_0", 10, "stop")\n{SPINNING}')
    for _ in range(20):
        bench.seconds(0.05)
        bench.write(input_int_register_0=1)
    assert bench.controller.runtime_state == RuntimeState.PLAYING
    bench.seconds(0.098)
    assert bench.controller.runtime_state == RuntimeState.PLAYING
    bench.seconds(0.006)
    assert bench.controller.runtime_state == RuntimeState.STOPPING
    bench.seconds(0.2)
    assert bench["target_qd"] == (0.0,) * 6


@pytest.mark.parametrize(
    ("action", "state"), [("pause", RuntimeState.PAUSED), ("ignore", RuntimeState.PLAYING)]
)
def test_watchdog_actions(bench: Bench, action: str, state: RuntimeState) -> None:
    bench.start(f'rtde_set_watchdog("input_int_register_0", 10, "{action}")\n{FOREVER}')
    bench.seconds(0.5)
    assert bench.controller.runtime_state == state


@pytest.mark.parametrize(
    ("program", "state"),
    [
        ("ft_rtde_input_enable(True)", RuntimeState.PAUSED),
        ("enable_external_ft_sensor(True)", RuntimeState.PAUSED),
        ("ft_rtde_input_enable(True)\nft_rtde_input_enable(False)", RuntimeState.PLAYING),
        (
            'rtde_set_watchdog("input_int_register_0", 1, "ignore")\nft_rtde_input_enable(True)',
            RuntimeState.PLAYING,
        ),
        (
            'rtde_set_watchdog("external_force_torque", 5, "pause")\nft_rtde_input_enable(False)',
            RuntimeState.PAUSED,
        ),
    ],
)
def test_measured_forces_are_expected_ten_times_a_second_unless_a_program_watches_something(
    bench: Bench, program: str, state: RuntimeState
) -> None:
    """Script manual, ft_rtde_input_enable."""
    bench.start(f"{program}\n{FOREVER}")
    for _ in range(10):
        bench.write(external_force_torque=(0.0,) * 6)
        bench.seconds(0.09)
    assert bench.controller.runtime_state == RuntimeState.PLAYING
    bench.seconds(0.5)
    assert bench.controller.runtime_state == state


def test_a_pause_does_not_count_for_the_watchdog(bench: Bench) -> None:
    bench.start(f'rtde_set_watchdog("input_int_register_0", 2, "stop")\n{FOREVER}')
    bench.controller.pause()
    bench.seconds(0.8)
    bench.controller.play()
    bench.seconds(0.3)
    assert bench.controller.runtime_state == RuntimeState.PLAYING


def test_loaded_program_plays_pauses_and_stops(bench: Bench) -> None:
    c = bench.controller
    assert not c.play()
    with pytest.raises(FileNotFoundError):
        c.load_program("missing.urp")
    c.load_program("simulation.urp")
    assert c.play()
    with pytest.raises(ProgramError, match="simulation runs"):
        c.load_program("simulation.urp")
    assert c.pause()
    bench.seconds(0.3)
    assert c.runtime_state == RuntimeState.PAUSED
    assert c.play()
    bench.seconds(0.3)
    assert c.runtime_state == RuntimeState.PLAYING
    assert c.stop()
    assert c.runtime_state == RuntimeState.STOPPED


def test_stop_in_the_middle_of_a_pause_does_not_speed_up(bench: Bench) -> None:
    moving(bench)
    bench.controller.pause()
    bench.seconds(0.1)
    before = bench["target_qd"]
    assert 0.1 < before[0] < 0.4
    bench.controller.stop()
    bench.ticks(1)
    assert bench["target_qd"][0] <= before[0]
    assert apart(bench["target_qd"], before) < 0.05


@pytest.mark.parametrize(
    ("line", "mode"), [("power off", RobotMode.POWER_OFF), ("stop program", RobotMode.RUNNING)]
)
def test_panel_commands_on_a_script_port(bench: Bench, line: str, mode: RobotMode) -> None:
    bench.start(FOREVER)
    bench.controller.run_script(line + "\n")
    bench.seconds(0.5)
    assert bench.controller.runtime_state == RuntimeState.STOPPED
    assert bench["robot_mode"] == mode
