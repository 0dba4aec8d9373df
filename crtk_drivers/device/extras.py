"""What a device does, takes and tells beyond CRTK, and the procedures that take it time."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from crtk_drivers.commands import Payload
from crtk_drivers.samples import Value

Steps = Generator[None, None, None]
"""A procedure that takes time: the runtime resumes it once a cycle until it returns or raises."""

Answer = Generator[None, None, str]
"""A procedure as `Steps`, which returns what is to be told."""


@dataclass(frozen=True, slots=True)
class Service:
    """Something that a device does when it is asked to, beyond CRTK: taring, clearing a fault, ...

    Attributes:
        summary: one line for people.
        run: begins it, as a procedure of the I/O thread. It may be asked for in any state; what it raises
            of `crtk_drivers.errors` is the answer, and ends nothing else.
        moves: it may set the hardware in motion, or let something go: a stop ends it before the next of its
            steps, and the hardware is stopped then in any state; so it is where it fails on its way.
        stops: it is a stop itself: it takes the place of a service that runs, and is never refused for one.
        undo: ends what it has begun where a stop came in the step in which it ended, and it heard nothing of
            that: of one that moves what `Device.stop` does not end. In the I/O thread, before that.
    """

    summary: str
    run: Callable[[], Answer]
    moves: bool = False
    stops: bool = False
    undo: Callable[[], None] | None = None


@dataclass(frozen=True, slots=True)
class Input:
    """A value that a device takes beyond CRTK: where its sensor points, an output to be set, ...

    Attributes:
        summary: one line for people.
        payload: what it is.
        take: called with each value, from any thread and in any state. It checks, keeps the value, and
            touches no bus; it raises CommandRefused.
        at_rest: it is refused while a motion is carried out: it changes what poses mean.
    """

    summary: str
    payload: Payload
    take: Callable[[Any], None]
    at_rest: bool = False


READINGS = "state"
"""Sub-namespace of a device's own readings: ``state/digital_in_3``."""


@dataclass(frozen=True, slots=True)
class Reading:
    """A value that a device tells beyond CRTK: a digital input, a mode, ...

    Attributes:
        summary: one line for people.
        payload: what it is.
        tell: returns the newest value, None while it is not known. No I/O; from any thread.
        is_bare: it is told without ``state/`` before its name, as others expect it there: pedals.
        repeats: it is told again and again on ROS, so that silence means something.
    """

    summary: str
    payload: Payload
    tell: Callable[[], Value | None]
    is_bare: bool = False
    repeats: bool = False

    def told_as(self, name: str) -> str:
        """Return the name below the device by which it is told."""
        return name if self.is_bare else f"{READINGS}/{name}"


class Severity(IntEnum):
    """How bad it is what a note says."""

    INFO = 0
    WARNING = 1
    ERROR = 2


@dataclass(frozen=True, slots=True)
class Note:
    """What people should know of a device now, in words: ``overload`` "saturated on Fz"."""

    severity: Severity
    key: str
    text: str
