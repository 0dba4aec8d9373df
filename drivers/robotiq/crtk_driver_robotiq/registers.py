"""The register map: what is written from register 1000 on, what is read from 2000 on. Pure: no I/O.

Source: instruction manual of 2F-85/2F-140, 4.4 to 4.6; Robotiq/grippers docs/03 and docs/04.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

__all__ = ["COMMAND", "COUNTS", "SIZE", "STATUS", "Activation", "Command", "Contact", "Status"]

COMMAND: Final = 1000
STATUS: Final = 2000
"""First registers of both blocks, which have three each."""
SIZE: Final = 6
"""Bytes of a block."""
COUNTS: Final = 255
"""The greatest position, speed and force."""

_NEAR: Final = 2
"""Counts by which fingers may miss what was asked for, away from the ends of their way."""
_ACT: Final = 0x01
_GTO: Final = 0x08


class Activation(IntEnum):
    """GSTA: how far the activation is."""

    RESET = 0
    RUNNING = 1
    NOT_USED = 2
    DONE = 3


class Contact(IntEnum):
    """GOBJ: what the fingers have met. It counts while gGTO is set, after the echo of the request only."""

    MOVING = 0
    WHILE_OPENING = 1
    WHILE_CLOSING = 2
    AT_REQUEST = 3


@dataclass(frozen=True, slots=True)
class Command:
    """What is written. Automatic release (rATR) is never sent: its direction differs between manuals.

    Attributes:
        activate: rACT; a change from false to true activates, which opens and closes the fingers fully.
        go: rGTO: go to the position; without it the fingers stop.
        position, speed, force: 0 to 255; position 0 is open.
        only_goal: rACT and rGTO are left as they are, and not written: a gripper that somebody has reset
            meanwhile is not activated by it.
        halts: it ends a motion (rGTO), and should activate nothing; in Modbus rACT is beside rGTO.
    """

    activate: bool = True
    go: bool = False
    position: int = 0
    speed: int = 0
    force: int = 0
    only_goal: bool = False
    halts: bool = False

    @property
    def address(self) -> int:
        """The first register that is written."""
        return COMMAND + self.only_goal

    @property
    def block(self) -> bytes:
        """The bytes from that on, high byte first."""
        action = _ACT * self.activate | _GTO * self.go
        block = bytes((action, 0, 0, self.position, self.speed, self.force))
        return block[2 * self.only_goal :]


@dataclass(frozen=True, slots=True)
class Status:
    """What is read.

    Attributes:
        activated, goes: gACT, gGTO: what was asked for last.
        activation, contact: gSTA, gOBJ.
        fault, controller_fault: gFLT, kFLT; see `crtk_driver_robotiq.faults`.
        requested: gPR, the echo of the position that was asked for last.
        position: gPO; 0 is open.
        current: of the motor, in A; None where it is not told (URCap).
    """

    activated: bool
    goes: bool
    activation: Activation
    contact: Contact
    fault: int
    controller_fault: int
    requested: int
    position: int
    current: float | None

    @property
    def ends_as_requested(self) -> bool:
        """Whether the fingers are where gOBJ says that they have ended the way to what is echoed.

        If not, it may be that of the way before: it comes later than the echo.
        """
        left = self.requested - self.position
        return {
            Contact.MOVING: False,
            Contact.WHILE_OPENING: left <= 0,
            Contact.WHILE_CLOSING: left >= 0,
            Contact.AT_REQUEST: abs(left) <= _NEAR,
        }[self.contact]

    def ahead(self, counts: int) -> int:
        """Return the position so many counts ahead on the way, but not beyond what was asked for."""
        if self.requested > self.position:
            return min(self.position + counts, self.requested)
        return max(self.position - counts, self.requested)

    @classmethod
    def parse(cls, block: bytes) -> Status:
        """Return what six bytes from register 2000 on say.

        Raises:
            ValueError: they are not six.
        """
        status, _, fault, requested, position, current = block
        return cls(
            activated=bool(status & _ACT),
            goes=bool(status & _GTO),
            activation=Activation(status >> 4 & 3),
            contact=Contact(status >> 6),
            fault=fault & 0xF,
            controller_fault=fault >> 4,
            requested=requested,
            position=position,
            current=0.01 * current,
        )
