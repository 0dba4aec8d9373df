"""Measures how far the clocks of drivers are off ours, again and again, in a thread of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Final

from crtk_drivers.client.clock_offset import ANSWERED_WITHIN, measured_offset
from crtk_drivers.samples import ClockOffset

if TYPE_CHECKING:
    from crtk_drivers.client.ros_link import Link

__all__ = ["ClockWatch"]

LOOK_PERIOD: Final = 0.1
"""Seconds between two looks at what is due."""

PERIOD: Final = 10.0
"""Seconds between two measurements of a clock."""

UNKNOWN_PERIOD: Final = 1.0
"""Seconds until a driver that did not answer is asked again."""


class ClockWatch:
    """Measures, from its making until `close`. Thread-safe.

    Args:
        link: to ROS, started.
        namespaces: returns those of the drivers that are there; what was measured of others is forgotten.
        measured: called with each measurement, by the thread that measures.
    """

    def __init__(
        self,
        link: Link,
        namespaces: Callable[[], Iterable[str]],
        measured: Callable[[str, ClockOffset], None] = lambda namespace, offset: None,
    ) -> None:
        self._link = link
        self._namespaces = namespaces
        self._measured = measured
        self._offsets: dict[str, ClockOffset | None] = {}
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="clocks", daemon=True)
        self._thread.start()

    def offset(self, namespace: str) -> ClockOffset | None:
        """Return the newest offset of the clock of a driver; None if it is not there, or did not answer."""
        return self._offsets.get(namespace)

    def close(self) -> None:
        """Measure no more; an answer that is on its way is waited for."""
        self._over.set()
        self._thread.join(2.0 * ANSWERED_WITHIN)

    def _run(self) -> None:
        due: dict[str, float] = {}
        while not self._over.wait(LOOK_PERIOD):
            there = frozenset(self._namespaces())
            for gone in due.keys() - there:
                del due[gone]
                self._offsets[gone] = None
            for namespace in sorted(there):
                if time.monotonic() >= due.get(namespace, 0.0):
                    found = self._measure(namespace)
                    due[namespace] = time.monotonic() + (PERIOD if found else UNKNOWN_PERIOD)

    def _measure(self, namespace: str) -> ClockOffset | None:
        caller = self._link.state_caller(f"{namespace.rstrip('/')}/operating_state")
        found = self._offsets[namespace] = measured_offset(caller, self._over.is_set)
        if found is not None:
            self._measured(namespace, found)
        return found
