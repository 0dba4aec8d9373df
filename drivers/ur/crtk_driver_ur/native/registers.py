"""Commands for the control program of our own, written into its RTDE registers."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Final

from crtk_driver_ur.native.program import (
    FEED,
    MOTION,
    SETTING,
    SETTING_VALUES,
    UPPER_RANGE,
    Kind,
    Setting,
)
from crtk_driver_ur.rtde.echoes import Echoes
from crtk_driver_ur.rtde.inputs import RtdeInputs
from crtk_drivers.errors import ConnectionFailed, ConnectionLost

__all__ = ["FEED_PERIOD", "ControlChannel"]

FEED_PERIOD: Final = 0.02
"""Seconds without a package after which the watchdog is fed."""

LOCK_TIMEOUT: Final = 0.05
"""Seconds that a stop waits for another thread."""

_NO_MOTION: Final = (0.0,) * 6


class ControlChannel:
    """Sends without waiting. May be used from any thread; one package goes out at a time.

    The constructor connects and claims the registers, which waits.

    Args:
        host: of the controller.
        first: first register of the range.
        clock: the monotonic clock.

    Attributes:
        echoes: when packages left.
        scaling: by how much the controller slows motion down now, 0 to 1; sent with each motion.

    Raises:
        ConnectionFailed: unreachable, or the registers are in use.
        ConnectionLost: by the constructor, and by everything that sends: the connection is gone.
    """

    def __init__(self, host: str, first: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._where = f"RTDE {host}"
        self._lock = threading.Lock()
        self._inputs = RtdeInputs(host)
        try:
            self._feed, self._motion, self._setting = (
                self._inputs.claim(registers.names(first)) for registers in (FEED, MOTION, SETTING)
            )
        except ConnectionFailed as error:
            self._inputs.close()
            in_use = "IN_USE" in error.message and first < UPPER_RANGE
            raise ConnectionFailed(
                f"{error.message}: the registers are in use" if in_use else error.message,
                where=error.where,
                remedy="Another RTDE client (a second driver, a fieldbus) has claimed the input "
                "registers: close it, or set upper_range_registers."
                if in_use
                else error.remedy,
            ) from error
        self.echoes = Echoes()
        self.scaling = 1.0
        self._program = 0
        self._sequence = 0
        self._settings = 0
        self._sent_at = 0.0

    def close(self) -> None:
        """Close the connection, and leave the registers to others."""
        with self._lock:
            self._inputs.close()

    def check(self) -> None:
        """Raise ConnectionLost if the controller has closed the connection."""
        with self._lock:
            self._inputs.check()

    def address(self, program: int) -> None:
        """Speak to the program with this number from now on; of it nothing is wanted yet."""
        with self._lock:
            self._program, self._sequence, self._settings = program, 0, 0
            self.echoes.begin()
            self._post_motion(Kind.REST, _NO_MOTION, 0.0, 0.0)
            self._post_setting(0, ())

    def command(
        self,
        kind: Kind,
        values: Sequence[float] = _NO_MOTION,
        first: float = 0.0,
        second: float = 0.0,
    ) -> int:
        """Send a motion with its six values and its parameters, and return its sequence number."""
        with self._lock:
            self._sequence += 1
            self._post_motion(kind, values, first, second)
            return self._sequence

    def stop(self) -> int:
        """Send the command to rest, and return its number; does not wait for a thread that hangs in here."""
        if not self._lock.acquire(timeout=LOCK_TIMEOUT):
            raise ConnectionLost(
                "another thread hangs in the connection for commands", where=self._where
            )
        try:
            self._sequence += 1
            self._post_motion(Kind.REST, _NO_MOTION, 0.0, 0.0)
            return self._sequence
        finally:
            self._lock.release()

    def set(self, setting: Setting, values: Sequence[float]) -> int:
        """Send a setting and return its number; not before the program has taken the one before."""
        with self._lock:
            self._settings += 1
            self._post_setting(setting, values)
            return self._settings

    def feed(self) -> None:
        """Feed the watchdog, if nothing else has lately."""
        with self._lock:
            if self._clock() - self._sent_at >= FEED_PERIOD:
                self._inputs.post(self._feed, (self._program, self._number()))

    def _post_motion(
        self, kind: Kind, values: Sequence[float], first: float, second: float
    ) -> None:
        numbers = (self._program, self._sequence, kind, self._number())
        self._inputs.post(self._motion, (*numbers, *values, first, second, self.scaling))

    def _number(self) -> int:
        """Return the number of a package that leaves now."""
        self._sent_at = self._clock()
        return self.echoes.leaves(self._sent_at)

    def _post_setting(self, setting: int, values: Sequence[float]) -> None:
        padding = (0.0,) * (SETTING_VALUES - len(values))
        numbers = (self._program, self._settings, setting, *values, *padding)
        self._inputs.post(self._setting, numbers)
