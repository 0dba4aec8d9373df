"""What is asked of the robot's nodes and answered later: plain data, set by one thread, read by another."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Generic, TypeVar

from crtk_drivers.samples import Vector

T = TypeVar("T")


@dataclass(eq=False)
class Asked(Generic[T]):
    """A request to a service.

    Attributes:
        service: full name.
        at: monotonic seconds when it was asked.
        answer: None until it has come.
        error: why none will come; empty if it may.
    """

    service: str
    at: float
    answer: T | None = None
    error: str = ""

    @property
    def has_ended(self) -> bool:
        """Whether there is an answer, or will be none."""
        return self.answer is not None or bool(self.error)


@dataclass(frozen=True)
class Told:
    """What ``switch_controller`` and ``set_hardware_component_state`` answer."""

    ok: bool
    text: str


@dataclass(frozen=True)
class Delivery:
    """How many subscribers a controller's commands have, and whether they have all that was sent."""

    listeners: int
    has_arrived: bool


@dataclass(eq=False)
class Following:
    """A goal of the trajectory controller.

    Attributes:
        positions: where it ends (n,), in the order of `joints`.
        seconds: that it takes.
        has_ended: nothing of it goes on any more.
        succeeded: it ended at its goal.
        text: what the controller said of its end.
        is_cancelled: it was asked to end.
    """

    joints: tuple[str, ...]
    positions: Vector
    seconds: float
    has_ended: bool = False
    succeeded: bool = False
    text: str = ""
    is_cancelled: bool = False
    handle: object = field(default=None, repr=False)
