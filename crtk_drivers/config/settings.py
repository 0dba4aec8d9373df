"""Configuration: typed, from defaults, a TOML or YAML file and the command line, later ones first.

A device's configuration is a subclass of `DeviceConfig`. Its fields are at once the keys of the
file, the options of ``crtk-driver <device>``, the JSON schema of ``crtk-driver schema <device>``
and the tables of ``docs/configuration.md``; `crtk_drivers.config.load` makes it from layers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, create_model, model_validator

from crtk_drivers.errors import ConfigError
from crtk_drivers.geometry.quaternions import QUATERNION_TOLERANCE, quaternion_from_rpy
from crtk_drivers.options import EngineOptions
from crtk_drivers.samples import Pose, vector

Seconds = Annotated[float, Field(gt=0.0, le=300.0)]
"""A duration in s, above zero and at most five minutes."""


_OPTIONS = EngineOptions()


class Settings(BaseModel):
    """Base of every table of a configuration: immutable, no unknown keys, no NaN, no infinity."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, validate_default=True
    )


class Interval(Settings):
    """A range of values, in the unit of the key that holds it."""

    lower: float = Field(description="Least value.")
    upper: float = Field(description="Greatest value; above `lower`.")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.lower < self.upper:
            raise ValueError(f"lower ({self.lower:g}) must be below upper ({self.upper:g})")
        return self


class LimitsConfig(Settings):
    """How commands are limited before they reach the hardware."""

    clamp_servo: bool = Field(
        default=_OPTIONS.limits.clamp_servo,
        description="Clamp a servo position that is out of range, and warn; if false, refuse it.",
    )
    max_step: float = Field(
        default=_OPTIONS.limits.max_step,
        gt=0.0,
        le=1.0,
        description="Largest step between two servo positions, as the time in s that the joint "
        "would need for it at its velocity limit; for the first of a stream, what its acceleration limit "
        "allows in twice that time.",
    )
    max_linear_step: float = Field(
        default=_OPTIONS.limits.max_linear_step,
        gt=0.0,
        le=1.0,
        description="Largest step of the tool between two servo poses, in m.",
    )
    max_command_age: float | None = Field(
        default=_OPTIONS.limits.max_command_age,
        gt=0.0,
        le=60.0,
        description="Refuse a command whose stamp is older than this, in s, enable, resume and home "
        "included; not checked if null. The clocks of driver and client must be synchronised: a stamp may be "
        "ahead by as much, and by at most 0.5 s.",
    )
    following_error: float | None = Field(
        default=_OPTIONS.limits.following_error,
        gt=0.0,
        le=10.0,
        description="A joint that is further than this, in rad (m), from what it was sent does not follow: "
        "FAULT. As the driver declares for each joint if null.",
    )


class PoseConfig(Settings):
    """A pose: where something is in the frame that the key speaks of."""

    position: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0), description="x, y, z in m."
    )
    orientation: tuple[float, float, float, float] | None = Field(
        default=None, description="Quaternion x, y, z, w. Give this or rpy."
    )
    rpy: tuple[float, float, float] | None = Field(
        default=None, description="Roll, pitch, yaw in rad, about fixed x, then y, then z."
    )

    @model_validator(mode="after")
    def _one_orientation(self) -> Self:
        if self.orientation is not None and self.rpy is not None:
            raise ValueError("give orientation or rpy, not both")
        if self.orientation is not None:
            norm = math.hypot(*self.orientation)
            if abs(norm - 1.0) > QUATERNION_TOLERANCE:
                raise ValueError(f"orientation must have a norm of 1, not {norm:g}")
        return self

    @property
    def pose(self) -> Pose:
        """The same as a value."""
        if self.orientation is not None:
            turned = vector(self.orientation)
            orientation = vector(turned / math.hypot(*self.orientation))
        else:
            orientation = quaternion_from_rpy(*(self.rpy or (0.0, 0.0, 0.0)))
        return Pose(vector(self.position), orientation)


class BaseConfig(PoseConfig):
    """Where the device stands: the pose of its own base in another frame."""

    frame_id: str = Field(
        default="world", min_length=1, max_length=100, description="Name of that frame."
    )


class ToolLimitsConfig(Settings):
    """How fast and hard the tool may be."""

    linear_velocity: float = Field(default=0.5, gt=0.0, description="m/s.")
    angular_velocity: float = Field(default=1.5, gt=0.0, description="rad/s.")
    linear_acceleration: float = Field(default=2.0, gt=0.0, description="m/s².")
    angular_acceleration: float = Field(default=6.0, gt=0.0, description="rad/s².")
    force: float = Field(
        default=0.0, ge=0.0, description="N; 0: no forces. Counts where joints take efforts."
    )
    torque: float = Field(default=0.0, ge=0.0, description="N·m; 0: no torques.")


class BoxConfig(Settings):
    """A box with edges along the axes of a frame."""

    lower: tuple[float, float, float] = Field(description="Corner with the least x, y, z, in m.")
    upper: tuple[float, float, float] = Field(description="The opposite corner, in m.")

    def within(self, other: BoxConfig) -> BoxConfig:
        """Return what both have; a ValueError where that is nothing."""
        (a, b, c), (d, e, f) = self.lower, other.lower
        (u, v, w), (x, y, z) = self.upper, other.upper
        return BoxConfig(
            lower=(max(a, d), max(b, e), max(c, f)), upper=(min(u, x), min(v, y), min(w, z))
        )

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not all(low < high for low, high in zip(self.lower, self.upper, strict=True)):
            raise ValueError(f"lower {self.lower} must be below upper {self.upper} on each axis")
        return self


class SpaceConfig(Settings):
    """Where a device may go, and how fast: narrower than its own limits."""

    joints: tuple[Interval, ...] = Field(
        default=(), description="Range of each joint, in rad (m), in their order; all or none."
    )
    tool_box: BoxConfig | None = Field(
        default=None,
        description="Box for the tool point in the base frame. `crtk-driver bench` watches it; the driver "
        "itself does not know it.",
    )
    speed: float = Field(
        default=1.0, gt=0.0, le=1.0, description="Share of every velocity limit that may be used."
    )

    def within(self, other: SpaceConfig | None) -> SpaceConfig:
        """Return what both allow; this one where there is no other.

        Raises:
            ConfigError: they have nothing in common, or ranges for another number of joints.
        """
        if other is None:
            return self
        joints, boxes = self.joints or other.joints, self.tool_box or other.tool_box
        try:
            if self.joints and other.joints:
                joints = tuple(
                    Interval(lower=max(a.lower, b.lower), upper=min(a.upper, b.upper))
                    for a, b in zip(self.joints, other.joints, strict=True)
                )
            if self.tool_box is not None and other.tool_box is not None:
                boxes = self.tool_box.within(other.tool_box)
        except ValueError as error:  # of pydantic too
            raise ConfigError(
                "the space of the lab file and that of the device's own settings have nothing in common",
                where="space",
                remedy="Give the same number of ranges, and let each overlap.",
            ) from error
        return SpaceConfig(joints=joints, tool_box=boxes, speed=min(self.speed, other.speed))


class DhRowConfig(Settings):
    """One row of a Denavit-Hartenberg table."""

    a: float = Field(default=0.0, description="Length of the link, in m.")
    alpha: float = Field(default=0.0, description="Twist of the link, in rad.")
    d: float = Field(default=0.0, description="Offset along the joint's axis, in m.")
    theta: float = Field(default=0.0, description="Angle about the joint's axis at zero, in rad.")
    kind: Literal["revolute", "prismatic"] = Field(default="revolute", description="Of the joint.")


class KinematicsConfig(Settings):
    """Kinematics for a device that has none of its own: a URDF, or a Denavit-Hartenberg table."""

    urdf: str | None = Field(
        default=None, description="Path of a URDF file (xacro expanded). Give this or dh."
    )
    base_link: str = Field(default="base_link", description="Link of the URDF that is the base.")
    tip_link: str = Field(default="tool0", description="Link of the URDF that carries the tool.")
    joints: tuple[str, ...] = Field(
        default=(),
        description="Names of the joints in the URDF, in the order of the device, where it calls "
        "them otherwise.",
    )
    dh: tuple[DhRowConfig, ...] = Field(
        default=(), description="One row for each joint, in the order of the device."
    )
    dh_convention: Literal["standard", "modified"] = Field(
        default="standard", description="Of the table."
    )
    tool: PoseConfig | None = Field(
        default=None, description="Tool point in the tip link; the tip itself if null."
    )
    position_only: bool = Field(
        default=False, description="Reach positions with any orientation: for arms of few axes."
    )
    limits: ToolLimitsConfig = Field(default=ToolLimitsConfig(), description="Of the tool.")

    @model_validator(mode="after")
    def _one_model(self) -> Self:
        if (self.urdf is None) is not bool(self.dh):
            raise ValueError("give urdf or dh")
        return self


class RecordingConfig(Settings):
    """What is recorded of a device, and where to."""

    folder: str | None = Field(
        default=None,
        max_length=1000,
        description="Folder of recordings that are not told where to go, and of the black box; none if "
        "empty. If null, `crtk-driver` takes ~/.local/state/crtk-drivers/NAME, and plain Python none.",
    )
    folder_size: float = Field(
        default=500.0,
        gt=0.0,
        le=1e7,
        description="MB that recordings in the folder may take before the oldest black boxes are deleted.",
    )
    black_box: float = Field(
        default=5.0,
        ge=0.0,
        le=600.0,
        description="Seconds that the black box keeps; 0: there is none.",
    )
    topics: tuple[str, ...] = Field(
        default=(),
        description="CRTK names that are recorded of each sample; if empty measured_*, setpoint_js and "
        "setpoint_cp.",
    )
    keep_free: float = Field(
        default=200.0,
        ge=0.0,
        le=1e7,
        description="MB of the disk that a recording leaves free; what does not fit is lost, counted and "
        "told.",
    )
    split_size: float = Field(
        default=0.0, ge=0.0, le=1e7, description="MB after which the next file begins; 0: never."
    )
    split_time: float = Field(
        default=0.0,
        ge=0.0,
        le=1e7,
        description="Seconds after which the next file begins; 0: never.",
    )


class DeviceConfig(Settings):
    """The keys that every device has; a driver adds its own in a subclass."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "Connection": ("name", "open_timeout", "sample_timeout"),
        "Streams of commands": (
            "stream_timeout",
            "interpolate_timeout",
            "on_stream_timeout",
            "mode_switch_dwell",
        ),
        "Moves, free drive": ("move_cp", "on_client_gone", "free_timeout"),
        "Page for the browser": ("web", "web_port"),
    }

    name: str = Field(
        default="",
        max_length=64,
        description="Name of the device in messages and diagnostics; the driver's name if empty.",
    )
    open_timeout: Seconds = Field(default=5.0, description="Longest time to connect, in s.")
    stream_timeout: float = Field(
        default=_OPTIONS.stream_timeout,
        gt=0.0,
        le=10.0,
        description="A servo stream has stopped when no command came for this long, in s.",
    )
    interpolate_timeout: float = Field(
        default=_OPTIONS.interpolate_timeout,
        gt=0.0,
        le=10.0,
        description="An interpolated stream has stopped when no command came for this long, in s.",
    )
    on_stream_timeout: Literal["hold", "pause", "fault"] = Field(
        default=_OPTIONS.on_stream_timeout,
        description="What follows when the stream has stopped and the device was held: "
        "stay ENABLED (hold), or go to PAUSED or FAULT.",
    )
    sample_timeout: float = Field(
        default=_OPTIONS.sample_timeout,
        gt=0.0,
        le=10.0,
        description="The device is in FAULT when its last sample is older than this, in s.",
    )
    mode_switch_dwell: float = Field(
        default=_OPTIONS.mode_switch_dwell,
        ge=0.0,
        le=10.0,
        description="Refuse a servo command of another kind until the last kind was silent for "
        "this long, in s.",
    )
    on_client_gone: Literal["keep", "hold"] = Field(
        default=_OPTIONS.on_client_gone,
        description="What becomes of free drive and gravity compensation when the client that asked for "
        "them has gone: go on (keep), or hold the device and switch it off within 1 s (hold). Over ROS a "
        "process that was killed has gone when DDS says so, with Fast DDS after 20 s.",
    )
    free_timeout: float | None = Field(
        default=_OPTIONS.free_timeout,
        gt=0.0,
        le=300.0,
        description="Free drive and gravity compensation end likewise when they are not asked for again for "
        "this long, in s; they go on if null.",
    )
    move_cp: Literal["line", "joints"] = Field(
        default=_OPTIONS.move_cp,
        description="The way of move_cp and move_cr: the tool in a straight line, or the joints all at "
        "once to where inverse kinematics has the goal.",
    )
    web: bool = Field(
        default=False,
        description="Show the device on a page for a browser on this machine; the page only looks.",
    )
    web_port: int = Field(
        default=8000, ge=0, le=65535, description="Port of that page at 127.0.0.1; 0: any free one."
    )
    limits: LimitsConfig = Field(default=LimitsConfig(), description="How commands are limited.")
    recording: RecordingConfig = Field(
        default=RecordingConfig(), description="What is recorded, and where to."
    )
    base: BaseConfig | None = Field(
        default=None,
        description="Where the device's own base is in another frame, in which poses are then given.",
    )
    kinematics: KinematicsConfig | None = Field(
        default=None, description="Kinematics for a device that has none of its own."
    )
    space: SpaceConfig | None = Field(
        default=None, description="Where it may go, and how fast; as its own limits say if null."
    )


class NodeConfig(Settings):
    """The ROS 2 node: the initial values of its parameters. ROS arguments override them."""

    publish_rate: float = Field(
        default=100.0,
        ge=0.1,
        le=2000.0,
        description="Rate of measured_*, setpoint_* and jacobian, in Hz.",
    )
    tf_rate: float = Field(
        default=50.0, ge=0.0, le=500.0, description="Rate of /tf, in Hz; 0 publishes none."
    )
    heartbeat_rate: float = Field(
        default=5.0,
        ge=1.0,
        le=10.0,
        description="Rate at which operating_state is repeated, in Hz.",
    )
    diagnostics_rate: float = Field(
        default=1.0,
        ge=0.0,
        le=10.0,
        description="Rate of /diagnostics, in Hz; 0 publishes none.",
    )
    frame_prefix: str | None = Field(
        default=None,
        max_length=200,
        description="Put before every frame id, so that two devices do not collide on /tf; "
        "from the namespace if null.",
    )
    share_namespace: bool = Field(
        default=False,
        description="Serve commands also while another driver is in the namespace, which was there first.",
    )
    joint_states: bool = Field(
        default=False,
        description="Publish joint_states too: measured_js for programs that know all joints by name.",
    )
    moveit: bool = Field(
        default=False,
        description="Serve what MoveIt asks of an arm or a gripper: joint_states, the actions "
        "follow_joint_trajectory and gripper_cmd, and what MoveIt Servo publishes. Needs the extra [moveit].",
    )
    joint_prefix: str = Field(
        default="",
        max_length=100,
        pattern="^[A-Za-z0-9_/]*$",
        description="Put before joint names in joint_states, robot_description and trajectories.",
    )


def with_node(model: type[DeviceConfig]) -> type[DeviceConfig]:
    """Return `model` with the table ``node`` beside its own keys: what a file may hold."""
    table = Field(default=NodeConfig(), description="The ROS 2 node. Not used in plain Python.")
    extended: type[DeviceConfig] = create_model(
        model.__name__, __base__=model, __doc__=model.__doc__, node=(NodeConfig, table)
    )
    return extended
