"""Wires from outputs of a controller to its inputs, for tests with nothing else connected."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from crtk_sim_backends.faults import unknown


class WiringError(ValueError):
    """A wire that cannot be."""


@dataclass(frozen=True, slots=True)
class Wire:
    """One wire.

    Attributes:
        analog: whether it connects analog signals.
        source: bit of a digital output in RTDE's, or number of an analog output.
        sink: bit of a digital input in RTDE's, or index in `signals.ANALOG_INPUTS`.
    """

    analog: bool
    source: int
    sink: int


def _names(direction: str) -> Iterator[tuple[str, tuple[bool, int]]]:
    for kind, first, count in (("digital", 0, 8), ("configurable", 8, 8), ("tool", 16, 2)):
        for index in range(count):
            yield f"{kind}_{direction}_{index}", (False, first + index)
    for index in range(2):
        yield f"analog_{direction}_{index}", (True, index)


SOURCES: Final[Mapping[str, tuple[bool, int]]] = dict(_names("out"))
"""Outputs by name: whether it is analog, and which."""

SINKS: Final[Mapping[str, tuple[bool, int]]] = {
    **dict(_names("in")),
    "tool_analog_in_0": (True, 2),
    "tool_analog_in_1": (True, 3),
}
"""Inputs by name, likewise."""


def parse_wires(text: str) -> tuple[Wire, ...]:
    """Read wires such as ``digital_out_0=digital_in_3,analog_out_1=tool_analog_in_0``.

    Raises:
        WiringError: for a signal that there is not, an input with two outputs, and an analog signal
            at one end only.
    """
    wires: dict[str, Wire] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        source, separator, sink = (piece.strip() for piece in part.partition("="))
        if not separator:
            raise WiringError(f"{part!r} is not OUTPUT=INPUT, such as digital_out_0=digital_in_3")
        if source not in SOURCES:
            raise WiringError(unknown("output", source, SOURCES))
        if sink not in SINKS:
            raise WiringError(unknown("input", sink, SINKS))
        if sink in wires:
            raise WiringError(f"{sink} has two outputs")
        (analog, number), (analog_too, index) = SOURCES[source], SINKS[sink]
        if analog != analog_too:
            raise WiringError(f"{part}: one is analog, the other digital")
        wires[sink] = Wire(analog, number, index)
    return tuple(wires.values())
