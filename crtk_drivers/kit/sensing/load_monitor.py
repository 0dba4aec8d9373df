"""What status words and loads of the last moments say, in words. Pure; the clock comes from outside."""

from __future__ import annotations

from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from crtk_drivers.kit.sensing.status_words import Meaning, StatusTable, combined

OnSaturation = Literal["flag", "invalid", "fault"]
"""Beyond what can be measured: say so, mark the measurement as invalid as well, or go to FAULT."""
LATCH: Final = 0.5
"""Seconds for which a condition is told after it is over: sensors hold theirs for a few milliseconds."""
AXES: Final = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")


class LoadMonitor:
    """Watches one sensor.

    Args:
        table: of its status word.
        alarm: share of the rated load above which it counts as too much.
        on_saturation: what follows from a load beyond what can be measured.
    """

    def __init__(
        self, table: StatusTable, alarm: float, on_saturation: OnSaturation = "flag"
    ) -> None:
        self._on_saturation = on_saturation
        self.error_records = 0
        self.saturated_records = 0
        self.peak = 0.0
        """The highest share of its rated load that any axis has borne."""
        self._table = table
        self._alarm = alarm
        self._rated: NDArray[np.float64] = np.empty(0)
        self._word = 0
        self._newest: NDArray[np.uint32] = np.empty(0, np.uint32)
        self._is_unfit = False
        self._error_text = ""
        self._error_until = -np.inf
        self._saturated_text = ""
        self._saturated_until = -np.inf
        self._over_text = ""
        self._over_until = -np.inf

    def set_rated(self, rated: NDArray[np.float64]) -> None:
        """Take the rated load of each axis (6,) in N and N·m; empty if it is unknown."""
        self._rated = rated

    def take(self, status: NDArray[np.uint32], values: NDArray[np.float64], now: float) -> None:
        """Look at measurements: status words (n,), and forces in N and torques in N·m (n, 6)."""
        self._word = int(status[-1])
        self._newest = status
        if status.any():
            self._take_status(status, now)
            self._is_unfit |= not self.is_valid(status)
        if self._rated.size:
            shares = np.abs(values).max(axis=0) / self._rated
            worst = int(shares.argmax())
            share = float(shares[worst])
            self.peak = max(self.peak, share)
            if share > self._alarm:
                self._over_text = f"{AXES[worst]} bears {share:.0%} of its rated load"
                self._over_until = now + LATCH

    def _take_status(self, status: NDArray[np.uint32], now: float) -> None:
        errors = int(self._table.is_error(status).sum())
        saturated = int(self._table.is_saturated(status).sum())
        self.error_records += errors
        self.saturated_records += saturated
        word = combined(status)
        if errors:
            texts = self._table.texts(word, [Meaning.ERROR]) or ("an error",)
            self._error_text = f"status 0x{word:08x}: {', '.join(texts)}"
            self._error_until = now + LATCH
        if saturated:
            self._saturated_text = ", ".join(self._table.texts(word, [Meaning.SATURATED]))
            self._saturated_until = now + LATCH

    def error(self, now: float) -> str:
        """Return what is wrong with the sensor; empty if nothing is."""
        return self._error_text if now < self._error_until else ""

    def saturation(self, now: float) -> str:
        """Return what is beyond what the sensor can measure; empty if nothing is."""
        return self._saturated_text if now < self._saturated_until else ""

    def fault(self, now: float) -> str:
        """Return why it cannot be relied on; empty if it can."""
        reason = self.error(now)
        if self._on_saturation == "fault":
            reason = reason or self.saturation(now)
        return reason

    def is_valid(self, status: NDArray[np.uint32]) -> bool:
        """Whether measurements with these status words (n,) are told as valid."""
        if self._table.is_error(status).any():
            return False
        return self._on_saturation == "flag" or not self._table.is_saturated(status).any()

    def is_value_valid(self, rest: int = 0) -> bool:
        """Whether a value of all measurements since the last call, but for the newest, is told as valid.

        Args:
            rest: the newest measurements, of those that were taken last, that are for the next value.
        """
        found = not self._is_unfit
        self._is_unfit = rest > 0 and not self.is_valid(self._newest[-rest:])
        return found

    def overload(self, now: float) -> str:
        """Return which axis bears too much of its rated load; empty if none does."""
        return self._over_text if now < self._over_until else ""

    @property
    def notices(self) -> tuple[str, ...]:
        """What the newest status word says besides."""
        return self._table.texts(self._word, [Meaning.NOTICE])

    def clear(self) -> None:
        """Forget what is latched: the sensor was connected anew."""
        self._word = 0
        self._is_unfit = False
        self._error_until = self._saturated_until = self._over_until = -np.inf
