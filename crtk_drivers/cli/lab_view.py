"""What `crtk-driver up` shows of a running lab: a table on a terminal, else log records."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Final

from rich.live import Live
from rich.table import Table
from rich.text import Text

from crtk_drivers.cli.status_line import LIVE_PERIOD, STATE_STYLES
from crtk_drivers.cli.terminal import ERR
from crtk_drivers.errors.wording import worded
from crtk_drivers.labs.child import Child, Phase
from crtk_drivers.labs.seen import Seen
from crtk_drivers.labs.supervisor import Supervisor
from crtk_drivers.state import OperatingState

__all__ = ["ShownLab", "shown", "table_of"]

_PHASES: Final = {
    Phase.WAITING: "yellow",
    Phase.RUNNING: "",
    Phase.RESTARTING: "bold red",
    Phase.STOPPING: "yellow",
    Phase.ENDED: "dim",
}

_STATES: Final[Mapping[str, str]] = {str(state): style for state, style in STATE_STYLES.items()}
"""What another machine says may be none of them: it may have another version."""

_SECONDS_FROM: Final = 10.0
"""Seconds between two clocks from which they are told in seconds, not in milliseconds."""

logger = logging.getLogger(__name__)


class ShownLab:
    """Shows a running lab each time it is called.

    Args:
        supervisor: of the lab.
        live: the table on a terminal; None: what changes is logged.
    """

    def __init__(self, supervisor: Supervisor, live: Live | None) -> None:
        self._supervisor = supervisor
        self._live = live
        self._due = 0.0
        self._told: dict[str, tuple[str, ...]] = {}
        self._warned: set[str] = set()

    def __call__(self) -> None:
        """Show how it is now."""
        if self._live is None:
            self._log_devices()
            self._log_others()
        elif time.monotonic() >= self._due:
            self._due = time.monotonic() + LIVE_PERIOD
            try:
                self._live.update(table_of(self._supervisor), refresh=True)
            except OSError as error:  # what was started is stopped in its order all the same
                logger.error("the terminal is gone: %s", error.strerror)
                self._live = None

    def _log_devices(self) -> None:
        for child in self._supervisor.devices.values():
            if child.report is not None:
                self._log(child.name, child.name, child.report.state, child.report.cause)

    def _log_others(self) -> None:
        observer = self._supervisor.observer
        if observer is None or observer.phase is Phase.ENDED:
            return
        for name, other in self._supervisor.lab.elsewhere.items():
            seen = observer.seen(name)
            if seen is None and name not in self._told:
                continue
            self._log(name, f"{name} on {other.machine}", *_words(seen))
            if seen is not None and seen.has_other_time and other.machine not in self._warned:
                self._warned.add(other.machine)
                logger.warning(
                    "the clock of %s is not that of this machine (%s): do not compare stamps of its devices "
                    "with stamps of this machine's. Synchronise the two machines by chrony or PTP",
                    other.machine,
                    _offset(seen),
                )

    def _log(self, name: str, called: str, *words: str) -> None:
        if self._told.get(name) != words:
            self._told[name] = words
            logger.info("%s: %s", called, "  ".join(filter(None, words)))


@contextmanager
def shown(supervisor: Supervisor) -> Iterator[ShownLab]:
    """Yield what shows a lab: on a terminal as a live table, else in the log."""
    if not ERR.is_terminal:
        yield ShownLab(supervisor, None)
        return
    with Live(console=ERR, auto_refresh=False, transient=True) as live:
        yield ShownLab(supervisor, live)


def table_of(supervisor: Supervisor) -> Table:
    """Return how every process of a lab is, and the devices of other machines as they are seen on ROS."""
    lab = supervisor.lab
    title = f"{lab.name} on {lab.machine}" if lab.elsewhere else lab.name
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for column in ("device", "namespace", "state"):
        table.add_column(column, no_wrap=True)
    for column in ("rate, Hz", "late", "refused", "CPU", "restarts"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("")
    for child in supervisor.children:
        table.add_row(*_row(supervisor, child))
    for machine in dict.fromkeys(other.machine for other in lab.elsewhere.values()):
        for row in _rows_of(supervisor, machine):
            table.add_row(*row)
    return table


def _row(supervisor: Supervisor, child: Child) -> Iterator[Text | str]:
    device = supervisor.lab.devices.get(child.name) if child.is_device else None
    simulated = " (sim)" if device is not None and device.sim else ""
    report = child.report
    figures = ["", "", ""]
    told = child.why
    state = Text(child.phase, _PHASES[child.phase])
    if child.phase is Phase.RUNNING and child.reports:
        state = Text("starting", "yellow")
        if report is not None:
            state = Text(report.state, _STATES.get(report.state, ""))
            figures = [f"{report.rate:.0f}/{report.expected:.0f}", str(report.late)]
            figures.append(str(report.refused))
            told = report.cause or report.last_refusal
    yield Text.assemble((child.name, "bold cyan"), (simulated, "dim"))
    yield "" if device is None else device.namespace
    yield state
    yield from figures
    yield f"{100.0 * child.cpu:.0f} %" if child.process is not None else ""
    yield str(child.restarts) if child.restarts else ""
    yield _told(told)


def _rows_of(supervisor: Supervisor, machine: str) -> Iterator[tuple[Text, ...]]:
    """Yield a heading with the clock of another machine, if that is off, and then each of its devices."""
    observer = supervisor.observer
    devices = [each for each in supervisor.lab.elsewhere.values() if each.machine == machine]
    seen = {each.name: None if observer is None else observer.seen(each.name) for each in devices}
    clocks = (_offset(each) for each in seen.values() if each is not None and each.has_other_time)
    yield Text(f"on {machine}", "dim"), Text(next(clocks, ""), "yellow")
    for other in devices:
        state, *words = _words(seen[other.name])
        if seen[other.name] is None and observer is not None:
            words.append(observer.why)
        told = _told("  ".join(filter(None, words)))
        name = Text(other.name, "bold cyan")
        yield name, Text(other.namespace), _state(state, seen[other.name]), *[Text()] * 5, told


def _state(state: str, seen: Seen | None) -> Text:
    """Return the state of a device of another machine, and since when it is not seen."""
    if seen is None or (not seen.seen and seen.ago is None):
        return Text(state, "yellow")
    if not seen.seen:
        return Text(f"{state} for {seen.ago:.0f} s", "bold red")
    return Text(state, _STATES.get(state, ""))


def _told(text: str) -> Text:
    return Text(worded(text), overflow="ellipsis")


def _words(seen: Seen | None) -> tuple[str, ...]:
    """Return how a device of another machine is, the state first; what runs on, as a time, is not in it."""
    if seen is None:
        return ("not known",)
    if not seen.seen:
        return ("not seen yet" if seen.ago is None else "not seen",)
    is_told = seen.measures or seen.state == OperatingState.FAULT  # which has a cause of its own
    return (seen.state or "seen", "" if is_told else "does not measure", seen.cause)


def _offset(seen: Seen) -> str:
    offset = seen.offset or 0.0
    if abs(offset) < _SECONDS_FROM:
        return f"clock {1e3 * offset:+.0f} ms"
    return f"clock {offset:+.0f} s"
