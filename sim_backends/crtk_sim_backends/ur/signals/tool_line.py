"""The serial line to the tool: its settings, and when bytes cross it. Pure: no port, no clock.

Source: URScript manual, `set_tool_communication`. The line is RS-485, half duplex: one direction at a
time. A character is a start bit, eight data bits, perhaps a parity bit, and the stop bits.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

BAUD_RATES: Final = (9600, 19200, 38400, 57600, 115200, 1_000_000, 2_000_000, 5_000_000)
PARITIES: Final = ("none", "odd", "even")
_BACKLOG: Final = 1 << 16  # bytes that wait for the line in one direction; what comes then is lost
_LONGEST_MESSAGE: Final = 1024  # bytes of the tool that are sent on without a pause behind them


@dataclass(frozen=True, slots=True, kw_only=True)
class LineSettings:
    """Settings of the line.

    Attributes:
        enabled: whether the line is there at all.
        baud: bits a second, one of `BAUD_RATES`.
        parity: index in `PARITIES`.
        stop_bits: 1 or 2.
        rx_idle: silence that ends a message of the tool, characters.
        tx_idle: silence before a message to the tool, characters.
    """

    enabled: bool = False
    baud: int = 115200
    parity: int = 0
    stop_bits: int = 1
    rx_idle: float = 1.5
    tx_idle: float = 3.5

    @property
    def character(self) -> float:
        """Seconds that a character takes."""
        return (9 + bool(self.parity) + self.stop_bits) / self.baud


@dataclass
class _Burst:
    """Bytes that follow each other on the line without a pause."""

    to_tool: bool
    start: float
    data: bytes
    passed: int = 0


class ToolLine:
    """Moves bytes at the pace of the line. Times are those of the controller, s."""

    def __init__(self, settings: LineSettings) -> None:
        self.settings = settings
        self._bursts: deque[_Burst] = deque()
        self._waiting = 0  # bytes in the bursts
        self._free = 0.0  # when the line falls silent
        self._now = 0.0
        self._message = bytearray()  # of the tool, not complete yet
        self._message_end = 0.0

    def put(self, data: bytes, *, to_tool: bool) -> None:
        """Have `data` follow what is on the line or waits for it."""
        data = data[: _BACKLOG - self._waiting]
        if not data:
            return
        character = self.settings.character
        start = max(self._now, self._free)
        if to_tool:
            start = max(start, self._free + self.settings.tx_idle * character)
        self._bursts.append(_Burst(to_tool, start, data))
        self._waiting += len(data)
        self._free = start + len(data) * character

    def advance(self, now: float) -> tuple[bytes, bytes]:
        """Let time pass; what has reached the tool, and the tool's messages for the client."""
        self._now = now
        character = self.settings.character
        to_tool = bytearray()
        while self._bursts and self._bursts[0].start <= now:
            burst = self._bursts[0]
            end = min(len(burst.data), int((now - burst.start) / character + 1e-6))
            piece = burst.data[burst.passed : end]
            burst.passed = end
            self._waiting -= len(piece)
            if burst.to_tool:
                to_tool += piece
            elif piece:
                self._message += piece
                self._message_end = burst.start + end * character
            if end < len(burst.data):
                break
            self._bursts.popleft()
        return bytes(to_tool), self._complete(now)

    def _complete(self, now: float) -> bytes:
        """The tool's message, when silence shows that it is complete."""
        silence = now - self._message_end + 1e-9
        over = silence >= self.settings.rx_idle * self.settings.character
        if not (over or len(self._message) >= _LONGEST_MESSAGE):
            return b""
        message, self._message = bytes(self._message), bytearray()
        return message
