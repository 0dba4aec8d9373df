"""The URScript built-ins for digital and analog signals, the tool, and how they are configured.

Names, parameters and values follow the URScript manual, chapters "interfaces" and "ioconfiguration".
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping
from typing import Any, Final, Protocol, TypeAlias

from crtk_sim_backends.ur.models import RobotModel
from crtk_sim_backends.ur.signals.control_box import (
    ANALOG_INPUTS,
    ANALOG_OUTPUTS,
    DIGITAL,
    TOOL_VOLTAGES,
    Signals,
)
from crtk_sim_backends.ur.signals.registers import BOOLEANS, boolean_written, read_boolean
from crtk_sim_backends.ur.signals.state_signals import ACTIONS, CHOICES, POWER_CHOICES, StateSignals
from crtk_sim_backends.ur.signals.tool_line import BAUD_RATES, PARITIES, LineSettings
from crtk_sim_backends.ur.urscript import Builtin, ScriptRuntimeError

_PINS: Final[Mapping[str, tuple[int, ...]]] = {
    **{kind: tuple(range(first, first + count)) for kind, (first, count) in DIGITAL.items()},
    "": (*range(8), 16, 17),  # of the deprecated functions
}
"""Bits of the digital signals that functions of one kind have, by number."""

_EUROMAP: Final = range(32)
_EUROMAP_OUTPUTS: Final = "euromap67_output_bits"

_INPUTS: Final = "actual_digital_input_bits"
_OUTPUTS: Final = "actual_digital_output_bits"

_POWER_MODE: Final = (0, 1)  # digital outputs, or power on both pins
_PIN_MODES: Final = (1, 2, 3)  # sinking (NPN), sourcing (PNP), push-pull

Call: TypeAlias = Callable[..., Any]
SetOutput: TypeAlias = Callable[[int, bool], object]


class Robot(Protocol):
    """Whose signals they are.

    Attributes:
        model: of the arm.
        inputs: process image by RTDE input variable name.
        outputs: the same by RTDE output variable name.
        signals: digital and analog signals.
        state_signals: outputs that follow the state, and inputs that act.
    """

    model: RobotModel
    inputs: dict[str, Any]
    outputs: dict[str, Any]
    signals: Signals
    state_signals: StateSignals

    def set_tool_communication(self, settings: LineSettings) -> None:
        """Set the serial line to the tool."""


def signal_builtins(robot: Robot) -> Iterator[Builtin]:
    """Every built-in of this module for one robot."""
    groups = [_digital, _analog, _flags, _tool, _actions, _run_state, _euromap]
    if not robot.model.is_cb3:
        groups.append(_tool_connector)
    for group in groups:
        for name, call in group(robot).items():
            yield Builtin(name, call)


def _one_of(name: str, what: str, value: Any, choices: Container[Any]) -> int:
    """Refuse what is none of the choices."""
    if not isinstance(value, (int, float)) or value not in choices:
        raise ScriptRuntimeError(f"{name}: no {what} {value}")
    return int(value)


def _pin(name: str, kind: str, n: Any) -> int:
    pins = _PINS[kind]
    return pins[_one_of(name, "digital signal", n, range(len(pins)))]


def _digital(robot: Robot) -> dict[str, Call]:
    out = robot.outputs

    def reader(name: str, kind: str, image: str) -> Call:
        def read(n: int) -> bool:
            return bool(out[image] >> _pin(name, kind, n) & 1)

        return read

    def writer(name: str, kind: str) -> Call:
        def write(n: int, b: bool) -> None:
            robot.signals.set_digital_outputs(1 << _pin(name, kind, n), -1 if b else 0)

        return write

    calls: dict[str, Call] = {}
    for kind in _PINS:
        stem = f"{kind}_digital" if kind else "digital"
        for name, image in ((f"get_{stem}_in", _INPUTS), (f"get_{stem}_out", _OUTPUTS)):
            calls[name] = reader(name, kind, image)
        calls[f"set_{stem}_out"] = writer(f"set_{stem}_out", kind)
    return calls


def _analog(robot: Robot) -> dict[str, Call]:
    out = robot.outputs

    def reader(name: str, signals: tuple[str, ...]) -> Call:
        def read(n: int) -> float:
            return float(out[signals[_one_of(name, "analog signal", n, range(len(signals)))]])

        return read

    def writer(name: str) -> Call:
        def write(n: int, f: float) -> None:
            channel = _one_of(name, "analog signal", n, (0, 1))
            if not 0.0 <= f <= 1.0:
                raise ScriptRuntimeError(f"{name}: a level lies in 0 to 1, not {f}")
            robot.signals.set_analog_output(channel, float(f))

        return write

    def domain(name: str, signals: tuple[str, ...]) -> Call:
        def set_domain(port: int, domain: int) -> None:
            signal = signals[_one_of(name, "analog signal", port, range(len(signals)))]
            voltage = bool(_one_of(name, "domain", domain, (0, 1)))
            robot.signals.set_domain(signal, voltage=voltage)

        return set_domain

    def set_analog_inputrange(port: int, range: int) -> None:
        name = "set_analog_inputrange"
        port = _one_of(name, "analog signal", port, (0, 1, 2, 3))
        at_tool = port > 1
        range = _one_of(name, "range", range, (0, 1, 2) if at_tool else (0, 2))
        robot.signals.set_domain(ANALOG_INPUTS[port], voltage=not (at_tool and range == 2))

    standard, tool = ANALOG_INPUTS[:2], ANALOG_INPUTS[2:]
    return {
        "get_standard_analog_in": reader("get_standard_analog_in", standard),
        "get_tool_analog_in": reader("get_tool_analog_in", tool),
        "get_standard_analog_out": reader("get_standard_analog_out", ANALOG_OUTPUTS),
        "get_analog_in": reader("get_analog_in", ANALOG_INPUTS),
        "get_analog_out": reader("get_analog_out", ANALOG_OUTPUTS),
        "set_standard_analog_out": writer("set_standard_analog_out"),
        "set_analog_out": writer("set_analog_out"),
        "set_standard_analog_input_domain": domain("set_standard_analog_input_domain", standard),
        "set_tool_analog_input_domain": domain("set_tool_analog_input_domain", tool),
        "set_analog_outputdomain": domain("set_analog_outputdomain", ANALOG_OUTPUTS),
        "set_analog_inputrange": set_analog_inputrange,
    }


def _flags(robot: Robot) -> dict[str, Call]:
    flags = [False] * 32  # kept between program runs

    def get_flag(n: int) -> bool:
        return flags[_one_of("get_flag", "flag", n, range(32))]

    def set_flag(n: int, b: bool) -> None:
        flags[_one_of("set_flag", "flag", n, range(32))] = bool(b)

    return {"get_flag": get_flag, "set_flag": set_flag}


def _tool(robot: Robot) -> dict[str, Call]:
    def set_tool_voltage(voltage: int) -> None:
        robot.signals.set_tool_voltage(
            _one_of("set_tool_voltage", "voltage", voltage, TOOL_VOLTAGES)
        )

    return {"set_tool_voltage": set_tool_voltage}


def _tool_connector(robot: Robot) -> dict[str, Call]:
    """What the tool connector of the e-Series has beyond that of CB3."""
    out = robot.outputs

    def set_tool_output_mode(mode: int) -> None:
        out["tool_output_mode"] = _one_of("set_tool_output_mode", "mode", mode, _POWER_MODE)

    def set_tool_digital_output_mode(n: int, mode: int) -> None:
        name = "set_tool_digital_output_mode"
        pin = _one_of(name, "tool output", n, (0, 1))
        out[f"tool_digital_output{pin}_mode"] = _one_of(name, "mode", mode, _PIN_MODES)

    def set_tool_communication(
        enabled: bool,
        baud_rate: int,
        parity: int,
        stop_bits: int,
        rx_idle_chars: float,
        tx_idle_chars: float,
    ) -> None:
        name = "set_tool_communication"
        for what, value, low in (("rx", rx_idle_chars, 1.0), ("tx", tx_idle_chars, 0.0)):
            if not low <= value <= 40.0:
                raise ScriptRuntimeError(
                    f"{name}: {what}_idle_chars lies in {low:g} to 40, not {value}"
                )
        robot.set_tool_communication(
            LineSettings(
                enabled=bool(enabled),
                baud=_one_of(name, "baud rate", baud_rate, BAUD_RATES),
                parity=_one_of(name, "parity", parity, range(len(PARITIES))),
                stop_bits=_one_of(name, "number of stop bits", stop_bits, (1, 2)),
                rx_idle=float(rx_idle_chars),
                tx_idle=float(tx_idle_chars),
            )
        )

    return {
        "set_tool_output_mode": set_tool_output_mode,
        "set_tool_digital_output_mode": set_tool_digital_output_mode,
        "set_tool_communication": set_tool_communication,
    }


def _euromap(robot: Robot) -> dict[str, Call]:
    """Euromap 67: what is set and read, without a machine at the other end."""
    out = robot.outputs

    def reader(name: str, image: str) -> Call:
        def read(port_number: int) -> bool:
            return bool(out[image] >> _one_of(name, "Euromap signal", port_number, _EUROMAP) & 1)

        return read

    def put(port: int, level: bool) -> None:
        bit = 1 << port
        bits = out[_EUROMAP_OUTPUTS]
        out[_EUROMAP_OUTPUTS] = bits | bit if level else bits & ~bit

    def set_euromap_output(port_number: int, signal_level: bool) -> None:
        port = _one_of("set_euromap_output", "Euromap signal", port_number, _EUROMAP)
        put(port, bool(signal_level))

    def set_euromap_runstate_dependent_choice(port_number: int, runstate_choice: int) -> None:
        name = "set_euromap_runstate_dependent_choice"
        port = _one_of(name, "Euromap signal", port_number, _EUROMAP)
        choice = _one_of(name, "state", runstate_choice, CHOICES)
        robot.state_signals.set_choice(f"{name} {port}", lambda level: put(port, level), choice)

    return {
        "get_euromap_input": reader("get_euromap_input", "euromap67_input_bits"),
        "get_euromap_output": reader("get_euromap_output", _EUROMAP_OUTPUTS),
        "set_euromap_output": set_euromap_output,
        "set_euromap_runstate_dependent_choice": set_euromap_runstate_dependent_choice,
    }


def input_action(name: str, action: Any) -> str:
    """Check the action that a built-in is to give to an input."""
    if action not in ACTIONS:
        raise ScriptRuntimeError(f"{name}: no action {action}")
    return str(action)


def _actions(robot: Robot) -> dict[str, Call]:
    """What inputs do beside being read."""

    def setter(name: str, kind: str) -> Call:
        def set_action(port: int, action: str) -> None:
            bit = _pin(name, kind, port)
            robot.state_signals.set_action(
                f"{kind} input {port}",
                lambda: bool(robot.outputs[_INPUTS] >> bit & 1),
                input_action(name, action),
            )

        return set_action

    def set_gp_boolean_input_action(port: int, action: str) -> None:
        name = "set_gp_boolean_input_action"
        register = _one_of(name, "boolean register", port, range(BOOLEANS))
        robot.state_signals.set_action(
            f"boolean input register {register}",
            lambda: read_boolean(robot.inputs, "input", register),
            input_action(name, action),
        )

    def set_input_actions_to_default() -> None:
        robot.state_signals.clear_actions()

    return {
        **{
            f"set_{kind}_digital_input_action": setter(f"set_{kind}_digital_input_action", kind)
            for kind in DIGITAL
        },
        "set_gp_boolean_input_action": set_gp_boolean_input_action,
        "set_input_actions_to_default": set_input_actions_to_default,
    }


def _run_state(robot: Robot) -> dict[str, Call]:
    """Outputs that follow the program and the power of the arm."""

    def set_register(register: int, level: bool) -> None:
        robot.outputs.update(boolean_written(robot.outputs, "output", register, level))

    def digital(kind: str) -> SetOutput:
        first = DIGITAL[kind][0]
        return lambda n, level: robot.signals.set_digital_outputs(
            1 << first + n, -1 if level else 0
        )

    def setter(name: str, set_output: SetOutput, count: int, choices: range) -> Call:
        def set_choice(outputId: int, state: int) -> None:  # noqa: N803
            output = _one_of(name, "output", outputId, range(count))
            choice = _one_of(name, "state", state, choices)
            robot.state_signals.set_choice(
                f"{name} {output}", lambda level: set_output(output, level), choice
            )

        return set_choice

    rows: tuple[tuple[str, SetOutput, int, range], ...] = (
        ("standard_digital_output", digital("standard"), 8, POWER_CHOICES),
        ("configurable_digital_output", digital("configurable"), 8, POWER_CHOICES),
        ("tool_digital_output", digital("tool"), 2, CHOICES),
        ("standard_analog_output", robot.signals.set_analog_output, 2, POWER_CHOICES),
        ("gp_boolean_output", set_register, BOOLEANS, POWER_CHOICES),
    )
    calls: dict[str, Call] = {
        (name := f"set_runstate_{stem}_to_value"): setter(name, set_output, count, choices)
        for stem, set_output, count, choices in rows
    }

    def set_low_when_stopped(outputs: list[int]) -> None:
        for output in outputs:
            calls["set_runstate_standard_digital_output_to_value"](output, 1)

    # In no manual: what PolyScope writes at the start of a program, and before 3.0 wrote (urx).
    calls["set_runstate_standard_digital_outputs"] = set_low_when_stopped
    calls["set_runstate_outputs"] = set_low_when_stopped
    return calls
