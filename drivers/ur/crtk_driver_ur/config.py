"""Configuration of a Universal Robots arm: keys, defaults, units and bounds."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from crtk_driver_ur.calibration import Calibration
from crtk_driver_ur.models import JOINT_NAMES, RobotModel, model_named
from crtk_driver_ur.plausibility import gravity_problem, payload_problem
from crtk_drivers.config import AttachedConfig, DeviceConfig, Settings

Vector3 = tuple[float, float, float]
Vector6 = tuple[float, float, float, float, float, float]
Flags6 = tuple[bool, bool, bool, bool, bool, bool]


class ToolLineConfig(Settings):
    """Supply and RS-485 of the tool connector (URScript manual, set_tool_voltage, set_tool_communication)."""

    voltage: Literal[0, 12, 24] = Field(default=24, description="Supply of the tool, in V.")
    baud: Literal[9600, 19200, 38400, 57600, 115200, 1000000, 2000000, 5000000] = Field(
        default=115200, description="Bits a second."
    )
    parity: Literal["none", "odd", "even"] = Field(default="none", description="Parity bit.")
    stop_bits: Literal[1, 2] = Field(default=1, description="Stop bits.")
    rx_idle: float = Field(
        default=1.5,
        ge=1.0,
        le=40.0,
        description="Silence that ends what the tool says, in characters.",
    )
    tx_idle: float = Field(
        default=3.5,
        ge=0.0,
        le=40.0,
        description="Silence before the tool is spoken to, in characters.",
    )


class MoveConfig(Settings):
    """How moves go (move_jp, move_jr, move_cp, move_cr), and how fast."""

    planned_by: Literal["driver", "controller"] = Field(
        default="driver",
        description="Who plans them: the driver, so that a newer move takes over without a stop; or the "
        "controller (moveJ, moveL), which brings the arm to rest first.",
    )
    joint_velocity: float = Field(
        default=1.05, gt=0.0, le=3.14, description="Of the leading joint, in rad/s."
    )
    joint_acceleration: float = Field(
        default=1.4, gt=0.0, le=40.0, description="Of the leading joint, in rad/s²."
    )
    linear_velocity: float = Field(default=0.25, gt=0.0, le=3.0, description="Of the tool, in m/s.")
    linear_acceleration: float = Field(
        default=1.2, gt=0.0, le=20.0, description="Of the tool, in m/s²."
    )


class ServoConfig(Settings):
    """How servo commands are carried out (servoJ, speedJ, speedL)."""

    lookahead: float = Field(
        default=0.1,
        ge=0.03,
        le=0.2,
        description="Smoothing of servo_jp and servo_cp in s; the arm lags by about this time.",
    )
    gain: float = Field(
        default=300.0, ge=100.0, le=2000.0, description="Stiffness of servo_jp and servo_cp."
    )
    joint_acceleration: float = Field(
        default=5.0,
        gt=0.0,
        le=40.0,
        description="For servo_jv, interpolate_* and for stops, in rad/s².",
    )
    linear_acceleration: float = Field(
        default=2.0,
        gt=0.0,
        le=20.0,
        description="For servo_cv, interpolate_c* and for stops, in m/s².",
    )
    max_linear_velocity: float = Field(
        default=1.0, gt=0.0, le=5.0, description="Of servo_cv and interpolate_c* at most, in m/s."
    )
    max_angular_velocity: float = Field(
        default=3.14,
        gt=0.0,
        le=10.0,
        description="Of servo_cv and interpolate_c* at most, in rad/s.",
    )


class ForceConfig(Settings):
    """Force mode (servo_cf, interpolate_cf); by the native control only."""

    axes: Flags6 = Field(
        default=(True, True, True, True, True, True),
        description="Axes of `frame` that give way: x, y, z, and about them. The others are held.",
    )
    frame: Literal["base", "tool"] = Field(
        default="base", description="Whose axes these are; those of the tool turn with it."
    )
    max_force: float = Field(default=50.0, gt=0.0, le=500.0, description="Of servo_cf, in N.")
    max_torque: float = Field(default=5.0, gt=0.0, le=100.0, description="Of servo_cf, in N·m.")
    linear_velocity: float = Field(
        default=0.1, gt=0.0, le=1.0, description="With which the tool gives way at most, in m/s."
    )
    angular_velocity: float = Field(
        default=0.5, gt=0.0, le=3.0, description="With which it turns at most, in rad/s."
    )
    damping: float = Field(
        default=0.025,
        ge=0.0,
        le=1.0,
        description="0: goes on when the force ends; 1: stops at once.",
    )
    gain: float = Field(
        default=0.5,
        ge=0.0,
        le=2.0,
        description="Of the controller's own loop; less is more stable against hard surfaces. Not CB3.",
    )


class PayloadConfig(Settings):
    """What the arm carries; sent to the controller by enable."""

    mass: float = Field(ge=0.0, le=100.0, description="In kg; no more than the model carries.")
    center_of_gravity: Vector3 = Field(
        default=(0.0, 0.0, 0.0), description="From the flange, in its axes, in m."
    )
    inertia: Vector6 | None = Field(
        default=None,
        description="About the centre of gravity, in the flange's axes: xx, yy, zz, xy, xz, yz in kg m². The "
        "controller's estimate if null, and on software before 5.10 (CB3: 3.15, by ur_rtde never).",
    )


JointName = Literal[
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
]


class JointConfig(Settings):
    """What one joint may do, within what the model's can."""

    lower: float | None = Field(
        default=None, description="Least position, in rad; the model's if null."
    )
    upper: float | None = Field(
        default=None, description="Largest position, in rad; the model's if null."
    )
    velocity: float | None = Field(
        default=None, gt=0.0, description="Largest speed, in rad/s; the model's if null."
    )


class UrConfig(DeviceConfig):
    """A Universal Robots arm."""

    host: str = Field(default="", max_length=253, description="Address or name of the controller.")
    model: Literal["ur3", "ur5", "ur10", "ur3e", "ur5e", "ur10e", "ur16e", "ur20", "ur30"] = Field(
        default="ur5e", description="Model of the arm."
    )
    joints: dict[JointName, JointConfig] = Field(
        default={},
        description="Ranges and speeds of joints, by name; `crtk-driver ur info --output` writes those of "
        "the controller's safety configuration.",
    )
    frequency: float | None = Field(
        default=None,
        ge=1.0,
        le=500.0,
        description="Samples per second, in Hz; the controller's own rate (125 or 500) if null.",
    )
    watchdog_frequency: float = Field(
        default=5.0,
        ge=2.0,
        le=50.0,
        description="The controller stops the arm when it heard nothing for one period of this, in Hz.",
    )
    control: Literal["native", "ur_rtde"] = Field(
        default="native",
        description="Who carries commands out: a control program of our own, fed from here, or the ur-rtde "
        "library in a process of its own.",
    )
    upper_range_registers: bool = Field(
        default=False,
        description="Use RTDE registers 24 to 47, where a fieldbus or another client has the lower.",
    )
    robot_api_port: int = Field(
        default=80,
        ge=1,
        le=65535,
        description="Port of the Robot API, which PolyScope X has in place of the dashboard server.",
    )
    require_remote_control: bool = Field(
        default=True,
        description="Take control of the arm only while the controller says that it is in remote control. "
        "False for one that obeys without, as UR's own simulator does.",
    )
    power_off_on_disable: bool = Field(
        default=True, description="Disable switches the arm's power off; otherwise it stays on."
    )
    enable_unlocks: bool = Field(
        default=False,
        description="Enable leaves a protective stop too; otherwise only the service "
        "`unlock_protective_stop` does, so that a client that enables in a loop clears no stop.",
    )
    on_close: Literal["hold", "power_off"] = Field(
        default="hold",
        description="What becomes of an enabled arm when the driver ends, once it stands: it keeps its power "
        "and holds its position, or its power is switched off and the brakes hold it.",
    )
    tcp: Vector6 | None = Field(
        default=None,
        description="Tool centre point from the flange: m and a rotation vector in rad. "
        "That of the controller's installation if null.",
    )
    payload: PayloadConfig | None = Field(
        default=None, description="Payload; that of the controller's installation if null."
    )
    gravity: Vector3 | None = Field(
        default=None,
        description="Acceleration opposite to gravity in base axes, in m/s²: 0, 0, 9.82 for an arm "
        "that stands upright. That of the controller's installation if null.",
    )
    calibration: Calibration | Literal["controller", "nominal"] = Field(
        default="controller",
        description="Lengths and angles of this very arm: `controller`, as that tells them when it is "
        "connected; a table, as `crtk-driver ur info --output` writes it; or `nominal`, those of the model.",
    )
    gripper: AttachedConfig | None = Field(
        default=None,
        description="What hangs at the tool, in the namespace `gripper`: its driver, as `robotiq`, or a "
        "table with its settings too.",
    )
    tool_line: ToolLineConfig | None = Field(
        default=None,
        description="Supply and serial line of the tool, switched on when the arm is connected (e-Series); "
        "left as they are if null, but for a gripper that is reached by them.",
    )
    move: MoveConfig = Field(default=MoveConfig(), description="Point-to-point motion.")
    servo: ServoConfig = Field(default=ServoConfig(), description="Streamed motion.")
    force: ForceConfig = Field(default=ForceConfig(), description="Force mode.")
    free_axes: Flags6 = Field(
        default=(True, True, True, True, True, True),
        description="Axes of `free_frame` that `free` lets go: x, y, z, and about them. By the native "
        "control, from PolyScope 5.10 on.",
    )
    free_frame: Literal["base", "tool"] = Field(
        default="base",
        description="Whose axes these are: of the base, or of the tool as it is when `free` begins. By the "
        "native control.",
    )

    @property
    def arm(self) -> RobotModel:
        """The model, with the ranges and speeds that are configured for its joints."""
        model = model_named(self.model)
        return model.limited_to(
            {
                name: (joint.lower, joint.upper, joint.velocity)
                for name, joint in self.joints.items()
            }
        )

    @model_validator(mode="after")
    def _ranges(self) -> UrConfig:
        limits = self.arm.position_limits
        for name, lower, upper in zip(JOINT_NAMES, limits.lower, limits.upper, strict=True):
            if not lower < upper:
                raise ValueError(f"joints: {name}: lower {lower:g} is not below upper {upper:g}")
        return self

    @model_validator(mode="after")
    def _watchdog_is_fed(self) -> UrConfig:
        slow = self.frequency is not None and self.frequency < 4.0 * self.watchdog_frequency
        if self.control == "native" and slow:
            raise ValueError(
                f"frequency: {self.frequency:g} Hz is too slow to feed the watchdog at "
                f"{self.watchdog_frequency:g} Hz; give at least 4 times that, or control: ur_rtde"
            )
        return self

    @model_validator(mode="after")
    def _native_only(self) -> UrConfig:
        chosen = not all(self.free_axes) or self.free_frame != "base"
        if self.control == "ur_rtde" and chosen:
            raise ValueError("free_axes and free_frame need control: native")
        return self

    @model_validator(mode="after")
    def _can_be(self) -> UrConfig:
        load = self.payload
        problems = (
            load
            and payload_problem(
                model_named(self.model), load.mass, load.center_of_gravity, load.inertia
            ),
            self.gravity and gravity_problem(self.gravity),
        )
        for key, problem in zip(("payload", "gravity"), problems, strict=True):
            if problem:
                raise ValueError(f"{key}: {problem}")
        return self

    @model_validator(mode="after")
    def _generation(self) -> UrConfig:
        cb3 = self.model in ("ur3", "ur5", "ur10")
        if cb3 and self.frequency is not None and self.frequency > 125.0:
            raise ValueError(f"{self.model} has a CB3 controller: frequency is at most 125 Hz")
        return self
