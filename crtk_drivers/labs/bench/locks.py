"""One bench at a time: a lab file and a device are tested by one run, of which a second one is told."""

from __future__ import annotations

import fcntl
import hashlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from crtk_drivers.errors import ConfigError
from crtk_drivers.labs.lab_file import Lab


@contextmanager
def alone(lab: Lab) -> Iterator[tuple[int, ...]]:
    """Within, no other bench tests this lab file, or one of its devices that are real.

    Yields:
        descriptors of the locks, each of which lasts until every process has ended that has it.

    Raises:
        ConfigError: another one does.
    """
    with ExitStack() as stack:
        yield tuple(stack.enter_context(_locked(*names)) for names in _names(lab))


def _names(lab: Lab) -> Iterator[tuple[str, str]]:
    """Yield what a run has for itself, and how it is called."""
    yield f"lab {lab.path.resolve()}", lab.name
    for device in lab.devices.values():
        if device.address:
            yield f"device {device.plugin.name} {device.address}", device.name


@contextmanager
def _locked(name: str, told: str) -> Iterator[int]:
    """Hold a lock that ends with this process and those that were given its file.

    Raises:
        ConfigError: another process holds it, or there can be none.
    """
    where = name.partition(" ")[2]
    try:
        file = os.open(_lock_file(name), os.O_RDWR | os.O_NOFOLLOW)
    except OSError as error:
        raise ConfigError(
            f"it cannot be locked against a second bench: {error.strerror}",
            where=where,
            remedy=f"Look at {error.filename}.",
        ) from error
    try:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise _taken(told, os.pread(file, 32, 0).decode("ascii", "replace"), where) from error
        os.ftruncate(file, 0)
        os.pwrite(file, str(os.getpid()).encode(), 0)
        yield file
    finally:
        os.close(file)


def _taken(told: str, owner: str, where: str) -> ConfigError:
    if not owner.isdecimal():
        owner = "of which nothing is known"
    elif not _is_there(int(owner)):
        return ConfigError(
            f"{told} was being tested by process {owner}, which is gone; what that has started still "
            "holds and leaves it",
            where=where,
            remedy="Wait some seconds, and see that it stands.",
        )
    return ConfigError(
        f"{told} is being tested by process {owner}",
        where=where,
        remedy="Wait for it to end, or stop it.",
    )


def _is_there(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # of another user
        return True
    return True


def _lock_file(name: str) -> Path:
    """Return the file of a lock, which is there for every user of this machine.

    Raises:
        OSError: it cannot be made.
    """
    digest = hashlib.sha256(name.encode()).hexdigest()
    path = Path(tempfile.gettempdir()) / f"crtk-bench-{digest[:16]}.lock"
    # A kernel lets nobody open the file of another user in /tmp with O_CREAT, whatever its mode is.
    if not path.exists():
        try:
            made = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        except FileExistsError:
            return path
        os.fchmod(made, 0o666)
        os.close(made)
    return path
