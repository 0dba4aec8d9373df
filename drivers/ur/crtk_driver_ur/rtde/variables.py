"""The variable types of RTDE and the output variables that this driver may ask for.

Source: RTDE Guide, "Data types" and "Robot controller outputs". All numbers are big endian.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

__all__ = ["IN_USE", "NOT_FOUND", "OUTPUTS", "TYPES", "VariableType"]

NOT_FOUND = "NOT_FOUND"
"""In place of a type: the controller does not know the variable."""
IN_USE = "IN_USE"
"""In place of a type: another client has claimed the input variable."""


class VariableType(NamedTuple):
    """How one variable lies in a data package: `width` items of the struct code `code`."""

    code: str
    width: int


TYPES: Mapping[str, VariableType] = MappingProxyType(
    {
        "BOOL": VariableType("?", 1),
        "UINT8": VariableType("B", 1),
        "UINT32": VariableType("I", 1),
        "UINT64": VariableType("Q", 1),
        "INT32": VariableType("i", 1),
        "DOUBLE": VariableType("d", 1),
        "VECTOR3D": VariableType("d", 3),
        "VECTOR6D": VariableType("d", 6),
        "VECTOR6INT32": VariableType("i", 6),
        "VECTOR6UINT32": VariableType("I", 6),
    }
)

OUTPUTS: Mapping[str, str] = MappingProxyType(
    {
        "timestamp": "DOUBLE",
        "target_q": "VECTOR6D",
        "target_qd": "VECTOR6D",
        "target_moment": "VECTOR6D",
        "actual_q": "VECTOR6D",
        "actual_qd": "VECTOR6D",
        "actual_current": "VECTOR6D",
        "actual_TCP_pose": "VECTOR6D",
        "actual_TCP_speed": "VECTOR6D",
        "actual_TCP_force": "VECTOR6D",
        "target_TCP_pose": "VECTOR6D",
        "target_TCP_speed": "VECTOR6D",
        "robot_mode": "INT32",
        "safety_mode": "INT32",
        "runtime_state": "UINT32",
        "robot_status_bits": "UINT32",
        "safety_status_bits": "UINT32",
        "speed_scaling": "DOUBLE",
        "target_speed_fraction": "DOUBLE",
        "output_int_register_0": "INT32",
        "output_int_register_1": "INT32",
        "output_int_register_2": "INT32",
        "payload": "DOUBLE",
        "tcp_offset": "VECTOR6D",
        "actual_current_as_torque": "VECTOR6D",
    }
)
"""Type of each output variable that a state sample is made of."""
