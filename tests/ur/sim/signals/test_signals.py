"""Digital and analog signals of a simulated controller: built-ins, wires, what follows the state."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_sim_backends.ur import ConfigError, SimConfig
from crtk_sim_backends.ur.messages import RuntimeExceptionMessage
from crtk_sim_backends.ur.safety.modes import RuntimeState
from crtk_sim_backends.ur.signals.control_box import from_ratio, to_ratio
from crtk_sim_backends.ur.signals.wiring import SINKS, SOURCES, WiringError, parse_wires
from rigs.ur_controller import Bench

OUT = "actual_digital_output_bits"
IN = "actual_digital_input_bits"


@pytest.fixture
def bench():
    return Bench()


def bench_with(wiring):
    return Bench(wires=parse_wires(wiring))


# Digital


def test_every_kind_of_output_has_its_bits(bench):
    bench.run(
        "set_standard_digital_out(7, True)\n"
        "set_configurable_digital_out(0, True)\n"
        "set_tool_digital_out(1, True)\n"
        "set_digital_out(8, True)\n"  # the tool's first, by its old number
        "write_output_boolean_register(0, get_digital_out(9))\n"
    )
    assert bench[OUT] == 1 << 7 | 1 << 8 | 1 << 16 | 1 << 17
    assert bench["output_bit_registers0_to_31"] == 1


@pytest.mark.parametrize(
    "call",
    [
        "set_standard_digital_out(8, True)",
        "set_tool_digital_out(2, True)",
        "get_digital_in(10)",
        "set_standard_analog_out(0, 1.5)",
        "get_tool_analog_in(2)",
        "get_flag(32)",
        "set_analog_inputrange(0, 1)",
        "set_standard_analog_input_domain(0, 2)",
        "set_tool_voltage(5)",
        "set_tool_output_mode(2)",
        "set_tool_digital_output_mode(0, 0)",
        'set_standard_digital_input_action(0, "dance")',
        "set_runstate_tool_digital_output_to_value(0, 6)",
        "set_tool_communication(True, 1200, 0, 1, 1.5, 3.5)",
        "set_tool_communication(True, 9600, 3, 1, 1.5, 3.5)",
        "set_tool_communication(True, 9600, 0, 1, 0.5, 3.5)",
    ],
)
def test_what_cannot_be_ends_the_program(bench, call):
    bench.run(f"{call}\nset_standard_digital_out(0, True)")
    assert bench.of_type(RuntimeExceptionMessage)
    assert bench[OUT] == 0


def test_flags_are_kept_between_programs(bench):
    bench.run("set_flag(31, True)")
    bench.run("set_standard_digital_out(0, get_flag(31))\nset_flag(31, False)")
    assert bench[OUT] == 1


# Analog


def test_an_analog_output_keeps_its_level_when_its_domain_changes(bench):
    bench.run("set_standard_analog_out(1, 0.25)")
    assert bench["standard_analog_output1"] == pytest.approx(0.008)
    bench.run("set_analog_outputdomain(1, 1)")
    assert bench["standard_analog_output1"] == pytest.approx(2.5)
    assert bench["analog_io_types"] == 0b1000


def test_analog_inputs_have_domains_and_old_numbers(bench):
    bench.controller.signals.set_analog_input("tool_analog_input1", 7.5)
    bench.run(
        "set_standard_analog_input_domain(1, 1)\n"
        "set_tool_analog_input_domain(0, 1)\n"
        "set_analog_inputrange(3, 1)\n"
        "write_output_float_register(0, get_analog_in(3))\n"
    )
    assert bench["analog_io_types"] == 0b10
    assert bench["tool_analog_input_types"] == 0b11
    assert bench["output_double_register_0"] == 7.5
    bench.run("set_analog_inputrange(3, 2)")
    assert bench["tool_analog_input_types"] == 0b01


@given(ratio=st.floats(0.0, 1.0), voltage=st.booleans())
def test_a_ratio_is_found_again_in_its_value(ratio, voltage):
    value = from_ratio(ratio, voltage=voltage)
    assert to_ratio(value, voltage=voltage) == pytest.approx(ratio, abs=1e-9)


# The tool


def test_the_tool_connector_reports_its_modes(bench):
    bench.run("set_tool_output_mode(1)\nset_tool_digital_output_mode(1, 3)\nset_tool_voltage(24)\n")
    assert (bench["tool_output_mode"], bench["tool_digital_output1_mode"]) == (1, 3)
    assert bench["tool_output_voltage"] == 24


def test_the_serial_line_takes_the_tools_analog_inputs(bench):
    signals = bench.controller.signals
    signals.set_analog_input("tool_analog_input0", 0.012)
    signals.set_analog_input("standard_analog_input0", 0.006)
    bench.run("set_tool_communication(True, 1000000, 2, 2, 1.0, 0.0)")
    assert bench["tool_analog_input0"] == 0.0
    assert bench["standard_analog_input0"] == 0.006
    signals.set_analog_input("tool_analog_input0", 0.02)
    assert bench["tool_analog_input0"] == 0.0
    settings = bench.controller.tool_communication
    assert settings.character == pytest.approx(12e-6)
    bench.run("set_tool_communication(False, 1000000, 2, 2, 1.0, 0.0)")
    assert bench["tool_analog_input0"] == 0.02


def test_a_cb3_arm_has_no_serial_line_to_its_tool():
    bench = Bench("ur5")
    bench.run("set_tool_communication(True, 9600, 0, 1, 1.5, 3.5)")
    assert bench.controller.program_name == ""


# Wires


def test_a_wire_brings_an_output_to_an_input():
    bench = bench_with("digital_out_0=digital_in_3, configurable_out_1=tool_in_1")
    bench.run("set_digital_out(0, True)\nset_configurable_digital_out(1, True)")
    assert bench[IN] == 1 << 3 | 1 << 17
    bench.run("set_digital_out(0, False)")
    assert bench[IN] == 1 << 17
    bench.controller.signals.set_digital_inputs(1 << 3)
    assert bench[IN] == 1 << 3 | 1 << 17  # what else is switched on comes to it


def test_a_program_sees_its_own_output_at_once():
    bench = bench_with("tool_out_0=configurable_in_7")
    bench.run(
        "set_tool_digital_out(0, True)\n"
        "set_standard_digital_out(0, get_configurable_digital_in(7))\n"
    )
    assert bench[OUT] == 1 | 1 << 16


def test_an_analog_wire_carries_what_its_ends_agree_on():
    bench = bench_with("analog_out_1=tool_analog_in_0")
    bench.run("set_standard_analog_out(1, 0.5)")
    assert bench["tool_analog_input0"] == pytest.approx(0.012)
    bench.run("set_analog_outputdomain(1, 1)")
    assert bench["tool_analog_input0"] == 0.0
    bench.run("set_tool_analog_input_domain(0, 1)")
    assert bench["tool_analog_input0"] == 5.0


@given(source=st.sampled_from(sorted(SOURCES)), sink=st.sampled_from(sorted(SINKS)))
def test_signals_of_one_kind_can_be_wired(source, sink):
    text = f" {source} = {sink} ,"
    if SOURCES[source][0] is SINKS[sink][0]:
        (wire,) = parse_wires(text)
        assert (wire.source, wire.sink) == (SOURCES[source][1], SINKS[sink][1])
    else:
        with pytest.raises(WiringError, match="analog"):
            parse_wires(text)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("digital_out_0", "OUTPUT=INPUT"),
        ("digital_out_8=digital_in_0", "did you mean .digital_out_7"),
        ("digital_out_0=digital_in_9", "unknown input"),
        ("digital_out_0=tool_in_0,tool_out_0=tool_in_0", "two outputs"),
    ],
)
def test_a_wire_that_cannot_be_is_refused(text, reason):
    with pytest.raises(ConfigError, match=f"wiring: .*{reason}"):
        SimConfig(wiring=text)


# Outputs that follow the state

LEVELS = {  # choice: level while a program runs, after its end, after its failure
    0: (0, 0, 0),
    1: (0, 0, 0),
    2: (1, 1, 1),
    3: (1, 0, 0),
    4: (0, 0, 0),
    5: (1, 1, 0),
    6: (1, 1, 1),
    7: (0, 0, 0),
}


@pytest.mark.parametrize("choice", LEVELS)
def test_outputs_follow_the_program(bench, choice):
    bench.run(f"set_runstate_standard_digital_output_to_value(4, {choice})")
    bench.controller.signals.set_digital_outputs(1 << 4, 1 << 4 if choice in (2, 6) else 0)
    bench.start("sleep(0.1)")
    bench.ticks(2)
    running = bench[OUT] >> 4
    bench.until(lambda: bench.controller.runtime_state == RuntimeState.STOPPED)
    bench.ticks(1)
    ended = bench[OUT] >> 4
    bench.run("a = [1]\ntextmsg(a[3])")
    bench.ticks(1)
    assert bench.of_type(RuntimeExceptionMessage)
    assert (running, ended, bench[OUT] >> 4) == LEVELS[choice]


def test_one_that_is_low_without_a_program_is_the_programs_while_it_runs(bench):
    bench.start(
        "set_standard_digital_out(0, True)\n"
        "set_runstate_standard_digital_output_to_value(0, 1)\n"
        "sleep(0.1)"
    )
    bench.ticks(5)
    assert bench[OUT] == 1
    bench.until(lambda: bench.controller.runtime_state == RuntimeState.STOPPED)
    bench.ticks(1)
    assert bench[OUT] == 0


def test_a_protective_stop_is_no_scheduled_end(bench):
    bench.run("set_runstate_configurable_digital_output_to_value(0, 5)")
    bench.start("while True:\n  sync()\nend")
    bench.ticks(2)
    assert bench[OUT] == 1 << 8
    bench.controller.protective_stop()
    bench.ticks(2)
    assert bench[OUT] == 0


def test_analog_outputs_and_registers_follow_too(bench):
    bench.run(
        "set_runstate_standard_analog_output_to_value(0, 3)\n"
        "set_runstate_gp_boolean_output_to_value(64, 2)\n"
        "set_runstate_gp_boolean_output_to_value(31, 6)\n"
    )
    bench.ticks(1)
    assert bench["standard_analog_output0"] == pytest.approx(0.004)
    assert bench["output_bit_register_64"] is True
    assert bench["output_bit_registers0_to_31"] == 1 << 31
    bench.start("sleep(0.1)")
    bench.ticks(2)
    assert bench["standard_analog_output0"] == pytest.approx(0.020)
    bench.controller.power_off()
    bench.seconds(2.0)
    assert bench["output_bit_registers0_to_31"] == 0


# Inputs that act


@pytest.mark.parametrize("place", ["standard", "configurable", "tool", "register"])
def test_an_input_switches_freedrive_on(bench, place):
    pins = {"standard": 1 << 1, "configurable": 1 << 9, "tool": 1 << 17}
    if place == "register":
        bench.run('set_gp_boolean_input_action(65, "freedrive")')
    else:
        bench.run(f'set_{place}_digital_input_action(1, "freedrive")')

    def switch(on):
        if place == "register":
            bench.write(input_bit_register_65=on)
        else:
            bench.controller.signals.set_digital_inputs(pins[place] if on else 0)
        bench.ticks(2)

    assert not bench.controller.plant.compliance.freedrive
    switch(True)
    assert bench.controller.plant.compliance.freedrive
    switch(False)
    assert not bench.controller.plant.compliance.freedrive
    bench.run("set_input_actions_to_default()")
    switch(True)
    assert not bench.controller.plant.compliance.freedrive


def test_freedrive_by_an_input_leaves_a_program_alone(bench):
    bench.run('set_standard_digital_input_action(0, "freedrive")')
    bench.controller.signals.set_digital_inputs(1)
    bench.start("sleep(0.1)")
    bench.ticks(3)
    assert not bench.controller.plant.compliance.freedrive
    bench.until(lambda: bench.controller.runtime_state == RuntimeState.STOPPED)
    bench.ticks(2)
    assert bench.controller.plant.compliance.freedrive
