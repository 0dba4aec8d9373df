"""Clocks of a world, in place of those of `time`."""

from __future__ import annotations

import time
from typing import Final

from crtk_drivers.testing.world.kernel import EPOCH, NS, running

_real_monotonic_ns: Final = time.monotonic_ns
_real_time_ns: Final = time.time_ns


def monotonic_ns(*_: object) -> int:
    """As `time.monotonic_ns`. It takes what a method is given, since a builtin in a class is no method."""
    kernel = running.kernel
    return _real_monotonic_ns() if kernel is None else kernel.read_clock()


def monotonic(*_: object) -> float:
    """As `time.monotonic`."""
    return monotonic_ns() / NS


def time_ns(*_: object) -> int:
    """As `time.time_ns`."""
    kernel = running.kernel
    return _real_time_ns() if kernel is None else EPOCH + kernel.read_clock() + kernel.wall_offset


def wall(*_: object) -> float:
    """As `time.time`."""
    return time_ns() / NS


def sleep(seconds: float) -> None:
    """As `time.sleep`."""
    if seconds < 0:
        raise ValueError("sleep length must be non-negative")
    kernel = running.kernel
    if kernel is None:
        return  # at import nothing is there to be waited for
    end = kernel.now + int(seconds * NS)
    if end == kernel.now:
        kernel.give_way()
    while kernel.now < end:
        kernel.wait((), end)
