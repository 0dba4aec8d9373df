"""Script text on ports 30001 to 30003: cut out of the byte stream into units that can be run.

A client sends programs (``def ... end``, ``sec ... end``), single statements, and a few plain
commands such as ``stop program``. Nothing marks where a program ends but its own `end`, so the text
is followed as it arrives. Source: UR "Remote Control Via TCP/IP", script manual.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final

MAX_PROGRAM: Final = 1 << 22  # bytes; more without an end is not a program

_UNIT_START: Final = re.compile(rb"[ \t]*(?:def|sec)\b")
_TOKEN: Final = re.compile(
    rb"\"[^\"\n]*\"?|'[^'\n]*'?|#[^\n]*|(?<!\.)\b(?:(def|sec|thread|if|while)|(end))\b"
)


class ScriptCutter:
    """Cuts a byte stream into complete programs and single lines, however it is split."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._scanned = 0  # bytes of the buffer that hold complete lines already followed
        self._searched = 0  # bytes of the buffer after which the next line end is
        self._depth = 0  # open blocks of the program at the start of the buffer
        self.discarded = 0  # bytes given up because no program ended in MAX_PROGRAM

    def feed(self, data: bytes) -> list[str]:
        """Take received bytes and return the units that they complete, in order."""
        self._buffer += data
        units = []
        while (newline := self._buffer.find(b"\n", self._searched)) >= 0:
            line = bytes(self._buffer[self._scanned : newline])
            self._scanned = self._searched = newline + 1
            if self._depth or _UNIT_START.match(line):
                self._depth = max(0, self._depth + _blocks_opened(line))
            if self._depth == 0:
                units += self._cut()
        self._searched = len(self._buffer)
        if len(self._buffer) > MAX_PROGRAM:
            self.discarded += len(self._buffer)
            self._buffer.clear()
            self._scanned = self._searched = self._depth = 0
        return units

    def finish(self) -> list[str]:
        """Return what is left when the client closes: its last line needs no line end."""
        return self.feed(b"\n") if self._buffer else []

    def _cut(self) -> list[str]:
        text = self._buffer[: self._scanned].decode("utf-8", "replace").strip()
        del self._buffer[: self._scanned]
        self._scanned = self._searched = 0
        return [text] if text and not text.startswith("#") else []


def _blocks_opened(line: bytes) -> int:
    """Blocks that a line opens, less those that it ends."""
    opened = 0
    for match in _TOKEN.finditer(line):
        if match.group(1):
            opened += 1
        elif match.group(2):
            opened -= 1
    return opened


class ScriptSession:
    """One client of a script port: bytes in, nothing out; `run` gets every unit."""

    ended = False

    def __init__(self, run: Callable[[str], None]) -> None:
        self._cutter = ScriptCutter()
        self._run = run

    def receive(self, data: bytes) -> bytes:
        """Take received bytes and run the units that they complete."""
        for unit in self._cutter.feed(data):
            self._run(unit)
        return b""

    def close(self) -> None:
        """Run the last line, which needs no line end when the client closes behind it."""
        for unit in self._cutter.finish():
            self._run(unit)
