"""Force sensors that answer, or stream, at a serial line, a robot's tool line, or in Modbus TCP."""

from __future__ import annotations

import time
from collections.abc import Iterable
from contextlib import closing
from typing import Final

from crtk_driver_robotiq.asking import (
    OPENING,
    PATIENCE,
    TCP,
    USUAL,
    ask,
    framing_at,
    settings_at,
    takes,
    way_to,
)
from crtk_driver_robotiq.ft300 import registers
from crtk_driver_robotiq.ft300.registers import Identity
from crtk_driver_robotiq.ft300.stream import stream_decoder
from crtk_drivers.kit import Transport, modbus_frames
from crtk_drivers.kit.adapters import serial_adapters
from crtk_drivers.plugins import Finder, FoundDevice

__all__ = ["SENSORS"]

SENSOR_BAUD: Final = 19_200
LISTENING: Final = 0.1
"""Seconds in which a sensor that streams is heard."""


def _look_for_sensors(place: str) -> Iterable[FoundDevice]:
    """Listen for a stream; where there is none, ask the usual address who it is."""
    with closing(way_to(place, SENSOR_BAUD)) as way:
        way.open(time.monotonic() + OPENING)
        settings = settings_at(place, SENSOR_BAUD, SENSOR_BAUD, USUAL)
        if not place.startswith(TCP) and _streams(way):
            return [FoundDevice(settings, "FT 300 that streams")]
        parts = []
        for which in (registers.FIRMWARE, registers.SERIAL, registers.YEAR):
            data = ask(way, framing_at(place, USUAL), modbus_frames.read(*which), 3.0 * PATIENCE)
            if data is None:
                return []
            parts.append(data)
    identity = Identity.parse(*parts)
    return [FoundDevice(settings, identity.described)] if identity.is_sensor else []


def _streams(way: Transport) -> bool:
    decoder, deadline = stream_decoder(), time.monotonic() + LISTENING
    while data := way.read(deadline):
        if decoder.feed(data):
            return True
        if time.monotonic() >= deadline:
            break
    return False


SENSORS: Final = Finder(serial_adapters, takes, _look_for_sensors)
"""Finds an FT 300."""
