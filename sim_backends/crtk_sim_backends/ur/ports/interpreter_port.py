"""TCP port 30020, where clients send statements to a program in interpreter mode.

One line is one or several complete statements, ended by a newline, and is answered by one line: `ack:
<id>: <statements>`, `discard: <reason>: <statements>`, or for a question `state: <number>:
<question>` (script manual, "Interpreter Mode"). An answer may come later than those to lines after it:
that to a line which waits to be interpreted.
"""

from __future__ import annotations

from typing import Final

from crtk_sim_backends.ur.program.interpreter import Interpreter

LINE_LIMIT: Final = 1 << 16  # bytes; a longer line is discarded
TOO_LONG: Final = "Line too long"

_QUOTED: Final = 100  # bytes of a line that is too long


class InterpreterSession:
    """One client of the port."""

    ended = False

    def __init__(self, interpreter: Interpreter) -> None:
        self._interpreter = interpreter
        self._buffer = bytearray()  # the beginning of a line
        self._too_long = False  # whether the rest of the line is dropped
        self._unanswered = 0  # lines
        self._replies: list[str] = []

    @property
    def waiting(self) -> bool:
        """Whether an answer is there, or due later."""
        return self._unanswered > 0 or bool(self._replies)

    def receive(self, data: bytes) -> bytes:
        """Take received bytes, or none, and return the answers that are there."""
        searched = len(self._buffer)
        self._buffer += data
        while (newline := self._buffer.find(b"\n", searched)) >= 0:
            self._take(bytes(self._buffer[:newline]))
            del self._buffer[: newline + 1]
            searched = 0
        if len(self._buffer) > LINE_LIMIT:
            self._refuse(bytes(self._buffer[:_QUOTED]))
            self._buffer.clear()
            self._too_long = True
        self._interpreter.interpret()
        replies, self._replies = self._replies, []
        return "".join(f"{reply}\n" for reply in replies).encode()

    def close(self) -> None:
        """Do nothing: what was accepted is executed."""

    def _take(self, line: bytes) -> None:
        if self._too_long:
            self._too_long = False
        elif len(line) > LINE_LIMIT:
            self._refuse(line[:_QUOTED])
        else:
            self._unanswered += 1
            self._interpreter.receive(line.decode("utf-8", "replace").strip(), self._answer)

    def _refuse(self, beginning: bytes) -> None:
        if not self._too_long:
            self._replies.append(f"discard: {TOO_LONG}: {beginning.decode('utf-8', 'replace')}")

    def _answer(self, reply: str) -> None:
        self._unanswered -= 1
        self._replies.append(reply)
