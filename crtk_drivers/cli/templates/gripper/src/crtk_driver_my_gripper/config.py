"""What a user may set: the keys of the file, and the options of ``crtk-driver my_gripper``."""

from __future__ import annotations

from crtk_drivers.config import DeviceConfig
from crtk_drivers.kit.gripping import OnClose
from crtk_drivers.kit.serial_server import PortName
from pydantic import Field


class MyGripperConfig(DeviceConfig):
    """A gripper."""

    port: PortName = Field(default="", description="/dev/ttyUSB0, or socket://HOST:PORT.")
    baud: int = Field(default=115_200, ge=300, le=4_000_000, description="Bits a second.")
    max_speed: float = Field(default=0.1, gt=0.0, le=0.5, description="In m/s.")
    on_close: OnClose = Field(
        default="hold", description="How it is left when the program ends while it is enabled."
    )
