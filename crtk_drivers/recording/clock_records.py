"""How far the clocks of devices were off the recorder's, as metadata of a recording."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Final

from crtk_drivers.samples import ClockOffset

__all__ = ["CLOCK", "clock_texts", "offsets_in"]

CLOCK: Final = "crtk_drivers clock"
"""Name of the metadata of one measurement. There may be several of a device, the newest last."""


def clock_texts(namespace: str, offset: ClockOffset, wall_ns: int) -> dict[str, str]:
    """Return the texts of a measurement.

    Args:
        namespace: of the device.
        offset: of its clock from the recorder's.
        wall_ns: when it was measured, by the recorder's clock, in ns since the epoch.
    """
    return {
        "namespace": namespace,
        "offset": f"{offset.value:.9f}",
        "uncertainty": f"{offset.uncertainty:.9f}",
        "measured_ns": str(wall_ns),
    }


def offsets_in(
    metadata: Iterable[tuple[str, Mapping[str, str]]],
) -> dict[str, tuple[ClockOffset, ...]]:
    """Return all that was measured, the newest last, by namespace. What cannot be read is left out."""
    found: dict[str, tuple[ClockOffset, ...]] = {}
    for name, texts in metadata:
        if name != CLOCK:
            continue
        try:
            namespace = texts["namespace"]
            offset = ClockOffset(float(texts["offset"]), float(texts["uncertainty"]))
        except (KeyError, ValueError):
            continue
        if math.isfinite(offset.value) and offset.uncertainty >= 0.0:
            found[namespace] = (*found.get(namespace, ()), offset)
    return found
