"""The bits and 16-bit registers of a controller that Modbus clients and programs share, as tables.

Source: UR support article 16377 "Modbus Server" with its list "ModBus server data" (software 3.1 and
later). Both tables serve the Modbus server and URScript's `read_port_register`, `write_port_bit`, ...
Registers are unsigned 16-bit; a negative value is its two's complement. The list does not say how
analog values fill their range: here 0 to 65535 is the whole range of the signal, 0-10 V or 4-20 mA.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import dataclass
from math import tau
from typing import Any, Final, TypeAlias

from crtk_sim_backends.ur.clock import Clock
from crtk_sim_backends.ur.safety.modes import RobotStatus, SafetyStatus
from crtk_sim_backends.ur.signals.control_box import (
    ANALOG_INPUTS,
    ANALOG_OUTPUTS,
    TOOL_VOLTAGES,
    Signals,
    to_ratio,
)
from crtk_sim_backends.ur.signals.registers import boolean_written, read_boolean
from crtk_sim_backends.ur.versions import Version

Read: TypeAlias = Callable[["PortMap", int], Any]
Write: TypeAlias = Callable[["PortMap", int, int], object]

GENERAL_PURPOSE: Final = range(128, 256)
"""Addresses of the registers that belong to users."""

_WORD: Final = 1 << 16
_TIME_UNITS: Final = ((1, 1000), (1000, 60), (60_000, 60), (3_600_000, 24), (86_400_000, _WORD))
_TENTHS: Final = (1e4, 1e4, 1e4, 1e3, 1e3, 1e3)  # of mm, mrad


class PortError(LookupError):
    """There is no such address, or it cannot be written."""


@dataclass(frozen=True, slots=True)
class Ports:
    """A run of addresses of the same kind; `read` and `write` get the index in the run.

    Attributes:
        first: address of the first.
        count: how many there are.
        name: what they are, with the unit.
        read: present value.
        write: sets it; None: read only.
        accepts: the values that can be set.
    """

    first: int
    count: int
    name: str
    read: Read
    write: Write | None = None
    accepts: Container[int] = range(_WORD)

    @property
    def addresses(self) -> range:
        """The addresses."""
        return range(self.first, self.first + self.count)


def _vector(variable: str, *scales: float) -> Read:
    """Items of a vector output, rounded; one scale for all, or one for each."""

    def read(m: PortMap, index: int) -> Any:
        return round(m.outputs[variable][index] * scales[index % len(scales)])

    return read


def _scalar(variable: str, scale: float = 1.0) -> Read:
    return lambda m, _: round(m.outputs[variable] * scale)


def _turns(m: PortMap, joint: int) -> tuple[int, int]:
    """Whole turns of a joint, and the rest in mrad (0 to 6283)."""
    turns, rest = divmod(m.outputs["actual_q"][joint], tau)
    return int(turns), round(rest * 1000.0)


# Digital signals. `bits` says where each bit of a word is in the digital bits of RTDE.

_BOX_AND_TOOL: Final = (*range(8), 16, 17)
_CONFIGURABLE: Final = tuple(range(8, 16))
_TOOL: Final = (16, 17)

_INPUTS: Final = "actual_digital_input_bits"
_OUTPUTS: Final = "actual_digital_output_bits"


def _word(variable: str, bits: tuple[int, ...]) -> Read:
    def read(m: PortMap, _: int) -> int:
        value = m.outputs[variable]
        return sum((value >> bit & 1) << place for place, bit in enumerate(bits))

    return read


def _mask(bits: tuple[int, ...], word: int) -> int:
    return sum((word >> place & 1) << bit for place, bit in enumerate(bits))


def _write_word(bits: tuple[int, ...]) -> Write:
    return lambda m, _, word: m.signals.set_digital_outputs(_mask(bits, -1), _mask(bits, word))


def _set_word(bits: tuple[int, ...], on: bool) -> Write:
    """Switch the outputs whose bit is set, and leave the others."""
    return lambda m, _, word: m.signals.set_digital_outputs(_mask(bits, word), -1 if on else 0)


def _bit(variable: str, bits: tuple[int, ...]) -> Read:
    def read(m: PortMap, index: int) -> bool:
        return index < len(bits) and bool(m.outputs[variable] >> bits[index] & 1)

    return read


def _write_bit(bits: tuple[int, ...]) -> Write:
    def write(m: PortMap, index: int, value: int) -> None:
        if index < len(bits):
            m.signals.set_digital_outputs(1 << bits[index], -1 if value else 0)

    return write


def _set_bit(bits: tuple[int, ...], on: bool) -> Write:
    def write(m: PortMap, index: int, value: int) -> None:
        if value and index < len(bits):
            m.signals.set_digital_outputs(1 << bits[index], -1 if on else 0)

    return write


def _half(variable: str) -> Read:
    """The lower, then the higher 16 of 32 bits."""
    return lambda m, index: m.outputs[variable] >> 16 * index


def _nothing(m: PortMap, index: int) -> int:
    return 0


# Analog signals: the value as a part of its range, and the domain, 0 current or 1 voltage.


def _analog(signal: str) -> Read:
    def read(m: PortMap, _: int) -> int:
        ratio = to_ratio(m.outputs[signal], voltage=m.signals.is_voltage(signal))
        return round(ratio * (_WORD - 1))

    return read


def _write_analog(channel: int) -> Write:
    return lambda m, _, word: m.signals.set_analog_output(channel, word / (_WORD - 1))


def _domain(signal: str) -> Read:
    return lambda m, _: int(m.signals.is_voltage(signal))


def _write_domain(signal: str) -> Write:
    return lambda m, _, word: m.signals.set_domain(signal, voltage=bool(word))


def _analog_ports(first: int, signals: tuple[str, ...]) -> Iterator[Ports]:
    """Value and domain of each signal, one after the other; only outputs have values to set."""
    for index, signal in enumerate(signals):
        write = _write_analog(index) if signals is ANALOG_OUTPUTS else None
        name = signal.replace("_", " ")
        yield Ports(first + 2 * index, 1, f"{name}, 1/65535 of its range", _analog(signal), write)
        yield Ports(
            first + 2 * index + 1,
            1,
            f"{name}: 0 current, 1 voltage",
            _domain(signal),
            _write_domain(signal),
            (0, 1),
        )


# States, clocks and versions.


def _flag(variable: str, flag: int) -> Read:
    return lambda m, _: bool(m.outputs[variable] & flag)


_FLAGS: Final[tuple[tuple[str, Read], ...]] = (
    ("isPowerOnRobot", _flag("robot_status_bits", RobotStatus.POWER_ON)),
    ("isSecurityStopped", _flag("safety_status_bits", SafetyStatus.PROTECTIVE_STOPPED)),
    ("isEmergencyStopped", _flag("safety_status_bits", SafetyStatus.EMERGENCY_STOPPED)),
    ("isTeachButtonPressed", _flag("robot_status_bits", RobotStatus.TEACH_BUTTON)),
    ("isPowerButtonPressed", _flag("robot_status_bits", RobotStatus.POWER_BUTTON)),
    (
        "isSafetySignalSuchThatWeShouldStop",
        _flag("safety_status_bits", SafetyStatus.STOPPED_DUE_TO_SAFETY),
    ),
)


def _flags() -> Iterator[Ports]:
    for offset, (name, read) in enumerate(_FLAGS):
        yield Ports(260 + offset, 1, name, read)


def _latch_time(m: PortMap, _: int, word: int) -> None:
    m.split_time = round(m.clock.time * 1000.0)


def _split_time(m: PortMap, index: int) -> int:
    """One of the latched milliseconds, seconds, minutes, hours and days since start."""
    size, count = _TIME_UNITS[index]
    return m.split_time // size % count


def _general(m: PortMap, index: int) -> int:
    return m.general[index]


def _write_general(m: PortMap, index: int, word: int) -> None:
    m.general[index] = word


def _boolean(direction: str) -> Read:
    return lambda m, index: read_boolean(m.outputs, direction, index)


def _write_boolean(m: PortMap, index: int, value: int) -> None:
    m.write_inputs(boolean_written(m.inputs, "input", index, bool(value)))


REGISTERS: Final[tuple[Ports, ...]] = (
    Ports(0, 1, "inputs: 0-7 standard, 8-9 tool", _word(_INPUTS, _BOX_AND_TOOL)),
    Ports(
        1,
        1,
        "outputs: 0-7 standard, 8-9 tool",
        _word(_OUTPUTS, _BOX_AND_TOOL),
        _write_word(_BOX_AND_TOOL),
    ),
    Ports(2, 1, "outputs to switch on", _nothing, _set_word(_BOX_AND_TOOL, True)),
    Ports(3, 1, "outputs to switch off", _nothing, _set_word(_BOX_AND_TOOL, False)),
    *_analog_ports(4, ANALOG_INPUTS),
    *_analog_ports(16, ANALOG_OUTPUTS),
    Ports(
        20,
        1,
        "tool output voltage, V",
        _scalar("tool_output_voltage"),
        lambda m, _, volts: m.signals.set_tool_voltage(volts),
        TOOL_VOLTAGES,
    ),
    Ports(21, 1, "tool inputs", _word(_INPUTS, _TOOL)),
    Ports(22, 1, "tool outputs", _word(_OUTPUTS, _TOOL), _write_word(_TOOL)),
    Ports(24, 2, "Euromap 67 inputs", _half("euromap67_input_bits")),
    Ports(26, 2, "Euromap 67 outputs", _half("euromap67_output_bits")),
    Ports(28, 1, "Euromap 67 supply, V", _scalar("euromap67_24V_voltage")),
    Ports(29, 1, "Euromap 67 supply, A", _scalar("euromap67_24V_current")),
    Ports(30, 1, "configurable inputs", _word(_INPUTS, _CONFIGURABLE)),
    Ports(
        31, 1, "configurable outputs", _word(_OUTPUTS, _CONFIGURABLE), _write_word(_CONFIGURABLE)
    ),
    Ports(32, 1, "configurable outputs to switch on", _nothing, _set_word(_CONFIGURABLE, True)),
    Ports(33, 1, "configurable outputs to switch off", _nothing, _set_word(_CONFIGURABLE, False)),
    Ports(128, 128, "general purpose", _general, _write_general),
    Ports(256, 2, "controller version, major and minor", lambda m, index: m.version[index]),
    Ports(258, 1, "robot mode", _scalar("robot_mode")),
    *_flags(),
    Ports(266, 1, "safety mode", _scalar("safety_mode")),
    Ports(270, 6, "joint angles, mrad, without whole turns", lambda m, joint: _turns(m, joint)[1]),
    Ports(280, 6, "joint velocities, mrad/s", _vector("actual_qd", 1e3)),
    Ports(290, 6, "joint currents, mA", _vector("actual_current", 1e3)),
    Ports(300, 6, "joint temperatures, degC", _vector("joint_temperatures", 1.0)),
    Ports(310, 6, "joint modes", _vector("joint_mode", 1)),
    Ports(320, 6, "whole turns of the joints", lambda m, joint: _turns(m, joint)[0]),
    Ports(400, 6, "TCP pose, 0.1 mm and mrad", _vector("actual_TCP_pose", *_TENTHS)),
    Ports(410, 6, "TCP speed, mm/s and mrad/s", _vector("actual_TCP_speed", 1e3)),
    Ports(420, 6, "TCP offset, mm and mrad", _vector("tcp_offset", 1e3)),
    Ports(450, 1, "robot current, mA", _scalar("actual_robot_current", 1e3)),
    Ports(451, 1, "I/O current, mA", _scalar("io_current", 1e3)),
    Ports(768, 1, "tool mode", _scalar("tool_mode")),
    Ports(769, 1, "tool temperature, degC", _scalar("tool_temperature")),
    Ports(770, 1, "tool current, mA", _scalar("tool_output_current", 1e3)),
    Ports(2048, 1, "anything written latches the time", _nothing, _latch_time),
    Ports(2049, 5, "latched time: ms, s, min, h, days", _split_time),
)
"""Every register, 16 bits."""

COILS: Final[tuple[Ports, ...]] = (
    Ports(0, 16, "inputs: 0-7 standard, 8-9 tool", _bit(_INPUTS, _BOX_AND_TOOL)),
    Ports(
        16,
        16,
        "outputs: 0-7 standard, 8-9 tool",
        _bit(_OUTPUTS, _BOX_AND_TOOL),
        _write_bit(_BOX_AND_TOOL),
    ),
    Ports(32, 16, "outputs to switch on", _nothing, _set_bit(_BOX_AND_TOOL, True)),
    Ports(48, 16, "outputs to switch off", _nothing, _set_bit(_BOX_AND_TOOL, False)),
    Ports(64, 32, "Euromap 67 inputs", _bit("euromap67_input_bits", tuple(range(32)))),
    Ports(96, 32, "Euromap 67 outputs", _bit("euromap67_output_bits", tuple(range(32)))),
    Ports(128, 8, "configurable inputs", _bit(_INPUTS, _CONFIGURABLE)),
    Ports(136, 8, "configurable outputs", _bit(_OUTPUTS, _CONFIGURABLE), _write_bit(_CONFIGURABLE)),
    Ports(144, 8, "configurable outputs to switch on", _nothing, _set_bit(_CONFIGURABLE, True)),
    Ports(152, 8, "configurable outputs to switch off", _nothing, _set_bit(_CONFIGURABLE, False)),
    *_flags(),
    Ports(300, 128, "boolean input registers", _boolean("input"), _write_boolean),
    Ports(500, 128, "boolean output registers", _boolean("output")),
)
"""Every bit."""


class PortTable:
    """The registers, or the bits, of one controller by address."""

    def __init__(self, port_map: PortMap, table: tuple[Ports, ...]) -> None:
        self._map = port_map
        self._by_address = {address: ports for ports in table for address in ports.addresses}

    def __getitem__(self, address: int) -> int:
        """Value of a register (0 to 65535) or bit (0 or 1).

        Raises:
            PortError: there is no such address.
        """
        ports = self._find(address)
        return int(ports.read(self._map, address - ports.first)) % _WORD

    def check(self, address: int, value: int) -> None:
        """Refuse what cannot be set.

        Raises:
            PortError: there is no such address, or it is read only.
            ValueError: it does not take this value.
        """
        ports = self._find(address)
        if ports.write is None:
            raise PortError(f"address {address} ({ports.name}) is read only")
        if value not in ports.accepts:
            raise ValueError(f"address {address} ({ports.name}) does not take {value}")

    def __setitem__(self, address: int, value: int) -> None:
        """Set a register (0 to 65535) or bit (0 or 1), which `check` lets pass."""
        self.check(address, value)
        ports = self._find(address)
        if ports.write is not None:
            ports.write(self._map, address - ports.first, value)

    def _find(self, address: int) -> Ports:
        try:
            return self._by_address[address]
        except KeyError:
            raise PortError(f"there is no address {address}") from None


class PortMap:
    """What the Modbus server of one controller has, and its programs read and write.

    Args:
        version: of the software.
        clock: of the controller.
        inputs: process image by RTDE input variable name.
        outputs: the same by RTDE output variable name.
        signals: digital and analog signals.
        write_inputs: writes variables of `inputs`.

    Attributes:
        registers: 16-bit registers by address.
        bits: bits by address.
        general: the general purpose registers, from address 128 on.
        split_time: the time since start that was latched last, ms.
    """

    def __init__(
        self,
        version: Version,
        clock: Clock,
        inputs: Mapping[str, Any],
        outputs: Mapping[str, Any],
        signals: Signals,
        write_inputs: Callable[[Mapping[str, Any]], None],
    ) -> None:
        self.version: Version = version
        self.clock = clock
        self.inputs = inputs
        self.outputs = outputs
        self.signals: Signals = signals
        self.write_inputs = write_inputs
        self.registers = PortTable(self, REGISTERS)
        self.bits = PortTable(self, COILS)
        self.general = [0] * len(GENERAL_PURPOSE)
        self.split_time = 0
