"""The adapter of a simulated bus: a tty and a TCP port, and who of their clients gets the answers."""

from __future__ import annotations

from crtk_sim_backends.dynamixel.tcp import TcpDoor
from crtk_sim_backends.kit.tty import Tty


class Adapter:
    """Both ways to one bus. What the servos say goes to the client that has spoken last.

    Args:
        tty: the serial port.
        door: the TCP port.
        baud: bits a second of clients that come by TCP, which cannot set it.
    """

    def __init__(self, tty: Tty, door: TcpDoor, baud: int) -> None:
        self.tty = tty
        self.door = door
        self._baud = baud
        self._by_tcp = False

    @property
    def plugged(self) -> bool:
        """Whether it is there at present."""
        return self.tty.plugged

    @property
    def baud(self) -> int:
        """Bits a second of the client that has spoken last."""
        return self._baud if self._by_tcp else self.tty.baud

    @property
    def clients(self) -> int:
        """How many there are."""
        return self.tty.clients + (self.door.client is not None)

    def read(self, *, by_tcp: bool) -> bytes:
        """What a client has sent; nothing if there is nothing."""
        data = self.door.read() if by_tcp else self.tty.read()
        if data:
            self._by_tcp = by_tcp
        return data

    def write(self, data: bytes) -> int:
        """Send to the client that has spoken last: how many bytes its buffer has taken."""
        return self.door.write(data) if self._by_tcp else self.tty.write(data)

    def plug(self) -> None:
        """Plug it in: there is a new tty, and clients may come by TCP.

        Raises:
            SimStartError: the link to the tty cannot be made.
        """
        self.tty.plug()

    def unplug(self) -> None:
        """Take it away: clients see errors. Safe to repeat."""
        self.door.leave()
        self.tty.unplug()
