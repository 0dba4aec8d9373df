"""Processes below another one."""

from __future__ import annotations

import os
from pathlib import Path


def children_of(pid: int) -> set[int]:
    """Return the ids of all processes below one."""
    try:
        own = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except (FileNotFoundError, ProcessLookupError):
        return set()
    found = {int(each) for each in own}
    return found.union(*map(children_of, found))


def process_of(module: str, below: int | None = None) -> int:
    """Return the id of the process that runs a module, below another one; this one if left out."""
    found = [pid for pid in children_of(below or os.getpid()) if module in command_of(pid)]
    assert len(found) == 1, f"{module}: {found}"
    return found[0]


def has_ended(pid: int) -> bool:
    """Whether a process has closed all its files, though nobody may have waited for it."""
    try:
        tasks = os.listdir(f"/proc/{pid}/task")
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):  # the latter of one that ends as it is read
        return True
    return state == "Z" and len(tasks) == 1  # its first thread may end before the others


def command_of(pid: int) -> str:
    """Return program and arguments of a process; empty if it has ended."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().decode()
    except OSError:  # it has ended since
        return ""
