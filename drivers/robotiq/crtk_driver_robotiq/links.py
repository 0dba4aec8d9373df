"""The ways to a gripper: Modbus, and the text server of the URCap."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Final, Protocol

from crtk_driver_robotiq import urcap
from crtk_driver_robotiq.registers import COMMAND, SIZE, STATUS, Command, Status
from crtk_drivers.errors import ConnectionFailed, ProtocolError
from crtk_drivers.kit import Transport, modbus_frames
from crtk_drivers.kit.modbus_frames import Question
from crtk_drivers.kit.modbus_link import Answer
from crtk_drivers.samples import Stamp

__all__ = ["ControllerRegisters", "GripperAnswer", "GripperRegisters", "Link", "UrcapLink"]

GripperAnswer = Answer[Command, Status]
After = Callable[[Status], bool]

QUIET: Final = 0.002
"""Seconds of silence after which a text server that ends no lines has said all."""

LISTEN: Final = 0.25
"""Seconds in which a robot would tell its state: it does so ten times a second or more often."""

_COUNT: Final = SIZE // 2
_PROBES: Final = (
    *((modbus_frames.READ_INPUT, count) for count in range(1, _COUNT)),
    *((modbus_frames.READ, count) for count in range(1, _COUNT)),
)


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

    def exchange(
        self, command: Command | None, deadline: float, after: After | None = None
    ) -> GripperAnswer | None:
        """Send a command, if there is one, and read the status; None: not by the deadline.

        Args:
            command: what to send.
            deadline: monotonic seconds.
            after: the command follows a status of which this is true, and nothing in between.

        Raises:
            ConnectionLost: the connection is gone.
            ProtocolError: what answers is no such gripper.
        """

    def shout(self, command: Command) -> None:
        """Send a command and wait for nothing, from any thread, whatever the I/O thread does."""

    @property
    def trouble(self) -> tuple[str, str]:
        """Why there is no answer, and what to do."""


class GripperRegisters:
    """What a gripper is asked in Modbus: a command and the status in one exchange (function 23)."""

    silent = (
        "Is it powered (24 V; on a robot's tool: its voltage), and are wiring, baud rate and address right? "
        "Where the Robotiq URCap owns the tool line nothing answers: use its text server (link: urcap)."
    )
    other = "Is it a gripper with these registers (2F-85, 2F-140, Hand-E), and no ePick or force sensor?"

    def read(self) -> Question:
        """See `RegisterMap`."""
        return modbus_frames.read(STATUS, _COUNT)

    def write(self, command: Command) -> Question:
        """See `RegisterMap`."""
        return modbus_frames.read_write(STATUS, _COUNT, command.address, command.block)

    def probe(self, turn: int) -> Question:
        """See `RegisterMap`: a part of the status."""
        function, count = _PROBES[turn % len(_PROBES)]
        return modbus_frames.read(STATUS, count, function)

    def variant(self, question: Question) -> Question:
        """See `RegisterMap`: the function for input registers."""
        return modbus_frames.read(STATUS, _COUNT, modbus_frames.READ_INPUT)

    def aside(self, command: Command) -> Question:
        """See `RegisterMap`."""
        return modbus_frames.write(command.address, command.block)

    def status(self, question: Question, reply: bytes) -> Status | None:
        """See `RegisterMap`; a probe tells none."""
        is_probe = (reply[0], reply[1] // 2) in _PROBES
        return None if is_probe else Status.parse(reply[2:])


class ControllerRegisters:
    """What Robotiq's own controller is asked in Modbus TCP: it knows functions 4 and 16, from register 0 on.

    Source: 2F-200 manual, 4.10. A command and the status are two exchanges.
    """

    silent = (
        "Is the controller powered and connected, and is it at this address (unit 2 as delivered)?"
    )
    other = "Is it Robotiq's own controller? A gateway to the gripper's own registers is `link: modbus`."

    def read(self) -> Question:
        """See `RegisterMap`."""
        return modbus_frames.read(0, _COUNT, modbus_frames.READ_INPUT)

    def write(self, command: Command) -> Question:
        """See `RegisterMap`."""
        return modbus_frames.write(command.address - COMMAND, command.block)

    def probe(self, turn: int) -> Question:
        """See `RegisterMap`: a part of the status."""
        return modbus_frames.read(0, 1 + turn % (_COUNT - 1), modbus_frames.READ_INPUT)

    def variant(self, question: Question) -> Question | None:
        """See `RegisterMap`: Modbus TCP numbers its answers, and needs none."""
        return None

    def aside(self, command: Command) -> Question:
        """See `RegisterMap`."""
        return self.write(command)

    def status(self, question: Question, reply: bytes) -> Status | None:
        """See `RegisterMap`; an acknowledgement and a probe tell none."""
        is_whole = reply[0] == modbus_frames.READ_INPUT and reply[1] == SIZE
        return Status.parse(reply[2:]) if is_whole else None


class UrcapLink:
    """The text server of the URCap: a SET, or a GET for each variable.

    Before anything is sent for the first time it listens: this server says nothing unasked, and a robot whose
    script port was given tells its state at once.

    Nothing is asked twice: TCP loses nothing, and what comes late would be taken for the answer to the next.

    Args:
        transport: to the server.
        clock: monotonic seconds.
    """

    def __init__(self, transport: Transport, clock: Callable[[], float] = time.monotonic) -> None:
        self._transport = transport
        self._clock = clock
        self._is_known = False
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
        if not self._is_known and (said := self._transport.read(self._clock() + LISTEN)):
            self._transport.close()
            raise ConnectionFailed(
                f"it says {said[:20]!r} before it is asked, as the URCap's server does not: nothing was sent",
                where=self.where,
                remedy="Give the port of the URCap's server (63352), not one of the robot's own.",
            )

    def close(self) -> None:
        """See `Link`."""
        self._transport.close()

    def exchange(
        self, command: Command | None, deadline: float, after: After | None = None
    ) -> GripperAnswer | None:
        """See `Link`; a sample is asked for in several calls where the server is slow."""
        while True:
            if not self._asked and self._setting is None:
                self._ask(command if after is None else None)
            until = deadline
            if self._asked and self._answers.ends_lines is not True:
                until = min(deadline, self._clock() + QUIET)
            data = self._transport.read(until)
            try:
                is_answered = self._take(data)
                is_whole = is_answered and not self._names and self._values.keys() >= _ALL
                status = urcap.status_of(self._values) if is_whole else None
            except ValueError as error:
                raise ProtocolError(
                    f"it sent {error}",
                    where=self.where,
                    remedy="Is the Robotiq URCap of this robot installed, and its gripper connected?",
                ) from error
            if status is not None:
                self._is_known = True
                delivered, self._delivered = self._delivered, None
                if after is not None and delivered is not command and after(status):
                    self._ask(command)
                return Answer(status, self._since, delivered)
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
