"""Which process has a serial port open, or has locked it: read from /proc, for messages to people."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Final, NamedTuple

from typing_extensions import override

__all__ = ["Holder", "holder_of", "holders", "lock_owner"]

_PROC: Final = Path("/proc")


class Holder(NamedTuple):
    """A process."""

    pid: int
    command: str

    @override
    def __str__(self) -> str:
        own = ", this one" if self.pid == os.getpid() else ""
        return f"process {self.pid} ({self.command}{own})"


def lock_owner(device: Path) -> Holder | None:
    """Return who has locked a port with flock, None if nobody has or the system does not tell."""
    status = os.stat(device)
    place = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
    try:
        lines = (_PROC / "locks").read_text().splitlines()
    except OSError:
        return None
    for line in lines:
        fields = line.split()
        if "FLOCK" in fields and place in fields:
            return holder_of(int(fields[fields.index(place) - 1]))
    return None


def holders(device: Path) -> list[Holder]:
    """Return the other processes that have a port open, as far as we may see them."""
    number = os.stat(device).st_rdev
    others = [int(entry.name) for entry in _PROC.iterdir() if entry.name.isdigit()]
    return [holder_of(pid) for pid in others if pid != os.getpid() and _has_open(pid, number)]


def _has_open(pid: int, number: int) -> bool:
    try:
        files = list((_PROC / str(pid) / "fd").iterdir())
    except OSError:
        return False
    return any(_is_device(file, number) for file in files)


def _is_device(file: Path, number: int) -> bool:
    try:
        status = file.stat()
    except OSError:
        return False
    return stat.S_ISCHR(status.st_mode) and status.st_rdev == number


def holder_of(pid: int) -> Holder:
    """Return a process with its command line, as far as we may see that."""
    try:
        words = (_PROC / str(pid) / "cmdline").read_bytes().split(b"\0")
    except OSError:
        words = []
    command = " ".join(word.decode(errors="replace") for word in words if word)
    return Holder(pid, command or "unknown command")
