"""What a user may set: the keys of the file, and the options of ``crtk-driver my_sensor``."""

from __future__ import annotations

from crtk_drivers.config import DeviceConfig
from crtk_drivers.kit.serial_server import PortName
from pydantic import Field


class MySensorConfig(DeviceConfig):
    """A sensor."""

    port: PortName = Field(default="", description="/dev/ttyUSB0, or socket://HOST:PORT.")
    baud: int = Field(default=9600, ge=300, le=4_000_000, description="Bits a second.")
    rate: float = Field(default=20.0, gt=0.0, le=1000.0, description="Measurements a second.")
    frame_id: str = Field(default="my_sensor", description="Its frame; force is along z.")
