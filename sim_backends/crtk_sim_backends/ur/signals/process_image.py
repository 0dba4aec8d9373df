"""What RTDE clients read: the outputs of the controller, brought up to date every period."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from crtk_sim_backends.ur.motion.arm import DEVIATION_LIMIT
from crtk_sim_backends.ur.motion.kinematics import (
    Floats,
    Matrix,
    Transform,
    compose,
    multiply,
    norm,
    rotate_back,
    to_pose,
    transpose_multiply,
)
from crtk_sim_backends.ur.safety.modes import (
    JOINT_MODES,
    SAFETY_RULES,
    JointMode,
    RobotMode,
    RobotStatus,
    RuntimeState,
    SafetyMode,
)

if TYPE_CHECKING:
    from crtk_sim_backends.ur.controller import Controller

TORQUE_CONSTANT: Final = (12.0, 12.0, 12.0, 9.0, 9.0, 9.0)  # N.m/A behind the gear
BUS_VOLTAGE: Final = 48.0  # V
IDLE_CURRENT: Final = 0.5  # A
STANDBY_POWER: Final = 90.0  # W
EXECUTION_TIME: Final = 0.35  # ms

_ZERO = (0.0,) * 6
_JOINT_FAULT = {SafetyMode.FAULT: JointMode.FAULT, SafetyMode.VIOLATION: JointMode.VIOLATION}


class ProcessImage:
    """Writes the state of a controller into its `outputs`; works only on what changed."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._still: Any = None
        self._load: Any = None
        self._modes: Any = None
        self._energy = 0.0
        self._moving_mass = 0.0
        self._moment: tuple[float, ...] = _ZERO
        controller.outputs["actual_current_window"] = tuple(
            limit / k for limit, k in zip(controller.model.torque, TORQUE_CONSTANT, strict=True)
        )
        self._twist: tuple[float, ...] = _ZERO

    def update(self) -> None:
        """Bring every output up to date."""
        c = self._controller
        out = c.outputs
        out["timestamp"] = c.time
        out["control_step"] = c.tick_count
        for direction in ("input", "output"):
            bits = out[f"actual_digital_{direction}_bits"]
            out[f"actual_configurable_digital_{direction}_bits"] = bits >> 8 & 0xFF
        out["speed_scaling"] = c.speed_scaling
        modes = (c.robot_mode, c.safety_mode, c.runtime_state)
        if modes != self._modes:
            self._modes = modes
            self._update_modes(out)
        arm = c.arm
        if c.load_revision != self._load:
            self._load = c.load_revision
            self._update_load(out)
        still = (arm.actual_q, arm.target_q, arm.target_qd, arm.actual_qd, c.load_revision, modes)
        if still != self._still or any(arm.target_qdd):
            self._still = still
            self._update_joints(out)
        power = STANDBY_POWER
        if any(arm.actual_qd):
            power += sum([abs(m * v) for m, v in zip(self._moment, arm.actual_qd, strict=True)])
        self._energy += power * c.dt
        out["actual_robot_energy_consumed"] = self._energy

    def _update_modes(self, out: dict[str, Any]) -> None:
        c = self._controller
        powered = c.robot_mode >= RobotMode.POWER_ON
        running = c.runtime_state in (
            RuntimeState.PLAYING,
            RuntimeState.PAUSING,
            RuntimeState.RESUMING,
        )
        out["robot_mode"] = int(c.robot_mode)
        out["safety_mode"] = out["safety_status"] = int(c.safety_mode)
        out["runtime_state"] = int(c.runtime_state)
        joint_mode = _JOINT_FAULT.get(c.safety_mode, JOINT_MODES[c.robot_mode])
        out["joint_mode"] = (int(joint_mode),) * 6
        status = RobotStatus.POWER_ON * powered | RobotStatus.PROGRAM_RUNNING * running
        out["robot_status_bits"] = int(status)
        out["safety_status_bits"] = int(SAFETY_RULES[c.safety_mode].bits)
        out["actual_main_voltage"] = BUS_VOLTAGE
        out["actual_robot_voltage"] = BUS_VOLTAGE if powered else 0.0
        out["actual_joint_voltage"] = (BUS_VOLTAGE if powered else 0.0,) * 6
        out["actual_execution_time"] = out["target_execution_time"] = EXECUTION_TIME

    def _update_joints(self, out: dict[str, Any]) -> None:
        c = self._controller
        arm = c.arm
        kinematics = c.kinematics
        tool = c.tool
        out["target_q"] = tuple(arm.target_q)
        out["target_qd"] = tuple(arm.target_qd)
        out["target_qdd"] = tuple(arm.target_qdd)
        out["actual_q"] = tuple(arm.actual_q)
        out["actual_qd"] = tuple(arm.actual_qd)
        flange = kinematics.flange(arm.actual_q)
        out["actual_TCP_pose"] = to_pose(compose(flange, tool))
        resting = arm.target_q == arm.actual_q
        target_flange = flange if resting else kinematics.flange(arm.target_q)
        out["target_TCP_pose"] = (
            out["actual_TCP_pose"] if resting else to_pose(compose(target_flange, tool))
        )
        jacobian = kinematics.jacobian(arm.actual_q, tool, flange)
        moving = any(arm.actual_qd) or any(arm.target_qd)
        twist = multiply(jacobian, arm.actual_qd) if moving else _ZERO
        target_twist = multiply(jacobian, arm.target_qd) if moving else _ZERO
        out["actual_TCP_acceleration"] = tuple(
            [(new - old) / c.dt for new, old in zip(twist, self._twist, strict=True)]
        )
        out["target_TCP_acceleration"] = (
            multiply(jacobian, arm.target_qdd) if any(arm.target_qdd) else _ZERO
        )
        self._twist = twist
        out["actual_TCP_speed"] = twist
        out["target_TCP_speed"] = target_twist
        out["elbow_position"], out["elbow_velocity"] = kinematics.elbow(arm.actual_q, arm.actual_qd)
        self._update_forces(out, flange, target_flange, jacobian)
        out["actual_momentum"] = norm(twist[:3]) * self._moving_mass
        out["joint_position_deviation_ratio"] = 0.0 if resting else arm.deviation / DEVIATION_LIMIT

    def _update_load(self, out: dict[str, Any]) -> None:
        c = self._controller
        out["tcp_offset"] = c.tcp
        out["payload"] = c.payload
        out["payload_cog"] = c.payload_cog
        out["payload_inertia"] = c.payload_inertia
        out["target_gravity"] = c.gravity
        self._moving_mass = sum(c.model.mass[3:]) + c.payload

    def _update_forces(
        self,
        out: dict[str, Any],
        flange: Transform,
        target_flange: Transform,
        jacobian: Matrix,
    ) -> None:
        c = self._controller
        sensor = c.force_sensor
        sensor.measure(flange, c.tool, c.payload, c.payload_cog, c.gravity)
        out["ft_raw_wrench"] = sensor.raw
        out["actual_TCP_force"] = out["wrench_calc_from_currents"] = sensor.tcp
        out["tcp_force_scalar"] = force = norm(sensor.tcp[:3])
        out["collision_detection_ratio"] = min(1.0, force / c.limits.tool_force)
        out["actual_tool_accelerometer"] = rotate_back(flange, c.gravity)
        if c.robot_mode != RobotMode.RUNNING:
            self._moment = _ZERO
            target: tuple[float, ...] = _ZERO
        else:
            arm = c.arm
            target = c.dynamics.torques(
                arm.target_q, arm.target_qdd, c.payload, c.payload_cog, c.gravity, target_flange
            )
            load = sensor.applied
            if any(load):
                external = transpose_multiply(jacobian, load)
                self._moment = tuple(t - e for t, e in zip(target, external, strict=True))
            else:
                self._moment = target
        current = _over(self._moment, TORQUE_CONSTANT)
        out["target_moment"] = target
        out["target_current"] = (
            current if target is self._moment else _over(target, TORQUE_CONSTANT)
        )
        out["actual_current"] = out["joint_control_output"] = current
        out["actual_current_as_torque"] = self._moment
        powered = c.robot_mode >= RobotMode.POWER_ON
        out["actual_robot_current"] = (
            IDLE_CURRENT + 0.1 * sum(map(abs, current)) if powered else 0.0
        )


def _over(numerator: Floats, denominator: Floats) -> tuple[float, ...]:
    """Quotients of two vectors, item by item."""
    return tuple([a / b for a, b in zip(numerator, denominator, strict=True)])
