"""Files that users hand in, read with care."""

from __future__ import annotations

from pathlib import Path
from stat import S_ISDIR, S_ISREG

from crtk_drivers.errors import ConfigError


def read_capped(path: Path, most: int, kind: str) -> bytes:
    """Return what a regular file holds.

    Args:
        path: of the file.
        most: bytes that it may have.
        kind: what it should be, with its article: "a configuration".

    Raises:
        ConfigError: missing, not a regular file, larger, or not to be read.
    """
    where = str(path)
    try:
        status = path.stat()
        if S_ISREG(status.st_mode) and status.st_size <= most:
            with path.open("rb") as file:
                return file.read(most)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(
            f"cannot be read: {reason}", where=where, remedy="Check path and rights."
        ) from error
    if not S_ISREG(status.st_mode):
        found = "is a directory" if S_ISDIR(status.st_mode) else "is not a regular file"
        raise ConfigError(found, where=where, remedy=f"Give {kind}.")
    raise ConfigError(
        f"has {status.st_size} bytes; {kind} has at most {most}",
        where=where,
        remedy="Is it the right file?",
    )
