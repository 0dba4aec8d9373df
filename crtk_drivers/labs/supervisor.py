"""Runs a lab: one process a device, started in order, started again when one ends, and stopped in order.

A device reports over a pipe, see `crtk_drivers.labs.reports`; the same pipe tells it when whoever started it
is gone, so that no driver outlives its lab. What does not hear of that, such as a program that ignores
signals, is ended by a guard: a process beside this one that outlives it.
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import IO, Final

from crtk_drivers.config.variables import absolute, merged
from crtk_drivers.errors.exit_codes import NOT_INSTALLED, USAGE_ERROR
from crtk_drivers.labs.invocation import device_command, settings_text
from crtk_drivers.labs.lab_file import Lab
from crtk_drivers.labs.reports import PULSE_FD, REPORT_FD, Report, last_line, read_reports
from crtk_drivers.status.marked_processes import Starter, start_guard, started_by
from crtk_drivers.status.pulse import LONGEST_LOOK, Pulse, pulse_ends

FIRST_DELAY: Final = 1.0
LONGEST_DELAY: Final = 30.0
"""Seconds before a process that ended is started again; twice as long each time."""

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

SILENCE: Final = 5.0
"""Seconds after the last report of a device that lives, after which nobody knows whether it measures."""

STANDS_STILL: Final = 30.0
"""Seconds without a report after which a device that has reported is killed, and started again.

One that ends by itself reports no more either, and may take `STOP_TIMEOUT` to stop its hardware."""

CPU_PERIOD: Final = 1.0

_PR_SET_PDEATHSIG: Final = 1
_PRCTL: Final = ctypes.CDLL(None).prctl  # looked for now: not between fork and exec

logger = logging.getLogger(__name__)


class Phase(StrEnum):
    """What a process of the lab is doing."""

    WAITING = "waiting"
    """For the devices that it comes after."""
    RUNNING = "running"
    RESTARTING = "restarting"
    """It has ended, and is started again after a while."""
    STOPPING = "stopping"
    ENDED = "ended"
    """It is not started again."""


_NO_REASON_LOGGED: Final = "cannot be started as asked"
"""The reason that is shown where a device ends with a usage error and its log is empty."""


@dataclass(eq=False)
class Child:
    """One process of the lab.

    Attributes:
        name: of the device or program.
        command: how it is started.
        after: names of the devices that must measure before.
        log: file that it writes to.
        reports: it is a device, and tells how it is.
        phase: what it is doing.
        report: the newest, if it is a device that lives.
        heard: monotonic seconds at which it came.
        silence: seconds since then, as far as this process ran meanwhile.
        restarts: how often it was started again.
        code: with which it ended last; negative: the signal.
        ended_well: unless it was told to stop and did not as it should.
        why: what is to be said of it: why it waits, or ended.
        cpu: share of a core that it takes.
    """

    name: str
    command: tuple[str, ...]
    after: tuple[str, ...]
    log: Path
    reports: bool
    phase: Phase = Phase.WAITING
    report: Report | None = None
    heard: float = 0.0
    restarts: int = 0
    code: int | None = None
    ended_well: bool = True
    why: str = ""
    cpu: float = 0.0
    process: subprocess.Popen[bytes] | None = None
    delay: float = FIRST_DELAY
    due: float = 0.0
    began: float = 0.0
    pipe: int = -1
    rest: bytes = b""
    log_file: IO[bytes] | None = None
    pulse: Pulse | None = None
    silence: float = 0.0
    looked: float = 0.0
    cpu_before: tuple[float, float] = (0.0, 0.0)

    @property
    def is_ready(self) -> bool:
        """Whether it is a device that is connected and measures, and has said so lately."""
        report, age = self.report, time.monotonic() - self.heard
        return (
            self.phase is Phase.RUNNING and report is not None and report.measures and age < SILENCE
        )


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
    def is_over(self) -> bool:
        """Whether nothing runs and nothing will."""
        return all(child.phase is Phase.ENDED for child in self.children)

    def step(self) -> None:
        """Take reports, see who has ended, and start what is due."""
        now = time.monotonic()
        for child in self.children:
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
                _signal(child, signal.SIGTERM if child.reports else signal.SIGINT)
            began = time.monotonic()
            while any(child.process is not None for child in running):
                for child in running:
                    self._see_end(child, time.monotonic() - began)
                idle()
                time.sleep(LOOK_PERIOD / 5.0)
        self._end_what_is_left(idle)
        return all(child.ended_well for child in self.children)

    def _groups(self) -> Iterator[list[Child]]:
        """Yield programs, then devices: none before those that come after it."""
        yield list(self.programs.values())
        left = dict(self.devices)
        while left:
            needed = {other for child in left.values() for other in child.after}
            group = [child for name, child in left.items() if name not in needed]
            yield group
            for child in group:
                del left[child.name]

    def _keep_guard(self) -> None:
        """Have a guard while anything runs; start another one if somebody ended it."""
        if self._guard is not None and self._guard.poll() is not None:
            logger.error("the guard of %s has ended, and is started again", self.lab.name)
            self._close_guard()
            self._guard = None
        if self._guard is None and any(child.process is not None for child in self.children):
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
        missing = [
            name for name in child.after if name in self.devices and not self.devices[name].is_ready
        ]
        child.why = f"waits for {', '.join(missing)}" if missing else ""
        if not (missing and child.reports and now > self._began + PATIENCE):
            return not missing
        logger.warning("%s: started, though %s does not measure", child.name, ", ".join(missing))
        return True

    def _start(self, child: Child, now: float) -> None:
        reading = writing = -1
        try:
            self._write_settings(child)
            reading, writing = os.pipe2(os.O_CLOEXEC)
            os.set_blocking(reading, False)
            child.log_file = child.log.open("ab", buffering=0)
            mark = self._starter.mark(child.name, is_device=child.reports)
            shell = absolute(os.environ, Path())  # a process runs in the folder of the lab file
            environment = {**merged(shell, self.lab.environment), **mark}
            log, folder = child.log_file.fileno(), self.lab.path.parent
            if child.reports:
                ours, theirs = pulse_ends()
                child.pulse = Pulse.start(ours)
                with theirs:
                    files = (writing, theirs.fileno())
                    environment |= {REPORT_FD: str(writing), PULSE_FD: str(theirs.fileno())}
                    child.process = _start(child.command, log, folder, environment, files)
            else:
                child.process = _start(child.command, log, folder, environment, ())
        except (OSError, ValueError) as error:
            if reading >= 0:
                os.close(reading)
            if child.pulse is not None:
                child.pulse.close()
                child.pulse = None
            if child.log_file is not None:
                child.log_file.close()
                child.log_file = None
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
            self._take_reports(child)
        process = child.process
        assert process is not None
        at, used = child.cpu_before
        if now >= at + CPU_PERIOD:
            total = _cpu_seconds(process.pid)
            child.cpu = max(0.0, total - used) / (now - at) if at else 0.0
            child.cpu_before = (now, total)
        if now > child.began + SOUND_AFTER:
            child.delay = FIRST_DELAY
        child.silence += min(now - child.looked, LONGEST_LOOK)
        child.looked = now
        stands_still = child.report is not None and child.silence > STANDS_STILL
        if stands_still:
            _signal(child, signal.SIGKILL)  # one that went on later would command an old goal
        code = process.poll()
        if code is None:
            return
        self._forget(child, code)
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
            why = (is_missing and last_line(child.log)) or _told(code)
            self._ended(child, now, f"{why} (see {child.log})", again=True)

    def _take_reports(self, child: Child) -> None:
        reports, child.rest = read_reports(child.pipe, child.rest)
        if reports:
            was, child.report, child.heard = child.is_ready, reports[-1], time.monotonic()
            child.silence = 0.0
            if child.is_ready and not was:
                took = time.monotonic() - child.began
                logger.info("%s: measures, %.1f s after its start", child.name, took)

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
            self._take_reports(child)
        killed = took > STOP_TIMEOUT
        if killed:
            _signal(child, signal.SIGKILL)
        code = process.poll()
        if code is None:
            return
        served = child.report is not None  # else it was still starting, whatever its exit code is
        self._forget(child, code)
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
            words = "check that its hardware stands" if child.reports else ""
        else:
            how, words = _told(code), last_line(child.log)
        child.why = f"{how}{': ' if words else ''}{words} (see {child.log})"
        logger.error("%s: %s", child.name, child.why)

    def _forget(self, child: Child, code: int) -> None:
        child.code, child.process, child.report, child.cpu = code, None, None, 0.0
        child.cpu_before = (0.0, 0.0)
        os.close(child.pipe)
        child.pipe = -1
        if child.pulse is not None:
            child.pulse.close()
            child.pulse = None
        if child.log_file is not None:
            child.log_file.close()
            child.log_file = None


def _start(
    command: Sequence[str],
    log: int,
    folder: Path,
    environment: Mapping[str, str],
    files: Sequence[int],
) -> subprocess.Popen[bytes]:
    """Start a device, which has `files` to report over, or a program, which has none."""
    return subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=subprocess.STDOUT,
        cwd=folder,
        env=environment,
        pass_fds=files,
        start_new_session=True,  # Ctrl-C reaches us alone, and we stop them in order
        preexec_fn=None if files else _end_with_us,
    )


def _end_with_us() -> None:
    """Let a program get SIGTERM when this process is killed: else it commands the devices of the next one."""
    _PRCTL(_PR_SET_PDEATHSIG, int(signal.SIGTERM), 0, 0, 0)


def _signal(child: Child, number: signal.Signals) -> None:
    """Send a signal to a process; a program's children, such as those of a shell, get it too."""
    process = child.process
    if process is None:
        return
    with contextlib.suppress(ProcessLookupError):
        if child.reports and number is not signal.SIGKILL:
            process.send_signal(number)
        else:
            os.killpg(process.pid, number)


def _told(code: int) -> str:
    if code >= 0:
        return f"ended with exit code {code}"
    with contextlib.suppress(ValueError):
        return f"ended by {signal.Signals(-code).name}"
    return f"ended by signal {-code}"


def _cpu_seconds(pid: int) -> float:
    """Return the CPU time that a process has taken; 0 where that cannot be told."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / float(os.sysconf("SC_CLK_TCK"))
    except (OSError, ValueError, IndexError):
        return 0.0
