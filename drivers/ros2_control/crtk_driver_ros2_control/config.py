"""Configuration of a robot behind ros2_control: keys, defaults, units and bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from crtk_drivers.config import DeviceConfig, PoseConfig, Seconds, Settings, ToolLimitsConfig

_NAME = r"^[A-Za-z][A-Za-z0-9_/]*$"
_TOPIC = r"^/[A-Za-z][A-Za-z0-9_/]*$"


class JointConfig(Settings):
    """One joint, as ros2_control calls it."""

    name: str = Field(min_length=1, max_length=200, description="As in joint_states.")
    lower: float = Field(default=-2.0 * math.pi, description="Of its range, in rad (m).")
    upper: float = Field(default=2.0 * math.pi, description="Of its range, in rad (m).")
    velocity: float = Field(default=1.0, gt=0.0, le=100.0, description="Limit, in rad/s (m/s).")
    acceleration: float = Field(
        default=3.0, gt=0.0, le=1000.0, description="Limit, in rad/s² (m/s²)."
    )
    effort: float = Field(default=0.0, ge=0.0, le=1e5, description="Limit, in N·m (N).")


class Ros2ControlConfig(DeviceConfig):
    """A robot behind ros2_control."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        **DeviceConfig.HEADINGS,
        "The robot on ROS": ("controller_manager", "joint_states", "domain"),
        "Its controllers": (
            "position_controller",
            "velocity_controller",
            "effort_controller",
            "trajectory_controller",
            "allow_untimed",
            "moves",
            "take_over",
        ),
    }

    controller_manager: str = Field(
        default="",
        max_length=200,
        pattern=rf"^$|{_TOPIC}",
        description="Full name of its controller manager, /controller_manager for most robots. Its "
        "controllers are beside it.",
    )
    joint_states: str = Field(
        default="/joint_states",
        max_length=200,
        pattern=_TOPIC,
        description="Topic of its joint_state_broadcaster.",
    )
    domain: int | None = Field(
        default=None,
        ge=0,
        le=232,
        description="ROS domain of the robot, where it is another one than the driver's.",
    )
    open_timeout: Seconds = Field(
        default=10.0,
        description="Longest time to connect, in s: nodes of ROS have to find each other.",
    )
    joints: tuple[JointConfig, ...] = Field(
        default=(),
        max_length=64,
        description="Its joints and their limits, in the order of the device. Give these or urdf.",
    )
    urdf: str | None = Field(
        default=None,
        description="Path of its URDF (xacro expanded): joints, limits and kinematics come from it. "
        "`crtk-driver ros2-control describe` saves what the robot publishes.",
    )
    base_link: str = Field(default="base_link", description="Link of the URDF that is the base.")
    tip_link: str = Field(default="tool0", description="Link of the URDF that carries the tool.")
    tool: PoseConfig | None = Field(
        default=None, description="Tool point in the tip link; the tip itself if null."
    )
    tool_limits: ToolLimitsConfig = Field(
        default=ToolLimitsConfig(), description="Of the tool, with a URDF."
    )
    acceleration: float = Field(
        default=3.0,
        gt=0.0,
        le=1000.0,
        description="Limit of each joint of the URDF, which has none, in rad/s² (m/s²).",
    )
    position_controller: str = Field(
        default="",
        max_length=200,
        pattern=rf"^$|{_NAME}",
        description="Forward controller that takes positions of all joints; empty if there is none.",
    )
    velocity_controller: str = Field(
        default="",
        max_length=200,
        pattern=rf"^$|{_NAME}",
        description="Forward controller that takes velocities of all joints; empty if there is none.",
    )
    effort_controller: str = Field(
        default="",
        max_length=200,
        pattern=rf"^$|{_NAME}",
        description="Forward controller that takes efforts of all joints; empty if there is none.",
    )
    trajectory_controller: str = Field(
        default="",
        max_length=200,
        pattern=rf"^$|{_NAME}",
        description="Joint trajectory controller of all joints; empty if there is none.",
    )
    allow_untimed: bool = Field(
        default=False,
        description="Use velocity_controller and effort_controller although nothing ends what they were told "
        "last when this driver dies: they have no timeout. Without it they are refused.",
    )
    moves: Literal["auto", "core", "trajectory"] = Field(
        default="auto",
        description="Who carries out move_jp: this driver point by point (core), or the trajectory "
        "controller as one goal (trajectory). auto: the latter where there is no position_controller.",
    )
    take_over: bool = Field(
        default=False,
        description="Enabling deactivates controllers of others that have the joints; else it is refused.",
    )
    hardware: tuple[str, ...] = Field(
        default=(),
        max_length=64,
        description="Hardware components to be brought to active by enable, and looked at from then on. Only "
        "with ROS 2 Jazzy: later releases answer list_hardware_components with other bytes.",
    )
    on_disable: Literal["controllers", "hardware"] = Field(
        default="controllers",
        description="What disable makes inactive: the controllers, or the hardware components as well.",
    )
    rate: float = Field(
        default=100.0,
        ge=5.0,
        le=1000.0,
        description="Of joint_states, in Hz; setpoints go out as often.",
    )
    service_timeout: float = Field(
        default=3.0,
        gt=0.0,
        le=60.0,
        description="Longest time that the controller manager may take for an answer, in s.",
    )
    lag: float = Field(
        default=0.5,
        gt=0.0,
        le=5.0,
        description="Seconds that the robot takes to carry a setpoint out.",
    )
    stop_time: float = Field(
        default=2.0, gt=0.0, le=30.0, description="Seconds in which the joints stand after a stop."
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.joints and self.urdf is not None:
            raise ValueError("give joints or urdf, not both")
        names = [joint.name for joint in self.joints]
        if len(set(names)) < len(names):
            raise ValueError(f"joints: {max(names, key=names.count)} is there twice")
        for joint in self.joints:
            if not joint.lower < joint.upper:
                raise ValueError(f"joints: lower of {joint.name} is not below upper")
        controllers = [name for name in self.controllers if name]
        if len(set(controllers)) < len(controllers):
            raise ValueError("one controller is named twice")
        untimed = [name for name in (self.velocity_controller, self.effort_controller) if name]
        if untimed and not self.allow_untimed:
            raise ValueError(
                f"{' and '.join(untimed)}: forward controllers have no timeout: when this driver dies, the "
                "joints go on at the last velocity or effort. Leave velocity_controller and "
                "effort_controller out, or say that you have an emergency stop at hand: allow_untimed: true"
            )
        if self.moves == "trajectory" and not self.trajectory_controller:
            raise ValueError("moves: trajectory needs a trajectory_controller")
        if self.on_disable == "hardware" and not self.hardware:
            raise ValueError("on_disable: hardware needs the names of hardware components")
        return self

    @property
    def controllers(self) -> tuple[str, ...]:
        """Those for position, velocity, effort and trajectories; empty where there is none."""
        return (
            self.position_controller,
            self.velocity_controller,
            self.effort_controller,
            self.trajectory_controller,
        )

    @property
    def moves_by_goal(self) -> bool:
        """Whether move_jp is a goal of the trajectory controller."""
        if self.moves == "auto":
            return bool(self.trajectory_controller) and not self.position_controller
        return self.moves == "trajectory"
