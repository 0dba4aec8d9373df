"""What clients of UR's see of a controller, on each generation of its software: CB3, e-Series, PolyScope X.

Source: tests of Universal_Robots_Client_Library, which say what a controller does. What differs by version
stands in tables (`Since`): RTDE variables, dashboard commands, functions, packets; all of this is the same.
"""

from __future__ import annotations

import struct

import pytest

from crtk_sim_backends.ur import SIM
from crtk_sim_backends.ur.messages import (
    ErrorMessage,
    KeyMessage,
    ReportLevel,
    RuntimeExceptionMessage,
    TextMessage,
)
from crtk_sim_backends.ur.safety.modes import RuntimeState, SafetyMode
from rigs.ur_clients import DashboardClient, PrimaryClient, RtdeClient
from rigs.ur_controller import Bench
from rigs.waiting import eventually

pytestmark = pytest.mark.sweep(3)

CONTROLLERS = [
    ("ur3", (3, 12, 0, 0)),
    ("ur5", (3, 15, 8, 0)),
    ("ur5e", (5, 5, 1, 0)),
    ("ur5e", (5, 9, 4, 0)),
    ("ur5e", (5, 12, 4, 0)),
    ("ur10e", (5, 21, 0, 0)),
    ("ur20", (5, 26, 3, 0)),
    ("ur5e", (10, 7, 0, 0)),
    ("ur5e", (10, 15, 0, 0)),
]

OF_THE_ROS_DRIVER = (
    "timestamp,actual_q,actual_qd,speed_scaling,target_speed_fraction,runtime_state,actual_TCP_force,"
    "actual_TCP_pose,actual_digital_input_bits,actual_digital_output_bits,standard_analog_input0,"
    "standard_analog_input1,standard_analog_output0,standard_analog_output1,analog_io_types,tool_mode,"
    "tool_analog_input_types,tool_analog_input0,tool_analog_input1,tool_output_voltage,tool_output_current,"
    "tool_temperature,robot_mode,safety_mode,robot_status_bits,safety_status_bits,actual_current,tcp_offset"
)
"""What UR's ROS drivers subscribe to (their RTDE output recipe)."""


def text(version: tuple[int, ...]) -> str:
    return ".".join(map(str, version[:3]))


@pytest.fixture(params=CONTROLLERS, ids=lambda given: f"{given[0]}-{text(given[1])}")
def controller(request) -> tuple[str, tuple[int, int, int, int]]:
    model, version = request.param
    return model, version


@pytest.fixture
def bench(controller) -> Bench:
    model, version = controller
    return Bench(model, version=version)


def level(bench: Bench) -> list[tuple[int, ReportLevel]]:
    return [(message.code, message.level) for message in bench.of_type(ErrorMessage)]


def test_the_ros_driver_is_told_all_that_it_asks_for(controller):
    model, version = controller
    with SIM.spawn(model=model, version=text(version)) as sim, RtdeClient(sim.host) as client:
        assert client.request("v")[:12] == struct.pack(">3I", *version[:3])
        number, types = client.setup_outputs(OF_THE_ROS_DRIVER)
        assert number == 1
        assert "NOT_FOUND" not in types
        assert client.setup_inputs("speed_slider_mask,speed_slider_fraction")[0] > 0
        assert client.start()
        assert client.data()


def test_a_program_is_played_and_paused_and_goes_on(controller):
    model, version = controller
    if version[0] >= 10:
        pytest.skip("PolyScope X has no dashboard server")
    with (
        SIM.spawn(model=model, version=text(version)) as sim,
        DashboardClient(sim.host) as dashboard,
    ):
        dashboard.ask("load simulation.urp")
        assert dashboard.ask("play") == "Starting program"
        eventually(lambda: dashboard.ask("running") == "Program running: true")
        assert dashboard.ask("pause") == "Pausing program"
        assert dashboard.ask("programState") == "PAUSED simulation.urp"
        assert dashboard.ask("play") == "Starting program"
        assert dashboard.ask("running") == "Program running: true"


def test_a_stop_of_a_script_is_a_warning_and_unlocked_by_the_port_it_came_from(controller):
    model, version = controller
    with SIM.spawn(model=model, version=text(version)) as sim, PrimaryClient(sim.host) as primary:
        primary.send(b"protective_stop()\n")
        code, argument, severity = struct.unpack_from(">3i", primary.message(6))
        assert (code, argument, severity) == (209, 0, ReportLevel.WARNING)
        eventually(lambda: sim.control.outputs("safety_mode")["safety_mode"] == 3)
        primary.send(b"set unlock protective stop\n")
        eventually(lambda: sim.control.outputs("safety_mode")["safety_mode"] == 1)
        primary.send(b'textmsg("goes on")\n')
        assert primary.message(0) == b"goes on"


def test_a_line_out_of_reach_is_a_warning_and_a_stop(bench):
    bench.start("movel(p[10, 0, 0, 0, 0, 0], v=1, a=2)")
    bench.until(lambda: bench.controller.safety_mode == SafetyMode.PROTECTIVE_STOP)
    bench.until(lambda: bench.controller.runtime_state == RuntimeState.STOPPED)
    assert level(bench) == [(154, ReportLevel.WARNING)]
    # The reason comes before the end of the program, for clients that wait for that.
    kinds = [type(message) for message in bench.messages]
    assert kinds.index(ErrorMessage) < len(kinds) - 1 - kinds[::-1].index(KeyMessage)
    bench.controller.run_script("set unlock protective stop")
    bench.run("movej([0, -1.4, 1.4, -1.57, -1.57, 0])")
    assert bench["target_q"][1] == pytest.approx(-1.4)


def test_a_pose_out_of_reach_of_movej_is_a_runtime_exception(bench):
    bench.start("movej(p[10, 0, 0, 0, 0, 0])")
    bench.until(lambda: bench.controller.runtime_state == RuntimeState.STOPPED)
    (error,) = bench.of_type(RuntimeExceptionMessage)
    assert "inverse kinematics" in error.text
    assert level(bench) == []
    assert bench.controller.safety_mode == SafetyMode.NORMAL


def test_manual_mode_stays_when_it_is_no_longer_controlled(bench):
    controller = bench.controller
    if controller.model.is_cb3:
        assert not controller.set_operational_mode("MANUAL")
        assert controller.remote
        return
    assert controller.set_operational_mode("MANUAL")
    assert controller.set_operational_mode("NONE")
    assert controller.operational_mode == "NONE"
    assert not controller.remote


def test_lines_that_joints_can_hardly_follow_succeed(bench):
    if bench.controller.model.name == "ur3":
        pytest.skip("out of its reach")
    bench.run("movej([-1.57, -1.6, 1.6, -0.7, 0.7, 0.2], a=3, v=3)")
    for y in (0.263, 0.463, 0.263):
        bench.run(f"movel(p[-0.203, {y}, 0.559, 0.68, -1.083, -2.076], a=2.5, v=2.5)")
        assert bench["target_TCP_pose"][:2] == pytest.approx((-0.203, y), abs=1e-6)
    assert level(bench) == []


@pytest.mark.sweep(6)
@pytest.mark.parametrize("slider", [1.0, 0.25])
def test_a_quintic_spline_with_a_speed_at_its_end_is_followed(bench, slider):
    """By speeds of one period each, as UR's program makes them; acceleration never turns within one."""
    bench.write(speed_slider_mask=1, speed_slider_fraction=slider)
    bench.seconds(0.4)
    start = bench["target_q"][0]
    # 0 to 0.3 rad in 1 s, at the end 0.273 rad/s and 1.7 rad/s^2
    bench.start(
        "  qd = [0, 0, 0, 0, 0, 0]\n  t = 0\n  dt = get_steptime()\n  while t < 1 - dt / 2:\n"
        "    t = t + dt\n    before = qd[0]\n"
        "    qd[0] = 3 * 2.758 * pow(t, 2) - 4 * 4.289 * pow(t, 3) + 5 * 1.831 * pow(t, 4)\n"
        "    write_output_float_register(1, t)\n"
        "    speedj(qd, norm(qd[0] - before) / dt, dt)\n  end\n  stopj(15)"
    )
    dt, periods, changes = bench.controller.dt, round(1 / slider), []
    while (t := bench["output_double_register_1"]) < 1.0 - 2.0 * dt:
        acceleration = bench["target_qdd"][0]
        bench.ticks(1)
        behind = t - dt  # the step that is written is the one that begins
        expected = 2.758 * behind**3 - 4.289 * behind**4 + 1.831 * behind**5
        assert bench["target_q"][0] - start == pytest.approx(expected, abs=0.02)
        changes.append(bench["target_qdd"][0] - acceleration)
    assert bench["target_qd"][0] == pytest.approx(slider * 0.27, rel=0.1)
    for i in range(0, len(changes) - periods, periods):
        step = [c for c in changes[i : i + periods] if abs(c) > 1e-9]
        assert len({c > 0.0 for c in step}) <= 1 or slider == 1.0
    bench.until(lambda: bench.controller.runtime_state == RuntimeState.STOPPED)
    assert bench["target_qd"] == (0.0,) * 6
    assert level(bench) == []


def test_a_time_that_cannot_be_kept_is_a_slower_move(bench):
    bench.run("movej([-1.57, -1.6, 1.6, -0.7, 0.7, 0.2], t=0.1)")
    bench.run("movej([1.57, -1.6, 1.6, -0.7, 0.7, 0.2], t=0.1)")
    assert bench["target_q"][0] == pytest.approx(1.57)
    assert not bench.of_type(ErrorMessage)


@pytest.mark.parametrize("slider", [1.0, 0.25])
def test_a_spline_of_speeds_arrives(bench, slider):
    bench.write(speed_slider_mask=1, speed_slider_fraction=slider)
    bench.seconds(0.4)
    bench.run(
        "  qd = [0, 0, 0, 0, 0, 0]\n  time = 0\n  while time < 0.9999:\n"
        "    time = time + get_steptime()\n    before = qd[0]\n"
        "    qd[0] = 3.0 * time * (1.0 - time)\n"
        "    speedj(qd, norm(qd[0] - before) / get_steptime(), get_steptime())\n  end\n  stopj(10)"
    )
    assert bench["target_q"][0] == pytest.approx(0.5, abs=3e-3)


def test_functions_of_newer_software_are_not_there(bench):
    version = bench.controller.version
    for name, has in (
        ("zero_ftsensor", True),
        ("get_inverse_kin_has_solution", version >= (5, 9) or (3, 15) <= version < (4,)),
        ("get_freedrive_status", version >= (5, 10)),
        ("direct_torque", version >= (10, 11) or (5, 23) <= version < (6,)),
    ):
        assert (name in bench.controller.player._builtins) is has, name


def test_a_message_of_a_program_reaches_the_clients(bench):
    bench.run('textmsg("still ", "running")')
    assert [message.text for message in bench.of_type(TextMessage)] == ["still running"]
