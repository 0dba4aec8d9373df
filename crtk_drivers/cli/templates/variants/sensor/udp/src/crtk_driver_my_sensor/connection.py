"""The way to the sensor: UDP datagrams."""

from __future__ import annotations

from crtk_drivers.kit import UdpTransport

from crtk_driver_my_sensor.config import MySensorConfig

REMEDY = "Is the sensor on, and is this its address and its port?"


def transport(config: MySensorConfig) -> UdpTransport:
    """Return the way to the sensor; nothing is opened."""
    return UdpTransport(config.host, config.port, "my_sensor", REMEDY)


def address(config: MySensorConfig) -> str:
    """Return where it is, for messages."""
    return f"{config.host}:{config.port}"
