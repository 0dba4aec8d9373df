"""Configuration of a virtual arm: keys, defaults, units and bounds."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field, model_validator

from crtk_driver_virtual.defects_config import DefectsConfig
from crtk_drivers.config import DeviceConfig, PoseConfig, Settings, ToolLimitsConfig

Vector3 = tuple[float, float, float]


class WallConfig(Settings):
    """A plane that the tool point cannot pass, with a spring and a damper in it."""

    point: Vector3 = Field(description="A point of the plane, in the arm's base frame, in m.")
    normal: Vector3 = Field(description="Out of the wall, to where the tool is free; any length.")
    stiffness: float = Field(default=5000.0, gt=0.0, le=1e6, description="In N/m.")
    damping: float = Field(default=50.0, ge=0.0, le=1e5, description="In N·s/m, within the wall.")

    @model_validator(mode="after")
    def _direction(self) -> WallConfig:
        if not math.hypot(*self.normal) > 1e-6:
            raise ValueError("normal must have a direction")
        return self


class VirtualConfig(DeviceConfig):
    """A virtual arm."""

    address: str = Field(
        default="virtual",
        min_length=1,
        max_length=100,
        description="A name; devices with the same address share one I/O thread.",
    )
    model: Literal["six_axis", "seven_axis", "haptic"] = Field(
        default="six_axis", description="One of the built-in arms, unless `urdf` names a file."
    )
    urdf: str | None = Field(
        default=None,
        description="Path of a URDF file (xacro expanded). Without inertias it takes no efforts.",
    )
    base_link: str = Field(default="base_link", description="Link of that file that is the base.")
    tip_link: str = Field(default="tool0", description="Link of that file that carries the tool.")
    tool: PoseConfig | None = Field(
        default=None, description="Tool point in the tip; the tip itself if null."
    )
    acceleration: float | None = Field(
        default=None,
        gt=0.0,
        le=1000.0,
        description="Limit of each joint, in rad/s² (m/s²); of the model if null, 5 for a file.",
    )
    jerk: float | None = Field(
        default=None,
        gt=0.0,
        le=1e5,
        description="Limit of each joint, in rad/s³ (m/s³); ten times the acceleration if null.",
    )
    tool_limits: ToolLimitsConfig | None = Field(
        default=None, description="Of the tool; of the model if null."
    )
    start: tuple[float, ...] | None = Field(
        default=None,
        description="Joint positions to begin with, in rad (m); of the model if null, for a file "
        "the middle of each range.",
    )
    rotor_inertia: float | None = Field(
        default=None,
        gt=0.0,
        le=100.0,
        description="Of each motor as its joint feels it, in kg·m² (kg); of the model if null, for a "
        "file the joint's effort limit divided by 200 rad/s².",
    )
    friction: float = Field(
        default=1.0, ge=0.0, le=100.0, description="Factor on the model's viscous friction."
    )
    gravity: Vector3 = Field(
        default=(0.0, 0.0, -9.81),
        description="Acceleration of free fall in the axes of the arm's own base, in m/s².",
    )
    gravity_compensation: bool = Field(
        default=True,
        description="Motors carry the arm's weight beside commanded efforts, until "
        "use_gravity_compensation says otherwise.",
    )
    servo_bandwidth: float = Field(
        default=20.0, ge=1.0, le=50.0, description="Of the joints' position servos, in Hz."
    )
    walls: tuple[WallConfig, ...] = Field(
        default=(), max_length=20, description="What the tool can push against."
    )
    rate: float = Field(default=500.0, ge=10.0, le=1000.0, description="Of the I/O cycle, in Hz.")
    needs_homing: bool = Field(default=False, description="Positions count only after home.")
    transition_time: float = Field(
        default=0.2, ge=0.0, le=4.0, description="What enable, disable and home take, in s."
    )
    defects: DefectsConfig = Field(
        default=DefectsConfig(),
        description="What is wrong with the arm, for benches that must find it.",
    )
