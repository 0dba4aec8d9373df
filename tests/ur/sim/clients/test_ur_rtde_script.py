"""The control script of ur_rtde, as the installed package gives it, compiles and runs."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any

import pytest

from crtk_sim_backends.ur.program.running import ProgramRuntime
from crtk_sim_backends.ur.urscript import (
    PURE_BUILTINS,
    Builtin,
    List,
    Pose,
    compile_program,
    timing_builtins,
)
from rigs.urscript_runtime import TICK

script_client = pytest.importorskip("script_client")

READY, DONE = 1, 2
SERVOJ, SERVO_STOP, IS_STEADY, MOVEJ, STOP_SCRIPT = 11, 16, 47, 1, 255

# Every robot function that ur_rtde's script and UR's external control program call.
MOTIONS = """
    direct_torque force_mode movec movej movel movep optimovej optimovel servoc servoj speedj
    speedl stopj stopl
"""
ACTIONS = """
    enable_external_ft_sensor end_force_mode end_freedrive_mode end_teach_mode
    force_mode_set_damping force_mode_set_gain_scaling freedrive_mode ft_rtde_input_enable popup
    protective_stop rtde_set_watchdog set_gravity set_payload set_target_payload set_tcp
    set_tool_voltage socket_close socket_open socket_read_binary_integer socket_send_int
    teach_mode textmsg zero_ftsensor
"""
LISTS = """
    get_actual_joint_positions_history get_actual_tcp_speed get_coriolis_and_centrifugal_torques
    get_inverse_kin get_joint_positions get_joint_torques get_target_joint_accelerations
    get_target_joint_positions get_target_joint_speeds get_target_payload_cog
    get_target_payload_inertia get_target_tcp_speed
"""
POSES = """
    get_actual_tcp_pose get_actual_tool_flange_pose get_forward_kin get_target_waypoint
    get_tcp_offset pose_sub pose_trans
"""
MATRICES = "get_jacobian get_jacobian_time_derivative get_mass_matrix"
NUMBERS = "get_freedrive_status get_steptime get_target_payload tool_contact"
TRUTHS = "get_inverse_kin_has_solution is_steady is_within_safety_limits"


class Robot:
    """Registers, and a log of the calls that are no arithmetic."""

    def __init__(self) -> None:
        self.inputs: dict[int, Any] = dict.fromkeys(range(48), 0)
        self.outputs: dict[int, Any] = {}
        self.calls: list[str] = []
        self.builtins = {**PURE_BUILTINS, **timing_builtins(TICK)}
        self._add(MOTIONS, lambda name: self._motion(name), blocking=True)
        self._add(ACTIONS, lambda name: lambda *_, **__: self.calls.append(name))
        self._add(LISTS, lambda _: lambda *_, **__: List([0.0] * 6))
        self._add(POSES, lambda _: lambda *_, **__: Pose([0.0] * 6))
        self._add(MATRICES, lambda _: lambda *_, **__: List([List([0.0] * 6)] * 6))
        self._add(NUMBERS, lambda _: lambda *_, **__: 0)
        self._add(TRUTHS, lambda _: lambda *_, **__: True)
        self._add(
            "read_input_integer_register read_input_float_register",
            lambda _: self.inputs.__getitem__,
        )
        self._add(
            "write_output_integer_register write_output_float_register",
            lambda name: self.outputs.__setitem__ if "integer" in name else lambda *_: None,
        )

    def _add(
        self, names: str, call_of: Callable[[str], Callable[..., Any]], blocking: bool = False
    ) -> None:
        for name in names.split():
            self.builtins[name] = Builtin(name, call_of(name), blocking)

    def _motion(self, name: str) -> Callable[..., Generator[None]]:
        def motion(*_: Any, **__: Any) -> Generator[None]:
            self.calls.append(name)
            yield

        return motion


def control_script(major: int, minor: int) -> str:
    """Return the script with the register offsets that the client puts in before it sends it."""
    client = script_client.ScriptClient("127.0.0.1", major, minor)
    lines = client.getScript().splitlines(keepends=True)
    offsets = [line + "0 " if line.rstrip().endswith("register offset") else line for line in lines]
    return f"def rtde_control():\n{''.join(offsets)}end\n"


def test_the_table_has_the_functions_of_both_client_programs() -> None:
    pure = {"get_list_length", "norm", "pow", "sleep", "str_cat", "sync", "to_str"}
    robot = set(f"{MOTIONS} {ACTIONS} {LISTS} {POSES} {MATRICES} {NUMBERS} {TRUTHS}".split())
    registers = {
        f"{verb}_{kind}_register"
        for verb in ("read_input", "write_output")
        for kind in ("integer", "float")
    }
    assert len(pure | robot | registers) == 77
    assert pure | robot | registers <= set(Robot().builtins)


@pytest.mark.parametrize("version", [(3, 15), (5, 4), (5, 12), (5, 23), (10, 9)])
def test_the_control_script_runs(version: tuple[int, int]) -> None:
    robot = Robot()
    program = compile_program(control_script(*version), robot.builtins)
    assert (program.name, program.kind) == ("rtde_control", "def")
    runtime = ProgramRuntime(program, TICK)
    runtime.start()

    def step(command: int, ticks: int) -> list[str]:
        robot.inputs[0] = command
        robot.calls.clear()
        for _ in range(ticks):
            runtime.step()
        return robot.calls

    assert "force_mode_set_damping" in step(0, 2)
    assert robot.outputs[0] == READY

    calls = step(SERVOJ, 2000)
    assert calls.count("servoj") == 2000
    assert robot.outputs[0] == READY
    assert "stopl" in step(SERVO_STOP, 3)
    assert robot.outputs[0] == DONE
    assert "servoj" not in step(0, 1000)
    assert robot.outputs[0] == READY

    step(IS_STEADY, 1)
    assert (robot.outputs[0], robot.outputs[1]) == (DONE, 1)
    step(0, 1)

    robot.inputs[1] = 1  # asynchronous: a thread that starts, moves and signals in the same tick
    assert "movej" in step(MOVEJ, 1)
    assert robot.outputs[2] & 0x8000
    step(0, 1)
    assert not robot.outputs[2] & 0x8000

    assert not runtime.finished
    step(STOP_SCRIPT, 2)
    assert runtime.finished
