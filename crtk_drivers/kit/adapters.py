"""The serial adapters of this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Final

__all__ = ["BY_ID", "serial_adapters"]

BY_ID: Final = Path("/dev/serial/by-id")
"""Where the names of adapters are that stay when they are plugged in again."""
_NAMES: Final = ("ttyUSB*", "ttyACM*")


def serial_adapters() -> list[str]:
    """Return the USB serial adapters, by their lasting names where they have some."""
    lasting = sorted(BY_ID.glob("*")) if BY_ID.is_dir() else []
    if lasting:
        return list(map(str, lasting))
    return [str(path) for name in _NAMES for path in sorted(Path("/dev").glob(name))]
