"""The register map of the vacuum gripper: what is written from register 1000 on, and read from 2000 on. Pure.

Pressures are absolute there, in kPa of 100 that surround it. Source: ePick instruction manual, 4.4 to 4.6;
PickNikRobotics/ros2_epick_gripper, default_driver.cpp.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from crtk_drivers.kit import modbus_frames
from crtk_drivers.kit.modbus_frames import Question

__all__ = [
    "LONGEST",
    "RELEASE",
    "SURROUNDING",
    "Command",
    "Detected",
    "EpickRegisters",
    "Status",
    "Valve",
    "level",
]

COMMAND: Final = 1000
STATUS: Final = 2000
"""First registers of both blocks."""
COUNT: Final = 3
"""Registers of each."""

SURROUNDING: Final = 100
"""Of the air, as the gripper counts it: kPa."""
RELEASE: Final = 255
"""Pressure that is asked for to let go."""
LONGEST: Final = 25.5
"""Seconds: the longest time-out."""

_ACT: Final = 0x01
_ADVANCED: Final = 0x02
_GTO: Final = 0x08


class Detected(IntEnum):
    """GOBJ: what is known of an object."""

    UNKNOWN = 0
    """It still regulates."""
    AT_MINIMUM = 1
    """There is one, at the least vacuum that was asked for."""
    AT_MAXIMUM = 2
    """There is one, at the greatest."""
    NONE = 3
    """It is lost, was dropped, or none was found in time."""


class Valve(IntEnum):
    """GVAS: what pump and valve do."""

    STANDBY = 0
    GRIPS = 1
    PASSIVE_RELEASE = 2
    ACTIVE_RELEASE = 3


def level(vacuum: float) -> int:
    """Return the pressure in kPa that is sent for a vacuum in Pa below the surroundings."""
    return min(max(SURROUNDING - round(1e-3 * vacuum), 0), SURROUNDING)


@dataclass(frozen=True, slots=True)
class Command:
    """What is written.

    Attributes:
        activate: rACT.
        advanced: rMOD: by the pressures that are sent, not by its own judgement.
        go: rGTO: regulate; without it the pump stands.
        pressure: to be reached, kPa absolute; `RELEASE` lets go.
        timeout: after which it gives up, in tenths of a second.
        minimum: pressure at which an object counts as gripped, and below which it must stay, kPa absolute.
        only_goal: rACT, rMOD and rGTO are left as they are, and not written: one that somebody has reset
            meanwhile is not activated by it.
    """

    activate: bool = True
    advanced: bool = False
    go: bool = False
    pressure: int = 0
    timeout: int = 0
    minimum: int = 0
    only_goal: bool = False

    @property
    def address(self) -> int:
        """The first register that is written."""
        return COMMAND + self.only_goal

    @property
    def block(self) -> bytes:
        """The bytes from that on, high byte first."""
        action = _ACT * self.activate | _ADVANCED * self.advanced | _GTO * self.go
        block = bytes((action, 0, 0, self.pressure, self.timeout, self.minimum))
        return block[2 * self.only_goal :]


@dataclass(frozen=True, slots=True)
class Status:
    """What is read.

    Attributes:
        activated, advanced, goes: gACT, gMOD, gGTO: what was asked for last.
        ready: gSTA: it is activated and works.
        detected, valve: gOBJ, gVAS.
        fault: gFLT; see `crtk_driver_robotiq.epick.faults`.
        requested: the pressure that was asked for last, kPa absolute.
        pressure: that is measured, kPa absolute.
    """

    activated: bool
    advanced: bool
    goes: bool
    ready: bool
    detected: Detected
    valve: Valve
    fault: int
    requested: int
    pressure: int

    @classmethod
    def parse(cls, block: bytes) -> Status:
        """Return what six bytes from register 2000 on say.

        Raises:
            ValueError: they are not six.
        """
        status, valve, fault, requested, pressure, _ = block
        return cls(
            activated=bool(status & _ACT),
            advanced=bool(status & _ADVANCED),
            goes=bool(status & _GTO),
            ready=status >> 4 & 3 == 3,
            detected=Detected(status >> 6),
            valve=Valve(valve & 3),
            fault=fault & 0xF,
            requested=requested,
            pressure=pressure,
        )

    @property
    def vacuum(self) -> float:
        """Below the surroundings, in Pa; 0 at a pressure above."""
        return 1e3 * max(SURROUNDING - self.pressure, 0)


_PROBES: Final = (
    *((modbus_frames.READ_INPUT, count) for count in range(1, COUNT)),
    *((modbus_frames.READ, count) for count in range(1, COUNT)),
)


class EpickRegisters:
    """What it is asked in Modbus: a command by function 16, then the status by 3."""

    silent = (
        "Is it powered (24 V; on a robot's tool: its voltage), and are wiring, baud rate and address "
        "right?"
    )
    other = "Is it an ePick, and no gripper with fingers or force sensor?"

    def read(self) -> Question:
        """See `RegisterMap`."""
        return modbus_frames.read(STATUS, COUNT)

    def write(self, command: Command) -> Question:
        """See `RegisterMap`."""
        return modbus_frames.write(command.address, command.block)

    def probe(self, turn: int) -> Question:
        """See `RegisterMap`: a part of the status."""
        function, count = _PROBES[turn % len(_PROBES)]
        return modbus_frames.read(STATUS, count, function)

    def variant(self, question: Question) -> Question:
        """See `RegisterMap`: the function for input registers."""
        return modbus_frames.read(STATUS, COUNT, modbus_frames.READ_INPUT)

    def aside(self, command: Command) -> Question:
        """See `RegisterMap`."""
        return self.write(command)

    def status(self, question: Question, reply: bytes) -> Status | None:
        """See `RegisterMap`; None: the command was acknowledged, or it was a probe."""
        is_status = reply[0] != modbus_frames.WRITE and reply[1] // 2 == COUNT
        return Status.parse(reply[2:]) if is_status else None
