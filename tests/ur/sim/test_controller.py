"""The simulated UR controller: inputs, outputs, robot built-ins, and ur_rtde's own program."""

from __future__ import annotations

import struct
from math import isfinite
from typing import Any

import pytest

from crtk_sim_backends.ur.messages import (
    KeyMessage,
    PopupMessage,
    RuntimeExceptionMessage,
    TextMessage,
)
from crtk_sim_backends.ur.models import MODELS
from crtk_sim_backends.ur.motion.kinematics import to_transform
from crtk_sim_backends.ur.safety.modes import RuntimeState, SafetyMode
from crtk_sim_backends.ur.signals.variables import INPUTS, OUTPUTS, TYPES
from rigs.ur_controller import Bench, apart

HOME = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)


@pytest.fixture
def bench() -> Bench:
    return Bench()


def said(bench: Bench, body: str) -> list[str]:
    """Run a program; what it wrote with textmsg. Fails when it stopped with an error."""
    bench.run(body)
    assert not bench.of_type(RuntimeExceptionMessage)
    return [message.text for message in bench.of_type(TextMessage)]


def numbers(text: str) -> list[float]:
    return [float(x) for x in text.strip("p[]").split(",")]


# Process image.


def test_outputs_are_the_rtde_variables_and_fit_their_types(bench: Bench) -> None:
    bench.controller.external_force([5, 0, 0, 0, 0, 1])
    bench.start("set_payload(1.5, [0, 0, 0.1])\nwhile True:\n speedj([0.1,0,0,0,0,0], 1)\nend")
    bench.seconds(0.1)
    assert bench.controller.outputs.keys() == OUTPUTS.keys()
    assert bench.controller.inputs.keys() == INPUTS.keys()
    for name, variable in OUTPUTS.items():
        wire = TYPES[variable.type]
        value = bench[name]
        items = (value,) if wire.count == 1 else value
        struct.pack(f">{wire.format}", *items)
        assert all(isfinite(x) for x in items), name


@pytest.mark.parametrize("name", sorted(MODELS))
def test_every_model_moves_and_reports(name: str) -> None:
    bench = Bench(name)
    assert said(bench, "movej([0.2, -1.4, 1.4, -1.5, -1.5, 0.1], v=1)\ntextmsg(get_steptime())")
    bench.seconds(0.2)
    assert bench["actual_q"] == (0.2, -1.4, 1.4, -1.5, -1.5, 0.1)
    assert bench["timestamp"] == pytest.approx(bench.controller.tick_count / MODELS[name].frequency)
    assert [m.text for m in bench.of_type(TextMessage)] == [f"{1 / MODELS[name].frequency:g}"]


def test_torques_hold_the_arm_against_gravity(bench: Bench) -> None:
    bench.ticks(1)
    moment = bench["target_moment"]
    assert moment[0] == pytest.approx(0.0, abs=1e-9)  # the base axis is vertical
    assert 10.0 < abs(moment[1]) < 150.0
    assert bench["actual_current"][1] == pytest.approx(moment[1] / 12.0)
    said(bench, "set_payload(5, [0, 0, 0.1])")
    assert abs(bench["target_moment"][1]) > abs(moment[1]) + 5.0
    said(bench, "set_gravity([0, 0, 0])")
    assert bench["target_moment"] == (0.0,) * 6


def test_target_and_actual_differ_while_moving_only(bench: Bench) -> None:
    bench.start("movej([0.5, -1.57, 1.57, -1.57, -1.57, 0.0], v=0.5)")
    bench.seconds(0.5)
    assert 1e-4 < apart(bench["target_q"], bench["actual_q"]) < 0.02
    assert bench["actual_TCP_speed"] != (0.0,) * 6
    bench.until(lambda: bench.controller.runtime_state == RuntimeState.STOPPED)
    bench.seconds(0.2)
    for kind in ("q", "qd", "TCP_pose", "TCP_speed"):
        assert bench[f"target_{kind}"] == bench[f"actual_{kind}"]
    assert bench["target_qdd"] == (0.0,) * 6


def test_time_is_virtual_and_a_tick_is_a_function_of_the_state() -> None:
    traces = []
    for _ in range(2):
        bench = Bench()
        bench.start("movel(pose_add(get_target_tcp_pose(), p[0,0,0.05,0,0,0]))")
        bench.seconds(0.5)
        traces.append(dict(bench.controller.outputs))
    assert traces[0] == traces[1]


# Inputs.


def test_input_registers_reach_programs_and_read_back(bench: Bench) -> None:
    bench.write(input_int_register_7=-42, input_double_register_31=2.5, input_bit_register_70=True)
    assert bench["input_int_register_7"] == -42
    texts = said(
        bench,
        "textmsg(read_input_integer_register(7))\ntextmsg(read_input_float_register(31))\n"
        "textmsg(read_input_boolean_register(70))\ntextmsg(read_input_boolean_register(3))",
    )
    assert texts == ["-42", "2.5", "True", "False"]


def test_output_registers_show_what_programs_write(bench: Bench) -> None:
    said(
        bench,
        "write_output_integer_register(12, 99)\nwrite_output_float_register(47, 0.25)\n"
        "write_output_boolean_register(33, True)\nwrite_output_boolean_register(127, True)",
    )
    assert bench["output_int_register_12"] == 99
    assert bench["output_double_register_47"] == 0.25
    assert bench["output_bit_registers32_to_63"] == 2
    assert bench["output_bit_register_127"] is True


@pytest.mark.parametrize(
    "call",
    [
        "read_input_float_register(48)",
        "read_input_integer_register(-1)",
        "write_output_integer_register(0, 3000000000)",
        "set_tcp([1, 2])",
        "set_payload(-1)",
        "set_standard_digital_out(8, True)",
        "set_tool_voltage(48)",
        "get_inverse_kin(p[5, 5, 5, 0, 0, 0])",
        "set_payload(1e7)",
        "set_payload(1, [1e300, 0, 0])",
        "set_tcp(p[1e300, 0, 0, 0, 0, 0])",
        'rtde_set_watchdog("no_such_register", 10)',
        "get_actual_joint_positions_history(100000)",
        "force_mode(p[0,0,0,0,0,0], [1,1], [0,0,0,0,0,0], 2, [1,1,1,1,1,1])",
    ],
)
def test_wrong_arguments_are_runtime_errors(bench: Bench, call: str) -> None:
    bench.start(f"\n{call}\nsync()")
    bench.ticks(2)
    assert bench.controller.runtime_state == RuntimeState.STOPPED
    error = bench.of_type(RuntimeExceptionMessage)[0]
    assert error.line == 3
    assert error.text


def test_a_script_that_does_not_compile_is_a_message(bench: Bench) -> None:
    bench.start("calldoesntexist()")
    error = bench.of_type(RuntimeExceptionMessage)[0]
    assert (error.line, error.text) == (2, "compile_error_name_not_found:calldoesntexist:")
    assert bench.controller.runtime_state == RuntimeState.STOPPED


def test_digital_and_analog_outputs_from_rtde_and_programs(bench: Bench) -> None:
    bench.write(standard_digital_output_mask=0b11, standard_digital_output=0b01)
    bench.write(configurable_digital_output_mask=1, configurable_digital_output=1)
    bench.write(tool_digital_output_mask=2, tool_digital_output=2)
    assert bench["actual_digital_output_bits"] == 1 | 1 << 8 | 2 << 16
    said(bench, "set_standard_digital_out(0, False)\nset_standard_digital_out(7, True)")
    assert bench["actual_digital_output_bits"] == 1 << 7 | 1 << 8 | 2 << 16
    bench.write(
        standard_analog_output_mask=3,
        standard_analog_output_type=2,
        standard_analog_output_0=0.5,
        standard_analog_output_1=0.5,
    )
    assert bench["standard_analog_output0"] == pytest.approx(0.012)
    assert bench["standard_analog_output1"] == pytest.approx(5.0)


def test_a_mask_of_zero_leaves_the_slider_alone(bench: Bench) -> None:
    bench.write(speed_slider_mask=0, speed_slider_fraction=0.1)
    assert bench["target_speed_fraction"] == 1.0
    bench.write(speed_slider_mask=1, speed_slider_fraction=0.1)
    assert bench["target_speed_fraction"] == 0.1


# Robot built-ins.


def test_getters_agree_with_the_process_image(bench: Bench) -> None:
    texts = said(
        bench,
        "set_tcp(p[0, 0, 0.1, 0, 0, 0])\nsync()\n"
        "textmsg(get_actual_tcp_pose())\ntextmsg(get_actual_joint_positions())\n"
        "textmsg(get_tcp_offset())\ntextmsg(get_forward_kin())\n"
        "textmsg(get_inverse_kin(get_actual_tcp_pose()))\ntextmsg(get_steptime())",
    )
    bench.ticks(1)
    pose, q, tcp, forward, inverse, step = (numbers(text) for text in texts)
    assert apart(pose, bench["actual_TCP_pose"]) < 1e-5
    assert apart(forward, pose) < 1e-5
    assert apart(q, HOME) < 1e-5
    assert apart(inverse, HOME) < 1e-4
    assert tcp == [0, 0, 0.1, 0, 0, 0]
    assert step == [0.002]
    assert bench["tcp_offset"] == (0, 0, 0.1, 0, 0, 0)


def test_tcp_moves_the_pose_along_the_flange(bench: Bench) -> None:
    bench.ticks(1)
    flange = to_transform(bench["actual_TCP_pose"])
    said(bench, "set_tcp(p[0, 0, 0.2, 0, 0, 0])")
    expected = [flange[9 + i] + 0.2 * flange[2 + 3 * i] for i in range(3)]
    assert apart(bench["actual_TCP_pose"][:3], expected) < 1e-9


def test_history_goes_back_step_by_step(bench: Bench) -> None:
    bench.start("while True:\n speedj([0.5, 0, 0, 0, 0, 0], 5, 0.002)\nend")
    bench.seconds(0.5)
    earlier = bench["actual_q"][0]
    bench.ticks(50)
    assert bench.arm.history[-51][0] == pytest.approx(earlier)


def test_limits_of_poses_and_joints(bench: Bench) -> None:
    assert said(
        bench,
        "textmsg(is_within_safety_limits([0,0,0,0,0,0]))\n"
        "textmsg(is_within_safety_limits([7,0,0,0,0,0]))\n"
        "textmsg(is_within_safety_limits(p[3,0,0,0,0,0]))\n"
        "textmsg(get_inverse_kin_has_solution(p[3,0,0,0,0,0]))",
    ) == ["True", "False", "False", "False"]


def test_external_force_shows_in_sensor_and_currents_and_can_be_zeroed(bench: Bench) -> None:
    bench.ticks(1)
    current = bench["actual_current"]
    bench.controller.external_force([0, 0, -20, 0, 0, 0])
    bench.ticks(1)
    assert apart(bench["actual_TCP_force"], (0, 0, -20, 0, 0, 0)) < 1e-9
    assert bench["tcp_force_scalar"] == pytest.approx(20)
    assert apart(bench["ft_raw_wrench"][:3], (0, 0, 20)) < 0.1  # the tool points down
    # The arm points along -x of the base: pushed down, the shoulder carries more.
    assert abs(bench["actual_current"][1]) > abs(current[1]) + 0.1
    said(bench, "zero_ftsensor()")
    assert apart(bench["actual_TCP_force"], (0.0,) * 6) < 1e-9


def test_a_force_at_a_long_tool_is_a_force_without_torque_there(bench: Bench) -> None:
    said(bench, "set_tcp(p[0, 0, 0.3, 0, 0, 0])")
    bench.controller.external_force([10, 0, 0, 0, 0, 0])
    bench.ticks(1)
    assert apart(bench["actual_TCP_force"], (10, 0, 0, 0, 0, 0)) < 1e-9
    assert max(map(abs, bench["ft_raw_wrench"][3:])) == pytest.approx(3.0, abs=0.01)


def test_payload_weight_is_in_the_raw_wrench_only(bench: Bench) -> None:
    said(bench, "set_payload(2.0, [0, 0, 0.05])")
    assert apart(bench["actual_TCP_force"], (0.0,) * 6) < 1e-9
    assert bench["ft_raw_wrench"][2] == pytest.approx(2 * 9.82, abs=0.01)
    assert bench["payload"] == 2.0
    assert bench["payload_cog"] == (0.0, 0.0, 0.05)


def test_rtde_force_input_replaces_the_sensor_once_enabled(bench: Bench) -> None:
    bench.write(external_force_torque=(0.0, 0.0, 7.0, 0.0, 0.0, 0.0))
    bench.ticks(1)
    assert bench["actual_TCP_force"] == (0.0,) * 6
    said(bench, "ft_rtde_input_enable(True)")
    assert bench["ft_raw_wrench"][2] == pytest.approx(7.0)
    assert bench["tcp_force_scalar"] == pytest.approx(7.0)


def test_tool_contact_counts_the_periods_since_the_touch(bench: Bench) -> None:
    bench.start(
        "while tool_contact(direction=[0,0,-1,0,0,0]) == 0:\n sync()\nend\nsleep(0.02)\n"
        "textmsg(tool_contact(direction=[0,0,-1,0,0,0]))\n"
        "textmsg(tool_contact(direction=[0,0,1,0,0,0]))"
    )
    bench.seconds(0.1)
    assert bench.controller.runtime_state == RuntimeState.PLAYING
    bench.controller.external_force([0, 0, 20, 0, 0, 0])
    bench.until(lambda: bench.controller.runtime_state == RuntimeState.STOPPED)
    forward, backward = (int(m.text) for m in bench.of_type(TextMessage))
    assert forward == pytest.approx(11, abs=1)
    assert backward == 0


def test_blocking_popup_waits_until_it_is_closed(bench: Bench) -> None:
    bench.start('popup("hello", "title", blocking=True)\ntextmsg("on")')
    bench.seconds(0.2)
    assert bench.controller.popup_text == "hello"
    assert bench.of_type(PopupMessage) == [PopupMessage("title", "hello", blocking=True)]
    assert not bench.of_type(TextMessage)
    bench.controller.close_popup()
    bench.seconds(0.01)
    assert bench.of_type(TextMessage)


def test_secondary_program_runs_beside_and_must_not_move(bench: Bench) -> None:
    bench.start("while True:\n speedj([0.1, 0, 0, 0, 0, 0], 1, 0.002)\nend")
    bench.seconds(0.1)
    bench.controller.run_script("sec io():\n set_digital_out(1, True)\nend\n")
    bench.ticks(2)
    assert bench["actual_digital_output_bits"] == 2
    assert bench.controller.runtime_state == RuntimeState.PLAYING
    bench.controller.run_script("sec bad():\n movej([0, 0, 0, 0, 0, 0])\nend\n")
    bench.ticks(2)
    refusal = bench.of_type(KeyMessage)[-1]
    assert refusal.title == "SECONDARY_PROGRAM_EXCEPTION_XXX"
    assert "secondary" in refusal.text
    assert bench.controller.runtime_state == RuntimeState.PLAYING
    assert bench["target_qd"][0] == pytest.approx(0.1)


# The program that ur_rtde uploads, driven through the registers as the library does.

READY, DONE = 1, 2


class RtdeControl:
    """ur_rtde's control program on a bench, and its register handshake (lower range)."""

    def __init__(self, model: str = "ur5e", version: tuple[int, int] = (5, 12)) -> None:
        script_client = pytest.importorskip("script_client")
        client = script_client.ScriptClient("127.0.0.1", *version)
        text = client.getScript()
        for offset in ("float", "int"):
            text = text.replace(f"reg_offset_{offset} = #", f"reg_offset_{offset} = 0 #")
        self.bench = Bench(model)
        self.bench.controller.run_script(f"def rtde_control():\n{text}end\n")
        self.wait(READY)

    @property
    def status(self) -> int:
        return int(self.bench["output_int_register_0"])

    def wait(self, status: int, seconds: float = 20.0) -> None:
        def arrived() -> bool:
            assert not self.bench.of_type(RuntimeExceptionMessage)
            return self.status == status

        self.bench.until(arrived, seconds)

    def send(self, command: int, *values: float, **registers: Any) -> None:
        doubles = {f"input_double_register_{i}": float(v) for i, v in enumerate(values)}
        self.bench.write(input_int_register_0=command, **doubles, **registers)

    def call(self, command: int, *values: float, **registers: Any) -> None:
        self.wait(READY)
        self.send(command, *values, **registers)
        self.wait(DONE)
        self.send(0)
        self.wait(READY)

    def stream(self, seconds: float, command: int, *values: float) -> None:
        for _ in range(round(seconds / self.bench.controller.dt)):
            self.send(command, *values)
            self.bench.ticks(1)

    def result(self, count: int) -> list[float]:
        return [self.bench[f"output_double_register_{i}"] for i in range(count)]


@pytest.fixture
def control() -> RtdeControl:
    return RtdeControl()


GOAL = (0.3, -1.2, 1.4, -1.6, -1.5, 0.2)


@pytest.mark.parametrize(
    ("model", "version"), [("ur5e", (5, 12)), ("ur5", (3, 15)), ("ur20", (5, 23))]
)
def test_ur_rtde_move_j_arrives_exactly(model: str, version: tuple[int, int]) -> None:
    control = RtdeControl(model, version)
    control.call(1, *GOAL, 1.05, 1.4, input_int_register_1=0)
    control.bench.seconds(0.2)
    assert control.bench["actual_q"] == GOAL


def test_ur_rtde_asynchronous_move_reports_its_progress(control: RtdeControl) -> None:
    control.call(1, *GOAL, 1.05, 1.4, input_int_register_1=1)
    status = control.bench["output_int_register_2"]
    assert status >> 15 & 1  # running
    control.bench.until(lambda: not control.bench["output_int_register_2"] >> 15 & 1)
    control.bench.seconds(0.2)
    assert control.bench["actual_q"] == GOAL
    control.call(47)
    assert control.bench["output_int_register_1"] in (0, 1)


def test_ur_rtde_asynchronous_move_can_be_stopped(control: RtdeControl) -> None:
    control.call(1, *GOAL, 0.5, 1.4, input_int_register_1=1)
    control.bench.seconds(0.5)
    control.call(34, 2.0, input_int_register_1=0)
    assert control.bench["target_qd"] == (0.0,) * 6
    assert control.bench["target_q"] != GOAL
    assert control.bench.controller.runtime_state == RuntimeState.PLAYING


def test_ur_rtde_move_l_arrives_exactly(control: RtdeControl) -> None:
    control.bench.ticks(1)
    pose = list(control.bench["actual_TCP_pose"])
    pose[2] += 0.1
    control.call(3, *pose, 0.25, 1.2, input_int_register_1=0)
    control.bench.seconds(0.2)
    assert apart(control.bench["actual_TCP_pose"], pose) < 1e-9


def test_ur_rtde_servo_j_arrives_and_stops(control: RtdeControl) -> None:
    goal = [q + 0.05 for q in HOME]
    control.stream(2.5, 11, *goal, 0.0, 0.0, 0.002, 0.1, 300.0)
    assert list(control.bench["actual_q"]) == goal
    control.call(16, 10.0)
    assert control.bench["target_qd"] == (0.0,) * 6
    assert control.bench.controller.runtime_state == RuntimeState.PLAYING


def test_ur_rtde_speed_j_and_its_stop(control: RtdeControl) -> None:
    control.stream(0.5, 9, 0.2, 0, 0, 0, 0, 0, 1.4, 0.0)
    assert control.bench["target_qd"][0] == pytest.approx(0.2)
    control.call(15, 10.0)
    assert control.bench["target_qd"] == (0.0,) * 6
    control.bench.seconds(1.0)
    control.call(47)
    assert control.bench["output_int_register_1"] == 1


def test_ur_rtde_speed_l(control: RtdeControl) -> None:
    control.stream(0.5, 10, 0, 0, 0.05, 0, 0, 0, 0.5, 0.0)
    assert apart(control.bench["target_TCP_speed"], (0, 0, 0.05, 0, 0, 0)) < 1e-3
    control.call(15, 10.0)


def test_ur_rtde_force_mode_and_freedrive(control: RtdeControl) -> None:
    control.send(
        6,
        *(0, 0, 0, 0, 0, 0),
        *(0, 0, -10, 0, 0, 0),
        *(0.1, 0.1, 0.05, 0.3, 0.3, 0.3),
        input_int_register_1=2,
        **{f"input_int_register_{2 + i}": int(i == 2) for i in range(6)},
    )
    control.bench.seconds(0.5)
    assert control.bench["actual_TCP_speed"][2] < -0.02
    control.send(0)
    control.call(7)
    control.bench.seconds(0.5)
    assert control.bench["actual_TCP_speed"] == (0.0,) * 6
    control.call(18)
    assert control.bench.controller.plant.compliance.freedrive
    control.call(19)
    assert not control.bench.controller.plant.compliance.freedrive


def test_ur_rtde_kinematics_and_tool(control: RtdeControl) -> None:
    control.call(29, 0, 0, 0.1, 0, 0, 0)
    control.call(40)
    assert control.result(6) == [0, 0, 0.1, 0, 0, 0]
    control.call(43)
    assert apart(control.result(6), control.bench["actual_TCP_pose"]) < 1e-9
    control.call(46, *control.bench["actual_TCP_pose"])
    assert apart(control.result(6), HOME) < 1e-6
    control.call(17, 1.5, 0.0, 0.0, 0.05)
    assert (control.bench["payload"], control.bench["payload_cog"]) == (1.5, (0.0, 0.0, 0.05))


def test_ur_rtde_mass_matrix_and_jacobian() -> None:
    control = RtdeControl(version=(5, 23))
    control.send(67)
    control.bench.ticks(3)
    outputs = [*range(24), *range(36, 48)]
    mass = [control.bench[f"output_double_register_{i}"] for i in outputs]
    assert all(mass[7 * i] > 0.0 for i in range(6))
    control.send(70)
    control.bench.ticks(3)
    jacobian = control.bench.controller.plant.kinematics.jacobian(HOME)
    column = [control.bench[f"output_double_register_{i}"] for i in range(6)]
    assert apart(column, [row[0] for row in jacobian]) < 1e-12


def test_ur_rtde_program_stops_on_request_and_on_a_protective_stop(control: RtdeControl) -> None:
    control.wait(READY)
    control.send(31)
    control.bench.seconds(0.1)
    assert control.bench.controller.safety_mode == SafetyMode.PROTECTIVE_STOP
    assert control.bench["runtime_state"] == RuntimeState.STOPPED
    other = RtdeControl()
    other.send(255)
    other.bench.seconds(0.1)
    assert other.bench["runtime_state"] == RuntimeState.STOPPED


def test_ur_rtde_unreachable_pose_stops_the_program(control: RtdeControl) -> None:
    control.send(46, 3.0, 0, 0, 0, 0, 0)
    control.bench.seconds(0.1)
    assert control.bench["runtime_state"] == RuntimeState.STOPPED
    assert "get_inverse_kin" in control.bench.of_type(RuntimeExceptionMessage)[0].text


def test_ur_rtde_second_motion_beside_a_servo_stops_the_program(control: RtdeControl) -> None:
    control.stream(0.1, 11, *HOME, 0.0, 0.0, 0.002, 0.1, 300.0)
    control.send(1, *GOAL, 1.05, 1.4, input_int_register_1=0)
    control.bench.seconds(0.1)
    assert control.bench["runtime_state"] == RuntimeState.STOPPED
    assert "Another thread" in control.bench.of_type(RuntimeExceptionMessage)[0].text


UNION = """
    direct_torque enable_external_ft_sensor end_force_mode end_freedrive_mode end_teach_mode
    force_mode force_mode_set_damping force_mode_set_gain_scaling freedrive_mode
    ft_rtde_input_enable get_actual_joint_positions_history get_actual_tcp_pose
    get_actual_tool_flange_pose get_coriolis_and_centrifugal_torques get_forward_kin
    get_freedrive_status get_inverse_kin get_inverse_kin_has_solution get_jacobian
    get_jacobian_time_derivative get_joint_torques get_mass_matrix get_steptime
    get_target_joint_accelerations get_target_payload get_target_payload_cog
    get_target_payload_inertia get_target_tcp_speed get_target_waypoint get_tcp_offset is_steady
    is_within_safety_limits movej movel norm pose_sub pose_trans protective_stop
    read_input_float_register read_input_integer_register rtde_set_watchdog servoc servoj
    set_gravity set_payload set_target_payload set_tcp speedj speedl stopj stopl sync teach_mode
    textmsg tool_contact write_output_float_register write_output_integer_register zero_ftsensor
    get_actual_tcp_speed get_joint_positions get_list_length get_target_joint_positions
    get_target_joint_speeds movec movep optimovej optimovel popup pow set_tool_voltage sleep
    str_cat to_str
"""  # of ur_rtde's and Universal Robots' own control programs, the socket functions apart


def test_every_function_of_the_known_control_programs_exists(bench: Bench) -> None:
    for name in UNION.split():
        bench.controller.run_script(f"def test():\n {name}()\nend\n")
    missing = [
        m.text
        for m in bench.controller.take_messages()
        if isinstance(m, RuntimeExceptionMessage) and "name_not_found" in m.text
    ]
    assert not missing


def test_calls_without_arguments_answer(bench: Bench) -> None:
    bench.run("speedj([0.3, 0.2, 0.1, 0, 0, 0], 2)\nstopj(2)")
    calls = """
        get_jacobian get_jacobian_time_derivative get_mass_matrix get_freedrive_status
        get_coriolis_and_centrifugal_torques get_joint_torques get_target_waypoint
        get_target_payload_inertia get_target_joint_accelerations tool_contact force
        get_tcp_force is_steady get_controller_temp get_tool_accelerometer_reading
    """.split()  # noqa: SIM905 - a list of words reads better
    texts = said(bench, "\n".join(f"textmsg({call}())" for call in calls))
    assert len(texts) == len(calls)
    assert abs(numbers(texts[-1])[2] + 9.82) < 0.1  # the tool points down
