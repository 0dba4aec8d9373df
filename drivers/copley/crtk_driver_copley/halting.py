"""A stop of the axes (``t 0``): believed when each has answered, and has told after that that it rests."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from crtk_driver_copley.axis import Axis
from crtk_driver_copley.codec import Reply, abort
from crtk_driver_copley.line import Line

__all__ = ["Halting"]


class Halting:
    """Stops of all axes. It belongs to the I/O thread, but for `aside`.

    Args:
        line, axes: of the arm.
    """

    def __init__(self, line: Line, axes: Sequence[Axis]) -> None:
        self._line = line
        self._axes = axes
        self._names = frozenset(axis.name for axis in axes)
        self.forget()

    def forget(self) -> None:
        """A connection begins."""
        self._unanswered: set[str] = set()
        self._unseen: set[str] = set()
        self._untold: set[str] = set()  # axes that have told nothing since they answered

    def begin(self) -> None:
        """Let it be sent before anything else, unless it is on its way, or nobody knows yet what it did.

        On a slow line stops that follow each other leave no room for what the axes tell.
        """
        if self._unanswered or self._untold:
            return
        self._unseen, self._untold = set(self._names), set(self._names)
        self._unanswered = set(self._names)
        self._line.ask_first(
            [(abort(axis.to), partial(self._answered, axis)) for axis in self._axes]
        )

    def _answered(self, axis: Axis, reply: Reply | None) -> None:
        """It was, if only by an error of an axis without power: whether it rests is looked at."""
        self._unanswered.discard(axis.name)

    def aside(self) -> None:
        """Send it from another thread; `begin` in the I/O thread is to follow."""
        self._unseen = set(self._names)
        self.moves()
        self.shout()

    def moves(self) -> None:
        """Something begins to move: the next stop is none that is repeated."""
        self._untold = set()

    def shout(self) -> None:
        """Send it, and wait for no answers."""
        self._line.stop_aside([abort(axis.to) for axis in self._axes])

    def look(self, axis: Axis) -> None:
        """An axis has told what its profile does."""
        if self._unanswered:
            return
        self._untold.discard(axis.name)
        if not axis.is_running:
            self._unseen.discard(axis.name)

    @property
    def is_seen(self) -> bool:
        """Whether the last one was carried out."""
        return not self._unanswered and not self._unseen
