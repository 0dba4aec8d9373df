"""Deadlines on the monotonic clock, as small values that a test can drive with a clock of its own."""

from __future__ import annotations

import math


class Deadman:
    """Expires when it has not been fed for `timeout` seconds. Starts unarmed.

    The command stream, the sample age and the heartbeat of an I/O thread are each one of these.
    """

    def __init__(self, timeout: float) -> None:
        self.timeout = timeout
        self._fed = -math.inf

    @property
    def armed(self) -> bool:
        """Whether it has been fed since it was made or disarmed."""
        return self._fed != -math.inf

    def feed(self, now: float) -> None:
        """Push the deadline to `timeout` seconds after `now`."""
        self._fed = now

    def disarm(self) -> None:
        """Forget the last feeding: it cannot expire until the next."""
        self._fed = -math.inf

    def age(self, now: float) -> float:
        """Return the seconds since the last feeding, infinite if unarmed."""
        return now - self._fed

    def expired(self, now: float) -> bool:
        """Say whether it is armed and its deadline has passed."""
        fed = self._fed  # once: another thread may disarm it in between
        return fed != -math.inf and now - fed > self.timeout
