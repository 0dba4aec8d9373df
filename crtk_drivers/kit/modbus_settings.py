"""Configuration of a device that is spoken to in Modbus, by whichever way it is connected."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from pydantic import Field, field_validator

from crtk_drivers.config.settings import DeviceConfig
from crtk_drivers.kit.robot_ports import script_port
from crtk_drivers.kit.serial_server import PortName

__all__ = ["ModbusConfig"]


class ModbusConfig(DeviceConfig):
    """A device in Modbus. A driver narrows `link` to the ways that it has, and gives `baud` and `address`."""

    WAY: ClassVar[tuple[str, ...]] = (
        "link",
        "port",
        "baud",
        "host",
        "tcp_port",
        "address",
        "rate",
        "reply_timeout",
    )
    """For `HEADINGS`: the keys that say how it is reached."""
    PORTS: ClassVar[Mapping[str, int]] = {"tool": 54321, "modbus": 502}
    """TCP port of each link that has one."""
    PARITY: ClassVar[str] = "none"
    """On a serial line."""

    link: str = Field(
        description="serial: Modbus RTU at a serial port; tool: the same through a robot's tool; "
        "modbus: Modbus TCP."
    )
    port: PortName = Field(
        default="", description="Serial port: /dev/ttyUSB0, or socket://HOST:PORT."
    )
    baud: int = Field(ge=1200, le=5_000_000, description="Bits a second there.")
    host: str = Field(default="", description="Address of the robot, or of the Modbus TCP device.")
    tcp_port: int | None = Field(
        default=None, ge=1, le=65535, description="TCP port; the usual one of the link if null."
    )
    address: int = Field(ge=1, le=247, description="Modbus address of the device.")
    rate: float = Field(default=100.0, ge=1.0, le=250.0, description="Samples a second.")
    reply_timeout: float = Field(
        default=0.05,
        gt=0.0,
        le=5.0,
        description="A question of Modbus that is not answered for this long, in s, is asked again.",
    )

    @field_validator("tcp_port")
    @classmethod
    def _of_a_device(cls, port: int | None) -> int | None:
        if port is not None and (danger := script_port(port)):
            raise ValueError(f"{danger}: give the port of the device itself")
        return port

    @property
    def number(self) -> int:
        """TCP port of the link; 0 for a serial one."""
        return self.tcp_port or self.PORTS.get(self.link, 0)

    @property
    def place(self) -> str:
        """Where the link ends, for messages."""
        return self.port if self.link == "serial" else f"{self.host}:{self.number}"
