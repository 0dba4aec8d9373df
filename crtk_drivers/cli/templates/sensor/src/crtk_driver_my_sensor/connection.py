"""The way to the sensor: a serial line."""

from __future__ import annotations

from crtk_drivers.kit.serial_port import SerialPort

from crtk_driver_my_sensor.config import MySensorConfig

REMEDY = "Is the sensor on, and is this its port and its baud rate?"


def transport(config: MySensorConfig) -> SerialPort:
    """Return the way to the sensor; nothing is opened."""
    return SerialPort(config.port, config.baud)


def address(config: MySensorConfig) -> str:
    """Return where it is, for messages."""
    return config.port
