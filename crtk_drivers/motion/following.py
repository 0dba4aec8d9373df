"""Whether the joints are where they were sent: while positions stream, and at the end of a move.

A joint follows late, by the transport, the smoothing and the control loop of the hardware. It therefore has
to be somewhere among all the positions that were in force within the device's `Following.lag` before the
sample, give or take `Following.error`.
"""

from __future__ import annotations

import math
from collections import deque

from crtk_drivers.device import Capabilities
from crtk_drivers.motion.stopping import SLOWEST_PACE
from crtk_drivers.samples import Vector


class FollowingWatch:
    """Compares what is measured with what was sent. Belongs to the I/O thread.

    Args:
        capabilities: of the device; without `Capabilities.following` nothing is ever found.
        error: in rad (m), in place of what the device declares for each joint that it says to follow; None:
            as declared.
    """

    def __init__(self, capabilities: Capabilities, error: float | None = None) -> None:
        following = capabilities.following
        self._joints = capabilities.joints
        self._declared = following is not None
        self._error = [] if following is None else list(following.error)
        if error is not None:
            self._error = [error if own < math.inf else own for own in self._error]
        self._arrival = [] if following is None else list(following.arrival)
        self._lag = 0.0 if following is None else following.lag + 1.0 / capabilities.rate
        self._sent: deque[tuple[float, list[float]]] = deque()

    def sent(self, position: Vector, measured: Vector, now: float) -> None:
        """A joint position (n,) went out.

        Args:
            position: that was sent.
            measured: (n,) where the joints are, which is where a stream begins.
            now: monotonic seconds.
        """
        if not self._declared:
            return
        if not self._sent and measured.size == position.size:
            self._sent.append((-math.inf, measured.tolist()))
        self._sent.append((now, position.tolist()))

    def hold(self, position: Vector, now: float) -> None:
        """Expect the joints at a position (n,) until something is sent.

        Args:
            position: where they are.
            now: monotonic seconds.
        """
        self._sent.clear()
        if self._declared and position.size == len(self._error):
            self._sent.append((now, position.tolist()))

    def forget(self) -> None:
        """The joints follow something else now."""
        self._sent.clear()

    def trouble(self, measured: Vector, at: float, pace: float = 1.0) -> str:
        """Return which joint does not follow and how far off it is, in words; empty if all do.

        Args:
            measured: (n,) position.
            at: monotonic seconds at which it was acquired.
            pace: of the hardware, see `Device.pace`: slowed down it is as much later.
        """
        sent = self._sent
        if not sent or measured.size != len(self._error):
            return ""
        begin = at - self._lag / max(pace, SLOWEST_PACE)
        # The one that was in force when the window begins stays.
        while len(sent) > 1 and sent[1][0] <= begin:
            sent.popleft()
        here = measured.tolist()
        newest = sent[-1][1]
        ways = zip(here, newest, self._error, strict=True)
        if all(abs(value - goal) <= error for value, goal, error in ways):
            return ""
        in_force = [values for time, values in sent if time <= at] or [sent[0][1]]
        for name, value, error, among in zip(
            self._joints, here, self._error, zip(*in_force, strict=True), strict=True
        ):
            off = max(min(among) - value, value - max(among))
            if not off <= error:
                return (
                    f"{name} does not follow: it is at {value:.4f}, {off:.4f} from what it was sent, "
                    f"more than {error:.4f}"
                )
        return ""

    def has_settled(self, measured: Vector) -> bool:
        """Whether the joints are where they were sent last, and nothing else can be on its way to them.

        Of all that was in force within `Following.lag`, nothing led away from there: else they may be there
        still, and not yet again. Asked right after `trouble`.

        Args:
            measured: (n,) position.
        """
        sent = self._sent
        if not sent or measured.size != len(self._arrival):
            return False
        newest = sent[-1][1]
        if self._is_off(measured.tolist(), newest):
            return False
        were_off = [self._is_off(values, newest) for _, values in sent]
        return were_off == sorted(were_off, reverse=True)

    def _is_off(self, position: list[float], goal: list[float]) -> bool:
        """Whether a joint is further from the goal than where a move ends."""
        ways = zip(position, goal, self._arrival, strict=True)
        return not all(abs(here - there) <= near for here, there, near in ways)

    def missing(self, measured: Vector, goal: Vector) -> str:
        """Return which joint is not at the end of a move, in words; empty if all are."""
        if not self._declared or measured.size != goal.size:
            return ""
        for name, here, there, near in zip(
            self._joints, measured.tolist(), goal.tolist(), self._arrival, strict=True
        ):
            if not abs(here - there) <= near:
                return f"{name} is at {here:.4f}, not at {there:.4f}"
        return ""
