"""Processes that one process has started, with all that they have started: marked, found, and ended.

The mark is a variable of their environment. A process keeps it that ignores signals, leaves its group or its
session, or loses its parent; one that clears its environment is not found.

As a program, this is the guard of whoever started them: it ends what is left when that process has ended,
however it did, or stands still. Its standard input is an end of a `crtk_drivers.status.pulse`.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from typing_extensions import override

from crtk_drivers.status.pulse import Pulse

MARK: Final = "CRTK_DRIVERS_STARTED_BY"
"""Environment variable: who has started a process, and for what."""

STANDS_STILL: Final = 10.0
"""Seconds without a sign of life after which a starter counts as gone."""

PROGRAM_ASKED_AFTER: Final = 1.0
"""Seconds after which a program gets SIGTERM: the kernel has sent one to the first process of each."""

PROGRAM_ENDS_WITHIN: Final = 5.0
DEVICE_ENDS_WITHIN: Final = 20.0
"""Seconds in which what lost its starter has ended; then it is killed. A device stops its hardware."""

GIVEN_UP_AFTER: Final = 60.0
"""Seconds after which what cannot be killed, such as a process that hangs in the kernel, is left."""

LOOK_PERIOD: Final = 0.1

_DEVICE: Final = "device"
_PROGRAM: Final = "program"


@dataclass(frozen=True)
class Starter:
    """A process that starts others.

    Attributes:
        pid: its process id.
        began: when it was started, as the kernel counts: an id is used again.
        number: makes it another one than others in the same process.
        group: what belongs together, such as the path of a lab file.
    """

    pid: int
    began: str
    number: str
    group: str

    @classmethod
    def here(cls, group: str) -> Starter:
        """Return a new one, which is this process."""
        return cls(os.getpid(), _began(os.getpid()), secrets.token_hex(4), group)

    @property
    def is_there(self) -> bool:
        """Whether the process still lives."""
        return bool(self.began) and _began(self.pid) == self.began

    def mark(self, name: str, *, is_device: bool) -> Mapping[str, str]:
        """Return what is added to the environment of what it starts."""
        kind = _DEVICE if is_device else _PROGRAM
        return {MARK: f"{self.pid} {self.began} {self.number} {kind} {name} {self.group}"}


@dataclass(frozen=True)
class Marked:
    """A process that was found by its mark.

    Attributes:
        pid: its process id.
        starter: who has started it, or what it descends from.
        name: of the device or program that it belongs to.
        is_device: it is one that stops its hardware when its starter is gone.
        command: program and arguments.
    """

    pid: int
    starter: Starter
    name: str
    is_device: bool
    command: str

    @override
    def __str__(self) -> str:
        return f"{self.name}: process {self.pid} ({self.command})"


def marked_processes() -> Iterator[Marked]:
    """Yield every process of this user that has a mark."""
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, ValueError):  # of another user, or ended since
            found = _marked(folder)
            if found is not None:
                yield found


def started_by(starter: Starter) -> list[Marked]:
    """Return what one has started and still runs."""
    return [each for each in marked_processes() if each.starter == starter]


def left_behind(group: str) -> list[Marked]:
    """Return what still runs of a group, whose starters are gone."""
    found = [each for each in marked_processes() if each.starter.group == group]
    return [each for each in found if not each.starter.is_there]


def start_guard(starter: Starter, end: socket.socket) -> subprocess.Popen[bytes]:
    """Start the process that ends what a starter leaves, once the other end of `end` is closed or silent."""
    words = (str(starter.pid), starter.began, starter.number, starter.group)
    return subprocess.Popen(
        [sys.executable, "-m", __name__, *words],
        stdin=end.fileno(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,  # who reads ours does not wait for the guard
        env={key: value for key, value in os.environ.items() if key != MARK},
        start_new_session=True,
    )


def end_all(starter: Starter, goes_on: Callable[[], bool] = lambda: False) -> None:
    """End what one has started: programs by SIGTERM, devices by themselves; then by SIGKILL.

    Args:
        starter: who has started them.
        goes_on: whether it does, so that what it starts now is not to be ended.
    """
    began, took, asked = time.monotonic(), 0.0, set[int]()
    while took < GIVEN_UP_AFTER and not goes_on() and (found := started_by(starter)):
        took = time.monotonic() - began
        for each in found:
            if took > (DEVICE_ENDS_WITHIN if each.is_device else PROGRAM_ENDS_WITHIN):
                _send(each, signal.SIGKILL)
            elif not each.is_device and took > PROGRAM_ASKED_AFTER and each.pid not in asked:
                asked.add(each.pid)
                _send(each, signal.SIGTERM)
        time.sleep(LOOK_PERIOD)


def _marked(folder: Path) -> Marked | None:
    """Return a process if it has a mark.

    Raises:
        OSError: it may not be looked at, or is gone.
        ValueError: its mark is none of ours.
    """
    prefix = f"{MARK}=".encode()
    words = (folder / "environ").read_bytes().split(b"\0")
    value = next((word for word in words if word.startswith(prefix)), None)
    if value is None:
        return None
    pid, began, number, kind, name, group = os.fsdecode(value[len(prefix) :]).split(" ", 5)
    command = (folder / "cmdline").read_bytes().rstrip(b"\0").replace(b"\0", b" ")
    starter = Starter(int(pid), began, number, group)
    return Marked(int(folder.name), starter, name, kind == _DEVICE, os.fsdecode(command))


def _send(process: Marked, number: signal.Signals) -> None:
    """Send a signal to a process, if it is still that one."""
    with contextlib.suppress(OSError, ValueError):
        descriptor = os.pidfd_open(process.pid)
        try:
            found = _marked(Path(f"/proc/{process.pid}"))
            if found is not None and found.starter == process.starter:
                signal.pidfd_send_signal(descriptor, number)
        finally:
            os.close(descriptor)


def _began(pid: int) -> str:
    """Return when a process was started; empty if it has ended, though nobody may have waited for it."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if fields[0] in ("Z", "X") else fields[19]


def main() -> int:
    """Guard what a starter has started, until that has ended."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    pid, began, number_of, group = sys.argv[1:]
    starter = Starter(int(pid), began, number_of, group)
    pulse = Pulse.start(socket.socket(fileno=os.dup(sys.stdin.fileno())))

    def is_heard() -> bool:
        return pulse.silence() < STANDS_STILL and not pulse.has_ended

    while not pulse.has_ended:
        if not is_heard():
            end_all(starter, is_heard)
        time.sleep(LOOK_PERIOD)
    end_all(starter)
    return 0


if __name__ == "__main__":
    sys.exit(main())
