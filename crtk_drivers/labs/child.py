"""One process of a lab: what it is doing, what it reports, and how it is started and told to end."""

from __future__ import annotations

import contextlib
import ctypes
import logging
import os
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import IO, Final

from typing_extensions import override

from crtk_drivers.labs.reports import Report, read_reports
from crtk_drivers.labs.seen import Seen, read_seen
from crtk_drivers.status.pulse import Pulse

__all__ = [
    "FIRST_DELAY",
    "SILENCE",
    "Child",
    "Observer",
    "Phase",
    "cpu_seconds",
    "how_it_ended",
    "send",
    "start_process",
]

FIRST_DELAY: Final = 1.0
"""Seconds before a process that ended is started again; twice as long each time."""

SILENCE: Final = 5.0
"""Seconds after the last report of a device that lives, after which nobody knows whether it measures."""

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


@dataclass(eq=False)
class Child:
    """One process of the lab.

    Attributes:
        name: of the device or program.
        command: how it is started.
        after: names of the devices that must measure before.
        log: file that it writes to.
        reports: it is a device, or the observer, and tells how it is.
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

    @property
    def is_device(self) -> bool:
        """Whether it stops hardware before it ends."""
        return self.reports

    @property
    def has_reported(self) -> bool:
        """Whether it has, since it was started."""
        return self.report is not None

    def take_reports(self) -> None:
        """Take what it has reported since the last time."""
        found, self.rest = read_reports(self.pipe, self.rest)
        if found:
            was = self.is_ready
            self.report = found[-1]
            self._hear()
            if self.is_ready and not was:
                took = time.monotonic() - self.began
                logger.info("%s: measures, %.1f s after its start", self.name, took)

    def forget(self, code: int) -> None:
        """Let go of a process that has ended.

        Args:
            code: with which it did.
        """
        self.code, self.process, self.report, self.cpu = code, None, None, 0.0
        self.cpu_before = (0.0, 0.0)
        os.close(self.pipe)
        self.pipe = -1
        self.close()

    def close(self) -> None:
        """Close the files that a start has opened, but for the pipe."""
        if self.pulse is not None:
            self.pulse.close()
            self.pulse = None
        if self.log_file is not None:
            self.log_file.close()
            self.log_file = None

    def _hear(self) -> None:
        self.heard, self.silence = time.monotonic(), 0.0


@dataclass(eq=False)
class Observer(Child):
    """The process that looks on ROS how the devices of other machines are.

    Attributes:
        told: the newest of each device, with the monotonic seconds at which it came.
    """

    told: dict[str, tuple[Seen, float]] = field(default_factory=dict)

    @property
    @override
    def is_device(self) -> bool:
        return False

    @property
    @override
    def has_reported(self) -> bool:
        return bool(self.told)

    @override
    def take_reports(self) -> None:
        found, self.rest = read_seen(self.pipe, self.rest)
        if found:
            self._hear()
            self.told |= {each.name: (each, self.heard) for each in found}

    @override
    def forget(self, code: int) -> None:
        super().forget(code)
        self.told.clear()

    def seen(self, name: str) -> Seen | None:
        """Return how a device is; None if that is not known, or was told too long ago."""
        found, heard = self.told.get(name, (None, 0.0))
        return found if time.monotonic() - heard < SILENCE else None


def start_process(
    command: Sequence[str],
    log: int,
    folder: Path,
    environment: Mapping[str, str],
    files: Sequence[int],
) -> subprocess.Popen[bytes]:
    """Start a device, which has `files` to report over, or a program, which has none.

    Raises:
        OSError, ValueError: it cannot be started.
    """
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


def send(child: Child, number: signal.Signals) -> None:
    """Send a signal to a process; a program's children, such as those of a shell, get it too."""
    process = child.process
    if process is None:
        return
    with contextlib.suppress(ProcessLookupError):
        if child.reports and number is not signal.SIGKILL:
            process.send_signal(number)
        else:
            os.killpg(process.pid, number)


def how_it_ended(code: int) -> str:
    """Return how a process ended, in words."""
    if code >= 0:
        return f"ended with exit code {code}"
    with contextlib.suppress(ValueError):
        return f"ended by {signal.Signals(-code).name}"
    return f"ended by signal {-code}"


def cpu_seconds(pid: int) -> float:
    """Return the CPU time that a process has taken; 0 where that cannot be told."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / float(os.sysconf("SC_CLK_TCK"))
    except (OSError, ValueError, IndexError):
        return 0.0
