"""The way to the sensor: a TCP connection."""

from __future__ import annotations

from crtk_drivers.kit import TcpTransport

from crtk_driver_my_sensor.config import MySensorConfig

REMEDY = "Is the sensor on, and is this its address and its port?"


def transport(config: MySensorConfig) -> TcpTransport:
    """Return the way to the sensor; nothing is opened."""
    return TcpTransport(config.host, config.port, "my_sensor", REMEDY)


def address(config: MySensorConfig) -> str:
    """Return where it is, for messages."""
    return f"{config.host}:{config.port}"
