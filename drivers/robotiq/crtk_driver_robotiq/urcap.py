"""The text protocol of the URCap's server on the robot, port 63352: values in, bytes out, and back. No I/O.

Sources: the URCap's URScript preamble (``rq_*``), fzi robotiq_2f_urcap_adapter. What it answers to mistakes
is not documented: whatever is not expected is an error.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

from crtk_driver_robotiq.registers import COUNTS, Activation, Command, Contact, Status

__all__ = ["ACK", "EACH", "HALT", "IN_TURN", "Answers", "get_line", "set_line", "status_of"]

ACK: Final = b"ack"
"""What a SET is answered with; no end of line follows."""

LONGEST: Final = 64
"""Bytes of an answer; more without an end is none."""

HALT: Final = b"SET GTO 0\n"
"""Stops the fingers, and activates nothing."""

EACH: Final = ("GTO", "PRE", "OBJ", "POS")
"""What is asked for each sample, in this order: OBJ counts after the echo (PRE) only."""
IN_TURN: Final = ("STA", "FLT", "ACT")
"""What changes seldom."""

_VALUE: Final = re.compile(rb"([A-Z]{3}) (\d{1,3})\r?\n?")


def set_line(command: Command) -> bytes:
    """Return the line that sends a command, all of it at once; a motion leaves ACT as it is."""
    if command.halts:
        return HALT
    if not command.activate:
        return b"SET ACT 0 GTO 0\n"
    if not command.go:
        return b"SET ACT 1 GTO 0\n"
    go = "" if command.only_goal else " GTO 1"
    return f"SET POS {command.position} SPE {command.speed} FOR {command.force}{go}\n".encode()


def get_line(name: str) -> bytes:
    """Return the line that asks for a variable."""
    return f"GET {name}\n".encode()


def status_of(values: Mapping[str, int]) -> Status:
    """Return what the variables of `EACH` and `IN_TURN` say.

    Raises:
        KeyError, ValueError: one is missing, or has no such value.
    """
    return Status(
        activated=bool(values["ACT"]),
        goes=bool(values["GTO"]),
        activation=Activation(values["STA"]),
        contact=Contact(values["OBJ"]),
        fault=values["FLT"],
        controller_fault=0,
        requested=values["PRE"],
        position=values["POS"],
        current=None,
    )


class Answers:
    """Cuts what the server sends. Where an answer ends it says by an end of line, or, in some versions, not.

    Attributes:
        ends_lines: whether it does; None while that is not known.
    """

    def __init__(self) -> None:
        self.ends_lines: bool | None = None
        self._rest = b""
        self._skip = 0

    def skip_ack(self) -> None:
        """An acknowledgement comes that nobody waits for."""
        self._skip += 1

    def ack(self, data: bytes) -> bool:
        """Take bytes; return whether an acknowledgement is there.

        Raises:
            ValueError: something else is.
        """
        self._take(data)
        if self._rest.startswith(ACK):
            self._rest = self._rest[len(ACK) :].lstrip(b"\r\n")
            return True
        if not ACK.startswith(self._rest):
            raise ValueError(f"{self._rest[:40]!r} instead of {ACK!r}")
        return False

    def value(self, name: str, data: bytes, *, quiet: bool = False) -> int | None:
        """Take bytes; return the variable that was asked for once its answer is whole.

        Args:
            name: of the variable.
            data: that has come.
            quiet: nothing came for a while: a server that ends no lines has said all.

        Raises:
            ValueError: it is something else.
        """
        self._take(data)
        if len(self._rest) > LONGEST:
            raise ValueError(f"{self._rest[:40]!r}, and goes on")
        is_whole = self._rest.endswith(b"\n")
        if not is_whole and (not quiet or not self._rest or self.ends_lines):
            return None
        match = _VALUE.fullmatch(self._rest)
        if match is None or match[1] != name.encode() or int(match[2]) > COUNTS:
            raise ValueError(f"{self._rest[:40]!r} instead of {name} and a number")
        self.ends_lines, self._rest = is_whole, b""
        return int(match[2])

    def _take(self, data: bytes) -> None:
        self._rest += data
        while self._skip and self._rest.startswith(ACK):
            self._rest = self._rest[len(ACK) :].lstrip(b"\r\n")
            self._skip -= 1
