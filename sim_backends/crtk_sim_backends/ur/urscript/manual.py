"""Which functions a controller has: the names of the script manual, and since which software.

Sources: URScript manuals 3.15, 5.x and 10.x (modules motion, internals, urmath, interfaces and I/O
configuration), the scripts that UR publishes, and for the versions what is said at each.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from crtk_sim_backends.ur.urscript.values import Builtin
from crtk_sim_backends.ur.versions import ALWAYS, Since

SINCE: Final[Mapping[str, Since]] = {
    # ur_rtde's control script, which keeps or drops its lines by version.
    "force_mode_set_damping": Since((3, 5), (5, 0)),
    "get_actual_joint_positions_history": Since((3, 0), (5, 4)),
    "get_freedrive_status": Since(None, (5, 10)),
    "get_tcp_offset": Since((3, 6), (5, 0)),
    "protective_stop": Since((3, 8), (5, 0)),
    "set_target_payload": Since((3, 0), (5, 10)),
    "tool_contact": Since((3, 0), (5, 4)),
    # The same, and for 5.x URSim 5.8.2 and 5.9.4.
    "get_inverse_kin_has_solution": Since((3, 15), (5, 9)),
    # ur_rtde keeps it from 5.0 on, but UR's external control program names it from 3.14 on.
    "force_mode_set_gain_scaling": Since((3, 14), (5, 0)),
    # UR's external control program, which asks for the version.
    "direct_torque": Since(None, (5, 23), (10, 11)),
    "ft_rtde_input_enable": Since((3, 14), (5, 9)),
    "optimovej": Since(None, (5, 21), (10, 8)),
    "optimovel": Since(None, (5, 21), (10, 8)),
    # UR's example of joint impedance control, made for 5.22.
    "get_coriolis_and_centrifugal_torques": Since(None, (5, 22)),
    "get_jacobian": Since(None, (5, 22)),
    "get_jacobian_time_derivative": Since(None, (5, 22)),
    "get_mass_matrix": Since(None, (5, 22)),
    "get_rtde_value": Since(None, (5, 22)),
    "torque_command": Since(None, (5, 22)),
    # UR, "New conveyor tracking guide": CB3 3.8 and e-Series 5.2.
    "encoder_enable_pulse_decode": Since((3, 8), (5, 2)),
    "encoder_enable_set_tick_count": Since((3, 8), (5, 2)),
    "encoder_get_tick_count": Since((3, 8), (5, 2)),
    "encoder_set_tick_count": Since((3, 8), (5, 2)),
    "encoder_unwind_delta_tick_count": Since((3, 8), (5, 2)),
    # Manual 5.x, "Flexible Ethernet/IP Adapter": from PolyScope 5.16 on.
    "eip_reader_factory": Since(None, (5, 16)),
    "eip_writer_factory": Since(None, (5, 16)),
    # UR's article "Interpreter mode": e-Series, from 5.10 on.
    "clear_interpreter": Since(None, (5, 10)),
    "end_interpreter": Since(None, (5, 10)),
    "interpreter_mode": Since(None, (5, 10)),
    # Manual, "Motion Version": the behaviour up to 5.21 is version 1.
    "motion_version_get": Since(None, (5, 22)),
    "motion_version_set": Since(None, (5, 22)),
    # UR, "Linear Algebra Examples": matrices since 3.14 and 5.9.
    "inv": Since((3, 14), (5, 9)),
    "size": Since((3, 14), (5, 9)),
    "transpose": Since((3, 14), (5, 9)),
    # UR's forum, "Variable length lists".
    "make_list": Since(None, (5, 15)),
    # e-Series arms alone have a serial interface in the tool.
    "set_tool_communication": Since(None, (5, 0)),
    "set_tool_digital_output_mode": Since(None, (5, 0)),
    "set_tool_output_mode": Since(None, (5, 0)),
}
"""Functions that not every software has; of the others no source says since when."""

_MANUAL: Final = """
acos asin atan atan2 binary_list_to_integer ceil cos d2r floor get_list_length
integer_to_binary_list interpolate_pose inv length log make_list norm normalize point_dist
pose_add pose_dist pose_inv pose_sub pose_trans pow r2d random rotvec2rpy rpy2rotvec sin size
sqrt tan transpose wrench_trans

estimate_payload force get_actual_joint_positions get_actual_joint_positions_history
get_actual_joint_speeds get_actual_tcp_pose get_actual_tcp_speed get_actual_tool_flange_pose
get_base_acceleration get_controller_temp get_coriolis_and_centrifugal_torques get_forward_kin
get_gravity get_inverse_kin get_inverse_kin_has_solution get_jacobian
get_jacobian_time_derivative get_joint_positions get_joint_speeds get_joint_temp
get_joint_torques get_mass_matrix get_rtde_value get_steptime get_target_joint_accelerations
get_target_joint_positions get_target_joint_speeds get_target_payload get_target_payload_cog
get_target_payload_inertia get_target_tcp_pose get_target_tcp_speed get_target_waypoint
get_tcp_force get_tcp_offset get_tool_accelerometer_reading get_tool_current get_tool_temp
high_holding_torque_disable high_holding_torque_enable is_steady is_within_safety_limits popup
powerdown protective_stop set_base_acceleration set_gravity set_payload set_payload_cog
set_payload_mass set_target_payload set_tcp sleep str_at str_cat str_empty str_find str_len
str_sub sync textmsg time to_num to_str tool_contact

request_boolean_from_primary_client request_float_from_primary_client
request_integer_from_primary_client request_string_from_primary_client

eip_reader_factory eip_writer_factory enable_external_ft_sensor ft_rtde_input_enable
get_analog_in get_analog_out get_configurable_digital_in get_configurable_digital_out
get_digital_in get_digital_out get_euromap_input get_euromap_output get_flag
get_standard_analog_in get_standard_analog_out get_standard_digital_in
get_standard_digital_out get_tool_analog_in get_tool_digital_in get_tool_digital_out
modbus_add_rw_signal modbus_add_signal modbus_delete_signal modbus_get_error
modbus_get_signal_status modbus_get_time_since_signal_invalid
modbus_request_update_signal_value modbus_reset_connection modbus_send_custom_command
modbus_set_digital_input_action modbus_set_output_register modbus_set_output_signal
modbus_set_runstate_dependent_choice modbus_set_signal_update_frequency
modbus_set_signal_watchdog read_input_boolean_register read_input_float_register
read_input_integer_register read_output_boolean_register read_output_float_register
read_output_integer_register read_port_bit read_port_register ros_action_client_factory
ros_publisher_factory ros_service_client_factory ros_subscriber_factory rpc_factory
rtde_set_watchdog set_analog_inputrange set_analog_out set_analog_outputdomain
set_baselight_iec set_baselight_off set_baselight_solid set_configurable_digital_input_action
set_configurable_digital_out set_digital_out set_euromap_output
set_euromap_runstate_dependent_choice set_flag set_gp_boolean_input_action
set_input_actions_to_default set_runstate_configurable_digital_output_to_value
set_runstate_gp_boolean_output_to_value set_runstate_outputs
set_runstate_standard_analog_output_to_value
set_runstate_standard_digital_output_to_value set_runstate_standard_digital_outputs
set_runstate_tool_digital_output_to_value set_standard_analog_input_domain
set_standard_analog_out set_standard_digital_input_action set_standard_digital_out
set_tool_analog_input_domain set_tool_communication set_tool_digital_input_action
set_tool_digital_out set_tool_digital_output_mode set_tool_output_mode set_tool_voltage
socket_close socket_get_var socket_open socket_read_ascii_float socket_read_binary_integer
socket_read_byte_list socket_read_line socket_read_string socket_send_byte socket_send_int
socket_send_line socket_send_string socket_set_var write_output_boolean_register
write_output_float_register write_output_integer_register write_port_bit write_port_register
zero_ftsensor

clear_interpreter conveyor_pulse_decode direct_torque encoder_enable_pulse_decode
encoder_enable_set_tick_count encoder_get_tick_count encoder_set_tick_count
encoder_unwind_delta_tick_count end_force_mode end_freedrive_mode end_interpreter
end_screw_driving end_teach_mode force_mode force_mode_set_damping
force_mode_set_gain_scaling freedrive_mode
freedrive_mode_no_incorrect_payload_check get_conveyor_tick_count get_freedrive_status
get_target_tcp_pose_along_path get_target_tcp_speed_along_path interpreter_mode
motion_version_get motion_version_set movec movej movel movep optimovej optimovel
path_offset_disable path_offset_enable path_offset_get path_offset_set
path_offset_set_alpha_filter path_offset_set_max_offset pause_on_error_code
position_deviation_warning reset_revolution_counter screw_driving servoc servoj
set_conveyor_tick_count set_pos set_safety_mode_transition_hardness speedj speedl
stop_conveyor_tracking stopj stopl teach_mode tool_wrench_limit_disable tool_wrench_limit_set
torque_command track_conveyor_circular track_conveyor_linear
"""
NAMES: Final = frozenset(_MANUAL.split())
"""The functions of the manuals, simulated or not."""

_ALIASES: Final = {"torque_command": "direct_torque"}
"""Names that a function had before; UR's example of impedance control uses this one."""

OLD_KEYWORDS: Final = {("speedj", "t_min"): "t", ("speedl", "t_min"): "t"}
"""Parameters by the name that they had in the first manuals; urx still uses it."""

ARRAYS: Final = {"digital_out": "set_digital_out"}
"""Variables that are the controller's, with the function that assigns an item; urx uses it."""

ENCLOSED: Final = frozenset({"interpreter_mode"})
"""Functions that run code in the scope from which they are called (manual, "Interpreter Mode")."""

_FIXED_LISTS: Final = ((5, 9), (5, 15))
"""First software in which "Resizing of 'List' is not supported", and first in which it is again:
5.9.4 to 5.14.6, found with every URSim by an author of URCaps; lists with a capacity came in 5.15."""


def _has(name: str, version: tuple[int, ...]) -> bool:
    return SINCE.get(name, ALWAYS).reached_by(version)


def available(builtins: Mapping[str, Builtin], version: tuple[int, ...]) -> dict[str, Builtin]:
    """Return the built-ins that a controller with this software has."""
    aliases = {old: builtins[new] for old, new in _ALIASES.items() if new in builtins}
    return {name: call for name, call in {**builtins, **aliases}.items() if _has(name, version)}


@dataclass(frozen=True)
class Dialect:
    """What the language itself owes to the software version.

    ``known`` are the functions, simulated or not. With ``fixed_lists`` a variable keeps the size of
    its first list.
    """

    known: frozenset[str] = frozenset()
    fixed_lists: bool = False


def dialect_of(version: tuple[int, ...]) -> Dialect:
    """Return the language of a controller with this software."""
    known = frozenset(name for name in NAMES if _has(name, version))
    return Dialect(known, _FIXED_LISTS[0] <= tuple(version[:2]) < _FIXED_LISTS[1])
