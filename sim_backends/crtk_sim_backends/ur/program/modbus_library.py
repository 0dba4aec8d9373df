"""The URScript built-ins by which a program reads and writes the signals of Modbus units.

Source: URScript manual, chapters "interfaces" and "ioconfiguration". An address may have a port
("127.0.0.1:1502"), which a robot does not know: it always asks port 502.
"""

from __future__ import annotations

import importlib.util
import re
import time
from collections.abc import Callable, Generator, Iterator
from typing import Any, Final

from crtk_sim_backends.ur.program.signal_library import input_action
from crtk_sim_backends.ur.signals.modbus_client import (
    KINDS,
    READ_WRITE,
    ModbusUnits,
    Signal,
    UnitConnection,
)
from crtk_sim_backends.ur.signals.state_signals import CHOICES, StateSignals
from crtk_sim_backends.ur.urscript import Builtin, List, ScriptRuntimeError

_LONGEST_NAME: Final = 20  # characters
_LARGEST_COUNT: Final = 123
_MOST_WRITTEN: Final = 121  # of function 23, by the Modbus specification; the manual says 123
_SIGNALS: Final = 100
_ADDRESS: Final = r"\d{1,3}(\.\d{1,3}){3}(:\d{1,5})?"

Call = Callable[..., Any]


def modbus_builtins(state_signals: StateSignals, units: ModbusUnits) -> Iterator[Builtin]:
    """Every built-in of this module for one controller."""
    for call in _settings(state_signals, units):
        yield Builtin(call.__name__, call)
    for call in _blocking(units):
        yield Builtin(call.__name__, call, blocking=True)


def _integer(name: str, what: str, value: Any, low: int, high: int) -> int:
    if not isinstance(value, (int, float)) or not low <= value <= high:
        raise ScriptRuntimeError(f"{name}: {what} lies in {low} to {high}, not {value}")
    return int(value)


def _address(name: str, value: Any) -> str:
    if not isinstance(value, str) or not re.fullmatch(_ADDRESS, value):
        raise ScriptRuntimeError(f"{name}: no IP address {value}")
    if importlib.util.find_spec("pymodbus") is None:
        raise ScriptRuntimeError(
            f"{name}: the simulator needs pymodbus; `pip install 'crtk-drivers[ur-sim]'`"
        )
    return value


def _find(units: ModbusUnits, name: str, signal_name: Any) -> tuple[Signal, UnitConnection]:
    found = units.find(signal_name) if isinstance(signal_name, str) else None
    if found is None:
        raise ScriptRuntimeError(f"{name}: no Modbus signal {signal_name}")
    return found


def _settings(state_signals: StateSignals, units: ModbusUnits) -> list[Call]:
    def named(name: str, signal_name: Any) -> str:
        if not isinstance(signal_name, str) or not 0 < len(signal_name) <= _LONGEST_NAME:
            raise ScriptRuntimeError(f"{name}: a name has 1 to {_LONGEST_NAME} characters")
        if units.find(signal_name) is None and units.count >= _SIGNALS:
            raise ScriptRuntimeError(f"{name}: more than {_SIGNALS} signals")
        return signal_name

    def add(name: str, address: Any, signal: Signal) -> None:
        try:
            units.add(_address(name, address), signal)
        except OverflowError as error:
            raise ScriptRuntimeError(f"{name}: {error}") from None
        state_signals.forget(_label(signal.name))

    def modbus_add_signal(
        IP: str,  # noqa: N803
        slave_number: int,
        signal_address: int,
        signal_type: int,
        signal_name: str,
        sequential_mode: bool = False,
        register_count: int = 1,
    ) -> None:
        name = "modbus_add_signal"
        if signal_type not in KINDS:
            raise ScriptRuntimeError(f"{name}: no signal type {signal_type}")
        signal = Signal(
            named(name, signal_name),
            KINDS[int(signal_type)],
            _integer(name, "slave_number", slave_number, 0, 255),
            _integer(name, "signal_address", signal_address, 0, 65535),
            _integer(name, "register_count", register_count, 1, _LARGEST_COUNT),
        )
        add(name, IP, signal)

    def modbus_add_rw_signal(
        IP: str,  # noqa: N803
        slave_number: int,
        read_address: int,
        read_register_count: int,
        write_address: int,
        write_register_count: int,
        signal_name: str,
        sequential_mode: bool = False,
    ) -> None:
        name = "modbus_add_rw_signal"
        signal = Signal(
            named(name, signal_name),
            READ_WRITE,
            _integer(name, "slave_number", slave_number, 0, 255),
            _integer(name, "read_address", read_address, 0, 65535),
            _integer(name, "read_register_count", read_register_count, 1, _LARGEST_COUNT),
            (
                _integer(name, "write_address", write_address, 0, 65535),
                _integer(name, "write_register_count", write_register_count, 1, _MOST_WRITTEN),
            ),
        )
        add(name, IP, signal)

    def modbus_delete_signal(signal_name: str) -> None:
        units.delete(signal_name)
        state_signals.forget(_label(signal_name))

    def set_output(name: str, signal_name: str, value: Any, *, bits: bool) -> None:
        signal, connection = _find(units, name, signal_name)
        if not signal.kind.output or signal.kind.bits is not bits:
            what = "digital output" if bits else "register output"
            raise ScriptRuntimeError(f"{name}: {signal_name} is no {what}")
        values = list(value) if isinstance(value, list) else [value]
        if not 0 < len(values) <= signal.settable:
            raise ScriptRuntimeError(f"{name}: {signal_name} takes 1 to {signal.settable} values")
        words = [_integer(name, "a value", x, 0, 1 if bits else 65535) for x in values]
        signal.wanted = (*words, *signal.present[len(words) :])
        connection.request(signal)

    def modbus_set_output_register(
        signal_name: str, register_value: Any, is_secondary_program: bool = False
    ) -> None:
        set_output("modbus_set_output_register", signal_name, register_value, bits=False)

    def modbus_set_output_signal(
        signal_name: str, digital_value: Any, is_secondary_program: bool = False
    ) -> None:
        set_output("modbus_set_output_signal", signal_name, digital_value, bits=True)

    def modbus_set_signal_update_frequency(signal_name: str, update_frequency: int) -> None:
        name = "modbus_set_signal_update_frequency"
        signal, connection = _find(units, name, signal_name)
        signal.frequency = _integer(name, "update_frequency", update_frequency, -1, 500)
        connection.request(signal)

    def modbus_set_signal_watchdog(signal_name: str, new_timeout_in_sec: float) -> None:
        name = "modbus_set_signal_watchdog"
        signal, _ = _find(units, name, signal_name)
        if not 0 <= new_timeout_in_sec <= 300:
            raise ScriptRuntimeError(f"{name}: a timeout lies in 0 to 300 s")
        signal.watchdog = float(new_timeout_in_sec)

    def modbus_request_update_signal_value(signal_name: str) -> None:
        signal, connection = _find(units, "modbus_request_update_signal_value", signal_name)
        connection.request(signal)

    def modbus_get_error(signal_name: str, error_source: int = 0) -> int:
        answer = _find(units, "modbus_get_error", signal_name)[0].answer
        device, connection = answer.device_error, answer.connection_error
        combined = (connection << 16) | device
        return (combined, device, connection)[
            _integer("modbus_get_error", "error_source", error_source, 0, 2)
        ]

    def modbus_get_time_since_signal_invalid(signal_name: str) -> float:
        name = "modbus_get_time_since_signal_invalid"
        return _find(units, name, signal_name)[0].invalid_for

    def modbus_send_custom_command(
        IP: str,  # noqa: N803
        slave_number: int,
        function_code: int,
        data: List,
    ) -> None:
        name = "modbus_send_custom_command"
        address = _address(name, IP)
        content = bytes(_integer(name, "a byte", x, 0, 255) for x in data)
        unit = _integer(name, "slave_number", slave_number, 0, 255)
        function = _integer(name, "function_code", function_code, 1, 127)
        try:
            units.connection(address).command(unit, function, content)
        except OverflowError as error:
            raise ScriptRuntimeError(f"{name}: {error}") from None

    def modbus_set_runstate_dependent_choice(signal_name: str, runstate_choice: int) -> None:
        name = "modbus_set_runstate_dependent_choice"
        signal, _ = _find(units, name, signal_name)
        if not signal.kind.output:
            raise ScriptRuntimeError(f"{name}: {signal_name} is no output")
        bits = signal.kind.bits
        choice = _integer(name, "runstate_choice", runstate_choice, 0, len(CHOICES) - 1)
        high = 1 if bits else 65535
        state_signals.set_choice(
            _label(signal_name),
            lambda level: set_output(name, signal_name, high if level else 0, bits=bits),
            choice,
        )

    def modbus_set_digital_input_action(signal_name: str, action: str) -> None:
        name = "modbus_set_digital_input_action"
        signal, _ = _find(units, name, signal_name)
        if signal.kind is not KINDS[0]:
            raise ScriptRuntimeError(f"{name}: {signal_name} is no digital input")
        state_signals.set_action(
            _label(signal_name),
            lambda: signal.valid and any(signal.answer.values or ()),
            input_action(name, action),
        )

    return [
        modbus_add_signal,
        modbus_add_rw_signal,
        modbus_delete_signal,
        modbus_set_output_register,
        modbus_set_output_signal,
        modbus_set_signal_update_frequency,
        modbus_set_signal_watchdog,
        modbus_request_update_signal_value,
        modbus_get_error,
        modbus_get_time_since_signal_invalid,
        modbus_send_custom_command,
        modbus_set_runstate_dependent_choice,
        modbus_set_digital_input_action,
    ]


def _label(signal_name: str) -> str:
    return f"Modbus signal {signal_name}"


def _blocking(units: ModbusUnits) -> list[Call]:
    def modbus_get_signal_status(
        signal_name: str, is_secondary_program: bool = False
    ) -> Generator[None, None, Any]:
        """Wait for a first value, and for each one of a signal without update frequency."""
        name = "modbus_get_signal_status"
        signal, connection = _find(units, name, signal_name)
        before = signal.answer.count
        if signal.frequency <= 0:
            connection.request(signal)
        deadline = time.monotonic() + signal.watchdog
        while time.monotonic() < deadline and (
            signal.answer.values is None
            or (signal.frequency <= 0 and signal.answer.count == before)
        ):
            yield
        answer = signal.answer
        if answer.values is None or signal.invalid_for > signal.watchdog:
            raise ScriptRuntimeError(
                f"{name}: no valid answer for {signal_name} in {signal.watchdog:g} s (device error "
                f"{answer.device_error}, connection error {answer.connection_error})"
            )
        values = [bool(x) for x in answer.values] if signal.kind.bits else answer.values
        return values[0] if signal.count == 1 else List(values)

    def modbus_reset_connection(
        connection_id: str, is_blocking: bool = True
    ) -> Generator[None, None, None]:
        name = "modbus_reset_connection"
        if not isinstance(connection_id, str) or not units.known(connection_id):
            raise ScriptRuntimeError(f"{name}: no Modbus unit {connection_id}")
        connection = units.connection(connection_id)
        before = {signal: signal.answer.count for signal in connection.signals}
        connection.reset()
        while is_blocking and any(
            signal.answer.connection_error or signal.answer.count == count
            for signal, count in before.items()
        ):
            yield

    return [modbus_get_signal_status, modbus_reset_connection]
