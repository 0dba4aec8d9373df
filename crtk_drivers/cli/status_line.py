"""One line that tells how a running device is: live on a terminal, when it changes in a log."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Final, Self

from rich.console import Console
from rich.live import Live
from rich.text import Text

from crtk_drivers.errors.wording import worded
from crtk_drivers.ros.names import ANOTHER_DRIVER
from crtk_drivers.state import OperatingState, Status
from crtk_drivers.status.health import Health
from crtk_drivers.status.throttle import kind_of

logger = logging.getLogger(__name__)

LIVE_PERIOD: Final = 0.25
LOG_PERIOD: Final = 3600.0
"""Seconds after which a log tells the status although it is what it was."""

STATE_STYLES = {
    OperatingState.ENABLED: "bold green",
    OperatingState.PAUSED: "bold yellow",
    OperatingState.DISABLED: "bold",
    OperatingState.FAULT: "bold red",
}
_RATE_TOLERANCE: Final = 0.05


def status_text(name: str, status: Status, health: Health, width: int | None = None) -> Text:
    """Return the line: name, state, rate, late cycles, stream, the reason of a fault or refusal.

    Of figures that leave no room for the reason within `width` columns, the last ones are left out first.
    """
    begin, end = _headline(name, status), _reason(status, health)
    figures = [] if status.connecting else _figures(health)
    if width is not None:
        room = width - begin.cell_len - end.cell_len
        while figures and sum(figure.cell_len for figure in figures) > room:
            figures.pop()
    return Text.assemble(begin, *figures, end)


def _headline(name: str, status: Status) -> Text:
    if status.connecting:
        return Text.assemble((name, "bold cyan"), "  ", (worded(status.detail), "yellow"))
    return Text.assemble(
        (name, "bold cyan"),
        "  ",
        (status.state, STATE_STYLES[status.state]),
        (" busy" if status.is_busy else "", "cyan"),
        ("" if status.is_homed else " not homed", "yellow"),
    )


_CAUSE_STYLES = {OperatingState.FAULT: "red", OperatingState.PAUSED: "yellow"}
"""Of the reason of a state; that of DISABLED says how the device was found."""


def _figures(health: Health) -> list[Text]:
    slow = health.rate < (1.0 - _RATE_TOLERANCE) * health.rate_expected
    rate = (f"{health.rate:.0f}", "yellow" if slow else "")
    figures = [
        Text.assemble(("  rate ", "dim"), rate, (f"/{health.rate_expected:.0f} Hz", "dim")),
        Text.assemble(("  late ", "dim"), f"{health.late_cycles}"),
    ]
    if health.reconnects:
        figures.append(Text.assemble(("  reconnects ", "dim"), f"{health.reconnects}"))
    if health.stream:
        figures.append(Text.assemble(("  stream ", "dim"), health.stream))
    return figures


def _reason(status: Status, health: Health) -> Text:
    refused = sum(health.refusals.values())
    reason = Text()
    for note in health.notes:
        if note.key == ANOTHER_DRIVER:
            reason.append("  ").append(worded(note.text), "yellow")
    if status.connecting:
        return reason
    if status.cause:
        reason.append("  ").append(worded(status.cause), _CAUSE_STYLES.get(status.state, ""))
    elif refused:
        reason.append(f"  {refused} refused, last: ", "dim").append(
            worded(health.last_refusal), "yellow"
        )
    return reason


class StatusLine:
    """Shows the status as long as it is entered. `update` may be called as often as one likes.

    Args:
        console: a terminal, or anything else: then a log record when the state or its reason changes but
            for a fault, which the engine logs, and every `LOG_PERIOD` with the figures.
        name: of the device; may be changed.
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
        self.name = name
        self._read = read
        self._clock = clock
        self._due = 0.0
        self._told: tuple[str, bool, str] | None = None
        self._console = console
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
        new = (status.state, status.is_homed, kind_of(status.cause))
        if new != self._told:
            self._told, self._due = new, now + LOG_PERIOD
            if status.state is OperatingState.FAULT and not status.connecting:
                return  # the engine logs a fault as an error, and what to do
            begin = _headline(self.name, replace(status, is_busy=False)).plain
            reason = "" if status.connecting else f"  {status.cause}"
            logger.info("%s", f"{begin}{reason}".rstrip())
        elif now >= self._due:
            self._due = now + LOG_PERIOD
            logger.info("%s", status_text(self.name, status, health).plain)

    def _line(self) -> Text:
        line = status_text(self.name, *self._read(), self._console.width)
        line.no_wrap = True
        line.overflow = "ellipsis"
        return line

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()
