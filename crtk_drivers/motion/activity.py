"""What is carried out: one activity at a time, stepped once a cycle by the I/O thread."""

from __future__ import annotations

from abc import ABC, abstractmethod

from typing_extensions import override

from crtk_drivers.device import Device
from crtk_drivers.motion.arbiter import Order
from crtk_drivers.motion.move import Move, Outcome
from crtk_drivers.motion.output import Output
from crtk_drivers.status.procedures import Procedure


class Activity(ABC):
    """A stream, a move, free drive, or an order that waits until it may begin.

    Attributes:
        name: of the command that is carried out.
        stamp_ns: of its newest command, the sender's; 0 if it gave none.
        move: what a client waits on; None if nobody waits.
    """

    def __init__(self, name: str, stamp_ns: int = 0, move: Move | None = None) -> None:
        self.name = name
        self.stamp_ns = stamp_ns
        self.move = move

    @abstractmethod
    def step(self, now: float, output: Output) -> bool:
        """Do this cycle's part at monotonic seconds; return whether it has come to its end.

        Raises:
            CommandRefused, MotionAborted: it cannot go on.
            DeviceError: the hardware could not be told.
        """

    def end(self, outcome: Outcome, reason: str = "") -> None:
        """It is over: release who waits for it, and clean up."""
        if self.move is not None:
            self.move.finish(outcome, reason)


class Pending(Activity):
    """An order that has been taken and has not begun, as the hardware comes to rest before it.

    Attributes:
        order: to be carried out.
        since: monotonic seconds since when it waits.
        fed: when its newest command came.
    """

    def __init__(self, order: Order, since: float, fed: float) -> None:
        super().__init__(order.name, order.stamp_ns, order.move)
        self.order = order
        self.since = since
        self.fed = fed

    @override
    def step(self, now: float, output: Output) -> bool:
        return False


class FreeDrive(Activity):
    """The arm is moved by hand."""

    def __init__(self, order: Order, device: Device, where: str) -> None:
        super().__init__(order.name, order.stamp_ns)
        self._procedure = Procedure(device.free(), where)

    @override
    def step(self, now: float, output: Output) -> bool:
        self._procedure.step()
        return False

    @override
    def end(self, outcome: Outcome, reason: str = "") -> None:
        self._procedure.close()
