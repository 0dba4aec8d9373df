"""The URScript built-ins for registers and for what Modbus clients share with programs.

Names, parameters and defaults follow the URScript manual, chapter "interfaces".
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from crtk_sim_backends.ur.program.player import ProgramPlayer
from crtk_sim_backends.ur.signals.port_map import PortError, PortMap, PortTable
from crtk_sim_backends.ur.signals.registers import BOOLEANS, boolean_written, read_boolean
from crtk_sim_backends.ur.urscript import Builtin, ScriptRuntimeError

WATCHDOG_ACTIONS = ("ignore", "pause", "stop")


def io_builtins(
    inputs: Mapping[str, Any], outputs: dict[str, Any], player: ProgramPlayer, port_map: PortMap
) -> Iterator[Builtin]:
    """Every built-in of this module for one controller.

    Args:
        inputs: process image by RTDE input variable name.
        outputs: the same by RTDE output variable name.
        player: watches over inputs.
        port_map: registers and bits of the Modbus server.
    """
    for call in (*_registers(inputs, outputs, player), *_ports(port_map)):
        yield Builtin(call.__name__, call)


def _registers(
    inputs: Mapping[str, Any], outputs: dict[str, Any], player: ProgramPlayer
) -> list[Callable[..., Any]]:

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

    def boolean(address: Any) -> int:
        if not isinstance(address, (int, float)) or not 0 <= address < BOOLEANS:
            raise ScriptRuntimeError(f"Register address out of range: {address}")
        return int(address)

    def read_input_boolean_register(address: int) -> bool:
        return read_boolean(inputs, "input", boolean(address))

    def read_output_boolean_register(address: int) -> bool:
        return read_boolean(outputs, "output", boolean(address))

    def write_output_boolean_register(address: int, value: bool) -> None:
        outputs.update(boolean_written(outputs, "output", boolean(address), bool(value)))

    def pause_on_error_code(code: int, argument: int | None = None) -> None:
        player.pauses_on.add((int(code), None if argument is None else int(argument)))

    def rtde_set_watchdog(variable_name: str, min_frequency: float, action: str = "pause") -> None:
        if variable_name not in inputs:
            raise ScriptRuntimeError(f"rtde_set_watchdog: no input variable {variable_name}")
        if action.lower() not in WATCHDOG_ACTIONS:
            raise ScriptRuntimeError(f"rtde_set_watchdog: unknown action {action}")
        player.set_watchdog(variable_name, float(min_frequency), action.lower())

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
        pause_on_error_code,
    ]


def _ports(port_map: PortMap) -> list[Callable[..., Any]]:
    registers = port_map.registers
    bits = port_map.bits

    def read(name: str, table: PortTable, address: int) -> int:
        try:
            return table[address]
        except PortError as error:
            raise ScriptRuntimeError(f"{name}: {error}") from None

    def write(name: str, table: PortTable, address: int, value: int) -> None:
        try:
            table[address] = value
        except (PortError, ValueError) as error:
            raise ScriptRuntimeError(f"{name}: {error}") from None

    def read_port_bit(address: int) -> bool:
        return bool(read("read_port_bit", bits, address))

    def read_port_register(address: int) -> int:
        word = read("read_port_register", registers, address)
        return word - 0x10000 if word & 0x8000 else word

    def write_port_bit(address: int, value: bool) -> None:
        write("write_port_bit", bits, address, int(bool(value)))

    def write_port_register(address: int, value: int) -> None:
        if not -0x8000 <= value <= 0x10000:
            raise ScriptRuntimeError(f"write_port_register: value out of range: {value}")
        write("write_port_register", registers, address, int(value) & 0xFFFF)

    return [read_port_bit, read_port_register, write_port_bit, write_port_register]
