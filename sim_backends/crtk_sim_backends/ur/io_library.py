"""The URScript built-ins for registers, digital and analog signals.

Names, parameters and defaults follow the URScript manual, chapters "internals" and "interfaces".
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from crtk_sim_backends.ur.urscript import Builtin, ScriptRuntimeError

if TYPE_CHECKING:
    from crtk_sim_backends.ur.controller import Controller

WATCHDOG_ACTIONS = ("ignore", "pause", "stop")

# Digital signals by kind: first bit, number of signals (RTDE actual_digital_*_bits).
DIGITAL = {"standard": (0, 8), "configurable": (8, 8), "tool": (16, 2)}


def io_builtins(controller: Controller) -> Iterator[Builtin]:
    """Every built-in of this module for one controller."""
    for group in (_registers, _signals):
        for call in group(controller):
            yield Builtin(call.__name__, call)


def _registers(c: Controller) -> list[Callable[..., Any]]:
    inputs = c.inputs
    outputs = c.outputs

    def names(template: str, count: int, first: int = 0) -> dict[float, str]:
        return {i: template.format(i) for i in range(first, count)}

    float_in = names("input_double_register_{}", 48)
    int_in = names("input_int_register_{}", 48)
    float_out = names("output_double_register_{}", 48)
    int_out = names("output_int_register_{}", 48)

    def lookup(table: dict[float, str], address: Any) -> str:
        try:
            return table[address]
        except (KeyError, TypeError):
            raise ScriptRuntimeError(f"Register address out of range: {address}") from None

    def read_input_float_register(address: int) -> float:
        return inputs[lookup(float_in, address)]  # type: ignore[no-any-return]

    def read_input_integer_register(address: int) -> int:
        return inputs[lookup(int_in, address)]  # type: ignore[no-any-return]

    def read_output_float_register(address: int) -> float:
        return outputs[lookup(float_out, address)]  # type: ignore[no-any-return]

    def read_output_integer_register(address: int) -> int:
        return outputs[lookup(int_out, address)]  # type: ignore[no-any-return]

    def write_output_float_register(address: int, value: float) -> None:
        outputs[lookup(float_out, address)] = float(value)

    def write_output_integer_register(address: int, value: int) -> None:
        number = int(value)
        if not -(2**31) <= number < 2**31:
            raise ScriptRuntimeError(f"Register value out of range: {value}")
        outputs[lookup(int_out, address)] = number

    def bit(direction: str, address: Any) -> tuple[str, int]:
        if not isinstance(address, (int, float)) or not 0 <= address < 128:
            raise ScriptRuntimeError(f"Register address out of range: {address}")
        index = int(address)
        if index < 64:
            span = "0_to_31" if index < 32 else "32_to_63"
            return f"{direction}_bit_registers{span}", 1 << index % 32
        return f"{direction}_bit_register_{index}", 0

    def read_bit(image: dict[str, Any], direction: str, address: int) -> bool:
        name, mask = bit(direction, address)
        return bool(image[name] & mask if mask else image[name])

    def read_input_boolean_register(address: int) -> bool:
        return read_bit(inputs, "input", address)

    def read_output_boolean_register(address: int) -> bool:
        return read_bit(outputs, "output", address)

    def write_output_boolean_register(address: int, value: bool) -> None:
        name, mask = bit("output", address)
        if not mask:
            outputs[name] = bool(value)
        else:
            outputs[name] = outputs[name] | mask if value else outputs[name] & ~mask

    def rtde_set_watchdog(variable_name: str, min_frequency: float, action: str = "pause") -> None:
        if variable_name not in inputs:
            raise ScriptRuntimeError(f"rtde_set_watchdog: no input variable {variable_name}")
        if action.lower() not in WATCHDOG_ACTIONS:
            raise ScriptRuntimeError(f"rtde_set_watchdog: unknown action {action}")
        c.player.set_watchdog(variable_name, float(min_frequency), action.lower())

    return [
        read_input_float_register,
        read_input_integer_register,
        read_input_boolean_register,
        read_output_float_register,
        read_output_integer_register,
        read_output_boolean_register,
        write_output_float_register,
        write_output_integer_register,
        write_output_boolean_register,
        rtde_set_watchdog,
    ]


def _signals(c: Controller) -> list[Callable[..., Any]]:
    out = c.outputs

    def bit(kind: str, n: Any) -> int:
        first, count = DIGITAL[kind]
        if not isinstance(n, (int, float)) or not 0 <= n < count:
            raise ScriptRuntimeError(f"No {kind} digital signal {n}")
        return first + int(n)

    def reader(name: str, kind: str, image: str) -> Callable[[int], bool]:
        def read(n: int) -> bool:
            return bool(out[image] >> bit(kind, n) & 1)

        read.__name__ = name
        return read

    def writer(name: str, kind: str) -> Callable[[int, bool], None]:
        def write(n: int, b: bool) -> None:
            c.signals.set_digital_outputs(1 << bit(kind, n), (1 << bit(kind, n)) if b else 0)

        write.__name__ = name
        return write

    def set_standard_analog_out(n: int, f: float) -> None:
        if n not in (0, 1) or not 0.0 <= f <= 1.0:
            raise ScriptRuntimeError(f"set_standard_analog_out: channel {n}, value {f}")
        c.signals.set_analog_output(int(n), float(f))

    def set_analog_out(n: int, f: float) -> None:
        set_standard_analog_out(n, f)

    def get_standard_analog_in(n: int) -> float:
        if n not in (0, 1):
            raise ScriptRuntimeError(f"get_standard_analog_in: channel {n}")
        return float(out[f"standard_analog_input{int(n)}"])

    def get_standard_analog_out(n: int) -> float:
        if n not in (0, 1):
            raise ScriptRuntimeError(f"get_standard_analog_out: channel {n}")
        return float(out[f"standard_analog_output{int(n)}"])

    def get_tool_analog_in(n: int) -> float:
        if n not in (0, 1):
            raise ScriptRuntimeError(f"get_tool_analog_in: channel {n}")
        return float(out[f"tool_analog_input{int(n)}"])

    def set_tool_voltage(voltage: int) -> None:
        if voltage not in (0, 12, 24):
            raise ScriptRuntimeError(f"set_tool_voltage: 0, 12 or 24 V, not {voltage}")
        out["tool_output_voltage"] = int(voltage)

    inputs = "actual_digital_input_bits"
    outputs = "actual_digital_output_bits"
    calls: list[Callable[..., Any]] = []
    for kind in DIGITAL:
        calls.append(reader(f"get_{kind}_digital_in", kind, inputs))
        calls.append(reader(f"get_{kind}_digital_out", kind, outputs))
        calls.append(writer(f"set_{kind}_digital_out", kind))
    return [
        *calls,
        reader("get_digital_in", "standard", inputs),
        reader("get_digital_out", "standard", outputs),
        writer("set_digital_out", "standard"),
        set_standard_analog_out,
        set_analog_out,
        get_standard_analog_in,
        get_standard_analog_out,
        get_tool_analog_in,
        set_tool_voltage,
    ]
