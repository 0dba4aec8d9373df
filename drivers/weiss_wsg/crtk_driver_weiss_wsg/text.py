"""The Gripper Control Language, its text mode: lines to messages and back. Pure: no I/O.

Source: GCL Reference Manual, firmware 4.0.0, 2. It tells the system state by single flags, which are asked
for in turn; firmware that does not know them counts as referenced until it refuses a motion for that.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

from crtk_driver_weiss_wsg.tables import (
    BUSY,
    MOTIONS,
    STATES,
    Command,
    Flag,
    Grasping,
    Message,
    Status,
)

__all__ = ["TextCodec"]


class _Line(NamedTuple):
    """Name of a command, and which of the values of `Command` it takes, in its order: index and scale."""

    name: str
    takes: tuple[tuple[int, float], ...] = ()


_MM: Final = 1e3
LINES: Mapping[Command, _Line] = MappingProxyType(
    {
        Command.GOODBYE: _Line("BYE"),
        Command.HOME: _Line("HOME", ((0, 1.0),)),
        Command.MOVE: _Line("MOVE", ((0, _MM), (1, _MM))),
        Command.STOP: _Line("STOP"),
        Command.FAST_STOP: _Line("FASTSTOP"),
        Command.ACKNOWLEDGE: _Line("FSACK"),
        Command.GRASP: _Line("GRIP", ((2, 1.0), (0, _MM), (1, _MM))),
        Command.RELEASE: _Line("RELEASE", ((2, _MM), (1, _MM))),  # a distance, not a width
    }
)
VALUES: Mapping[str, tuple[Command, float]] = MappingProxyType(
    {
        "GRIPSTATE": (Command.GRASPING, 1.0),
        "SPEED": (Command.SPEED, _MM),
        "FORCE": (Command.FORCE, 1.0),
        "POS": (Command.WIDTH, _MM),
    }
)
FLAGS: Final = tuple(
    flag
    for seldom in (Flag.TEMPERATURE, Flag.POWER, Flag.CURRENT, Flag.FINGER, Flag.WARM)
    for flag in (Flag.REFERENCED, Flag.FAST_STOP, seldom)
)
"""What is asked for, in this order, again and again."""
LONGEST: Final = 200
_NAMED: Mapping[str, Command] = MappingProxyType({line.name: key for key, line in LINES.items()})
_ANSWER: Final = re.compile(r"(ACK|FIN|ERR) (\w+)\S*(?: (\d+)\b.*)?")
_VALUE: Final = re.compile(r"@?(\w+)(?:\[(\d+)\])?=([-+.\w]+)")
_ENDS: Final = {"ACK": Status.PENDING, "FIN": Status.OK}


class TextCodec:
    """One connection.

    Attributes:
        strange: bytes of lines that nobody knows.
    """

    def __init__(self) -> None:
        self.strange = 0
        self._rest = b""
        self._flags = Flag.REFERENCED  # as they are told
        self._tells_stops = False
        self._grasping = Grasping.IDLE
        self._turn = 0

    def encode(self, command: Command, *values: float) -> bytes:
        """Return the line of a command with values in SI units; nothing if there is none in this mode."""
        line = LINES.get(command)
        if line is None:
            return b""
        given = ",".join(f"{scale * values[at]:.6g}" for at, scale in line.takes)
        return f"{line.name}({given})\n".encode()

    def subscribe(self, period: float) -> bytes:
        """Return what asks for all that changes, every `period` seconds, the width last."""
        lines = (f'AUTOSEND("{name}",{round(1e3 * period)})\n' for name in VALUES)
        return self.ask() + self.ask() + "".join(("VERBOSE=0\n", *lines)).encode()

    def ask(self) -> bytes:
        """Return what asks for the next of the flags."""
        flag = FLAGS[self._turn % len(FLAGS)]
        self._turn += 1
        return f"SYSFLAGS[{flag.bit_length() - 1}]?\n".encode()

    def feed(self, data: bytes) -> list[Message]:
        """Return the messages of the lines that bytes complete; what is none is left out, and counted."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > LONGEST:
            self.strange += len(self._rest)
            self._rest = b""
        found: list[Message] = []
        for line in lines:
            messages = self._parse(line.decode("ascii", "replace").strip())
            self.strange += 0 if messages is not None else len(line)
            found += messages or []
        return found

    def _parse(self, line: str) -> list[Message] | None:
        """Return what a line says; None: it is not of this protocol."""
        if match := _ANSWER.fullmatch(line):
            return self._answer(match[1], match[2], match[3])
        if match := _VALUE.fullmatch(line):
            return self._value(match[1], match[2], match[3])
        return [] if not line else None

    def _answer(self, kind: str, name: str, code: str | None) -> list[Message]:
        command = _NAMED.get(name)
        status = int(code or Status.FAILED) if kind == "ERR" else _ENDS[kind]
        if command not in MOTIONS and kind == "ACK":
            status = Status.OK
        if status == Status.NOT_REFERENCED:
            self._flags &= ~Flag.REFERENCED
        elif (command, status) == (Command.HOME, Status.OK):
            self._flags |= Flag.REFERENCED
        return [] if command is None else [Message(command, status)]

    def _value(self, name: str, index: str | None, text: str) -> list[Message] | None:
        try:
            number = float(text)
        except ValueError:
            return [] if name == "VERBOSE" else None
        if name == "SYSFLAGS" and index is not None:
            flag = Flag(1 << min(int(index), 31))
            self._tells_stops |= flag is Flag.FAST_STOP
            self._flags = self._flags | flag if number else self._flags & ~flag
            return [self._system]
        if name not in VALUES:
            return []
        command, scale = VALUES[name]
        messages = [Message(command, Status.OK, (number / scale,))]
        if command is Command.GRASPING and number in STATES:
            self._grasping = Grasping(int(number))
            messages.append(self._system)
        return messages

    @property
    def _system(self) -> Message:
        """The system state, as far as it follows from the flags that were told and the grasping state."""
        moves = Flag.MOVING if self._grasping in BUSY else Flag(0)
        is_error = self._grasping is Grasping.ERROR and not self._tells_stops
        stopped = Flag.FAST_STOP if is_error else Flag(0)
        return Message(Command.SYSTEM, Status.OK, (float(self._flags | moves | stopped),))
