"""URScript on the simulated controller: what depends on its software, its state and its arm."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crtk_sim_backends.ur.controller import Controller
from crtk_sim_backends.ur.messages import KeyMessage, RuntimeExceptionMessage, TextMessage
from crtk_sim_backends.ur.program.script_rpc import ScriptRpc
from crtk_sim_backends.ur.program.script_sockets import ScriptSockets
from crtk_sim_backends.ur.urscript import Builtin
from crtk_sim_backends.ur.urscript.manual import NAMES, SINCE, available, dialect_of
from rigs.examples import examples
from rigs.ur_controller import Bench


def texts(body: str, **options: Any) -> list[str]:
    """Run a program and return what it wrote with textmsg, or its error."""
    bench = Bench(**options)
    bench.run(body)
    errors = [error.text for error in bench.of_type(RuntimeExceptionMessage)]
    return errors or [message.text for message in bench.of_type(TextMessage)]


@pytest.mark.parametrize(
    ("expression", "text"),
    [
        ("rotvec2rpy([0, 0, 0])", "[0,0,0]"),
        ("rotvec2rpy([0.3, 0, 0])", "[0.3,0,0]"),
        ("rotvec2rpy([0, 0, -2])", "[0,0,-2]"),
        ("norm(rpy2rotvec([0, 0, 1]) - [0, 0, 1]) < 1e-9", "True"),
        # About the fixed axes x, y, z in turn: first x to its place, then the rest about z.
        (
            "norm(pose_trans(p[0,0,0,0,0,d2r(90)], p[0,0,0,d2r(90),0,0]) - p[0,0,0,"
            "rpy2rotvec([d2r(90), 0, d2r(90)])[0], rpy2rotvec([d2r(90), 0, d2r(90)])[1],"
            "rpy2rotvec([d2r(90), 0, d2r(90)])[2]]) < 1e-9",
            "True",
        ),
        ("norm(rotvec2rpy(rpy2rotvec([0.1, -0.2, 3])) - [0.1, -0.2, 3]) < 1e-9", "True"),
        ("norm(rotvec2rpy(rpy2rotvec([0.4, d2r(90), 0])) - [0.4, d2r(90), 0]) < 1e-6", "True"),
        # A force of 1 N along x, seen from a frame in which its point is 2 m along y.
        ("wrench_trans(p[0, 2, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0])", "[1,0,0,0,0,-2]"),
        ("norm(wrench_trans(p[0,0,0,0,0,d2r(90)], [1,0,0,0,0,3]) - [0,1,0,0,0,3]) < 1e-9", "True"),
        ("norm(pose_trans(inv(p[1,2,3,0,1,0]), p[1,2,3,0,1,0])) < 1e-9", "True"),
        ("inv([[2, 0], [0, 4]])", "[[0.5,0],[0,0.25]]"),
        ("get_gravity()", "[0,0,9.82]"),
        ("get_rtde_value('robot_mode')", "7"),
        ("length(get_rtde_value('actual_q'))", "6"),
        ("0 <= random() and random() < 1 and random() != random()", "True"),
        ("length('text' + to_str(1))", "5"),
        ("get_base_acceleration()", "[0,0,0]"),
        ("get_target_tcp_pose_along_path() == get_target_tcp_pose()", "True"),
    ],
)
def test_values(expression: str, text: str) -> None:
    (result,) = texts(f"textmsg({expression})")
    assert result.replace("-0", "0") == text


def test_random_numbers_are_the_same_in_each_run() -> None:
    body = "textmsg([random(), random()])"
    assert texts(body) == texts(body)


def test_time_passes_with_the_controller() -> None:
    body = (
        "a = time()\nb = time(2)\nsleep(1.5)\n"
        "textmsg(time() - a)\nc = time(2)\n"
        "textmsg((c.sec - b.sec) * 1e9 + (c.nanosec - b.nanosec))"
    )
    seconds, nanoseconds = map(float, texts(body))
    assert seconds == pytest.approx(1.5, abs=0.004)
    assert nanoseconds == pytest.approx(1.5e9, abs=4e6)


def test_settings_are_kept_by_the_controller() -> None:
    bench = Bench()
    bench.run("set_base_acceleration([1, 2, 3])\nmotion_version_set(2)")
    bench.run("textmsg(get_base_acceleration())\ntextmsg(motion_version_get())")
    assert [message.text for message in bench.of_type(TextMessage)] == ["[1,2,3]", "2"]


@pytest.mark.parametrize(
    "call",
    [
        "motion_version_set(3)",
        "set_safety_mode_transition_hardness(2)",
        "set_base_acceleration([1])",
        "tool_wrench_limit_set(p[0,0,0,0,0,0], Mz=-1)",
        "position_deviation_warning(True, 2)",
    ],
)
def test_wrong_settings_are_refused(call: str) -> None:
    (error,) = texts(call)
    assert call.partition("(")[0] in error


@pytest.mark.parametrize("call", ["time(7)", "get_rtde_value('speed')", "rotvec2rpy([1])"])
def test_wrong_arguments(call: str) -> None:
    (error,) = texts(f"x = {call}")
    assert call.partition("(")[0] in error


VALUES = [
    "0",
    "1",
    "-1",
    "7",
    "0.5",
    "1e9",
    "-1e-9",
    "True",
    "''",
    "'abc'",
    "[]",
    "[1]",
    "[0,0,0,0,0,0]",
    "[1,-1,1,-1,1,-1]",
    "p[0.1,0.2,0.3,0,0,0]",
    "[[1,2],[3,4]]",
    "struct(a=1)",
    "['a','b']",
    "make_list(300,1)",
    "none()",
    "h",
    "to_num('nan')",
    "to_num('inf')",
    "[to_num('nan'),0,0,0,0,0]",
    "p[0,0,0,0,0,to_num('inf')]",
]


def network(controller: Controller) -> Iterator[Builtin]:
    yield from ScriptSockets("127.0.0.1").builtins(controller.clock)
    yield from ScriptRpc("127.0.0.1").builtins()


@given(st.data())
@settings(max_examples=examples(400))
def test_any_function_takes_any_arguments_or_says_what_is_wrong(data: st.DataObject) -> None:
    bench = Bench(extra_builtins=network)
    name = data.draw(
        st.sampled_from(sorted(set(bench.controller.player._builtins) - {"socket_open"}))
    )
    arguments = data.draw(st.lists(st.sampled_from(VALUES), max_size=4))
    bench.start(
        "def none():\nend\nh = rpc_factory('xmlrpc', 'http://127.0.0.1:1')\n"
        f"x = {name}({','.join(arguments)})\ny = to_str(x)\nsync()"
    )
    bench.ticks(4)
    for error in bench.of_type(RuntimeExceptionMessage):
        assert error.line == 5 or error.line == 6
        assert "Internal error" not in error.text


# Software versions


@pytest.mark.parametrize(
    ("name", "version", "has"),
    [
        ("make_list", (5, 14, 9, 9), False),
        ("make_list", (5, 15, 0, 0), True),
        ("make_list", (3, 15, 8, 0), False),
        ("make_list", (10, 0, 0, 0), True),
        ("optimovej", (10, 7, 0, 0), False),
        ("optimovej", (10, 8, 0, 0), True),
        ("optimovej", (5, 21, 0, 0), True),
        ("ft_rtde_input_enable", (3, 13, 0, 0), False),
        ("ft_rtde_input_enable", (3, 14, 3, 0), True),
        ("movej", (3, 0, 0, 0), True),
    ],
)
def test_functions_come_with_a_version(name: str, version: tuple[int, ...], has: bool) -> None:
    assert (name in dialect_of(version).known) is has


def test_versions_are_given_for_functions_that_there_are() -> None:
    assert set(SINCE) <= NAMES


def test_every_builtin_is_in_the_manual() -> None:
    builtins = Bench().controller.player._builtins
    undocumented = {"get_target_tool_flange_pose"}
    assert set(builtins) - NAMES == undocumented
    assert set(available(builtins, (5, 4, 0, 0))) < set(builtins)


def test_a_function_of_newer_software_is_not_found() -> None:
    body = "\n  x = make_list(1, 2)"
    assert texts(body + "\n  textmsg(x)", version=(5, 15, 0, 0)) == ["[2]"]
    bench = Bench(version=(5, 14, 0, 0))
    bench.start(body)
    bench.ticks(1)
    (error,) = bench.of_type(RuntimeExceptionMessage)
    assert (error.line, error.column) == (3, 7)
    assert error.text == "compile_error_name_not_found:make_list:"


def test_cb3_compiles_the_gain_scaling_that_it_has_no_use_for() -> None:
    """UR's external control program names it on every software, and runs on 3.14 and later."""
    body = "\n  if get_steptime() < 0.008:\n    force_mode_set_gain_scaling(1)\n  end\n  textmsg(1)"
    assert texts(body, version=(3, 14, 3, 0)) == ["1"]


RESIZED = (
    "q = [1, 2]\nq = [3, 4]\nq = [1, 2, 3]",
    "q = [1, 2]\ndef g():\n q = get_actual_joint_positions()\nend\ng()",
    "def g(q):\n q = [1]\nend\nq = [1]\ng(q)\nr = [1, 2]\nr = q",
    "s = struct(a=[1])\nq = [1, 2]\nif q[0] == 1:\n q = s.a\nend",
)


@pytest.mark.parametrize("body", RESIZED)
def test_a_list_keeps_its_size_in_some_versions(body: str) -> None:
    refused = ["Resizing of 'List' is not supported"]
    assert texts(body, version=(5, 8, 2, 0)) == []
    assert texts(body, version=(5, 9, 4, 0)) == refused
    assert texts(body, version=(5, 14, 6, 0)) == refused
    assert texts(body, version=(5, 15, 0, 0)) == []


@pytest.mark.parametrize(
    "body",
    [
        "if False:\n q = [1]\nend\nq = [1, 2]",
        "while False:\n q = [1]\nend\nq = [1, 2]",
        "q = 1\nq = [1, 2]",
        "def g():\n local q = [1]\nend\nq = [1, 2]\ng()",
        "q = [1, 2]\nq = p[1, 2, 3, 4, 5, 6][0]",
    ],
)
def test_what_is_no_resizing(body: str) -> None:
    assert texts(body, version=(5, 12, 4, 0)) == []


def test_a_function_that_is_not_simulated_is_refused_by_name() -> None:
    bench = Bench()
    bench.start("powerdown()")
    (error,) = bench.of_type(RuntimeExceptionMessage)
    assert error.text.startswith("compile_error_name_not_found:powerdown: (a function that is not")


# Functions that few programs use


def test_the_simulated_arm_can_be_put_somewhere() -> None:
    bench = Bench()
    bench.run(
        "set_pos([0.5, -1.2, 1.2, -1.57, -1.57, 0])\nmovej([0.6, -1.2, 1.2, -1.57, -1.57, 0])"
    )
    assert bench["target_q"] == (0.6, -1.2, 1.2, -1.57, -1.57, 0.0)
    bench.start("set_pos([7, 0, 0, 0, 0, 0])\nsync()")
    bench.ticks(4)
    assert "range" in bench.of_type(RuntimeExceptionMessage)[-1].text


def test_screw_driving_presses_along_the_tool_and_follows() -> None:
    bench = Bench()
    before = bench["target_TCP_pose"]
    bench.start("screw_driving(20, 0.05)\nsleep(1)\nend_screw_driving()\nsleep(1)")
    bench.seconds(1.0)
    after = bench["target_TCP_pose"]
    assert before[2] - after[2] == pytest.approx(0.05, abs=5e-3)  # the tool points down
    assert after[:2] == pytest.approx(before[:2], abs=1e-4)
    bench.seconds(0.5)
    assert bench["target_qd"] == (0.0,) * 6


def test_euromap_signals_are_set_read_and_follow_the_program() -> None:
    bench = Bench()
    bench.run(
        "set_euromap_output(5, True)\nset_euromap_runstate_dependent_choice(6, 3)\nsync()\n"
        "write_output_boolean_register(0, get_euromap_output(5))\n"
        "write_output_boolean_register(1, get_euromap_input(5))\n"
        "write_output_boolean_register(2, get_euromap_output(6))"
    )
    assert bench["output_bit_registers0_to_31"] & 7 == 0b101
    bench.ticks(1)
    assert bench["euromap67_output_bits"] == 1 << 5


@pytest.mark.parametrize(("argument", "state"), [("", "PAUSED"), (", 4", "PAUSED"), (", 9", "")])
def test_an_error_can_pause_the_program(argument: str, state: str) -> None:
    bench = Bench()
    bench.start(
        f"pause_on_error_code(171{argument})\n"
        "movej([0.02, -1.57, 1.57, -1.57, -1.57, 0], r=0.05)\n"
        "movej([0.03, -1.57, 1.57, -1.57, -1.57, 0], r=0.05)\n"
        "movej([0.5, -1.57, 1.57, -1.57, -1.57, 0])\nsync()"
    )
    bench.seconds(3.0)
    assert (bench.controller.runtime_state.name == "PAUSED") is bool(state)
    bench.controller.play()
    bench.seconds(3.0)
    assert bench["target_q"][0] == 0.5


@pytest.mark.parametrize(
    "call",
    [
        "reset_revolution_counter()",
        "set_baselight_off()\nset_baselight_iec()\nset_baselight_solid(0, 128, 255)",
        "freedrive_mode_no_incorrect_payload_check()\nend_freedrive_mode()",
    ],
)
def test_what_has_no_effect_here_is_taken(call: str) -> None:
    bench = Bench("ur20")
    bench.run(call)
    assert not bench.of_type(RuntimeExceptionMessage)


# Programs


def test_an_error_of_a_secondary_program_is_a_message_of_its_own() -> None:
    bench = Bench()
    bench.controller.run_script("sec s():\n  x = str_sub('a')\nend")
    bench.ticks(2)
    assert bench.of_type(KeyMessage) == [
        KeyMessage("SECONDARY_PROGRAM_EXCEPTION_XXX", "Type error: str_sub takes 2 to 3 arguments")
    ]
    assert not bench.of_type(RuntimeExceptionMessage)


def test_an_infinite_loop_ends_the_program_and_not_the_controller() -> None:
    bench = Bench()
    bench.start("x = 0\nwhile True:\n  x = x + 1\nend")
    bench.ticks(3)
    (error,) = bench.of_type(RuntimeExceptionMessage)
    assert "Consider using a Wait or sync()" in error.text
    assert error.line == 3
    assert texts("textmsg(1)") == ["1"]


def test_the_line_that_sets_the_speed_slider() -> None:
    bench = Bench()
    bench.controller.run_script("set speed 0.25")
    assert bench["target_speed_fraction"] == 0.25
    assert not bench.of_type(RuntimeExceptionMessage)


def test_what_urx_writes() -> None:
    bench = Bench()
    bench.run(
        "set_runstate_outputs([])\nset_runstate_standard_digital_outputs([0])\n"
        "digital_out[3] = True\nset_digital_out(0, True)\n"
        "speedj([0.1, 0, 0, 0, 0, 0], a=1, t_min=0.1)\nspeedl([0,0,0.01,0,0,0], a=1, t_min=0.1)\n"
        "textmsg(get_digital_out(0) and get_digital_out(3))"
    )
    assert [message.text for message in bench.of_type(TextMessage)] == ["True"]
    assert bench["actual_digital_output_bits"] == 8  # output 0 is low when nothing runs


def test_a_variable_of_the_script_hides_the_controllers() -> None:
    assert texts("digital_out = [0, 0]\ndigital_out[1] = 5\ntextmsg(digital_out)") == ["[0,5]"]


STATE_OF_A_TRAJECTORY = """
  global cmd_q = get_joint_positions()
  global points_left = 2
  thread_move = 0
  def limited(step_start, step_end, time):
    local idx = 0
    while idx < 6:
      local velocity = norm(step_end[idx] - step_start[idx]) / time
      if velocity > 20.0:
        local str = str_cat(str_cat("Velocity ", velocity), str_cat(
          str_cat(" in joint ", idx), " is too high"))
        textmsg(str)
        return False
      end
      idx = idx + 1
    end
    return True
  end
  def spline(end_q, time, is_last=False):
    local start_q = get_joint_positions()
    local c2 = (-3 * start_q + end_q * 3) / pow(time, 2)
    local c3 = (2 * start_q - 2 * end_q) / pow(time, 3)
    run_spline(c2, c3, time)
    return True and (is_last == False)
  end
  def run_spline(c2, c3, time):
    local t = 0.0
    while t < time:
      t = t + get_steptime()
      speedj(2.0 * t * c2 + 3.0 * pow(t, 2) * c3, 40, get_steptime())
    end
  end
  thread trajectory():
    enter_critical
    while points_left > 0:
      local q = cmd_q + [0.1, 0, 0, 0, 0, 0] * points_left
      points_left = points_left - 1
      if points_left == 1 or
        points_left == 17:
        moving = spline(q, 0.5, points_left == 0)
      else:
        movej(get_inverse_kin(get_forward_kin(q), qnear=q), a = 4, v = 1.5, t = 0, r = 0.0)
        moving = False
      end
    end
    exit_critical
    stopj(4.0)
    textmsg("moving: ", moving)
  end
  $ 1 "Robot Program"
  if not limited(cmd_q, cmd_q + 1, 0.002):
    thread_move = run trajectory()
    join thread_move
  end
  global reached = get_target_joint_positions() - cmd_q
  textmsg(norm(reached - [0.1, 0, 0, 0, 0, 0]) < 1e-6)
  kill thread_move
"""


def test_a_program_with_the_constructs_of_urs_external_control() -> None:
    assert texts(STATE_OF_A_TRAJECTORY) == [
        "Velocity 500 in joint 0 is too high",
        "moving: False",
        "True",
    ]


def test_matrices_and_structs_as_in_urs_examples_of_compliant_control() -> None:
    body = """
  def diagonal(v):
    return [[v[0], 0, 0], [0, v[1], 0], [0, 0, v[2]]]
  end
  def state(time):
    return struct(p = p[cos(time), sin(time), 0, 0, 0, 0], v = [1 * -sin(time), 0, 0])
  end
  local M = diagonal([2, 4, 8])
  local M = M * 0.5
  acc = inv(M) * ([1, 1, 1] - (diagonal([1, 1, 1]) * [0.5, 0.5, 0.5]))
  textmsg(acc)
  textmsg(state(0).p)
  q = get_inverse_kin(get_target_tcp_pose())
  qd = inv(get_jacobian(q)) * [0.1, 0, 0, 0, 0, 0]
  speed = get_jacobian(q) * qd
  textmsg(norm(speed - [0.1, 0, 0, 0, 0, 0]) < 1e-9)
  torque = get_mass_matrix() * qd + [1, 1, 1, 1, 1, 1] * qd + get_coriolis_and_centrifugal_torques()
  textmsg(length(torque))
"""
    assert texts(body) == ["[0.5,0.25,0.125]", "p[1,0,0,0,0,0]", "True", "6"]


def test_the_rotation_of_a_wrench_is_that_of_a_pose() -> None:
    angle = math.pi / 6
    (text,) = texts(
        f"w = wrench_trans(p[0,0,0,0,0,{angle}], [1, 0, 0, 0, 0, 0])\n"
        f"x = pose_trans(p[0,0,0,0,0,{angle}], p[1,0,0,0,0,0])\n"
        "textmsg(norm([w[0] - x[0], w[1] - x[1], w[2] - x[2]]) < 1e-12)"
    )
    assert text == "True"
