"""The RTDE variables of a UR controller: name, type, unit, first value, first software version.

Source: UR "Real-Time Data Exchange (RTDE) Guide", tables of controller outputs and inputs; the
newest of them from the tests of Universal_Robots_Client_Library. Both
tables map a variable's name to its :class:`Variable`; everything else that needs to know a
variable (recipes, process image, documentation) is derived from them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from crtk_sim_backends.ur.versions import Release, Since


@dataclass(frozen=True, slots=True)
class WireType:
    """How one RTDE type lies on the wire (big endian)."""

    format: str
    count: int
    zero: int | float | bool


TYPES: Final[dict[str, WireType]] = {
    "BOOL": WireType("?", 1, False),
    "UINT8": WireType("B", 1, 0),
    "UINT32": WireType("I", 1, 0),
    "UINT64": WireType("Q", 1, 0),
    "INT32": WireType("i", 1, 0),
    "DOUBLE": WireType("d", 1, 0.0),
    "VECTOR3D": WireType("3d", 3, 0.0),
    "VECTOR6D": WireType("6d", 6, 0.0),
    "VECTOR6INT32": WireType("6i", 6, 0),
    "VECTOR6UINT32": WireType("6I", 6, 0),
}


@dataclass(frozen=True, slots=True)
class Variable:
    """One RTDE variable.

    `initial` is a scalar, or a tuple for a vector type. `since` is the first software that has it.
    """

    name: str
    type: str
    initial: Any
    unit: str
    since: Since


_CB3: Final = (3, 0)
_E: Final = (5, 0)
_X: Final = (10, 0)
_E_ONLY: Final = None
_X_ONLY: Final = None


def _variable(
    name: str,
    type_name: str,
    unit: str = "",
    since_cb3: Release | None = _CB3,
    since_e: Release | None = _E,
    since_x: Release = _X,
    initial: Any = None,
) -> Variable:
    wire = TYPES[type_name]
    if initial is None:
        initial = wire.zero if wire.count == 1 else (wire.zero,) * wire.count
    return Variable(name, type_name, initial, unit, Since(since_cb3, since_e, since_x))


def _registers(direction: str, since_cb3: Release) -> Iterator[Variable]:
    """Bit, int and double registers: the lower half is for fieldbuses, the upper for RTDE."""
    upper = ((3, 9), (5, 3))
    for span in ("0_to_31", "32_to_63"):
        yield _variable(f"{direction}_bit_registers{span}", "UINT32", since_cb3=since_cb3)
    for index in range(64, 128):
        yield _variable(f"{direction}_bit_register_{index}", "BOOL", "", *upper)
    for kind, type_name in (("int", "INT32"), ("double", "DOUBLE")):
        for index in range(48):
            since = upper if index >= 24 else (since_cb3, _E)
            yield _variable(f"{direction}_{kind}_register_{index}", type_name, "", *since)


def _table(*groups: Iterator[Variable] | tuple[Variable, ...]) -> dict[str, Variable]:
    return {variable.name: variable for group in groups for variable in group}


OUTPUTS: Final[dict[str, Variable]] = _table(
    (
        _variable("timestamp", "DOUBLE", "s"),
        _variable("target_q", "VECTOR6D", "rad"),
        _variable("target_qd", "VECTOR6D", "rad/s"),
        _variable("target_qdd", "VECTOR6D", "rad/s^2"),
        _variable("target_current", "VECTOR6D", "A"),
        _variable("target_moment", "VECTOR6D", "Nm"),
        _variable("actual_q", "VECTOR6D", "rad"),
        _variable("actual_qd", "VECTOR6D", "rad/s"),
        _variable("actual_current", "VECTOR6D", "A"),
        _variable("actual_current_window", "VECTOR6D", "A"),
        _variable("actual_current_as_torque", "VECTOR6D", "Nm", _E_ONLY, (5, 23), (10, 11)),
        _variable("joint_control_output", "VECTOR6D", "A"),
        _variable("actual_TCP_pose", "VECTOR6D", "m, rotation vector"),
        _variable("actual_TCP_speed", "VECTOR6D", "m/s, rad/s"),
        _variable("actual_TCP_force", "VECTOR6D", "N, Nm"),
        _variable("actual_TCP_acceleration", "VECTOR6D", "m/s^2, rad/s^2", _E_ONLY),
        _variable("target_TCP_pose", "VECTOR6D", "m, rotation vector"),
        _variable("target_TCP_speed", "VECTOR6D", "m/s, rad/s"),
        _variable("target_TCP_acceleration", "VECTOR6D", "m/s^2, rad/s^2", _E_ONLY),
        _variable("actual_digital_input_bits", "UINT64"),
        _variable("actual_configurable_digital_input_bits", "UINT64", "", _E_ONLY),
        _variable("joint_temperatures", "VECTOR6D", "degC", initial=(28.0,) * 6),
        _variable("actual_execution_time", "DOUBLE", "ms"),
        _variable("target_execution_time", "DOUBLE", "ms", _E_ONLY),
        _variable("robot_mode", "INT32", initial=3),
        _variable("joint_mode", "VECTOR6INT32", initial=(239,) * 6),
        _variable("safety_mode", "INT32", initial=1),
        _variable("safety_status", "INT32", "", (3, 10), (5, 4), initial=1),
        _variable("actual_tool_accelerometer", "VECTOR3D", "m/s^2"),
        _variable("speed_scaling", "DOUBLE", initial=1.0),
        _variable("target_speed_fraction", "DOUBLE", initial=1.0),
        _variable("actual_momentum", "DOUBLE", "kg m/s"),
        _variable("actual_main_voltage", "DOUBLE", "V", initial=48.0),
        _variable("actual_robot_voltage", "DOUBLE", "V"),
        _variable("actual_robot_current", "DOUBLE", "A"),
        _variable("actual_joint_voltage", "VECTOR6D", "V"),
        _variable("actual_digital_output_bits", "UINT64"),
        _variable("actual_configurable_digital_output_bits", "UINT64", "", _E_ONLY),
        _variable("runtime_state", "UINT32", initial=1),
        _variable("elbow_position", "VECTOR3D", "m", (3, 5)),
        _variable("elbow_velocity", "VECTOR3D", "m/s", (3, 5)),
        _variable("robot_status_bits", "UINT32"),
        _variable("safety_status_bits", "UINT32", initial=1),
        _variable("analog_io_types", "UINT32"),
        _variable("standard_analog_input0", "DOUBLE", "A or V"),
        _variable("standard_analog_input1", "DOUBLE", "A or V"),
        _variable("standard_analog_output0", "DOUBLE", "A or V"),
        _variable("standard_analog_output1", "DOUBLE", "A or V"),
        _variable("io_current", "DOUBLE", "A"),
        _variable("euromap67_input_bits", "UINT32"),
        _variable("euromap67_output_bits", "UINT32"),
        _variable("euromap67_24V_voltage", "DOUBLE", "V"),
        _variable("euromap67_24V_current", "DOUBLE", "A"),
        _variable("tool_mode", "UINT32", initial=253),
        _variable("tool_analog_input_types", "UINT32"),
        _variable("tool_analog_input0", "DOUBLE", "A or V"),
        _variable("tool_analog_input1", "DOUBLE", "A or V"),
        _variable("tool_output_voltage", "INT32", "V"),
        _variable("tool_output_voltage_2", "INT32", "V", _E_ONLY, _X_ONLY, (10, 15)),
        _variable("tool_output_current", "DOUBLE", "A"),
        _variable("tool_temperature", "DOUBLE", "degC", initial=28.0),
        _variable("tool_output_mode", "UINT8", "", _E_ONLY, (5, 2)),
        _variable("tool_digital_output0_mode", "UINT8", "", _E_ONLY, (5, 2)),
        _variable("tool_digital_output1_mode", "UINT8", "", _E_ONLY, (5, 2)),
        _variable("tcp_force_scalar", "DOUBLE", "N"),
        _variable("tcp_offset", "VECTOR6D", "m, rotation vector", (3, 12), (5, 5, 1)),
        _variable("joint_position_deviation_ratio", "DOUBLE", "", _E_ONLY),
        _variable("collision_detection_ratio", "DOUBLE", "", _E_ONLY, (5, 15)),
        _variable("time_scale_source", "INT32", "", _E_ONLY, (5, 17)),
        _variable("payload", "DOUBLE", "kg", (3, 11), (5, 6)),
        _variable("payload_cog", "VECTOR3D", "m", (3, 11), (5, 6)),
        _variable("payload_inertia", "VECTOR6D", "kg m^2", (3, 15), (5, 11)),
        _variable(
            "target_gravity", "VECTOR3D", "m/s^2", _E_ONLY, (5, 26), (10, 12), (0.0, 0.0, 9.82)
        ),
        _variable(
            "target_base_acceleration", "VECTOR6D", "m/s^2, rad/s^2", _E_ONLY, (5, 26), (10, 12)
        ),
        _variable("target_base_wrench", "VECTOR6D", "N, Nm", _E_ONLY, (5, 26), (10, 14)),
        _variable("control_step", "UINT64", "", _E_ONLY, (5, 26), (10, 13)),
        _variable("script_control_line", "UINT32", "", (3, 14), (5, 9)),
        _variable("ft_raw_wrench", "VECTOR6D", "N, Nm", _E_ONLY, (5, 9)),
        _variable("wrench_calc_from_currents", "VECTOR6D", "N, Nm", _E_ONLY),
        _variable("actual_robot_energy_consumed", "DOUBLE", "J", _E_ONLY),
        _variable("actual_robot_braking_energy_dissipated", "DOUBLE", "J", _E_ONLY),
        _variable("encoder0_raw", "INT32", "", _E_ONLY),
        _variable("encoder1_raw", "INT32", "", _E_ONLY),
    ),
    _registers("output", _CB3),
    _registers("input", (3, 4)),
)

INPUTS: Final[dict[str, Variable]] = _table(
    (
        _variable("speed_slider_mask", "UINT32"),
        _variable("speed_slider_fraction", "DOUBLE", initial=1.0),
        _variable("standard_digital_output_mask", "UINT8"),
        _variable("standard_digital_output", "UINT8"),
        _variable("configurable_digital_output_mask", "UINT8"),
        _variable("configurable_digital_output", "UINT8"),
        _variable("tool_digital_output_mask", "UINT8"),
        _variable("tool_digital_output", "UINT8"),
        _variable("standard_analog_output_mask", "UINT8"),
        _variable("standard_analog_output_type", "UINT8"),
        _variable("standard_analog_output_0", "DOUBLE", "ratio"),
        _variable("standard_analog_output_1", "DOUBLE", "ratio"),
        _variable("external_force_torque", "VECTOR6D", "N, Nm", (3, 3)),
    ),
    _registers("input", _CB3),
)


def initial_image(table: dict[str, Variable]) -> dict[str, Any]:
    """Return a process image: every variable of `table` by name, with its first value."""
    return {name: variable.initial for name, variable in table.items()}
