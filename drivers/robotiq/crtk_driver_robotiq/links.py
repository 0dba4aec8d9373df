"""The ways to a gripper: one question at a time, which the next call goes on with if it takes longer."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final, Protocol

from crtk_driver_robotiq import modbus, urcap
from crtk_driver_robotiq.modbus import EXCEPTIONS, Exceptional, Framing, Question
from crtk_driver_robotiq.registers import Command, Status
from crtk_drivers.errors import ProtocolError
from crtk_drivers.kit import Transport
from crtk_drivers.samples import Stamp

__all__ = ["Answer", "Link", "ModbusLink", "UrcapLink"]

QUIET: Final = 0.002
"""Seconds of silence after which a text server that ends no lines has said all."""

_FUNCTIONS: Final = (3, 4)
_ANOTHER: Final = Exceptional("unknown", "See its manual.", passes=True)


@dataclass(frozen=True, slots=True)
class Answer:
    """What came back. `stamp` is from when it was asked for: what is told is not older than that."""

    status: Status
    stamp: Stamp
    delivered: Command | None
    """The command that it has acknowledged since the last answer."""

    def after(self, earlier: Answer) -> Answer:
        """Return this with what an answer before it has acknowledged, if this acknowledges nothing."""
        return self if self.delivered else replace(self, delivered=earlier.delivered)


class Link(Protocol):
    """A way to the gripper. It belongs to the I/O thread, but for `shout`."""

    @property
    def where(self) -> str:
        """For messages."""

    @property
    def counters(self) -> Mapping[str, float]:
        """What went wrong, counted."""

    def open(self, deadline: float) -> None:
        """Connect; nothing is sent."""

    def close(self) -> None:
        """Disconnect."""

    def exchange(self, command: Command | None, deadline: float) -> Answer | None:
        """Send a command, if there is one, and read the status; None: not by the deadline.

        Raises:
            ConnectionLost: the connection is gone.
            ProtocolError: what answers is no such gripper.
        """

    def shout(self, command: Command) -> None:
        """Send a command and wait for nothing, from any thread, whatever the I/O thread does."""

    @property
    def trouble(self) -> tuple[str, str]:
        """Why there is no answer, and what to do."""


class ModbusLink:
    """Modbus over a transport.

    A line cannot tell to which question an answer belongs. After one that did not come in time the other
    functions of the same meaning are used (4 for 3, 16 and 4 for 23): what then comes late is told apart.

    Args:
        transport: the way.
        framing: of the bytes on it.
        timeout: seconds after which a question counts as lost.
        clock: monotonic seconds.
    """

    def __init__(
        self,
        transport: Transport,
        framing: Framing,
        timeout: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._transport = transport
        self._framing = framing
        self._timeout = timeout
        self._clock = clock
        self._asked: Stamp | None = None
        self._writing: Command | None = None
        self._delivered: Command | None = None
        self._way = 0
        self._heard = False
        self._counts: Counter[str] = Counter(missed=0, exceptions=0)
        self._exception: Exceptional | None = None

    @property
    def where(self) -> str:
        """See `Link`."""
        return self._transport.where

    @property
    def counters(self) -> Mapping[str, float]:
        """See `Link`."""
        return {**self._counts, "strange_bytes": self._framing.strange}

    def open(self, deadline: float) -> None:
        """See `Link`."""
        self._asked = self._delivered = self._exception = None
        self._heard = False
        self._transport.open(deadline)

    def close(self) -> None:
        """See `Link`."""
        self._transport.close()

    def exchange(self, command: Command | None, deadline: float) -> Answer | None:
        """See `Link`."""
        late: Answer | None = None
        is_late = self._asked is not None
        if not is_late:
            self._ask(command)
        while data := self._transport.read(deadline):
            reply = self._feed(data)
            if reply is None:
                continue
            answer = self._answered(reply)
            if answer is None and self._exception is not None:
                return late
            if answer is not None and not is_late:
                return answer if late is None else answer.after(late)
            late, is_late = answer or late, False
            # What was asked for before this call has come, or a command was acknowledged: now the status.
            self._ask(None if answer is None or command is answer.delivered else command)
        asked = self._asked
        if asked is not None and self._clock() - asked.monotonic > self._timeout:
            self._counts["missed"] += 1
            self._asked, self._way = None, 1 - self._way
        return late

    def shout(self, command: Command) -> None:
        """See `Link`. On a line it may meet what is on its way; its answer is left out as strange."""
        self._transport.write(self._framing.aside(modbus.write(command.block)))

    @property
    def trouble(self) -> tuple[str, str]:
        """See `Link`."""
        if self._exception is not None:
            return f"it answers with an exception: {self._exception.text}", self._exception.remedy
        if self._heard:
            return (
                "bytes come, and none of them are an answer",
                "Check baud rate, parity, and its address; does another program use the line?",
            )
        return (
            "it does not answer",
            "Is it powered (24 V; on a robot's tool: its voltage), and are wiring, baud rate and address "
            "right? Where the Robotiq URCap owns the tool line nothing answers: use its text server (link: "
            "urcap).",
        )

    def _ask(self, command: Command | None) -> None:
        while data := self._transport.read(0.0):
            self._feed(data)  # late or doubled: strange
        self._writing = command
        self._asked = Stamp.now()
        self._transport.write(self._framing.ask(self._question(command)))

    def _question(self, command: Command | None) -> Question:
        if command is None:
            return modbus.read(_FUNCTIONS[self._way])
        return (modbus.write if self._way else modbus.read_write)(command.block)

    def _feed(self, data: bytes) -> bytes | None:
        self._heard = True
        try:
            return self._framing.feed(data)
        except ValueError as error:
            raise ProtocolError(
                str(error), where=self.where, remedy="Is this its port, and link as it should be?"
            ) from error

    def _answered(self, reply: bytes) -> Answer | None:
        asked, self._asked = self._asked, None
        assert asked is not None
        if reply[0] & 0x80:
            self._refused(reply[1])
            return None
        self._exception = None
        if self._writing is not None:
            self._delivered, self._writing = self._writing, None
        if reply[0] == modbus.WRITE:
            return None
        delivered, self._delivered = self._delivered, None
        return Answer(Status.parse(reply[2:]), asked, delivered)

    def _refused(self, code: int) -> None:
        self._counts["exceptions"] += 1
        self._exception = EXCEPTIONS.get(code, _ANOTHER)
        if not self._exception.passes:
            raise ProtocolError(
                f"it answers with exception {code}: {self._exception.text}",
                where=self.where,
                remedy=self._exception.remedy,
            )


class UrcapLink:
    """The text server of the URCap: a SET, or a GET for each variable.

    Nothing is asked twice: TCP loses nothing, and what comes late would be taken for the answer to the next.

    Args:
        transport: to the server.
        clock: monotonic seconds.
    """

    def __init__(self, transport: Transport, clock: Callable[[], float] = time.monotonic) -> None:
        self._transport = transport
        self._clock = clock
        self._begin()

    def _begin(self) -> None:
        self._answers = urcap.Answers()
        self._values: dict[str, int] = {}
        self._turn = 0
        self._names: list[str] = []
        self._asked = ""
        self._since = Stamp(0, 0.0)
        self._setting: Command | None = None
        self._delivered: Command | None = None

    @property
    def where(self) -> str:
        """See `Link`."""
        return self._transport.where

    @property
    def counters(self) -> Mapping[str, float]:
        """See `Link`."""
        return {}

    def open(self, deadline: float) -> None:
        """See `Link`."""
        self._begin()
        self._transport.open(deadline)

    def close(self) -> None:
        """See `Link`."""
        self._transport.close()

    def exchange(self, command: Command | None, deadline: float) -> Answer | None:
        """See `Link`; a sample is asked for in several calls where the server is slow."""
        while True:
            if not self._asked and self._setting is None:
                self._ask(command)
            until = deadline
            if self._asked and self._answers.ends_lines is not True:
                until = min(deadline, self._clock() + QUIET)
            data = self._transport.read(until)
            try:
                is_answered = self._take(data)
            except ValueError as error:
                raise ProtocolError(
                    f"it sent {error}",
                    where=self.where,
                    remedy="Is the Robotiq URCap of this robot installed, and its gripper connected?",
                ) from error
            if is_answered and not self._names and self._values.keys() >= _ALL:
                delivered, self._delivered = self._delivered, None
                return Answer(urcap.status_of(self._values), self._since, delivered)
            if not is_answered and not data and self._clock() >= deadline:
                return None

    def shout(self, command: Command) -> None:
        """See `Link`."""
        self._answers.skip_ack()
        self._transport.write(urcap.set_line(command))

    @property
    def trouble(self) -> tuple[str, str]:
        """See `Link`."""
        return (
            "the URCap's server does not answer",
            "Is the Robotiq URCap installed, the robot on, and the gripper chosen in its installation?",
        )

    def _ask(self, command: Command | None) -> None:
        if command is not None and command is not self._delivered:
            self._setting = command
            self._names = []  # what was read before does not count for it
            self._transport.write(urcap.set_line(command))
            return
        if not self._names:
            self._names = [*urcap.EACH, urcap.IN_TURN[self._turn % len(urcap.IN_TURN)]]
            self._turn += 1
            self._since = Stamp.now()
        self._asked = self._names.pop(0)
        self._transport.write(urcap.get_line(self._asked))

    def _take(self, data: bytes) -> bool:
        if self._setting is not None:
            if not self._answers.ack(data):
                return False
            self._delivered, self._setting = self._setting, None
            return False
        value = self._answers.value(self._asked, data, quiet=not data)
        if value is None:
            return False
        self._values[self._asked], self._asked = value, ""
        return True


_ALL: Final = {*urcap.EACH, *urcap.IN_TURN}
