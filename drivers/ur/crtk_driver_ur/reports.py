"""What the controller reports beside motion, for people: numbers and notes of one state."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from crtk_driver_ur.models import JOINT_NAMES
from crtk_driver_ur.rtde.state_sample import StateSample
from crtk_driver_ur.safety import RobotMode, RuntimeState, SafetyMode, name_of
from crtk_drivers.device import Note, Severity

__all__ = ["ANALOG", "DIGITAL", "numbers_of", "reports_of"]

DIGITAL = {"": (0, 8), "configurable": (8, 8), "tool": (16, 2)}
"""Kinds of digital signals: first bit and number (RTDE Guide, `actual_digital_input_bits`)."""

_SINGLE = {
    "robot voltage (V)": "actual_robot_voltage",
    "robot current (A)": "actual_robot_current",
    "payload (kg)": "payload",
    "tool voltage (V)": "tool_output_voltage",
    "tool current (A)": "tool_output_current",
    "tool temperature (°C)": "tool_temperature",
}

ANALOG = {
    "analog in 0": ("standard_analog_input0", "analog_io_types", 0),
    "analog in 1": ("standard_analog_input1", "analog_io_types", 1),
    "analog out 0": ("standard_analog_output0", "analog_io_types", 2),
    "analog out 1": ("standard_analog_output1", "analog_io_types", 3),
    "tool analog in 0": ("tool_analog_input0", "tool_analog_input_types", 0),
    "tool analog in 1": ("tool_analog_input1", "tool_analog_input_types", 1),
}
"""Analog signals: their value, and the bit that makes it volts instead of amperes."""

_JOINTS = {"temperature (°C)": "joint_temperatures", "current (A)": "actual_current"}


def numbers_of(state: StateSample) -> Mapping[str, float]:
    """Return what the controller measures, by name with its unit; without what it does not report."""
    numbers = {
        "speed scaling": state.combined_speed_scaling,
        "speed slider": state.target_speed_fraction,
    }
    for name, field in _SINGLE.items():
        if (value := getattr(state, field)) is not None:
            numbers[name] = float(value)
    for name, (field, types, bit) in ANALOG.items():
        value, kinds = getattr(state, field), getattr(state, types)
        if value is not None and kinds is not None:
            numbers[f"{name} ({'V' if kinds >> bit & 1 else 'A'})"] = value
    for what, field in _JOINTS.items():
        for joint, value in zip(JOINT_NAMES, getattr(state, field) or (), strict=False):
            numbers[f"{joint} {what}"] = value
    return numbers


def reports_of(state: StateSample) -> Iterator[Note]:
    """Yield the modes, the program and the digital signals in words."""
    yield _note("robot mode", name_of(RobotMode, state.robot_mode))
    yield _note("safety mode", name_of(SafetyMode, state.safety_mode))
    yield _note("program", name_of(RuntimeState, state.runtime_state))
    for key, bits in (
        ("digital inputs", state.actual_digital_input_bits),
        ("digital outputs", state.actual_digital_output_bits),
    ):
        if bits is not None:
            yield _note(key, signals_text(bits))
    speed = state.combined_speed_scaling
    if not math.isclose(speed, 1.0, abs_tol=1e-3):
        text = f"programs run at {speed:.0%} of their speed"
        yield _note("speed", text)


def signals_text(bits: int) -> str:
    """Name the signals that are on: ``0, 3, tool 1``; ``none``."""
    on = [
        f"{kind} {pin}".strip()
        for kind, (first, count) in DIGITAL.items()
        for pin in range(count)
        if bits >> first + pin & 1
    ]
    return ", ".join(on) or "none"


def _note(key: str, text: str) -> Note:
    return Note(Severity.INFO, key, text)
