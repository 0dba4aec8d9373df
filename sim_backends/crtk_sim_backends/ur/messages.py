"""Messages that the controller sends to its primary clients, as plain values.

Numbering and meaning: Universal Robots client interface, message types 0 (text), 5 (safety mode),
6 (robot comm), 7 (key) and 10 (runtime exception). The bytes are built in `primary`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class ReportLevel(IntEnum):
    """Severity of an `ErrorMessage`, with the numbers of the primary interface."""

    DEBUG = 0
    INFO = 1
    WARNING = 2
    VIOLATION = 3
    FAULT = 4
    CRITICAL = 5


@dataclass(frozen=True)
class TextMessage:
    """Text that a program wrote with `textmsg`."""

    text: str


@dataclass(frozen=True)
class KeyMessage:
    """A program started or stopped: `title` is PROGRAM_XXX_STARTED or PROGRAM_XXX_STOPPED."""

    title: str
    text: str


@dataclass(frozen=True)
class ErrorMessage:
    """An entry of the error log, shown on the panel as C<code>A<argument>."""

    code: int
    argument: int
    level: ReportLevel
    text: str


@dataclass(frozen=True)
class RuntimeExceptionMessage:
    """A program could not be compiled or stopped with an error at `line` and `column`."""

    line: int
    column: int
    text: str


@dataclass(frozen=True)
class SafetyModeMessage:
    """The safety mode changed; `mode` is a `safety.SafetyMode` number."""

    mode: int


@dataclass(frozen=True)
class PopupMessage:
    """A program opened a pop-up on the panel."""

    title: str
    text: str
    warning: bool = False
    error: bool = False
    blocking: bool = False


Message = (
    TextMessage
    | KeyMessage
    | ErrorMessage
    | RuntimeExceptionMessage
    | SafetyModeMessage
    | PopupMessage
)
