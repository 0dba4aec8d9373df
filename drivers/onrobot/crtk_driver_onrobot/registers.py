"""What is asked of a tool and what its registers say, by the tables of `models`. Pure: no I/O."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from crtk_driver_onrobot.models import IDENTITY, MODELS, Fingers, Span, Spot, Vacuum
from crtk_drivers.kit import modbus_frames
from crtk_drivers.kit.modbus_frames import Question

__all__ = ["Command", "Identity", "Registers", "Status", "order", "stop_order"]

LOOK: Final = 1.0
"""Seconds after which it is looked who is there, and with which range."""
_NAMES: Final = {model.code: model.title for model in MODELS.values()}


@dataclass(frozen=True, eq=False, slots=True)
class Command:
    """Bytes for registers. Two are never the same, whatever is in them.

    Attributes:
        address, block: of the first register, and the bytes, high byte first.
        opening: to which it is sent, in m; None: it stops.
    """

    address: int
    block: bytes
    opening: float | None = None


def order(tool: Fingers, opening: float, force: float, speed: float) -> Command:
    """Return what sends the fingers to an opening (m), with a force (N) and a share of the speed."""
    values = {"opening": opening, "force": force, "speed": speed}
    counts = [
        part if isinstance(part, int) else round(values[part[0]] / part[1]) for part in tool.command
    ]
    return Command(0, struct.pack(f">{len(counts)}H", *counts), opening)


def stop_order(tool: Fingers) -> Command:
    """Return what stops the fingers."""
    return Command(len(tool.command) - 1, tool.stop.to_bytes(2, "big"))


@dataclass(frozen=True, slots=True)
class Identity:
    """Which tool is there."""

    code: int
    firmware: str
    serial: str

    @classmethod
    def parse(cls, data: bytes) -> Identity:
        """Return what the registers `IDENTITY` say."""
        major, minor, build = data[8], data[9], int.from_bytes(data[10:12], "big")
        serial = data[18:].split(b"\0")[0].decode("ascii", "replace").strip()
        return cls(int.from_bytes(data[:2], "big"), f"{major}.{minor}.{build}", serial)

    @property
    def title(self) -> str:
        """For people."""
        name = _NAMES.get(self.code, f"tool with product code {self.code:#04x}")
        return f"{name} {self.serial}".strip()


@dataclass(frozen=True, slots=True)
class Status:
    """What was read.

    Attributes:
        identity: of the tool.
        words: registers by address, those of the range too.
    """

    identity: Identity
    words: Mapping[int, int]

    def value(self, spot: Spot) -> float:
        """Return a value in SI units."""
        word = self.words[spot.address]
        return spot.unit * (word - 0x10000 if spot.signed and word & 0x8000 else word)


class Registers:
    """The `RegisterMap` of a tool.

    Args:
        tool: that should be there.
        clock: monotonic seconds.
    """

    silent = (
        "Is it powered, and are wiring, baud rate (1 000 000, 8E1) and address (65) right? host is the "
        "Compute Box, not the robot. The OnRobot URCap, where it is installed, owns the tool line: remove it."
    )
    other = (
        "Is a gripper mounted, and is it at this address (65; 66: second side of a dual changer)?"
    )

    def __init__(self, tool: Fingers | Vacuum, clock: Callable[[], float] = time.monotonic) -> None:
        self._tool = tool
        self._clock = clock
        self.begin()

    def begin(self) -> None:
        """A connection begins: nothing is known."""
        self._identity: Identity | None = None
        self._details: Mapping[int, int] | None = None
        self._looked = -LOOK

    def read(self) -> Question:
        """See `RegisterMap`: who is there and its range, now and then, and otherwise the status."""
        if self._identity is None or self._clock() - self._looked > LOOK:
            return modbus_frames.read(*IDENTITY)
        if self._details is None:
            return modbus_frames.read(*self._tool.details)
        return modbus_frames.read(*self._tool.status)

    def write(self, command: Command) -> Question:
        """See `RegisterMap`."""
        return modbus_frames.write(command.address, command.block)

    aside = write

    def probe(self, turn: int) -> Question:
        """See `RegisterMap`: the beginning of the identity, which has more registers than a status."""
        return modbus_frames.read(IDENTITY.address, IDENTITY.size - 1 - turn % 12)

    def variant(self, question: Question) -> Question | None:
        """See `RegisterMap`: other registers that have the same in them."""
        is_status = question == modbus_frames.read(*self._tool.status)
        return modbus_frames.read(*self._tool.other) if is_status and self._tool.other else None

    def status(self, question: Question, reply: bytes) -> Status | None:
        """See `RegisterMap`."""
        if reply[0] == modbus_frames.WRITE:
            return None
        address, count = struct.unpack(">HH", question.request[1:])
        data = reply[2:]
        words = dict(enumerate(struct.unpack(f">{count}H", data), address))
        asked = Span(address, count)
        if asked == IDENTITY:
            self._identity, self._looked = Identity.parse(data), self._clock()
            self._details = None
        elif asked == self._tool.details:
            self._details = words
        elif asked in (self._tool.status, self._tool.other) and self._identity is not None:
            return Status(self._identity, {**(self._details or {}), **words})
        return None
