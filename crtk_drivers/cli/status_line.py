"""One line that tells how a running device is: live on a terminal, now and then in a log."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from types import TracebackType
from typing import Final, Self

from rich.console import Console
from rich.live import Live
from rich.text import Text

from crtk_drivers.health import Health
from crtk_drivers.state import OperatingState, Status

logger = logging.getLogger(__name__)

LIVE_PERIOD: Final = 0.25
LOG_PERIOD: Final = 5.0

_STATE_STYLES = {
    OperatingState.ENABLED: "bold green",
    OperatingState.PAUSED: "bold yellow",
    OperatingState.DISABLED: "bold",
    OperatingState.FAULT: "bold red",
}
_RATE_TOLERANCE: Final = 0.05


def status_text(name: str, status: Status, health: Health) -> Text:
    """Return the line: name, state, rate, late cycles, stream, the reason of a fault or refusal."""
    slow = health.rate < (1.0 - _RATE_TOLERANCE) * health.rate_expected
    text = Text.assemble(
        (name, "bold cyan"),
        "  ",
        (status.state, _STATE_STYLES[status.state]),
        (" busy" if status.is_busy else "", "cyan"),
        ("" if status.is_homed else " not homed", "yellow"),
        ("  rate ", "dim"),
        (f"{health.rate:.0f}", "yellow" if slow else ""),
        (f"/{health.rate_expected:.0f} Hz", "dim"),
        ("  late ", "dim"),
        f"{health.late_cycles}",
    )
    if health.reconnects:
        text.append("  reconnects ", "dim").append(f"{health.reconnects}")
    if health.stream:
        text.append("  stream ", "dim").append(health.stream)
    refused = sum(health.refusals.values())
    if status.detail:
        text.append("  ").append(status.detail, "red")
    elif refused:
        text.append(f"  {refused} refused, last: ", "dim").append(health.last_refusal, "yellow")
    return text


class StatusLine:
    """Shows the status as long as it is entered. `update` may be called as often as one likes.

    Args:
        console: a terminal, or anything else: then a log record every few seconds, and at once when
            the state changes.
        name: of the device.
        read: returns status and health.
        clock: monotonic seconds.
    """

    def __init__(
        self,
        console: Console,
        name: str,
        read: Callable[[], tuple[Status, Health]],
        *,
        live: bool,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._name = name
        self._read = read
        self._clock = clock
        self._due = 0.0
        self._state = ""
        self._live = Live(console=console, auto_refresh=False, transient=True) if live else None

    def update(self) -> None:
        """Show the present status if it is time."""
        now = self._clock()
        if self._live is not None:
            if now >= self._due:
                self._due = now + LIVE_PERIOD
                self._live.update(self._line(), refresh=True)
            return
        status, health = self._read()
        if now >= self._due or status.state != self._state:
            self._due = now + LOG_PERIOD
            self._state = status.state
            logger.info("%s", status_text(self._name, status, health).plain)

    def _line(self) -> Text:
        line = status_text(self._name, *self._read())
        line.no_wrap = True
        line.overflow = "ellipsis"
        return line

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._live is not None:
            self._live.stop()
