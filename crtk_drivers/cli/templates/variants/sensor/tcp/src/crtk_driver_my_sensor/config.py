"""What a user may set: the keys of the file, and the options of ``crtk-driver my_sensor``."""

from __future__ import annotations

from crtk_drivers.config import DeviceConfig
from pydantic import Field


class MySensorConfig(DeviceConfig):
    """A sensor."""

    host: str = Field(default="", description="Address of the sensor.")
    port: int = Field(default=7891, ge=1, le=65535, description="TCP port of the sensor.")
    rate: float = Field(default=20.0, gt=0.0, le=1000.0, description="Measurements a second.")
    frame_id: str = Field(default="my_sensor", description="Its frame; force is along z.")
