"""What a user may set: the keys of the file, and the options of ``crtk-driver raven``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

from pydantic import Field

from crtk_drivers.config import DeviceConfig, ToolLimitsConfig

__all__ = ["RavenConfig"]

_SLOW = ToolLimitsConfig(
    linear_velocity=0.05,
    angular_velocity=1.0,
    linear_acceleration=0.5,
    angular_acceleration=10.0,
)


class RavenConfig(DeviceConfig):
    """A Raven II with both arms."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The robot": ("host", "port", "rate"),
        "How fast": ("tool", "jaw_velocity"),
        **DeviceConfig.HEADINGS,
    }

    host: str = Field(default="", max_length=253, description="Address of Raven's computer.")
    port: int = Field(default=36_000, ge=1, le=65_535, description="UDP port of its network layer.")
    rate: Literal[1000, 500, 250, 100] = Field(
        default=250, description="Packets a second, moving or not; Raven looks at them 1000 times."
    )
    tool: ToolLimitsConfig = Field(
        default=_SLOW, description="No packet leads an arm faster than that."
    )
    jaw_velocity: float = Field(
        default=2.0,
        gt=0.0,
        le=20.0,
        description="No packet leads a jaw faster than that, in rad/s.",
    )
