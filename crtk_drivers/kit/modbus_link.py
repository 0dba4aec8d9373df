"""A Modbus device over a transport: one question at a time, which the next call goes on with."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final, Generic, Protocol, TypeVar

from crtk_drivers.errors import ConnectionFailed, ProtocolError
from crtk_drivers.kit.modbus_frames import EXCEPTIONS, Exceptional, Framing, Question
from crtk_drivers.kit.transport import Transport
from crtk_drivers.samples import Stamp

__all__ = ["Answer", "Asked", "ModbusLink", "RegisterMap", "first_answer"]

CommandT = TypeVar("CommandT")
StatusT = TypeVar("StatusT")
_Command = TypeVar("_Command", contravariant=True)
_Status = TypeVar("_Status", covariant=True)

_PIECE: Final = 0.05
"""Seconds after which `first_answer` looks whether it is given up."""
_SILENT: Final = 0.25
"""Seconds without an answer after which a device may have been without power meanwhile."""
_QUIET: Final = 0.002
"""Seconds without a byte before a question whose answer looks like the last one: 3.5 characters, which are
1.75 ms above 19200 bits a second (MODBUS over Serial Line, 2.5.1.1)."""
_FLOOD: Final = 0.05
_OVERDUE: Final = 32
"""Seconds in which all that has come can be read, and how often what is no answer is read when the time for
one is over: what comes still is noise without an end."""
_ANOTHER: Final = Exceptional("unknown", "See its manual.", passes=True)


class RegisterMap(Protocol[_Command, _Status]):
    """What a device is asked, and what its answers say.

    A line cannot tell to which question an answer belongs. So no two questions in a row have answers that
    look alike, where `variant` has another one: an answer that comes twice is not taken for that to the
    next. Where it has none, the line is silent before the next question, and a second copy that is seen
    is told apart by a probe; one that comes later than that, on the way of the next answer, is believed
    once.

    After one that was not answered in time `probe` is asked, whose answer is like none of the others, nor
    like that of the last probes: when that has come, no late one is on its way. After a longer silence
    the status is read, and returned before anything is written: the device may have been without power,
    and a command may mean something else to it now.
    """

    silent: str
    """What to do when it does not answer."""
    other: str
    """What to do when it answers as another device does."""

    def read(self) -> Question:
        """Return what reads."""

    def write(self, command: _Command) -> Question:
        """Return what sends a command, and may read the status as well."""

    def probe(self, turn: int) -> Question:
        """Return what is asked after an answer was missed; `turn` counts: several may be late."""

    def variant(self, question: Question) -> Question | None:
        """Return what reads the same as `read`, with an answer that looks different; None: nothing."""

    def aside(self, command: _Command) -> Question:
        """Return what sends a command whose answer nobody waits for."""

    def status(self, question: Question, reply: bytes) -> _Status | None:
        """Return what a reply (function and data) says; None: something else must still be asked.

        Raises:
            CrtkError: it is another device.
        """


@dataclass(frozen=True, slots=True)
class Answer(Generic[CommandT, StatusT]):
    """What came back. `stamp` is from when it was asked for: what is told is not older than that."""

    status: StatusT
    stamp: Stamp
    delivered: CommandT | None
    """The command that it has acknowledged since the last answer."""

    def after(self, earlier: Answer[CommandT, StatusT]) -> Answer[CommandT, StatusT]:
        """Return this with what an answer before it has acknowledged, if this acknowledges nothing."""
        return self if self.delivered else replace(self, delivered=earlier.delivered)


class Asked(Protocol[CommandT, StatusT]):
    """A link that is asked: a `ModbusLink`, or one that is like it."""

    @property
    def where(self) -> str:
        """See `ModbusLink`."""

    @property
    def trouble(self) -> tuple[str, str]:
        """See `ModbusLink`."""

    def open(self, deadline: float) -> None:
        """See `ModbusLink`."""

    def close(self) -> None:
        """See `ModbusLink`."""

    def exchange(
        self, command: CommandT | None, deadline: float
    ) -> Answer[CommandT, StatusT] | None:
        """See `ModbusLink`."""


def first_answer(
    link: Asked[CommandT, StatusT], deadline: float, given_up: Callable[[], bool]
) -> Answer[CommandT, StatusT]:
    """Open a link, and return what the device answers; nothing is written.

    Raises:
        ConnectionFailed: it does not, by the monotonic `deadline`, or it is given up.
    """
    link.open(deadline)
    while not given_up() and (now := time.monotonic()) < deadline:
        until = min(deadline, now + _PIECE)
        answer = link.exchange(None, until)
        if answer is not None:
            return answer
        time.sleep(max(0.0, until - time.monotonic()))  # it is busy, or not there yet
    text, remedy = link.trouble
    link.close()
    raise ConnectionFailed(text, where=link.where, remedy=remedy)


class ModbusLink(Generic[CommandT, StatusT]):
    """The way to one device. It belongs to the I/O thread, but for `shout`.

    A command is the same as long as it is the same object.

    Args:
        registers: of the device.
        transport: the way.
        framing: of the bytes on it.
        timeout: seconds after which a question counts as lost.
        clock: monotonic seconds.
    """

    def __init__(
        self,
        registers: RegisterMap[CommandT, StatusT],
        transport: Transport,
        framing: Framing,
        timeout: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._registers = registers
        self._transport = transport
        self._framing = framing
        self._timeout = timeout
        self._clock = clock
        self._asked: Stamp | None = None
        self._question: Question | None = None
        self._looked: Question | None = None  # as the answer that came last
        self._writing: CommandT | None = None
        self._delivered: CommandT | None = None
        self._missed = self._blind = False
        self._answered_at = self._clock()
        self._heard = False
        self._counts: Counter[str] = Counter(missed=0, doubled=0, exceptions=0)
        self._exception: Exceptional | None = None

    @property
    def where(self) -> str:
        """For messages."""
        return self._transport.where

    @property
    def counters(self) -> Mapping[str, float]:
        """What went wrong, counted."""
        return {**self._counts, "strange_bytes": self._framing.strange}

    def open(self, deadline: float) -> None:
        """Connect; nothing is sent.

        Raises:
            ConnectionFailed: not by the monotonic `deadline`.
        """
        self._asked = self._delivered = self._exception = None
        self._looked = None
        self._heard = self._missed = self._blind = False
        self._answered_at = self._clock()
        self._framing.begin()
        self._transport.open(deadline)

    def close(self) -> None:
        """Disconnect. May be called twice."""
        self._transport.close()

    def exchange(
        self,
        command: CommandT | None,
        deadline: float,
        after: Callable[[StatusT], bool] | None = None,
    ) -> Answer[CommandT, StatusT] | None:
        """Send a command, if there is one, and read the status; None: not by the deadline.

        Args:
            command: what to send.
            deadline: monotonic seconds.
            after: the command follows a status of which this is true, and nothing in between.

        Raises:
            ConnectionLost: the connection is gone.
            ProtocolError: what answers is no such device.
        """
        late: Answer[CommandT, StatusT] | None = None
        is_late, overdue = self._asked is not None, 0
        if not is_late:
            is_late = after is not None
            self._ask(None if is_late else command)
        while data := self._transport.read(min(deadline, self._lost_at)):
            reply = self._feed(data)
            if reply is None:
                overdue += self._clock() >= min(deadline, self._lost_at)
                if overdue > _OVERDUE:
                    break
                continue
            was_blind = self._blind
            answer = self._answered(reply)
            if answer is None and self._exception is not None:
                return late
            if answer is not None and (was_blind or not is_late):
                return answer if late is None else answer.after(late)
            late, is_late = answer or late, False
            # What was asked for before this call has come, or a command was acknowledged: what is left.
            is_told = command in (self._delivered, late and late.delivered)
            may_follow = after is None or (answer is not None and after(answer.status))
            self._ask(command if may_follow and not is_told else None)
        if self._clock() >= self._lost_at:
            self._counts["missed"] += 1
            self._asked, self._missed = None, True
            self._was_silent()
        return late

    def shout(self, command: CommandT) -> None:
        """Send a command and wait for nothing, from any thread, whatever the I/O thread does.

        On a line it may meet what is on its way; its answer is left out as strange.
        """
        self._transport.write(self._framing.aside(self._registers.aside(command)))

    def tell(self, question: Question, unit: int) -> None:
        """Ask another unit, and wait for nothing: what stands before the device (a gateway, a box)."""
        self._transport.write(self._framing.aside(question, unit))

    @property
    def trouble(self) -> tuple[str, str]:
        """Why there is no answer, and what to do."""
        if self._exception is not None:
            return f"it answers with an exception: {self._exception.text}", self._remedy
        if self._heard:
            return (
                "bytes come, and none of them are an answer",
                "Check baud rate, parity, and its address; does another program use the line?",
            )
        return "it does not answer", self._registers.silent

    @property
    def _lost_at(self) -> float:
        """When the question that waits for its answer counts as lost."""
        return math.inf if self._asked is None else self._asked.monotonic + self._timeout

    def _ask(self, command: CommandT | None) -> None:
        is_doubled = self._drain(0.0)
        if self._missed or self._blind:
            command = None
        if not self._missed:
            command, is_alike = self._choose(command)
            if is_alike and (is_doubled or self._drain(_QUIET)):
                self._counts["doubled"] += 1
                self._missed, command = True, None  # another one may be on its way
        if self._missed:
            self._question = self._registers.probe(self._counts["missed"] + self._counts["doubled"])
        self._writing = command
        self._asked = Stamp.now()
        assert self._question is not None
        self._transport.write(self._framing.ask(self._question))

    def _drain(self, silence: float) -> bool:
        """Read what comes late or doubled, until nothing does; whether it looks like the last answer."""
        found, end = False, self._clock() + _FLOOD
        while data := self._transport.read(silence and self._clock() + silence):
            found |= self._feed(data) is not None
            if self._clock() > end:
                break
        return found

    def _choose(self, command: CommandT | None) -> tuple[CommandT | None, bool]:
        """Choose what is asked; return the command in it, and whether its answer looks like the last."""
        before, registers = self._looked, self._registers
        question = registers.read() if command is None else registers.write(command)
        if not self._framing.numbered and question.is_answered_like(before):
            if command is not None:
                command, question = None, registers.read()  # between two that look alike
            if question.is_answered_like(before):
                question = registers.variant(question) or question
        self._question = question
        return command, not self._framing.numbered and question.is_answered_like(before)

    def _feed(self, data: bytes) -> bytes | None:
        self._heard = True
        try:
            return self._framing.feed(data)
        except ValueError as error:
            raise ProtocolError(
                str(error), where=self.where, remedy="Is this its port, and link as it should be?"
            ) from error

    def _answered(self, reply: bytes) -> Answer[CommandT, StatusT] | None:
        asked, self._asked = self._asked, None
        assert asked is not None
        assert self._question is not None
        self._looked = None if reply[0] & 0x80 else self._question
        if reply[0] & 0x80:
            self._refused(reply[1])
            return None
        self._exception = None
        self._missed = False
        self._answered_at = self._clock()
        if self._writing is not None:
            self._delivered, self._writing = self._writing, None
        status = self._registers.status(self._question, reply)
        if status is None:
            return None
        self._blind = False
        delivered, self._delivered = self._delivered, None
        return Answer(status, asked, delivered)

    def _was_silent(self) -> None:
        """Nothing was answered: after a while what it is must be read before it is told anything."""
        self._blind |= self._clock() - self._answered_at > _SILENT

    def _refused(self, code: int) -> None:
        self._counts["exceptions"] += 1
        self._was_silent()
        self._exception = EXCEPTIONS.get(code, _ANOTHER)
        if not self._exception.passes:
            raise ProtocolError(
                f"it answers with exception {code}: {self._exception.text}",
                where=self.where,
                remedy=self._remedy,
            )

    @property
    def _remedy(self) -> str:
        assert self._exception is not None
        return self._exception.remedy or self._registers.other
