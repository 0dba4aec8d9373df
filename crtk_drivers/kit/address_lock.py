"""One program of this machine at an address, where the device itself serves anybody and tells nobody.

A name in Linux's abstract socket namespace stands for the address: it is free again when its process ends,
however that ends. Programs on other machines, in other network namespaces (containers), and those of others
are not kept out.
"""

from __future__ import annotations

import errno
import os
import socket
from pathlib import Path
from typing import Final

from crtk_drivers.errors import ConnectionFailed
from crtk_drivers.kit.holders import Holder, holder_of

__all__ = ["AddressLock"]

_SOCKETS: Final = Path("/proc/net/unix")
_INODE: Final = 6
"""Column of it (proc(5)); the name is the one after that."""


class AddressLock:
    """Held from `take` until `release`.

    Args:
        what: the kind of device: ``raven``.
        host, port: where it is.
    """

    def __init__(self, what: str, host: str, port: int) -> None:
        self._what, self._host, self._port = what, host, port
        self._held: socket.socket | None = None

    def take(self) -> None:
        """Take it; nothing is done if it is held by this object.

        Raises:
            ConnectionFailed: another program has it, with which; or the address cannot be resolved.
        """
        if self._held is not None:
            return
        where = f"{self._what} {self._host}:{self._port}"
        name = f"crtk-drivers {self._what} {self._resolved(where)}:{self._port}"
        held = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            held.bind(f"\0{name}")
        except OSError as error:
            held.close()
            if error.errno != errno.EADDRINUSE:
                raise ConnectionFailed(
                    f"it cannot be reserved: {error.strerror}", where=where
                ) from error
            holder = _holder(name) or "another program of this machine"
            raise ConnectionFailed(
                f"{holder} drives it already",
                where=where,
                remedy="End that one: the device itself would listen to both, and tell neither.",
            ) from error
        self._held = held

    def _resolved(self, where: str) -> str:
        """Return the address, so that two names of one device are one."""
        try:
            return socket.gethostbyname(self._host)
        except OSError as error:
            raise ConnectionFailed(
                f"{self._host!r} cannot be resolved: {error}",
                where=where,
                remedy="Give its IP address.",
            ) from error

    def release(self) -> None:
        """Let others have it. May be called twice."""
        held, self._held = self._held, None
        if held is not None:
            held.close()


def _holder(name: str) -> Holder | None:
    """Return which process has an abstract name, as far as we may see that."""
    try:
        lines = _SOCKETS.read_text(errors="replace").splitlines()
    except OSError:
        return None
    found = [line.split(None, _INODE + 1) for line in lines if line.endswith(f" @{name}")]
    links = {f"socket:[{fields[_INODE]}]" for fields in found}
    for process in Path("/proc").iterdir():
        if process.name.isdigit() and _has_one_of(process, links):
            return holder_of(int(process.name))
    return None


def _has_one_of(process: Path, links: set[str]) -> bool:
    try:
        files = list((process / "fd").iterdir())
    except OSError:
        return False
    return any(_target(file) in links for file in files)


def _target(file: Path) -> str:
    try:
        return os.readlink(file)
    except OSError:
        return ""
