"""The configuration of a stage: the keys of the file, and the options of ``crtk-driver one_axis``."""

from __future__ import annotations

from pydantic import Field

from crtk_drivers.config import DeviceConfig


class OneAxisConfig(DeviceConfig):
    """A stage."""

    host: str = Field(default="", description="Address of the stage.")
    port: int = Field(default=7890, ge=1, le=65535, description="TCP port of the stage.")
    travel: float = Field(
        default=0.5, gt=0.0, le=10.0, description="Length of the stage, in m; it begins at 0."
    )
    max_speed: float = Field(default=0.25, gt=0.0, le=2.0, description="In m/s.")
