"""One state of the arm, as the controller tells it in a package of RTDE."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias, cast

__all__ = ["StateSample"]

Vector3: TypeAlias = tuple[float, float, float]
Vector6: TypeAlias = tuple[float, float, float, float, float, float]


class StateSample(NamedTuple):
    """One state of the arm, in SI units, as the controller names it.

    Poses are x, y, z and a rotation vector of the TCP in the base frame; speeds and forces are
    linear before angular, in base axes at the TCP. Variables that the controller's software does not
    know are None.
    """

    received: float
    """When it was read from the socket, on the monotonic clock in seconds."""
    lost: int
    """Packages that the controller sent since the previous sample and that never arrived."""
    skipped: int
    """Packages that arrived since the previous sample and were older than this one."""
    restarted: bool
    """The controller's clock went back: it was restarted."""
    passed: tuple[int, ...]
    """``runtime_state`` of the packages since the previous sample that are no samples, one of each."""

    timestamp: float
    target_q: Vector6
    target_qd: Vector6
    target_moment: Vector6
    actual_q: Vector6
    actual_qd: Vector6
    actual_current: Vector6
    actual_TCP_pose: Vector6  # noqa: N815 (the controller's name)
    actual_TCP_speed: Vector6  # noqa: N815
    actual_TCP_force: Vector6  # noqa: N815
    target_TCP_pose: Vector6  # noqa: N815
    target_TCP_speed: Vector6  # noqa: N815
    robot_mode: int
    safety_mode: int
    runtime_state: int
    robot_status_bits: int
    safety_status_bits: int
    speed_scaling: float
    target_speed_fraction: float
    output_int_register_0: int
    output_int_register_1: int
    output_int_register_2: int
    output_int_register_3: int
    output_int_register_4: int
    output_int_register_5: int
    payload: float | None
    tcp_offset: Vector6 | None
    actual_current_as_torque: Vector6 | None
    payload_cog: Vector3 | None
    joint_mode: tuple[int, ...] | None
    joint_temperatures: Vector6 | None
    actual_robot_voltage: float | None
    actual_robot_current: float | None
    actual_digital_input_bits: int | None
    actual_digital_output_bits: int | None
    analog_io_types: int | None
    standard_analog_input0: float | None
    standard_analog_input1: float | None
    standard_analog_output0: float | None
    standard_analog_output1: float | None
    tool_mode: int | None
    tool_analog_input_types: int | None
    tool_analog_input0: float | None
    tool_analog_input1: float | None
    tool_output_voltage: int | None
    tool_output_current: float | None
    tool_temperature: float | None
    output_int_register_24: int | None
    output_int_register_25: int | None
    output_int_register_26: int | None
    output_int_register_27: int | None
    output_int_register_28: int | None
    output_int_register_29: int | None

    @property
    def combined_speed_scaling(self) -> float:
        """Share of its speed at which the arm follows a program, 0 to 1.

        `speed_scaling` is without the speed slider, which is `target_speed_fraction` (as UR's own client
        library and ur-rtde combine them).
        """
        return min(1.0, max(0.0, self.speed_scaling * self.target_speed_fraction))

    def control_registers(self, first: int) -> tuple[int, int, int, int, int, int] | None:
        """Return the six integer output registers from `first` (0 or 24) on; None if there are none."""
        if first == 0:
            return (
                self.output_int_register_0,
                self.output_int_register_1,
                self.output_int_register_2,
                self.output_int_register_3,
                self.output_int_register_4,
                self.output_int_register_5,
            )
        upper = (
            self.output_int_register_24,
            self.output_int_register_25,
            self.output_int_register_26,
            self.output_int_register_27,
            self.output_int_register_28,
            self.output_int_register_29,
        )
        return None if None in upper else cast(tuple[int, int, int, int, int, int], upper)
