"""Inputs of the driver that need no control program: speed slider, outputs, programs and pop-ups."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final

from crtk_driver_ur.inputs import Setting
from crtk_driver_ur.rtde.state_sample import StateSample
from crtk_drivers.commands import Payload

__all__ = ["output_settings"]

DIGITAL: Final = {
    "digital_out": ("standard", 0, 8),
    "configurable_out": ("configurable", 8, 8),
    "tool_out": ("tool", 16, 2),
}
"""Kinds of digital outputs: name in RTDE, first bit of `actual_digital_output_bits`, number."""

ANALOG: Final = {"voltage": (1, 0.0, 10.0, "V"), "current": (0, 0.004, 0.020, "A")}
"""Kinds of analog outputs: bit of `standard_analog_output_type`, range, unit."""

TOOL_VOLTAGES: Final = (0.0, 12.0, 24.0)

TEXTS: Final = {
    "load_program": ("program to be loaded, by its path within the folder of programs", True),
    "load_installation": ("installation to be loaded, by its path", True),
    "popup": ("what the teach pendant is to show", False),
    "add_to_log": ("line for the log of the controller", False),
}
"""Requests of the dashboard with a text, and whether they are refused while the driver has control."""

LONGEST_TEXT: Final = 1000
"""Characters."""


def output_settings() -> Iterator[tuple[str, Setting]]:
    """Yield them by name."""
    yield (
        "speed_slider",
        Setting(
            "share of their speed at which programs run, 0 to 1",
            Payload.NUMBER,
            lambda value: 0.0 <= value <= 1.0,
            "a number from 0 to 1",
            lambda value: _inputs(speed_slider_mask=1, speed_slider_fraction=value),
            lambda state, value: math.isclose(state.target_speed_fraction, value, abs_tol=0.01),
            "Is the slider locked on the teach pendant?",
        ),
    )
    yield (
        "tool_voltage",
        Setting(
            "supply voltage of the tool connector: 0, 12 or 24 V",
            Payload.NUMBER,
            TOOL_VOLTAGES.__contains__,
            "0, 12 or 24",
            lambda value: ("set_tool_voltage", {"voltage": int(value)}),
            lambda state, value: state.tool_output_voltage in (None, value),
            "Is the tool connector controlled by a URCap, or the arm without power?",
        ),
    )
    for name, (kind, first, count) in DIGITAL.items():
        for pin in range(count):
            yield f"{name}_{pin}", _digital(kind, first + pin, pin)
    for kind, (domain, low, high, unit) in ANALOG.items():
        for channel in (0, 1):
            name = f"analog_out_{channel}_{kind}"
            yield name, _analog(channel, kind, domain, low, high, unit)
    for name, (summary, hands_off) in TEXTS.items():
        yield name, _dashboard(name, summary, hands_off)


def _inputs(**values: float) -> tuple[str, dict[str, Any]]:
    return "write_inputs", {"values": values}


def _digital(kind: str, bit: int, pin: int) -> Setting:
    def request(value: float) -> tuple[str, dict[str, Any]]:
        name = f"{kind}_digital_output"
        return _inputs(**{f"{name}_mask": 1 << pin, name: int(value) << pin})

    def reported(state: StateSample, value: float) -> bool:
        bits = state.actual_digital_output_bits
        return bits is None or bits >> bit & 1 == value

    return Setting(
        f"{kind} digital output {pin}",
        Payload.FLAG,
        lambda value: value in (0.0, 1.0),
        "true or false",
        request,
        reported,
        "Is it assigned to a function in the controller's installation?",
    )


def _analog(channel: int, kind: str, domain: int, low: float, high: float, unit: str) -> Setting:
    def request(value: float) -> tuple[str, dict[str, Any]]:
        ratios = {f"standard_analog_output_{other}": 0.0 for other in (0, 1)}
        ratios[f"standard_analog_output_{channel}"] = (value - low) / (high - low)
        return _inputs(
            standard_analog_output_mask=1 << channel,
            standard_analog_output_type=domain << channel,
            **ratios,
        )

    def reported(state: StateSample, value: float) -> bool:
        present = (state.standard_analog_output0, state.standard_analog_output1)[channel]
        return present is None or math.isclose(present, value, abs_tol=0.01 * (high - low))

    return Setting(
        f"{kind} of analog output {channel}, {low:g} to {high:g} {unit}",
        Payload.NUMBER,
        lambda value: low <= value <= high,
        f"a number from {low:g} to {high:g} {unit}",
        request,
        reported,
        "Is it assigned to a function in the controller's installation?",
    )


def _dashboard(name: str, summary: str, hands_off: bool) -> Setting:
    return Setting(
        summary,
        Payload.TEXT,
        lambda text: 0 < len(text) <= LONGEST_TEXT and text.isprintable(),
        f"one line of 1 to {LONGEST_TEXT} characters",
        lambda text: (name, {"text": text}),
        by_dashboard=True,
        hands_off=hands_off,
    )
