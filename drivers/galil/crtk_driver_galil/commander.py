"""Commands to a controller over TCP, many on their way at once, and their answers in order."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Final, NamedTuple

from crtk_driver_galil.codes import refusal
from crtk_driver_galil.replies import Replies, Reply
from crtk_drivers.errors import ConnectionFailed, ConnectionLost, DeviceError, ProtocolError
from crtk_drivers.kit import MessageLink, TcpTransport

REMEDY: Final = (
    "Is the controller on, is this its address, and is one of its eight handles free (TH)?"
)
MOST: Final = 24
"""Commands on their way, beyond which no setpoint is sent."""
UNHEARD: Final = 0.03
"""Seconds without any answer after which none is sent either: an answer takes milliseconds."""

Take = Callable[[str], None]


class _Asked(NamedTuple):
    command: str
    since: float
    take: Take | None
    explains: bool = False


class CommandRefusedByController(DeviceError):
    """A controller has answered a command with ``?``."""


class Commander:
    """The command connection. Belongs to the I/O thread, but for `send`.

    Args:
        host: address.
        port: TCP port.
        timeout: seconds for an answer.

    Attributes:
        echoes: answers that began with their command, as with echo on.
    """

    def __init__(self, host: str, port: int, timeout: float) -> None:
        self._replies = Replies()
        transport = TcpTransport(host, port, "galil", REMEDY)
        self._link = MessageLink[Reply](transport, self._fresh, REMEDY)
        self._timeout = timeout
        self._asked: deque[_Asked] = deque()
        self._unexplained: list[str] = []  # commands, oldest first: the code (TC) is of the last
        self._refused: deque[CommandRefusedByController] = deque(maxlen=32)
        self._lock = threading.Lock()
        self.echoes = 0

    def _fresh(self) -> Replies:
        self._replies = Replies()
        return self._replies

    @property
    def where(self) -> str:
        """The controller, for errors."""
        return self._link.where

    @property
    def said(self) -> int:
        """Characters that the controller said unasked."""
        return self._replies.said

    @property
    def waiting(self) -> int:
        """Commands without an answer yet."""
        return len(self._asked)

    @property
    def is_busy(self) -> bool:
        """Whether no setpoint should follow what is on its way: it is much, or nothing is answered."""
        return self.waiting >= MOST or self._link.unheard > UNHEARD

    def open(self, deadline: float) -> None:
        """Connect.

        Raises:
            ConnectionFailed: not by the monotonic `deadline`.
        """
        self._asked.clear()
        self._unexplained.clear()
        self._refused.clear()
        self._link.open(deadline)

    def close(self) -> None:
        """Disconnect. May be called twice."""
        self._link.close()
        self._asked.clear()

    def send(self, command: str, take: Take | None = None, *, explains: bool = False) -> None:
        """Send a command, from any thread; its answer is dealt with by `collect`.

        Args:
            command: without its end.
            take: gets the text of the answer.
            explains: it asks why commands were refused.

        Raises:
            ConnectionLost: the connection is gone.
        """
        with self._lock:
            self._asked.append(_Asked(command, time.monotonic(), take, explains))
            self._link.write(f"{command}\r".encode())

    def ask(self, command: str, deadline: float) -> str:
        """Return the answer to a command; waits for it, as only `open` of a device may.

        Raises:
            CommandRefusedByController: it was refused, and why.
            ConnectionFailed: no answer by the monotonic `deadline`.
            ConnectionLost: the connection is gone.
        """
        answer: list[str] = []
        deadline = min(deadline, time.monotonic() + self._timeout)
        self.send(command, answer.append)
        while self.waiting:
            self._receive(deadline)
            if time.monotonic() > deadline:
                raise ConnectionFailed(f"no answer to {command!r}", where=self.where, remedy=REMEDY)
        refused = self.take_refused()
        if refused:
            raise refused[0]
        return answer[0]

    def collect(self) -> None:
        """Deal with the answers that have come by now.

        Raises:
            ConnectionLost: the connection is gone, or an answer does not come.
            ProtocolError: what came is no answer to anything.
        """
        self._receive(0.0)
        if self._asked and time.monotonic() - self._asked[0].since > self._timeout:
            raise ConnectionLost(
                f"no answer to {self._asked[0].command!r} within {self._timeout:g} s",
                where=self.where,
                remedy=REMEDY,
            )

    def take_refused(self) -> list[CommandRefusedByController]:
        """Return what was refused since the last call, oldest first."""
        refused = list(self._refused)
        self._refused.clear()
        return refused

    def _receive(self, deadline: float) -> None:
        for reply in self._link.read(deadline):
            if not self._asked:
                raise ProtocolError(
                    f"an answer to nothing: {reply.text!r}",
                    where=self.where,
                    remedy="Let programs on the controller write nothing (MG) on this handle.",
                )
            self._answered(self._asked.popleft(), reply)

    def _answered(self, asked: _Asked, reply: Reply) -> None:
        text = reply.text
        if text.startswith(asked.command):
            self.echoes += 1
            text = text[len(asked.command) :].lstrip()
        if asked.explains:
            self._explain(text)
        elif not reply.taken:
            self._unexplained.append(asked.command)
            self.send("TC1", explains=True)
        elif asked.take is not None:
            asked.take(text)

    def _explain(self, text: str) -> None:
        """Take the code of what was refused last; what was refused before that, no code tells any more."""
        number = text.split()[0] if text else "0"
        code = int(number) if number.isdigit() else 0
        found = refusal(code)
        commands, self._unexplained = self._unexplained, []
        for command in commands[:-1]:
            self._refuse(
                f"{command!r} was refused, and no code tells why: {commands[-1]!r} was refused after it: "
                f"{code} {found.text}",
                found.remedy,
            )
        for command in commands[-1:]:
            self._refuse(f"{command!r} was refused: {code} {found.text}", found.remedy)

    def _refuse(self, text: str, remedy: str) -> None:
        self._refused.append(CommandRefusedByController(text, where=self.where, remedy=remedy))
