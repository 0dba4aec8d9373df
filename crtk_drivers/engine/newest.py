"""When the newest stop and the newest change of state came, to refuse what was sent before them.

Moments are nanoseconds of the system clock, which says when a message came. It may be set meanwhile: what is
kept here moves with it.
"""

from __future__ import annotations

import time
from typing import Final

from crtk_drivers.samples import Stamp

_SET_NS: Final = 1_000_000
"""ns by which the system clock moves against the monotonic one where it was set. Less is no sign of that: the
two are not read at the same moment."""


class Newest:
    """The newest stop and the newest change of state of a device. For one thread at a time."""

    def __init__(self) -> None:
        self._stop_ns = self._change_ns = 0
        self._ahead_ns = _ahead_ns()

    def note(self, received_ns: int = 0, *, is_stop: bool) -> None:
        """Note what comes now.

        Args:
            received_ns: when it came, in ns since the epoch, if that was before now.
            is_stop: it is a stop; otherwise another change of state.
        """
        self._follow_the_clock()
        now = time.time_ns()
        came = min(received_ns or now, now)
        self._change_ns = max(self._change_ns, came)
        if is_stop:
            self._stop_ns = max(self._stop_ns, came)

    def is_after_stop(self, sent_ns: int) -> bool:
        """Whether the newest stop came after what was sent at `sent_ns`; 0: now."""
        self._follow_the_clock()
        return 0 < sent_ns < self._stop_ns

    def is_after(self, sent_ns: int) -> bool:
        """Whether the newest stop, or change of state, came after what was sent at `sent_ns`; 0: now."""
        self._follow_the_clock()
        return 0 < sent_ns < self._change_ns

    def _follow_the_clock(self) -> None:
        """Move what is kept with the system clock, if that was set."""
        step = _ahead_ns() - self._ahead_ns
        if abs(step) > _SET_NS:
            self._ahead_ns += step
            self._stop_ns += step if self._stop_ns else 0
            self._change_ns += step if self._change_ns else 0


def _ahead_ns() -> int:
    """Return by how much the system clock is ahead of the monotonic one."""
    now = Stamp.now()
    return now.wall_ns - round(1e9 * now.monotonic)
