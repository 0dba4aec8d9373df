"""What a user may set: the keys of the file, and the options of ``crtk-driver my_arm``."""

from __future__ import annotations

from crtk_drivers.config import DeviceConfig
from pydantic import Field


class MyArmConfig(DeviceConfig):
    """An arm."""

    host: str = Field(default="", description="Address of the arm.")
    port: int = Field(default=7890, ge=1, le=65535, description="TCP port of the arm.")
    max_speed: float = Field(default=1.0, gt=0.0, le=3.0, description="Of each joint, in rad/s.")
