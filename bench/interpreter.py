"""What else happens in the interpreter of a measured client."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

SWITCH_INTERVAL = 0.0005
"""Seconds: as in the process of the driver (`crtk_drivers.engine.threads`)."""


@contextmanager
def busy_thread(wanted: bool) -> Iterator[int]:
    """Keep the interpreter busy; yield the thread's id, 0 without one."""
    if not wanted:
        yield 0
        return
    ended = False

    def spin() -> None:
        number = 0
        while not ended:
            number += 1

    thread = threading.Thread(target=spin)
    thread.start()
    try:
        yield thread.native_id or 0
    finally:
        ended = True
        thread.join()
