"""Sessions of the box's TCP ports: what they have beyond those of the kit comes by itself."""

from __future__ import annotations

from typing import Protocol

from crtk_sim_backends import kit
from crtk_sim_backends.control import ControlSession


class Session(kit.Session, Protocol):
    """One client of a port: bytes in, bytes out. `ended` asks for the connection to be closed."""

    def more(self, now: float) -> bytes:
        """Return what comes by itself."""


class Requests(ControlSession):
    """A connection of the control port."""

    def more(self, now: float) -> bytes:
        """Nothing comes by itself."""
        return b""
