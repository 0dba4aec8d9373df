"""What can be wrong with a CAN bus, told from exceptions and error frames, and what follows from it."""

from __future__ import annotations

import errno
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Final, NamedTuple

from crtk_drivers.errors import ConnectionLost


class Condition(StrEnum):
    """State of the bus, or what has just happened on it."""

    GOOD = "error active"
    WARNING = "many errors"
    PASSIVE = "error passive"
    BUS_OFF = "bus-off"
    RESTARTED = "restarted after bus-off"
    NO_ACK = "nobody acknowledges"
    OVERRUN = "received frames were lost"
    FULL = "no room to send"
    DOWN = "interface is down"
    GONE = "interface is gone"


REMEDIES: Final[Mapping[Condition, str]] = MappingProxyType(
    {
        Condition.BUS_OFF: "Check bit rate, wiring and termination. So that the kernel starts it again: "
        "ip link set <channel> type can restart-ms 100",
        Condition.NO_ACK: "Is anything on the bus, with power and the same bit rate?",
        Condition.FULL: "Is anything on the bus to acknowledge? Check bit rate, wiring and bus load, and the "
        "queue: ip link set <channel> txqueuelen 128",
        Condition.DOWN: "Bring it up: ip link set <channel> up type can bitrate <bit/s>",
        Condition.GONE: "Check that the adapter is plugged in, or that the server of the bus is running.",
    }
)

FATAL: Final = frozenset({Condition.BUS_OFF, Condition.DOWN, Condition.GONE})
"""Conditions in which nothing can be sent: the bus is given up, and opened again later."""

_BY_ERRNO: Final[Mapping[int, Condition]] = MappingProxyType(
    {
        errno.ENOBUFS: Condition.FULL,
        errno.EAGAIN: Condition.FULL,
        errno.ENETDOWN: Condition.DOWN,
    }
)

_FULL_TEXTS: Final = ("buffer full", "could not send message to one or more recipients")
"""How python-can says so without a number: its `socketcan` and `virtual`."""


def condition_of_error(error: Exception) -> Condition:
    """Return the condition that an exception of python-can tells of.

    Args:
        error: a `can.CanError`, whose `error_code` is that of the operating system, or an OSError.
    """
    number = getattr(error, "error_code", None) or getattr(error, "errno", None)
    if number is not None:
        return _BY_ERRNO.get(number, Condition.GONE)
    text = str(error).lower()
    return Condition.FULL if any(part in text for part in _FULL_TEXTS) else Condition.GONE


class _Row(NamedTuple):
    """Error frames with `error` in their identifier, and in data byte `byte` a bit of `mask`."""

    error: int
    byte: int
    mask: int
    condition: Condition


_ERROR_FRAMES: Final = (
    _Row(0x040, 0, 0x00, Condition.BUS_OFF),
    _Row(0x100, 0, 0x00, Condition.RESTARTED),
    _Row(0x020, 0, 0x00, Condition.NO_ACK),
    _Row(0x004, 1, 0x03, Condition.OVERRUN),
    _Row(0x004, 1, 0x30, Condition.PASSIVE),
    _Row(0x004, 1, 0x0C, Condition.WARNING),
    _Row(0x004, 1, 0x40, Condition.GOOD),
)
"""Error frames of SocketCAN (linux/can/error.h), which python-can passes on for several interfaces."""


def conditions_of_frame(identifier: int, data: bytes) -> list[Condition]:
    """Return what an error frame tells of; none for single errors on the wire."""
    whole = data.ljust(8, b"\0")
    return [
        row.condition
        for row in _ERROR_FRAMES
        if identifier & row.error and (not row.mask or whole[row.byte] & row.mask)
    ]


class BusLost(ConnectionLost):
    """The bus cannot be used any more.

    Attributes:
        condition: why.
    """

    condition = Condition.GONE


def bus_lost(condition: Condition, text: str, where: str) -> BusLost:
    """Return the error of a condition."""
    error = BusLost(
        f"{condition}: {text}" if text else str(condition),
        where=where,
        remedy=REMEDIES.get(condition, ""),
    )
    error.condition = condition
    return error


def lost(where: str) -> BusLost:
    """Return the error of a bus on which nobody answers any more."""
    return BusLost(
        "no drive answers any more",
        where=where,
        remedy="Is the power of the drives on, and the bus connected and terminated?",
    )


@dataclass(slots=True)
class BusCounters:
    """What happened on the bus since it was opened.

    Attributes:
        sent: frames.
        received: frames.
        error_frames: error frames.
        passive: times that the controller became error passive.
        bus_off: times that it went off the bus.
        overruns: times that received frames were lost.
        full: frames that could not be sent, for want of room.
        unknown: frames that nobody waited for.
    """

    sent: int = 0
    received: int = 0
    error_frames: int = 0
    passive: int = 0
    bus_off: int = 0
    overruns: int = 0
    full: int = 0
    unknown: int = 0
