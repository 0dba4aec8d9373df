"""What status words and loads of the last moments say, in words. Pure; the clock comes from outside."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from crtk_driver_ati_netft.profiles import Profile
from crtk_driver_ati_netft.status import Meaning, combined
from crtk_driver_ati_netft.stream import Batch
from crtk_drivers.samples import Vector, vector

LATCH: Final = 0.5
"""Seconds for which a condition is told after it is over: sensors hold theirs for a few milliseconds."""
AXES: Final = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")


class LoadMonitor:
    """Watches one sensor.

    Args:
        profile: its family.
        alarm: share of the rated load above which it counts as too much.
    """

    def __init__(self, profile: Profile, alarm: float) -> None:
        self.error_records = 0
        self.saturated_records = 0
        self.peak = 0.0
        """The highest share of its rated load that any axis has borne."""
        self._table = profile.status
        self._alarm = alarm
        self._rated: Vector = vector([])
        self._word = 0
        self._error_text = ""
        self._error_until = -np.inf
        self._saturated_text = ""
        self._saturated_until = -np.inf
        self._over_text = ""
        self._over_until = -np.inf

    def set_rated(self, rated: Vector) -> None:
        """Take the rated load of each axis (6,) in N and N·m; empty if it is unknown."""
        self._rated = rated

    def take(self, batch: Batch, now: float) -> None:
        """Look at measurements."""
        status = batch.status
        self._word = int(status[-1])
        if status.any():
            self._take_status(status, now)
        if self._rated.size:
            shares = np.abs(batch.values).max(axis=0) / self._rated
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
        self._error_until = self._saturated_until = self._over_until = -np.inf
