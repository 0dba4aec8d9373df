"""What the UR driver reports beside CRTK: in Python, in the counters and in the notes."""

import pytest

from crtk_driver_ur.models import JOINT_NAMES
from crtk_drivers.cli.check_command import _check_state
from rigs.ur_bench import LONG, UrBench, eventually, ur_bench


@pytest.fixture(scope="module")
def bench():
    with ur_bench() as bench:
        yield bench


def notes(bench: UrBench) -> dict[str, str]:
    return {note.key: note.text for note in bench.engine.health().notes}


def numbers(bench: UrBench) -> dict[str, float]:
    return dict(bench.device.counters)


def test_modes_follow_the_controller(bench):
    found = notes(bench)
    assert (found["robot mode"], found["safety mode"]) == ("RUNNING", "NORMAL")
    assert found["program"] == "STOPPED"
    bench.inject("reduced_mode")
    eventually(lambda: notes(bench)["safety mode"] == "REDUCED", "the mode is told")
    bench.sim.control.clear("reduced_mode")
    bench.arm.enable(timeout=LONG)
    eventually(lambda: notes(bench)["program"] == "PLAYING", "the program is told")


def test_digital_signals_are_named(bench):
    assert notes(bench)["digital inputs"] == "none"
    bench.inject("digital_inputs", bits=1 << 0 | 1 << 7 | 1 << 11 | 1 << 17)
    expected = "0, 7, configurable 3, tool 1"
    eventually(lambda: notes(bench)["digital inputs"] == expected, "the inputs are told")
    assert bench.device.robot_state.actual_digital_input_bits == 1 << 0 | 1 << 7 | 1 << 11 | 1 << 17
    bench.sim.control.clear("digital_inputs")
    bench.arm.tool_out_0(True)
    eventually(lambda: notes(bench)["digital outputs"] == "tool 0", "the outputs are told")
    bench.arm.tool_out_0(False)


@pytest.mark.parametrize(
    ("signal", "name"),
    [
        ("standard_analog_input0", "analog in 0 (A)"),
        ("standard_analog_input1", "analog in 1 (A)"),
        ("tool_analog_input0", "tool analog in 0 (A)"),
        ("tool_analog_input1", "tool analog in 1 (A)"),
    ],
)
def test_analog_inputs(bench, signal, name):
    bench.inject("analog_input", signal=signal, value=0.0125)
    eventually(lambda: numbers(bench)[name] == pytest.approx(0.0125), name)
    bench.sim.control.clear("analog_input")
    eventually(lambda: numbers(bench)[name] == 0.0, name)


def test_analog_outputs_and_tool_come_with_their_unit(bench):
    bench.arm.analog_out_1_voltage(7.5)
    bench.arm.tool_voltage(12.0)
    eventually(lambda: numbers(bench).get("analog out 1 (V)") == pytest.approx(7.5), "7.5 V")
    eventually(lambda: numbers(bench)["tool voltage (V)"] == 12.0, "12 V")
    assert numbers(bench)["tool temperature (°C)"] == pytest.approx(28.0)


def test_joints_and_speed(bench):
    bench.arm.speed_slider(0.3)
    eventually(lambda: numbers(bench)["speed slider"] == pytest.approx(0.3), "slider")
    eventually(lambda: "30%" in notes(bench).get("speed", ""), "the speed is told")
    bench.arm.speed_slider(1.0)
    eventually(lambda: "speed" not in notes(bench), "full speed")
    truth = bench.sim.control.outputs("joint_temperatures", "actual_current")
    found = numbers(bench)
    for i, joint in enumerate(JOINT_NAMES):
        assert found[f"{joint} temperature (°C)"] == truth["joint_temperatures"][i]
        assert found[f"{joint} current (A)"] == pytest.approx(truth["actual_current"][i], abs=0.5)


def test_what_an_old_controller_does_not_report_is_left_out():
    with ur_bench(model="ur5", version="3.8.0") as bench:
        assert "payload (kg)" not in numbers(bench)
        assert bench.device.robot_state.payload is None
        assert notes(bench)["robot mode"] == "RUNNING"
        assert len([name for name in numbers(bench) if "temperature" in name]) == 7


def test_nothing_is_told_while_there_is_no_connection():
    with ur_bench() as bench:
        bench.sim.control.inject("disconnect", port="rtde", duration=LONG)
        eventually(lambda: bench.device.robot_state is None, "the link is lost")
        assert "robot mode" not in notes(bench)
        assert "speed scaling" not in numbers(bench)


def test_check_tells_modes_in_words_and_the_joints_in_a_line(bench):
    found = {finding.what: finding.result for finding in _check_state(bench.engine)}
    counters = found["device counters"]
    assert "robot: mode RUNNING, " in counters
    assert "safety mode NORMAL" in counters
    assert "temperature (°C) by joint: 28, 28, 28, 28, 28, 28" in counters
    assert len(counters.splitlines()) < 10
