"""What a driver needs of the way to its device."""

from __future__ import annotations

from typing import Protocol

__all__ = ["Transport"]


class Transport(Protocol):
    """The way to a device. It can be opened again and again: what was lost is connected anew by `open`.

    It belongs to the I/O thread.
    """

    @property
    def where(self) -> str:
        """For messages."""

    def open(self, deadline: float) -> None:
        """Connect, anew if it is connected.

        Raises:
            ConnectionFailed: not by the monotonic `deadline`.
        """

    def close(self) -> None:
        """Disconnect. May be called twice."""

    def read(self, deadline: float) -> bytes:
        """Return what has arrived as soon as there is any; nothing if none came by the monotonic `deadline`.

        Raises:
            ConnectionLost: the connection is gone.
        """

    def write(self, data: bytes) -> None:
        """Send all of `data`.

        Raises:
            ConnectionLost: the connection is gone, or takes no more.
        """
