"""Grippers that answer at a serial line, a robot's tool line, or in Modbus TCP."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import closing
from typing import Final

from crtk_driver_robotiq.asking import (
    OPENING,
    PATIENCE,
    USUAL,
    ask,
    framing_at,
    settings_at,
    takes,
    way_to,
)
from crtk_driver_robotiq.registers import SIZE, STATUS, Status
from crtk_drivers.kit import modbus_frames
from crtk_drivers.kit.adapters import serial_adapters
from crtk_drivers.plugins import Finder, FoundDevice

__all__ = ["GRIPPERS"]

BAUDS: Final = (115_200, 57_600, 38_400, 19_200)
"""Rates that a gripper can be set to, as delivered first."""
ADDRESSES: Final = range(1, 248)


def _look_for_grippers(place: str) -> Iterable[FoundDevice]:
    """Ask the usual address at each rate, and all addresses at the usual one if nobody answers."""
    is_line = place.startswith("/")
    for baud in BAUDS if is_line else BAUDS[:1]:
        if found := list(_grippers(place, baud, [USUAL], 3.0 * PATIENCE)):
            return found
    return list(_grippers(place, BAUDS[0], ADDRESSES, PATIENCE))


def _grippers(
    place: str, baud: int, units: Iterable[int], patience: float
) -> Iterator[FoundDevice]:
    with closing(way_to(place, baud)) as way:
        way.open(time.monotonic() + OPENING)
        for unit in units:
            data = ask(
                way, framing_at(place, unit), modbus_frames.read(STATUS, SIZE // 2), patience
            )
            if data is None:
                continue
            status = Status.parse(data)
            told = (
                f"Robotiq gripper, address {unit}, {status.activation.name.lower().replace('_', ' ')}: which "
                "model cannot be asked; an ePick is robotiq-epick"
            )
            yield FoundDevice(settings_at(place, baud, BAUDS[0], unit), told)


GRIPPERS: Final = Finder(serial_adapters, takes, _look_for_grippers)
"""Finds 2F-85, 2F-140, Hand-E, and an ePick, which has the same registers."""
