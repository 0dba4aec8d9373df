"""Digital and analog signals of the control box and the tool, kept in the process image."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

_DIGITAL_SHIFT: Final = {"standard": 0, "configurable": 8, "tool": 16}  # first bit of each kind

ANALOG_INPUTS: Final = tuple(
    f"{place}_analog_input{i}" for place in ("standard", "tool") for i in (0, 1)
)


class Signals:
    """The signals in the process images of a controller.

    Args:
        inputs: image by RTDE input variable name.
        outputs: image by RTDE output variable name.
    """

    def __init__(self, inputs: Mapping[str, Any], outputs: dict[str, Any]) -> None:
        self._inputs = inputs
        self._outputs = outputs

    def take(self, values: Mapping[str, Any]) -> None:
        """Do what the masks of one RTDE input package ask for."""
        for kind, shift in _DIGITAL_SHIFT.items():
            mask = values.get(f"{kind}_digital_output_mask", 0)
            if mask:
                bits = self._inputs[f"{kind}_digital_output"]
                self.set_digital_outputs(mask << shift, bits << shift)
        mask = values.get("standard_analog_output_mask", 0)
        for channel in (0, 1):
            if mask >> channel & 1:
                bit = 1 << channel
                voltage = self._inputs["standard_analog_output_type"] & bit
                types = self._outputs["analog_io_types"] & ~(bit << 2)
                self._outputs["analog_io_types"] = types | (bit << 2 if voltage else 0)
                self.set_analog_output(channel, self._inputs[f"standard_analog_output_{channel}"])

    def set_digital_outputs(self, mask: int, bits: int) -> None:
        """Set the outputs of `mask` to `bits`: 0-7 standard, 8-15 configurable, 16-17 tool."""
        present = self._outputs["actual_digital_output_bits"]
        self._outputs["actual_digital_output_bits"] = (present & ~mask) | (bits & mask)

    def set_digital_inputs(self, bits: int) -> None:
        """Switch the inputs: 0-7 standard, 8-15 configurable, 16-17 tool."""
        self._outputs["actual_digital_input_bits"] = bits

    def set_analog_input(self, name: str, value: float) -> None:
        """Put `value` (V or A, by its type) on one of `ANALOG_INPUTS`."""
        self._outputs[name] = value

    def set_analog_output(self, channel: int, ratio: float) -> None:
        """Set analog output 0 or 1 to `ratio` (0 to 1) of 4-20 mA or 0-10 V, by its type."""
        ratio = max(0.0, min(1.0, ratio))
        voltage = self._outputs["analog_io_types"] >> (2 + channel) & 1
        value = 10.0 * ratio if voltage else 0.004 + 0.016 * ratio
        self._outputs[f"standard_analog_output{channel}"] = value
