"""A serial line in a loop: a pseudo-terminal whose client talks to a session."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

from crtk_sim_backends.faults import Fault
from crtk_sim_backends.kit.faulty_line import FaultyLine
from crtk_sim_backends.kit.loop import Loop
from crtk_sim_backends.kit.ports import Session
from crtk_sim_backends.kit.tty import Tty
from crtk_sim_backends.process import SimStartError
from crtk_sim_backends.wire import Direction

log = logging.getLogger(__name__)


class TtyServer:
    """One serial line. A new client has a new session.

    Args:
        loop: in which it lives.
        link: path of the symbolic link by which clients find it.
        session: makes that of a new client.

    Raises:
        SimStartError: the link cannot be made.
    """

    def __init__(self, loop: Loop, link: Path, session: Callable[[], Session]) -> None:
        self._loop = loop
        self._tty = Tty(link)
        self._make_session = session
        self._line = FaultyLine(loop, self._take, self._tty.write)
        self._session: Session | None = None  # None: its client is never answered
        self._plug()

    @property
    def baud(self) -> int:
        """Bits a second that the client has set."""
        return self._tty.baud

    @property
    def path(self) -> str:
        """Of the link."""
        return str(self._tty.link)

    @property
    def clients(self) -> int:
        """How many have it open."""
        return self._tty.clients

    def send(self, data: bytes, to: Session | None = None) -> None:
        """Send to whoever has it open; what its buffer does not take is lost. It has one session."""
        if self._tty.plugged and self._tty.clients and self._session is not None:
            self._line.carry(Direction.OUT, data)

    def begin(self, fault: Fault) -> None:
        """Let a fault of the wire begin; by ``disconnect`` the line is unplugged."""
        if fault.kind == "disconnect":
            self._unplug()
        else:
            self._line.begin(fault)
            self._tell_next_client(fault)

    def end(self, fault: Fault) -> None:
        """Let it end."""
        if fault.kind == "disconnect":
            try:
                self._plug()
            except SimStartError as error:
                log.error("it stays unplugged: %s", error)
        else:
            self._line.end(fault)
            self._tell_next_client(fault)

    def close(self) -> None:
        """Take the line away; safe to repeat."""
        self._unplug()

    def _tell_next_client(self, fault: Fault) -> None:
        """Make the session anew that waits for a client, as this fault concerns new clients only."""
        if fault.kind == "no_answer" and self._tty.plugged and not self._tty.clients:
            self._begin_anew()

    def _begin_anew(self) -> None:
        self._close_session()
        self._session = self._make_session() if self._line.answers else None
        self._line.clear()

    def _close_session(self) -> None:
        if self._session is not None:
            self._session.close()

    def _plug(self) -> None:
        self._tty.plug()
        self._begin_anew()
        self._loop.watch(self._tty.fileno(), self._receive)
        if self._tty.openings is not None:
            self._loop.watch(self._tty.openings.fileno(), self._look)

    def _unplug(self) -> None:
        if self._tty.plugged:
            self._loop.forget(self._tty.fileno())
            if self._tty.openings is not None:
                self._loop.forget(self._tty.openings.fileno())
            self._tty.unplug()
            self._close_session()
            self._line.clear()

    def _look(self, events: int) -> None:
        """See who has come or left."""
        if not self._tty.look():
            return
        # The kernel hands on what a client has written some time later, but at once to whoever reads.
        data = b""
        while not self._tty.clients and (data := self._tty.read()):
            self._tty.look()
            if not self._tty.clients:
                self._line.carry(Direction.IN, data)
        self._begin_anew()
        if self._tty.clients:
            self._line.carry(Direction.IN, data)  # it may be of the client who has come meanwhile

    def _receive(self, events: int) -> None:
        self._look(events)  # who has sent this
        self._line.carry(Direction.IN, self._tty.read())

    def _take(self, data: bytes) -> None:
        if self._session is not None:
            self.send(self._session.receive(data))
