"""The variable types of RTDE and the output variables that this driver may ask for.

Source: RTDE Guide, "Data types" and "Robot controller outputs". All numbers are big endian.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

__all__ = ["IN_USE", "NOT_FOUND", "OPTIONAL_OUTPUTS", "OUTPUTS", "TYPES", "VariableType"]

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

NEEDED_OUTPUTS: Mapping[str, str] = MappingProxyType(
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
        "output_int_register_3": "INT32",
        "output_int_register_4": "INT32",
        "output_int_register_5": "INT32",
    }
)
"""Type of each output variable that a state sample needs."""

OPTIONAL_OUTPUTS: Mapping[str, str] = MappingProxyType(
    {
        "payload": "DOUBLE",
        "tcp_offset": "VECTOR6D",
        "actual_current_as_torque": "VECTOR6D",
        "payload_cog": "VECTOR3D",
        "joint_mode": "VECTOR6INT32",
        "joint_temperatures": "VECTOR6D",
        "actual_robot_voltage": "DOUBLE",
        "actual_robot_current": "DOUBLE",
        "actual_digital_input_bits": "UINT64",
        "actual_digital_output_bits": "UINT64",
        "analog_io_types": "UINT32",
        "standard_analog_input0": "DOUBLE",
        "standard_analog_input1": "DOUBLE",
        "standard_analog_output0": "DOUBLE",
        "standard_analog_output1": "DOUBLE",
        "tool_mode": "UINT32",
        "tool_analog_input_types": "UINT32",
        "tool_analog_input0": "DOUBLE",
        "tool_analog_input1": "DOUBLE",
        "tool_output_voltage": "INT32",
        "tool_output_current": "DOUBLE",
        "tool_temperature": "DOUBLE",
        "output_int_register_24": "INT32",
        "output_int_register_25": "INT32",
        "output_int_register_26": "INT32",
        "output_int_register_27": "INT32",
        "output_int_register_28": "INT32",
        "output_int_register_29": "INT32",
    }
)
"""Type of each that older controllers do not have, and that the driver can do without."""

OUTPUTS: Mapping[str, str] = MappingProxyType({**NEEDED_OUTPUTS, **OPTIONAL_OUTPUTS})
"""Type of each output variable that a state sample is made of, in its order."""
