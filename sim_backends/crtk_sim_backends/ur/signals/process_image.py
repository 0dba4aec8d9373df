"""What RTDE clients read: the outputs of the controller, brought up to date every period."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, Protocol

from crtk_sim_backends.ur.clock import Clock
from crtk_sim_backends.ur.defects import ArmDefects, Flaws
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
from crtk_sim_backends.ur.motion.limits import SafetyLimits
from crtk_sim_backends.ur.motion.plant import Plant
from crtk_sim_backends.ur.safety.modes import (
    JOINT_MODES,
    SAFETY_RULES,
    JointMode,
    RobotMode,
    RobotStatus,
    RuntimeState,
    SafetyMode,
)

TORQUE_CONSTANT: Final = (12.0, 12.0, 12.0, 9.0, 9.0, 9.0)  # N.m/A behind the gear
BUS_VOLTAGE: Final = 48.0  # V
IDLE_CURRENT: Final = 0.5  # A
STANDBY_POWER: Final = 90.0  # W
EXECUTION_TIME: Final = 0.35  # ms

_ZERO = (0.0,) * 6
_JOINT_FAULT = {SafetyMode.FAULT: JointMode.FAULT, SafetyMode.VIOLATION: JointMode.VIOLATION}


class Robot(Protocol):
    """What the image shows.

    Attributes:
        clock: of the controller.
        plant: the mechanics.
        limits: at which the arm stops protectively.
        outputs: the image, by RTDE output variable name.
    """

    clock: Clock
    plant: Plant
    limits: SafetyLimits
    outputs: dict[str, Any]

    @property
    def robot_mode(self) -> RobotMode:
        """How far the arm is powered."""

    @property
    def safety_mode(self) -> SafetyMode:
        """The safety mode that shows."""

    @property
    def runtime_state(self) -> RuntimeState:
        """State of the program."""

    @property
    def speed_scaling(self) -> float:
        """What slows programs down beside the speed slider, 0 to 1."""


class ProcessImage:
    """Writes the state of a robot into its `outputs`; works only on what changed.

    Args:
        robot: whose it is.
        defects: of groups of its joints.
    """

    def __init__(self, robot: Robot, defects: Sequence[ArmDefects] = ()) -> None:
        self._robot = robot
        self._flaws = Flaws(defects, TORQUE_CONSTANT) if defects else None
        self._current: tuple[float, ...] = _ZERO
        self._still: Any = None
        self._load: Any = None
        self._modes: Any = None
        self._energy = 0.0
        self._moving_mass = 0.0
        self._moment: tuple[float, ...] = _ZERO
        limits = robot.plant.arm.model.torque
        robot.outputs["actual_current_window"] = tuple(
            limit / k for limit, k in zip(limits, TORQUE_CONSTANT, strict=True)
        )
        self._twist: tuple[float, ...] = _ZERO

    def update(self) -> None:
        """Bring every output up to date."""
        robot = self._robot
        plant = robot.plant
        out = robot.outputs
        out["timestamp"] = robot.clock.time
        out["control_step"] = robot.clock.ticks
        for direction in ("input", "output"):
            bits = out[f"actual_digital_{direction}_bits"]
            out[f"actual_configurable_digital_{direction}_bits"] = bits >> 8 & 0xFF
        out["speed_scaling"] = robot.speed_scaling
        modes = (robot.robot_mode, robot.safety_mode, robot.runtime_state)
        if modes != self._modes:
            self._modes = modes
            self._update_modes(out)
        arm = plant.arm
        if plant.load_revision != self._load:
            self._load = plant.load_revision
            self._update_load(out)
        load = plant.load_revision
        still = (arm.actual_q, arm.target_q, arm.target_qd, arm.actual_qd, load, modes)
        if still != self._still or any(arm.target_qdd):
            self._still = still
            self._update_joints(out)
        if self._flaws is not None:
            time = robot.clock.time
            self._flaws.tell(out, arm.actual_q, arm.actual_qd, self._current, time)
            self._flaws.tell_pose(out, plant.kinematics, plant.tool)
        power = STANDBY_POWER
        if any(arm.actual_qd):
            power += sum([abs(m * v) for m, v in zip(self._moment, arm.actual_qd, strict=True)])
        self._energy += power * arm.dt
        out["actual_robot_energy_consumed"] = self._energy

    def _update_modes(self, out: dict[str, Any]) -> None:
        robot = self._robot
        powered = robot.robot_mode >= RobotMode.POWER_ON
        running = robot.runtime_state in (
            RuntimeState.PLAYING,
            RuntimeState.PAUSING,
            RuntimeState.RESUMING,
        )
        out["robot_mode"] = int(robot.robot_mode)
        out["safety_mode"] = out["safety_status"] = int(robot.safety_mode)
        out["runtime_state"] = int(robot.runtime_state)
        joint_mode = _JOINT_FAULT.get(robot.safety_mode, JOINT_MODES[robot.robot_mode])
        out["joint_mode"] = (int(joint_mode),) * 6
        status = RobotStatus.POWER_ON * powered | RobotStatus.PROGRAM_RUNNING * running
        out["robot_status_bits"] = int(status)
        out["safety_status_bits"] = int(SAFETY_RULES[robot.safety_mode].bits)
        out["actual_main_voltage"] = BUS_VOLTAGE
        out["actual_robot_voltage"] = BUS_VOLTAGE if powered else 0.0
        out["actual_joint_voltage"] = (BUS_VOLTAGE if powered else 0.0,) * 6
        out["actual_execution_time"] = out["target_execution_time"] = EXECUTION_TIME

    def _update_joints(self, out: dict[str, Any]) -> None:
        plant = self._robot.plant
        arm = plant.arm
        kinematics = plant.kinematics
        tool = plant.tool
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
            [(new - old) / arm.dt for new, old in zip(twist, self._twist, strict=True)]
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
        plant = self._robot.plant
        out["tcp_offset"] = plant.tcp
        out["payload"] = plant.payload
        out["payload_cog"] = plant.payload_cog
        out["payload_inertia"] = plant.payload_inertia
        out["target_gravity"] = plant.gravity
        self._moving_mass = sum(plant.arm.model.mass[3:]) + plant.payload

    def _update_forces(
        self,
        out: dict[str, Any],
        flange: Transform,
        target_flange: Transform,
        jacobian: Matrix,
    ) -> None:
        robot = self._robot
        plant = robot.plant
        payload, cog, gravity = plant.payload, plant.payload_cog, plant.gravity
        sensor = plant.force_sensor
        sensor.measure(flange, plant.tool, payload, cog, gravity)
        out["ft_raw_wrench"] = sensor.raw
        out["actual_TCP_force"] = out["wrench_calc_from_currents"] = sensor.tcp
        out["tcp_force_scalar"] = force = norm(sensor.tcp[:3])
        out["collision_detection_ratio"] = min(1.0, force / robot.limits.tool_force)
        out["actual_tool_accelerometer"] = rotate_back(flange, gravity)
        if robot.robot_mode != RobotMode.RUNNING:
            self._moment = _ZERO
            target: tuple[float, ...] = _ZERO
        else:
            arm = plant.arm
            target = plant.dynamics.torques(
                arm.target_q, arm.target_qdd, payload, cog, gravity, target_flange
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
        out["actual_current"] = out["joint_control_output"] = self._current = current
        out["actual_current_as_torque"] = self._moment
        powered = robot.robot_mode >= RobotMode.POWER_ON
        out["actual_robot_current"] = (
            IDLE_CURRENT + 0.1 * sum(map(abs, current)) if powered else 0.0
        )


def _over(numerator: Floats, denominator: Floats) -> tuple[float, ...]:
    """Quotients of two vectors, item by item."""
    return tuple([a / b for a, b in zip(numerator, denominator, strict=True)])
