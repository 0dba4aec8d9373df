"""Runs a lab: one process a device, started in order, started again when one ends, and stopped in order.

A device reports over a pipe, see `crtk_drivers.labs.reports`; the same pipe tells it when whoever started it
is gone, so that no driver outlives its lab. What does not hear of that, such as a program that ignores
signals, is ended by a guard: a process beside this one that outlives it.

The devices of other machines are seen on ROS by one more process, the observer, whose lines are
`crtk_drivers.labs.seen`. It is there if the lab has such devices.
"""

from __future__ import annotations

import json
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from crtk_drivers.config.variables import absolute, merged
from crtk_drivers.errors.exit_codes import NOT_INSTALLED, USAGE_ERROR
from crtk_drivers.labs.child import (
    FIRST_DELAY,
    Child,
    Observer,
    Phase,
    cpu_seconds,
    how_it_ended,
    send,
    start_process,
)
from crtk_drivers.labs.invocation import device_command, settings_text
from crtk_drivers.labs.lab_file import Lab
from crtk_drivers.labs.reports import PULSE_FD, REPORT_FD, last_line
from crtk_drivers.status.marked_processes import Starter, start_guard, started_by
from crtk_drivers.status.pulse import LONGEST_LOOK, Pulse, pulse_ends

LONGEST_DELAY: Final = 30.0
"""Seconds before a process that ended is started again at most; see `FIRST_DELAY`."""

SOUND_AFTER: Final = 30.0
"""Seconds after which one that lives counts as sound: the next delay is the first one again."""

PATIENCE: Final = 15.0
"""Seconds for which a device waits for those that it comes after; then it is started all the same."""

STOP_TIMEOUT: Final = 20.0
"""Seconds in which a process that was told to stop has ended; then it is killed, and that is told."""

LOOK_PERIOD: Final = 0.1
"""Seconds between two looks at the processes."""

GUARD_TIMEOUT: Final = 30.0
"""Seconds in which the guard has ended what others left."""

STANDS_STILL: Final = 30.0
"""Seconds without a report after which a device that has reported is killed, and started again.

One that ends by itself reports no more either, and may take `STOP_TIMEOUT` to stop its hardware."""

CPU_PERIOD: Final = 1.0

OBSERVER: Final = (sys.executable, "-m", "crtk_drivers.client.lab_watch")
"""Watches devices of other machines; its argument are their namespaces by their names, as JSON."""

OBSERVER_NAME: Final = "other-machines"
"""Of the observer and its log; no device is called so (`crtk_drivers.labs.lab_entries.NAME`)."""

_NO_REASON_LOGGED: Final = "cannot be started as asked"
"""The reason that is shown where a device ends with a usage error and its log is empty."""

logger = logging.getLogger(__name__)


class Supervisor:
    """Everything belongs to one thread. `step` again and again, then `stop`.

    Args:
        lab: what is started.
        folder: for logs, and the settings as they are used; made if it is not there.

    Raises:
        OSError: the folder cannot be written.
    """

    def __init__(self, lab: Lab, folder: Path) -> None:
        self.lab = lab
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self.devices = {
            name: Child(
                name,
                device_command(device, self._settings_file(name)),
                device.after,
                folder / f"{name}.log",
                True,
            )
            for name, device in lab.devices.items()
        }
        self.programs = {
            name: Child(name, program.command, program.after, folder / f"{name}.log", False)
            for name, program in lab.programs.items()
        }
        self.observer = self._observer() if lab.elsewhere else None
        self._began = time.monotonic()
        self._starter = Starter.here(str(lab.path.resolve()))
        self._guard: subprocess.Popen[bytes] | None = None
        self._guard_pulse: Pulse | None = None

    @property
    def children(self) -> Iterator[Child]:
        """Every device, then every program."""
        yield from self.devices.values()
        yield from self.programs.values()

    @property
    def _all(self) -> Iterator[Child]:
        yield from self.children
        if self.observer is not None:
            yield self.observer

    @property
    def is_over(self) -> bool:
        """Whether nothing runs and nothing will."""
        return all(child.phase is Phase.ENDED for child in self.children)

    def step(self) -> None:
        """Take reports, see who has ended, and start what is due."""
        now = time.monotonic()
        for child in self._all:
            if child.process is not None:
                self._follow(child, now)
            if child.phase is Phase.WAITING and self._may_start(child, now):
                self._start(child, now)
            elif child.phase is Phase.RESTARTING and now >= child.due:
                child.restarts += 1
                self._start(child, now)
        self._keep_guard()

    def stop(self, idle: Callable[[], None] = lambda: None) -> bool:
        """End everything: programs first, then the devices, those that others come after last.

        How each ended is logged.

        Args:
            idle: called while it waits.

        Returns:
            whether all ended by themselves, the devices seen to stand (exit code 0).
        """
        for group in self._groups():
            running = [child for child in group if child.process is not None]
            for child in group:
                if child not in running and child.phase is not Phase.ENDED:
                    logger.info("%s: was not running: %s", child.name, child.why)
                child.phase = Phase.STOPPING if child in running else Phase.ENDED
            for child in running:
                # Python forgets a SIGINT that interrupts an import: a device that is still starting
                # would go on.
                send(child, signal.SIGTERM if child.reports else signal.SIGINT)
            began = time.monotonic()
            while any(child.process is not None for child in running):
                for child in running:
                    self._see_end(child, time.monotonic() - began)
                if self.observer is not None and self.observer.process is not None:
                    self.observer.take_reports()  # else what is shown grows old
                idle()
                time.sleep(LOOK_PERIOD / 5.0)
        self._end_what_is_left(idle)
        return all(child.ended_well for child in self.children)

    def _groups(self) -> Iterator[list[Child]]:
        """Yield programs, then devices, none before those that come after it, then the observer.

        Hardware does not wait for the observer, which may hang.
        """
        yield list(self.programs.values())
        left = dict(self.devices)
        while left:
            needed = {other for child in left.values() for other in child.after}
            group = [child for name, child in left.items() if name not in needed]
            yield group
            for child in group:
                del left[child.name]
        if self.observer is not None:
            yield [self.observer]

    def _keep_guard(self) -> None:
        """Have a guard while anything runs; start another one if somebody ended it."""
        if self._guard is not None and self._guard.poll() is not None:
            logger.error("the guard of %s has ended, and is started again", self.lab.name)
            self._close_guard()
            self._guard = None
        if self._guard is None and any(child.process is not None for child in self._all):
            try:
                ours, theirs = pulse_ends()
                with theirs:
                    self._guard = start_guard(self._starter, theirs)
                self._guard_pulse = Pulse.start(ours)
            except OSError as error:
                logger.error("the guard of %s cannot be started: %s", self.lab.name, error)

    def _end_what_is_left(self, idle: Callable[[], None]) -> None:
        """Wait until the guard has ended what programs have left, such as the child of a shell."""
        guard, self._guard = self._guard, None
        if guard is None:
            return
        for each in started_by(self._starter):
            logger.warning("%s was left by it, and is ended", each)
        self._close_guard()
        deadline = time.monotonic() + GUARD_TIMEOUT
        while guard.poll() is None and time.monotonic() < deadline:
            idle()
            time.sleep(LOOK_PERIOD / 5.0)
        for each in started_by(self._starter):
            logger.error("%s was left by it, and still runs", each)

    def _close_guard(self) -> None:
        if self._guard_pulse is not None:
            self._guard_pulse.close()

    # ------------------------------------------------------------------------------- one process

    def _settings_file(self, name: str) -> Path:
        return self.folder / f"{name}.yaml"

    def _observer(self) -> Observer:
        namespaces = {name: other.namespace for name, other in self.lab.elsewhere.items()}
        command = (*OBSERVER, json.dumps(namespaces))
        log = self.folder / f"{OBSERVER_NAME}.log"
        return Observer(OBSERVER_NAME, command, (), log, True)

    def _write_settings(self, child: Child) -> None:
        """Write the settings of a device anew, and their folder: somebody may have removed it.

        Raises:
            OSError: they cannot be written.
        """
        child.log.parent.mkdir(parents=True, exist_ok=True)
        device = self.lab.devices.get(child.name) if child.reports else None
        if device is not None:
            self._settings_file(device.name).write_text(settings_text(device), "utf-8")

    def _may_start(self, child: Child, now: float) -> bool:
        missing = list(self._missing(child))
        child.why = f"waits for {', '.join(missing)}" if missing else ""
        if not (missing and child.reports and now > self._began + PATIENCE):
            return not missing
        logger.warning("%s: started, though %s does not measure", child.name, ", ".join(missing))
        return True

    def _missing(self, child: Child) -> Iterator[str]:
        """Yield what a process comes after and does not measure, in words."""
        for name in child.after:
            device, other = self.devices.get(name), self.lab.elsewhere.get(name)
            if device is not None and not device.is_ready:
                yield name
            if other is not None and self.observer is not None:
                seen = self.observer.seen(name)
                if seen is None or not seen.is_ready:
                    yield f"{name} on {other.machine}"

    def _start(self, child: Child, now: float) -> None:
        reading = writing = -1
        try:
            self._write_settings(child)
            reading, writing = os.pipe2(os.O_CLOEXEC)
            os.set_blocking(reading, False)
            child.log_file = child.log.open("ab", buffering=0)
            mark = self._starter.mark(child.name, is_device=child.is_device)
            shell = absolute(os.environ, Path())  # a process runs in the folder of the lab file
            environment = {**merged(shell, self.lab.environment), **mark}
            log, folder = child.log_file.fileno(), self.lab.path.parent
            if child.reports:
                ours, theirs = pulse_ends()
                child.pulse = Pulse.start(ours)
                with theirs:
                    files = (writing, theirs.fileno())
                    environment |= {REPORT_FD: str(writing), PULSE_FD: str(theirs.fileno())}
                    child.process = start_process(child.command, log, folder, environment, files)
            else:
                child.process = start_process(child.command, log, folder, environment, ())
        except (OSError, ValueError) as error:
            if reading >= 0:
                os.close(reading)
            child.close()
            # A file or a folder may come back: a device is tried again, as after any other end.
            self._ended(child, now, f"cannot be started: {error}", again=child.reports)
        else:
            child.pipe, child.rest, child.report = reading, b"", None
            child.silence, child.looked = 0.0, now
            child.phase, child.began, child.why = Phase.RUNNING, now, ""
            logger.info("%s: started, process %d", child.name, child.process.pid)
        finally:
            if writing >= 0:
                os.close(writing)

    def _follow(self, child: Child, now: float) -> None:
        if child.reports:
            child.take_reports()
        process = child.process
        assert process is not None
        at, used = child.cpu_before
        if now >= at + CPU_PERIOD:
            total = cpu_seconds(process.pid)
            child.cpu = max(0.0, total - used) / (now - at) if at else 0.0
            child.cpu_before = (now, total)
        if now > child.began + SOUND_AFTER:
            child.delay = FIRST_DELAY
        child.silence += min(now - child.looked, LONGEST_LOOK)
        child.looked = now
        stands_still = child.has_reported and child.silence > STANDS_STILL
        if stands_still:
            send(child, signal.SIGKILL)  # one that went on later would command an old goal
        code = process.poll()
        if code is None:
            return
        child.forget(code)
        if stands_still:
            why = f"gave no report for {STANDS_STILL:g} s, and was killed"
            self._ended(child, now, why, again=True)
        elif not child.reports and code == 0:
            self._ended(child, now, "has done its work", again=False)
        elif child.reports and code == USAGE_ERROR:
            why = last_line(child.log) or _NO_REASON_LOGGED
            self._ended(child, now, f"{why} (see {child.log})", again=False)
        else:
            is_missing = child.reports and code == NOT_INSTALLED
            why = (is_missing and last_line(child.log)) or how_it_ended(code)
            self._ended(child, now, f"{why} (see {child.log})", again=True)

    def _ended(self, child: Child, now: float, why: str, *, again: bool) -> None:
        child.why = why
        if not again:
            child.phase = Phase.ENDED
            level = logging.INFO if child.code == 0 else logging.ERROR
            logger.log(level, "%s: %s", child.name, why)
            return
        child.phase, child.due = Phase.RESTARTING, now + child.delay
        logger.error("%s: %s; started again in %g s", child.name, why, child.delay)
        child.delay = min(2.0 * child.delay, LONGEST_DELAY)

    def _see_end(self, child: Child, took: float) -> None:
        """Look whether a process that was told to stop `took` seconds ago has, and log how."""
        process = child.process
        if process is None:
            return
        if child.reports:
            child.take_reports()
        killed = took > STOP_TIMEOUT
        if killed:
            send(child, signal.SIGKILL)
        code = process.poll()
        if code is None:
            return
        served = child.has_reported  # else it was still starting, whatever its exit code is
        child.forget(code)
        child.phase = Phase.ENDED
        child.ended_well = not killed and (code == 0 or not served)
        if child.ended_well:
            how = (
                "stopped"
                if served
                else "was still starting, and ended"
                if child.reports
                else "ended"
            )
            child.why = f"{how} in {took:.1f} s"
            logger.info("%s: %s", child.name, child.why)
            return
        if killed:
            how = f"did not end in {STOP_TIMEOUT:g} s, and was killed"
            words = "check that its hardware stands" if child.is_device else ""
        else:
            how, words = how_it_ended(code), last_line(child.log)
        child.why = f"{how}{': ' if words else ''}{words} (see {child.log})"
        logger.error("%s: %s", child.name, child.why)
