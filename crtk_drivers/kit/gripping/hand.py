"""What a driver brings of a gripper to `GripperDevice`: what it is told and tells, by its protocol."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, NamedTuple

from crtk_drivers.device import Answer, Capabilities, Condition, Mode, Note, Reading, Steps
from crtk_drivers.errors import CrtkError
from crtk_drivers.kit.gripping.adjustable import Adjustable
from crtk_drivers.kit.gripping.doing import ENDS_WELL, ON_ITS_WAY, Doing, Fault
from crtk_drivers.samples import Stamp

__all__ = ["Hand", "HandService", "Measured", "When"]


class Measured(NamedTuple):
    """What was measured.

    Attributes:
        stamp: not later than that.
        position: of its joint; None: it has none.
        velocity: None: found from positions.
        effort: None: not told.
        is_setpoint: the next stream begins here, wherever a motion of its own has taken it.
    """

    stamp: Stamp
    position: float | None = None
    velocity: float | None = None
    effort: float | None = None
    is_setpoint: bool = False


class When(Enum):
    """In which states a service is carried out; the value is what is told otherwise."""

    ANY = ""
    ENABLED = "it is not enabled"
    NOT_ENABLED = "it is enabled"


@dataclass(frozen=True)
class HandService:
    """Something that it does when it is asked to.

    Attributes:
        summary: for people.
        run: does it.
        when: `ENABLED` for a motion, or letting go; `NOT_ENABLED` for what moves it to make it ready.
        empty: it is refused while something is held.
        moves: fingers may move for it, or let go: a stop ends it.
        stops: it is a stop itself, and takes the place of a service that runs.
    """

    summary: str
    run: Callable[[], Answer]
    when: When = When.ENABLED
    empty: bool = False
    moves: bool = True
    stops: bool = False


class Hand(ABC):
    """One gripper by its protocol. It belongs to the I/O thread, but for `halt`.

    Attributes:
        capabilities: see `Device`.
    """

    capabilities: Capabilities

    @property
    @abstractmethod
    def where(self) -> str:
        """For messages."""

    @property
    def counters(self) -> Mapping[str, float]:
        """What went wrong, counted."""
        return {}

    # --------------------------------------------------------------------------------------- the link

    @property
    @abstractmethod
    def is_open(self) -> bool:
        """Whether it has told its state since `open`."""

    @abstractmethod
    def open(self, deadline: float, given_up: Callable[[], bool]) -> None:
        """Connect, and read once; nothing is written, and what was to be sent is forgotten."""

    @abstractmethod
    def close(self, *, moves: bool) -> None:
        """Disconnect. May be called twice.

        Args:
            moves: it moves, and should not.
        """

    @abstractmethod
    def exchange(self, deadline: float) -> Measured | None:
        """Send what is to be sent, and read; None: not by the deadline."""

    # ---------------------------------------------------------------------------------- what moves it

    @abstractmethod
    def order(self, mode: Mode, value: float, ratio: float) -> Hashable:
        """Return what sends it to a value, with a share of its speed; equal ones are asked for once."""

    @abstractmethod
    def go(self, order: Any, *, at_once: bool) -> None:
        """Send this in place of what has waited; `at_once`: in place of a motion as well."""

    @abstractmethod
    def halt(self, *, aside: bool) -> None:
        """Stop a motion, keep a grip, send nothing that has waited.

        Args:
            aside: this is another thread, and the I/O thread may hang: it is sent at once.
        """

    @abstractmethod
    def let_go(self) -> None:
        """Let go of what it may hold: the last order of a program that ends."""

    @property
    @abstractmethod
    def is_told(self) -> bool:
        """Whether all that was to be sent has been taken by it."""

    @property
    @abstractmethod
    def doing(self) -> Doing:
        """What it does, by what it has told last."""

    @property
    def rests(self) -> bool:
        """Whether nothing moves."""
        return self.doing not in ON_ITS_WAY

    @property
    def has_reached(self) -> bool:
        """Whether it rests as a move wanted it: at its goal, or at what was in its way."""
        return self.doing in ENDS_WELL

    @property
    def disobeys(self) -> bool:
        """Whether it does no more what it was asked for last, which is sent again if it is asked for."""
        return self.taken_over

    @property
    def refusal(self) -> str:
        """Why the last order is not carried out; empty: it is, or may be."""
        return ""

    def check(self, command: str, value: float) -> None:  # noqa: B027 - most have one range
        """Refuse a goal that its fingers cannot have now.

        Raises:
            CommandRefused: with what they can.
        """

    # --------------------------------------------------------------------------------------- its state

    @property
    @abstractmethod
    def fault(self) -> Fault | None:
        """What it reports, if anything."""

    @property
    def taken_over(self) -> bool:
        """Whether another program commands it."""
        return False

    @property
    def is_others(self) -> bool:
        """Whether what it does is another program's for certain, and not a command of ours that came late."""
        return self.taken_over

    @property
    def is_in_doubt(self) -> bool:
        """Whether another program may have just begun to command it: that is known within half a second."""
        return False

    def unfit(self, *, enabled: bool) -> Condition | None:
        """Why it cannot be used, beside faults; None: it can."""
        return None

    def adopt(self) -> None:  # noqa: B027 - most know nothing of others
        """What it does now is as if we had asked for it."""

    def obstacles(self, *, may_hold: bool) -> tuple[CrtkError, ...]:
        """Return what `enable` fails on now, beside faults that stop it; see `Device.obstacles`.

        Args:
            may_hold: it held something when that could be told last; what drops that is refused
                (`not_made_ready`).
        """
        return ()

    def make_ready(self, *, may_hold: bool) -> Steps:
        """Make the gripper ready for motions, as a part of `enable`.

        `enable` has asked for `obstacles` before, and there were none.

        Args:
            may_hold: as for `obstacles`. A gripper that must acknowledge a fault first knows only after that
                what else it needs. It refuses here what would drop something (`not_made_ready`).
        """
        yield from ()

    def sort_out(self) -> Steps:
        """What remains of `enable` when it rests."""
        yield from ()

    # ------------------------------------------------------------------------------------ beyond CRTK

    @property
    def services(self) -> Mapping[str, HandService]:
        """What it does beyond CRTK."""
        return {}

    @property
    def adjustables(self) -> tuple[Adjustable, ...]:
        """Numbers that a user may change."""
        return ()

    @property
    def readings(self) -> Mapping[str, Reading]:
        """What it tells beside ``holds``, ``grip`` and ``fault``."""
        return {}

    @property
    def notes(self) -> tuple[Note, ...]:
        """What people should know, beside what was lost and faults that pass."""
        return ()
