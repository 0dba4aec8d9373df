"""The way to a tracker: its serial line, whose rate is found first, or TCP; one command and its reply."""

from __future__ import annotations

import contextlib
import logging
import time
from collections import deque
from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

from crtk_driver_ndi.codec import Reply, command, error_text, reply_decoder
from crtk_driver_ndi.config import BAUDS, NdiConfig
from crtk_drivers.device.giving_up import is_given_up
from crtk_drivers.errors import ConnectionFailed, ConnectionLost, DeviceError, ProtocolError
from crtk_drivers.kit import MessageLink, TcpTransport, Transport

if TYPE_CHECKING:
    from crtk_drivers.kit.serial_port import SerialPort

__all__ = ["PATIENCE", "NdiLink", "Refused", "patience_for"]

logger = logging.getLogger(__name__)

PATIENCE: Final = 3.0
_PATIENCE: Final[Mapping[str, float]] = {
    "INIT": 15.0,
    "PINIT": 10.0,
    "TSTART": 10.0,
    "TSTOP": 5.0,
    "COMM": 5.0,
}
"""Seconds that the reply to a command may take; illuminators and field generators are slow to start."""

FIRST_REPLY: Final = 0.5
"""Seconds for a reply at a rate that is tried."""
SWITCHING: Final = 0.2
"""Seconds after which both sides have the new rate (sawNDITracker)."""
QUIET: Final = 0.02
"""Seconds without a byte after which a damaged reply is over."""
REPEATS: Final = 3
PIECE: Final = 0.05

_REMEDY: Final = (
    "Check its power, the cable, the address; is it an NDI tracker, and has nobody else its line?"
)


class Refused(DeviceError):
    """The tracker answered a command with an error.

    Args:
        asked: the command.
        code: of the error.
        where: for messages.
    """

    def __init__(self, asked: str, code: int, where: str) -> None:
        super().__init__(f"{asked} was answered with {error_text(code)}", where=where)
        self.code = code


def patience_for(text: str) -> float:
    """Return the seconds that the reply to a command may take."""
    return _PATIENCE.get(text.partition(":")[0], PATIENCE)


class NdiLink:
    """One tracker. It belongs to the I/O thread, but for `abort`.

    Attributes:
        damaged: replies that failed their check, since the first connection.
        is_ready: whether the tracker is connected and initialised. Set by its owner; `close` clears it.
    """

    def __init__(self, config: NdiConfig) -> None:
        self._config = config
        self._port: SerialPort | None = None
        self._tcp = TcpTransport(
            config.host, config.tcp_port, "ndi", _REMEDY, aborted=lambda: self.is_given_up
        )
        transport: Transport = self._tcp
        if config.transport == "serial":
            from crtk_drivers.kit.serial_port import SerialPort  # needs pyserial

            transport = self._port = SerialPort(config.port, config.baud)
        self._link = MessageLink(transport, reply_decoder, _REMEDY)
        self._replies: deque[Reply] = deque()
        self._aborted = False
        self.damaged = 0
        self.is_ready = False

    @property
    def where(self) -> str:
        """For messages."""
        return self._link.where

    def open(self, deadline: float) -> None:
        """Connect, and agree on the rate of a serial line.

        Raises:
            ConnectionFailed: nobody answers.
        """
        self._link.open(deadline)
        self._replies.clear()
        if self._port is not None:
            self._agree_on_rate(deadline)
        elif not self._answers(min(deadline, time.monotonic() + PATIENCE)):
            raise self._silent()

    def abort(self) -> None:
        """End an `open` of the tracker that waits, and let later ones fail; from any thread.

        A tracker that is ready is asked on: a driver that closes sends TSTOP and waits for the answer.
        """
        self._aborted = True

    @property
    def is_given_up(self) -> bool:
        """Whether nothing can be asked here and now: the program ends while the tracker is opened."""
        return (self._aborted and not self.is_ready) or is_given_up()

    def close(self) -> None:
        """Disconnect. May be called twice."""
        self.is_ready = False
        self._link.close()

    def send(self, text: str) -> None:
        """Send a command.

        Raises:
            ConnectionLost: the link is gone.
        """
        self._link.write(command(text))

    def receive(self, deadline: float) -> Reply | None:
        """Return the next reply; None if none came by the monotonic `deadline`.

        Raises:
            ConnectionLost: the link is gone.
            ProtocolError: what came is damaged, and so forgotten; the command may be sent again.
        """
        if not self._replies:
            try:
                self._replies.extend(self._link.read(deadline))
            except ProtocolError:
                self.damaged += 1
                self._link.forget(QUIET)
                raise
        return self._replies.popleft() if self._replies else None

    def forget(self) -> None:
        """Forget what has arrived by now."""
        self._replies.clear()
        self._link.forget()

    def ask(self, text: str, deadline: float) -> Reply:
        """Send a command and return its reply; while a connection is set up.

        Raises:
            Refused: it is an error.
            ConnectionFailed: none came by the `deadline`, or in the time that such a command may take.
            ConnectionLost: the link is gone, or the tracker was reset.
        """
        deadline = min(deadline, time.monotonic() + patience_for(text))
        for _ in range(REPEATS):
            self.send(text)
            try:
                reply = self._await(deadline)
            except ProtocolError as error:
                logger.debug("%s: %s; it is sent again", text, error)
                continue
            if reply is None:
                break
            if reply.is_reset and not text.startswith("RESET"):
                raise ConnectionLost("the tracker was reset", where=self.where)
            if reply.error is not None:
                raise Refused(text, reply.error, self.where)
            if reply.warning is not None:
                logger.warning("%s: %s was answered with a %s", self.where, text, reply.text)
            return reply
        raise ConnectionFailed(f"no usable answer to {text}", where=self.where, remedy=_REMEDY)

    def _await(self, deadline: float) -> Reply | None:
        while (now := time.monotonic()) < deadline:
            if self.is_given_up:
                raise ConnectionLost("given up: the driver is being shut down", where=self.where)
            reply = self.receive(min(deadline, now + PIECE))
            if reply is not None:
                return reply
        return None

    def _answers(self, deadline: float) -> bool:
        """Whether anything comes back that passes its check, be it an error."""
        self.send("APIREV:")
        try:
            return self._await(deadline) is not None
        except ProtocolError:
            return False

    def _agree_on_rate(self, deadline: float) -> None:
        """Find the rate that the tracker has, which may be that of a client that died; go to ours."""
        port, wanted = self._port, self._config.baud
        assert port is not None
        others = [] if port.has_own_rate else [rate for rate in (9600, *BAUDS) if rate != wanted]
        for rate in dict.fromkeys((wanted, *others)):
            port.set_baud(rate)
            self.forget()
            patience = FIRST_REPLY + port.wire_time(64)
            if self._answers(min(deadline, time.monotonic() + patience)):
                break
        else:
            raise self._silent()
        self._link.forget(QUIET)
        if port.baud != wanted:
            logger.info("%s: it is at %d bit/s, and goes to %d", self.where, port.baud, wanted)
            with contextlib.suppress(Refused):  # a client that died may have left it tracking
                self.ask("TSTOP:", deadline)
            self.ask(f"COMM:{BAUDS[wanted]}0000", deadline)
            time.sleep(SWITCHING)
            port.set_baud(wanted)
            self.forget()

    def _silent(self) -> ConnectionFailed:
        return ConnectionFailed("nobody answers", where=self.where, remedy=_REMEDY)
