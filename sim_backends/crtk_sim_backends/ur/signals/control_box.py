"""Digital and analog signals of the control box and the tool, kept in the process image.

Bits of digital signals are those of RTDE: 0-7 standard, 8-15 configurable, 16-17 tool. Analog values
are in V or A, by the domain of the signal.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

from crtk_sim_backends.ur.signals.wiring import Wire

DIGITAL: Final[Mapping[str, tuple[int, int]]] = {
    "standard": (0, 8),
    "configurable": (8, 8),
    "tool": (16, 2),
}
"""Digital signals by kind: first bit, number of signals."""

ANALOG_INPUTS: Final = tuple(
    f"{place}_analog_input{i}" for place in ("standard", "tool") for i in (0, 1)
)

ANALOG_OUTPUTS: Final = ("standard_analog_output0", "standard_analog_output1")

_DOMAINS: Final = {
    "standard_analog_input0": ("analog_io_types", 1),
    "standard_analog_input1": ("analog_io_types", 2),
    "standard_analog_output0": ("analog_io_types", 4),
    "standard_analog_output1": ("analog_io_types", 8),
    "tool_analog_input0": ("tool_analog_input_types", 1),
    "tool_analog_input1": ("tool_analog_input_types", 2),
}
"""Where the domain of each analog signal is: 0 current, 1 voltage."""

TOOL_VOLTAGES: Final = (0, 12, 24)

_CURRENT: Final = (0.004, 0.016)  # A: at ratio 0, and what ratio 1 adds
_VOLTAGE: Final = (0.0, 10.0)  # V


def from_ratio(ratio: float, *, voltage: bool) -> float:
    """The V or A of a part (0 to 1) of the range 0-10 V or 4-20 mA."""
    low, span = _VOLTAGE if voltage else _CURRENT
    return low + span * ratio


def to_ratio(value: float, *, voltage: bool) -> float:
    """The part of its range that a value in V or A is, 0 to 1."""
    low, span = _VOLTAGE if voltage else _CURRENT
    return max(0.0, min(1.0, (value - low) / span))


class Signals:
    """The signals in the process images of a controller.

    Args:
        inputs: image by RTDE input variable name.
        outputs: image by RTDE output variable name.
        wires: outputs that are connected to inputs.
    """

    def __init__(
        self, inputs: Mapping[str, Any], outputs: dict[str, Any], wires: Iterable[Wire] = ()
    ) -> None:
        self._inputs = inputs
        self._outputs = outputs
        wires = tuple(wires)
        self._digital_wires = [wire for wire in wires if not wire.analog]
        self._analog_wires = [wire for wire in wires if wire.analog]
        self._switched = 0  # digital inputs that somebody else than a wire switches on
        self._ratios = [0.0, 0.0]
        self._measured = dict.fromkeys(ANALOG_INPUTS, 0.0)
        self._tool_analog = True

    def take(self, values: Mapping[str, Any]) -> None:
        """Do what the masks of one RTDE input package ask for."""
        for kind, (shift, _) in DIGITAL.items():
            mask = values.get(f"{kind}_digital_output_mask", 0)
            if mask:
                bits = self._inputs[f"{kind}_digital_output"]
                self.set_digital_outputs(mask << shift, bits << shift)
        mask = values.get("standard_analog_output_mask", 0)
        for channel in (0, 1):
            if mask >> channel & 1:
                voltage = self._inputs["standard_analog_output_type"] >> channel & 1
                self.set_domain(f"standard_analog_output{channel}", voltage=bool(voltage))
                self.set_analog_output(channel, self._inputs[f"standard_analog_output_{channel}"])

    # Digital signals

    def set_digital_outputs(self, mask: int, bits: int) -> None:
        """Set the outputs of `mask` to `bits`."""
        present = self._outputs["actual_digital_output_bits"]
        self._outputs["actual_digital_output_bits"] = (present & ~mask) | (bits & mask)
        if self._digital_wires:
            self._switch_inputs()

    def set_digital_inputs(self, bits: int) -> None:
        """Switch the inputs; one with a wire is on also when the output at its other end is."""
        self._switched = bits
        self._switch_inputs()

    def _switch_inputs(self) -> None:
        outputs = self._outputs["actual_digital_output_bits"]
        bits = self._switched
        for wire in self._digital_wires:
            bits |= (outputs >> wire.source & 1) << wire.sink
        self._outputs["actual_digital_input_bits"] = bits

    # Analog signals

    def is_voltage(self, signal: str) -> bool:
        """Whether an analog signal is a voltage, not a current."""
        variable, bit = _DOMAINS[signal]
        return bool(self._outputs[variable] & bit)

    def set_domain(self, signal: str, *, voltage: bool) -> None:
        """Make an analog signal, by its RTDE name, a voltage or a current."""
        variable, bit = _DOMAINS[signal]
        present = self._outputs[variable]
        self._outputs[variable] = present | bit if voltage else present & ~bit
        for channel, output in enumerate(ANALOG_OUTPUTS):
            if signal == output:
                self.set_analog_output(channel, self._ratios[channel])
        for wire in self._analog_wires:
            if signal == ANALOG_INPUTS[wire.sink]:
                self._drive(wire)

    def set_analog_input(self, name: str, value: float) -> None:
        """Put `value` (V or A, by its domain) on one of `ANALOG_INPUTS`."""
        self._measured[name] = value
        connected = self._tool_analog or not name.startswith("tool")
        self._outputs[name] = value if connected else 0.0

    def set_analog_output(self, channel: int, ratio: float) -> None:
        """Set analog output 0 or 1 to `ratio` (0 to 1) of 4-20 mA or 0-10 V, by its domain."""
        ratio = max(0.0, min(1.0, ratio))
        self._ratios[channel] = ratio
        name = ANALOG_OUTPUTS[channel]
        self._outputs[name] = from_ratio(ratio, voltage=self.is_voltage(name))
        for wire in self._analog_wires:
            if wire.source == channel:
                self._drive(wire)

    def _drive(self, wire: Wire) -> None:
        """Let an input measure the output that it is wired to; of the other domain it measures 0."""
        source, sink = ANALOG_OUTPUTS[wire.source], ANALOG_INPUTS[wire.sink]
        same = self.is_voltage(source) == self.is_voltage(sink)
        self.set_analog_input(sink, self._outputs[source] if same else 0.0)

    # The tool

    def connect_tool_analog(self, on: bool) -> None:
        """Connect the analog inputs of the tool; not connected they measure nothing."""
        self._tool_analog = on
        for name, value in self._measured.items():
            self.set_analog_input(name, value)

    def set_tool_voltage(self, volts: int) -> None:
        """Set the supply of the tool, one of `TOOL_VOLTAGES`."""
        self._outputs["tool_output_voltage"] = volts
