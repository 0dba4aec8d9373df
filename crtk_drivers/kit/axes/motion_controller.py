"""What a driver brings of a controller, or of the drives at one line, to `AxesDevice`: its protocol."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import NamedTuple

from crtk_drivers.device import Capabilities, Note, Steps
from crtk_drivers.kit.axes.counting import Counting
from crtk_drivers.samples import Stamp

__all__ = ["AxisTold", "Complaint", "Counted", "Heard", "MotionController", "Words"]


class AxisTold(NamedTuple):
    """What one axis has told last.

    Attributes:
        name: of its joint.
        has_power: its motor can hold it.
        is_off: it was switched off, which is more than to be without power.
        is_moving: it carries out a motion, of whomever.
        limit: at which limit it is, in words for people; empty: at none.
    """

    name: str
    has_power: bool
    is_off: bool
    is_moving: bool
    limit: str = ""


class Counted(NamedTuple):
    """What was measured of all axes, (n,) each.

    Attributes:
        stamp: of the oldest of it.
        positions: counts.
        rates: counts/s.
        efforts: in the controller's unit.
    """

    stamp: Stamp
    positions: Sequence[float]
    rates: Sequence[float]
    efforts: Sequence[float]


class Heard(NamedTuple):
    """What one cycle has brought.

    Attributes:
        counted: None: nothing new of all axes.
        fault: what went wrong, by axis and with remedies; empty: nothing that is sure.
    """

    counted: Counted | None = None
    fault: str = ""


class Complaint(NamedTuple):
    """What to say of something.

    Attributes:
        text: what happened.
        remedy: what to do.
    """

    text: str
    remedy: str = ""


class Words(NamedTuple):
    """What to say of what every controller may do.

    Attributes:
        goes_on: axes do not rest although they were told to stop.
        stays_on: axes have power although they were switched off.
    """

    goes_on: Complaint
    stays_on: Complaint


class MotionController(ABC):
    """One controller by its protocol. It belongs to the I/O thread, but for `halt`.

    Attributes:
        capabilities: see `Device`; `promises` makes them.
        counting: what its counts mean.
        words: of what may go wrong.
        blind: seconds without a word of it after which no setpoint is sent: nobody sees what the axes do.
        patience: seconds in which axes come to rest, or have power, or have none.
        homes: places of the joints that can be homed, in the order in which they are.
    """

    capabilities: Capabilities
    counting: Counting
    words: Words
    blind: float
    patience: float
    homes: Sequence[int] = ()

    @property
    @abstractmethod
    def where(self) -> str:
        """For messages."""

    @property
    @abstractmethod
    def axes(self) -> Sequence[AxisTold]:
        """What all axes have told last, in the order of joints; empty: nothing yet."""

    @property
    def counters(self) -> Mapping[str, float]:
        """What went wrong, counted."""
        return {}

    @property
    def notes(self) -> tuple[Note, ...]:
        """What people should know, beside axes that are at their limits."""
        return ()

    # --------------------------------------------------------------------------------------- the link

    @abstractmethod
    def open(self, deadline: float, given_up: Callable[[], bool]) -> None:
        """Connect, refuse axes that are not as configured, and hear of all once; nothing moves.

        Raises:
            ConnectionFailed, DeviceError: with the remedy.
        """

    @abstractmethod
    def close(self, *, power_off: bool) -> None:
        """Disconnect. May be called twice, and when the link is gone.

        Args:
            power_off: the power that was switched on is to be taken away, as well as that can be told still.
        """

    @abstractmethod
    def exchange(self, deadline: float) -> Heard:
        """Send what waits, and hear. What cannot be, or is a fault, is believed when it was told twice.

        Raises:
            ConnectionLost: the link is gone.
        """

    def lost(self) -> None:  # noqa: B027 - most links are gone both ways
        """The link is lost while axes have power: say to them what may still be heard."""

    # ---------------------------------------------------------------------------------------- motion

    @property
    @abstractmethod
    def here(self) -> Sequence[float]:
        """Where a stream begins, counts (n,)."""

    def admits(self) -> bool:
        """Whether a setpoint may go out now; one that may not is left out, and counted."""
        return True

    @abstractmethod
    def follow(self, now: float, counts: Sequence[float]) -> None:
        """Lead the axes to `counts` (n,), as part of a stream that begins after `halt`.

        What a buffer needs to go on is sent here as well, in each cycle.
        """

    @property
    def has_arrived(self) -> bool:
        """Whether the axes should be where they were led last."""
        return True

    @abstractmethod
    def halt(self, *, aside: bool) -> None:
        """Slow all axes down, before anything else that is to be sent; what has waited is forgotten.

        Args:
            aside: this is another thread, and the I/O thread may hang: it is sent at once.
        """

    @property
    @abstractmethod
    def has_stopped(self) -> bool:
        """Whether the last `halt` was answered, and all axes have told after that that they rest."""

    def give_up(self) -> None:
        """A fault was found: whatever still moves is stopped, and the stream forgotten."""
        self.halt(aside=False)

    # ------------------------------------------------------------------------------------------ power

    def watch(self, on: bool) -> None:  # noqa: B027 - some tell faults by themselves
        """Judge from now on what axes tell, which should have power; or do not, while that changes."""

    @property
    def hindered(self) -> Sequence[Complaint]:
        """Why axes would get no power now, by what they have told last; what `prepare` removes is none."""
        return ()

    def prepare(self) -> Steps:
        """Have the axes ready for power: faults cleared that can be, velocities and accelerations set."""
        yield from ()

    @abstractmethod
    def switch(self, on: bool) -> Steps:
        """Give power to all axes, or take it away; whether they have it is looked at after that."""

    def without_power(self) -> Complaint:
        """What to say of axes that got no power."""
        off = ", ".join(axis.name for axis in self.axes if not axis.has_power)
        return Complaint(f"{off}: no power although it was switched on", "Look at its drive.")

    # ----------------------------------------------------------------------------------------- homing

    @property
    def is_homed(self) -> bool:
        """Whether its counts can be trusted."""
        return True

    def home(self, place: int) -> Generator[None, None, Complaint | None]:
        """Home one of `homes`, and return why it was not; `halt` breaks that off."""
        raise NotImplementedError

    def homed(self) -> Steps:
        """All of `homes` are: what is heard after this counts from there."""
        yield from ()

    def unhome(self) -> Steps:
        """Trust its counts no more."""
        yield from ()
