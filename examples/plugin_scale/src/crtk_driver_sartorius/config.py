"""What a user may set: the keys of the file, and the options of ``crtk-driver sartorius``."""

from typing import Literal

from pydantic import Field

from crtk_drivers.config import DeviceConfig
from crtk_drivers.kit.serial_server import PortName


class SartoriusConfig(DeviceConfig):
    """A scale."""

    port: PortName = Field(default="", description="/dev/ttyUSB0, or socket://HOST:PORT.")
    unit: Literal["mg", "g", "kg"] = Field(default="g", description="As its display has it.")
    rate: float = Field(default=10.0, gt=0.0, le=20.0, description="Weights a second.")
    frame_id: str = Field(default="scale", description="Its frame; z is up.")
