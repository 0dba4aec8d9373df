"""Cores that do not sleep between two frames, as on a computer that is set up for control."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager

LATENCY = "/dev/cpu_dma_latency"
"""While it is open, waking a core may take so many µs (Linux, Documentation/power/pm_qos_interface.rst)."""


@contextmanager
def awake() -> Iterator[None]:
    """Keep idle cores awake, as cyclictest does.

    Raises:
        OSError: not permitted; that takes root, or write access to `LATENCY`.
    """
    descriptor = os.open(LATENCY, os.O_WRONLY)
    try:
        os.write(descriptor, struct.pack("=i", 0))
        yield
    finally:
        os.close(descriptor)
