"""How much the programs of this machine wait for a processor, as the kernel tells it (Linux, PSI)."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Final

_PRESSURE: Final = Path("/proc/pressure/cpu")


class Pressure:
    """Counts from when it is made."""

    def __init__(self) -> None:
        self._since = time.monotonic()
        self._before = _stalled()

    @property
    def share(self) -> float:
        """Share of the time since then in which some program waited; 0 where the kernel does not tell."""
        seconds = time.monotonic() - self._since
        return (_stalled() - self._before) / seconds if seconds > 0.0 else 0.0


def _stalled() -> float:
    """Return the seconds since the boot in which some program waited for a processor."""
    try:
        some = _PRESSURE.read_text("ascii").partition("\n")[0]
        return 1e-6 * float(some.rpartition("total=")[2])
    except (OSError, ValueError):
        return 0.0
