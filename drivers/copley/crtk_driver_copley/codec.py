"""Commands to drives, and their answers, as lines of text that end with a carriage return.

``2 .B g r0x32`` asks axis B of node 2 for parameter 0x32 in RAM. Answers are ``ok``, ``v`` and values, ``r``
and a register, ``e`` and the code of an error; they say neither who answers nor to what. No I/O.

Source: ASCII Programmer's Guide (16-01196), chapters 1 and 2.
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple

__all__ = [
    "END",
    "LONGEST",
    "Reply",
    "abort",
    "address",
    "get",
    "home",
    "is_question",
    "parse",
    "put",
    "update",
]

END: Final = b"\r"
LONGEST: Final = 120
"""Bytes of an answer; those that are asked for here have less than 40."""

_NUMBERS: Final = re.compile(r"([verVER])((?: -?[0-9]{1,11})+) ?")


class Reply(NamedTuple):
    """One line of a drive.

    Attributes:
        kind: ``ok``, ``v``, ``r`` or ``e``; empty: it is none of these.
        values: its numbers.
        text: the line.
    """

    kind: str
    values: tuple[int, ...]
    text: str

    @property
    def error(self) -> int:
        """The code of an error; 0: it is none."""
        return self.values[0] if self.kind == "e" else 0


def parse(line: str) -> Reply:
    """Return what a line without its end says. What is no answer is a reply without a kind."""
    text = line.strip("\n\0 ")
    if text == "ok":
        return Reply("ok", (), text)
    found = _NUMBERS.fullmatch(text)
    if found is None:
        return Reply("", (), text)
    return Reply(found[1].lower(), tuple(int(part) for part in found[2].split()), text)


def address(node: int, axis: str | None) -> str:
    """Return what a command begins with.

    Args:
        node: 0: the drive at the serial line; others are behind it.
        axis: letter of an axis of a drive with several; None: it has one.
    """
    return (f"{node} " if node else "") + (f".{axis} " if axis else "")


def get(to: str, parameter: int) -> str:
    """Return the command that asks for a parameter in RAM; `to` is an `address`."""
    return f"{to}g r0x{parameter:02x}"


def is_question(command: str) -> bool:
    """Whether a command asks for a parameter: its answer is ``v``, that to others ``ok``."""
    return "g r" in command


def put(to: str, parameter: int, *values: int) -> str:
    """Return the command that sets a parameter in RAM."""
    return f"{to}s r0x{parameter:02x} {' '.join(map(str, values))}"


def update(to: str) -> str:
    """Return the command that begins a motion, or gives it a new goal."""
    return f"{to}t 1"


def abort(to: str) -> str:
    """Return the command that ends a motion with the abort deceleration; the axis keeps its power."""
    return f"{to}t 0"


def home(to: str) -> str:
    """Return the command that begins homing."""
    return f"{to}t 2"
