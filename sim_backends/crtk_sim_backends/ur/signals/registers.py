"""Boolean registers in a process image: 0-63 are bits of two words, 64-127 are variables of their own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

BOOLEANS: Final = 128
"""How many there are in each direction."""


FIELDBUS_INPUTS: Final = (
    "input_bit_registers0_to_31",
    "input_bit_registers32_to_63",
    *(f"input_int_register_{i}" for i in range(24)),
    *(f"input_double_register_{i}" for i in range(24)),
)
"""Variables that EtherNet/IP or PROFINET has to itself, once it is enabled (RTDE guide, script manual)."""


def fieldbus_value(name: str, value: float) -> float:
    """What a fieldbus puts into one of `FIELDBUS_INPUTS`: a number, or 32 bits with or without sign."""
    if "double" in name:
        return value
    bits = int(value) & 0xFFFFFFFF
    return bits if "bit" in name else (bits ^ 0x80000000) - 0x80000000


def _place(direction: str, index: int) -> tuple[str, int]:
    """Variable of a register, and its bit in it; 0 for a variable of its own."""
    if index < 64:
        span = "0_to_31" if index < 32 else "32_to_63"
        return f"{direction}_bit_registers{span}", 1 << index % 32
    return f"{direction}_bit_register_{index}", 0


def read_boolean(image: Mapping[str, Any], direction: str, index: int) -> bool:
    """Value of register `index` (0 to 127) of an "input" or "output" image."""
    name, bit = _place(direction, index)
    return bool(image[name] & bit if bit else image[name])


def boolean_written(
    image: Mapping[str, Any], direction: str, index: int, value: bool
) -> dict[str, Any]:
    """The variable that has register `index`, and what it becomes when that is set to `value`."""
    name, bit = _place(direction, index)
    if not bit:
        return {name: value}
    return {name: image[name] | bit if value else image[name] & ~bit}
