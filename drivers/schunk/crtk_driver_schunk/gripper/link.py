"""What the driver needs of a way to a gripper: one question at a time, which the next call goes on with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

from crtk_drivers.samples import Stamp

__all__ = ["Link", "Question", "Reply"]


class Question(NamedTuple):
    """An instance to be read, so many bytes; or to be written, if there is `data`."""

    instance: int
    size: int
    data: bytes = b""


class Reply(NamedTuple):
    """What came back, and when it was asked for: what is told is not older than that."""

    data: bytes
    asked: Stamp


class Link(Protocol):
    """A way to the gripper. It belongs to the I/O thread, but for `shout`."""

    @property
    def where(self) -> str:
        """For messages."""

    @property
    def counters(self) -> Mapping[str, float]:
        """What went wrong, counted."""

    @property
    def trouble(self) -> tuple[str, str]:
        """Why there is no answer, and what to do."""

    def open(self, deadline: float) -> None:
        """Connect; nothing is sent."""

    def close(self) -> None:
        """Disconnect."""

    def exchange(self, question: Question, deadline: float) -> Reply | None:
        """Ask, or go on waiting for what was asked for; None: not by the deadline.

        An earlier question that is not answered yet is waited for first, and its answer dropped.

        Raises:
            ConnectionLost: the connection is gone.
            ProtocolError: what answers is no such gripper.
        """

    def shout(self, question: Question) -> None:
        """Write and wait for nothing, from any thread, whatever the I/O thread does."""
