"""The sensor's page, read again while the sensor streams: somebody may change there what a count is worth.

The stream does not tell. The page is read on a slow clock, and at once when the load jumps, as it does when
the unit of a loaded sensor is changed. A page that says something else is read twice before it is believed.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Final

import numpy as np

from crtk_driver_ati_netft.calibration import SensorInfo
from crtk_driver_ati_netft.web import WebPages
from crtk_drivers.errors import DeviceError, ProtocolError
from crtk_drivers.samples import Array, Vector

SHORTEST: Final = 1.0
"""Seconds between two looks at the page, however often the load jumps: it is a small web server."""
JUMP: Final = 0.2
"""Share of a load by which it jumps: the least of the unit changes (N·m to lbf-ft) is a quarter."""
FAINT: Final = 0.002
"""Share of the rated load below which nothing counts as a jump."""

logger = logging.getLogger(__name__)

_MEANING: Final[tuple[tuple[str, Callable[[SensorInfo], object]], ...]] = (
    ("serial number", lambda info: info.serial),
    ("active configuration", lambda info: info.active_configuration),
    ("calibration", lambda info: info.calibration_serial),
    ("scale", lambda info: info.scale),
    ("tool transform (m, rad)", lambda info: tuple(info.transform.tolist())),
    ("internal rate", lambda info: info.internal_rate),
)
"""What measurements mean depends on these."""


def difference(before: SensorInfo, now: SensorInfo) -> str:
    """Return in words what makes measurements mean something else than before; empty if nothing does."""
    return "; ".join(
        f"{name} was {tell(before)}, is {tell(now)}"
        for name, tell in _MEANING
        if tell(before) != tell(now)
    )


class JumpWatch:
    """Says when the load has jumped. Pure.

    Args:
        rated: load of each axis (6,); empty if it is unknown, and then nothing counts as a jump.
    """

    def __init__(self, rated: Vector) -> None:
        self._faint: list[float] = (FAINT * rated).tolist()
        self._before: list[float] = []

    def take(self, values: Array) -> bool:
        """Take measurements (n, 6) that arrived together; return whether their mean is far from the last."""
        if not self._faint:
            return False
        means: list[float] = (np.add.reduce(values) / len(values)).tolist()
        before, self._before = self._before, means
        if not before:
            return False
        return any(
            abs(now - then) > max(faint, JUMP * abs(now), JUMP * abs(then))
            for now, then, faint in zip(means, before, self._faint, strict=True)
        )


class PageWatch:
    """Reads the page of one sensor in a thread of its own.

    Args:
        web: makes the way to its web server, for one connection.
        period: seconds between two looks.
        where: the device, for messages.
    """

    def __init__(self, web: Callable[[], WebPages], period: float, where: str) -> None:
        self.change = ""
        """What the page says that it did not say when the sensor was connected; empty if nothing."""
        self.trouble = ""
        """Why the page was not read last time; empty if it was."""
        self._make_web = web
        self._period = period
        self._where = where
        self._asked = threading.Event()
        self._ended = threading.Event()
        self._web: WebPages | None = None
        self._thread: threading.Thread | None = None

    def begin(self, page: SensorInfo) -> None:
        """Watch from now on whether it goes on saying what `page` says."""
        self.end()
        self.change = self.trouble = ""
        self._ended = threading.Event()
        self._asked.clear()
        self._web = self._make_web()
        self._thread = threading.Thread(
            target=self._run,
            args=(self._web, page, self._ended),
            name=f"page {self._where}",
            daemon=True,
        )
        self._thread.start()

    def end(self) -> None:
        """Watch no more. May be called twice."""
        self._ended.set()
        if self._web is not None:
            self._web.abort()
        self._asked.set()
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join()

    def look(self) -> None:
        """Look at once: the load has jumped."""
        self._asked.set()

    def _run(self, web: WebPages, page: SensorInfo, ended: threading.Event) -> None:
        while not ended.is_set():
            self._asked.wait(self._period)
            self._asked.clear()
            found = self._look(web, page, ended) and self._look(web, page, ended)
            if found:
                self.change = found
                return
            ended.wait(min(SHORTEST, self._period))

    def _look(self, web: WebPages, before: SensorInfo, ended: threading.Event) -> str:
        """Return what is different now."""
        if ended.is_set():
            return ""
        try:
            page = web.sensor_page()
        except DeviceError as error:
            if not self.trouble and not ended.is_set():
                logger.warning("%s: its page was not read again: %s", self._where, error)
            self.trouble = f"was not read again: {error.message}"
            return ""
        self.trouble = ""
        try:
            return difference(before, web.understand(page))
        except ProtocolError as error:
            return error.message
