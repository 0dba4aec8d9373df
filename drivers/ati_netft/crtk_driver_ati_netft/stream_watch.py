"""When to ask a sensor for its stream again, and what its silence meant. Pure; no clock of its own.

A sensor sends to one client: the last that asked. Silence therefore means that the sensor or the network is
away, or that another client has asked. When the stream is back at the first request, the sensor was there all
the time, and it was probably the other client. That one is not fought with: each time it happens soon after
the last, we wait longer before we ask.
"""

from __future__ import annotations

import math
from typing import Final

PATIENCE: Final = 0.1
"""Seconds of silence after which the stream is asked for again; an answer comes in less."""
FIRST_PAUSE: Final = 0.1
LONGEST_PAUSE: Final = 2.0
FEUD: Final = 10.0
"""Seconds after a takeover in which the next one counts as part of the same quarrel."""


class StreamWatch:
    """The watch over one stream. It remembers over any number of connections.

    Args:
        patience: seconds of silence that are no reason to ask; may be set at any time.
    """

    def __init__(self, patience: float = PATIENCE) -> None:
        self.takeovers = 0
        """How often the stream had probably been taken."""
        self.requests = 0
        """Requests since the stream was heard last."""
        self.patience = patience
        self._heard = -math.inf
        self._next = math.inf
        self._asked = -math.inf
        self._pause = FIRST_PAUSE
        self._begun = False
        self._ended_by_us = True
        self._taken = -math.inf
        self._grudge = 0.0

    def begin(self, now: float) -> None:
        """Want a new series from now on, also if one is there already."""
        self._begun = True
        self._ended_by_us |= now - self._heard < self.patience
        self._next = max(now, self._heard + self._grudge)
        self._pause = FIRST_PAUSE

    def end(self) -> None:
        """Want it no more."""
        self._begun = False
        self._ended_by_us = True
        self._next = math.inf

    def due(self, looked: float, now: float) -> bool:
        """Return whether to ask now; if so, it counts as asked.

        Args:
            looked: monotonic seconds at which one began to look for records; for who was held up since then,
                some may have come.
            now: monotonic seconds.
        """
        if looked < self._next:
            return False
        self._begun = False
        self.requests += 1
        self._asked = now
        self._next = now + self._pause
        self._pause = min(2.0 * self._pause, LONGEST_PAUSE)
        return True

    def heard(self, now: float, new_series: bool) -> bool:
        """Records were there at `now`; return whether they had probably been taken from us.

        Args:
            now: monotonic seconds.
            new_series: the first of them begins the series that was asked for. If it goes on with the one
                before, that was held up on its way, and nobody took it.
        """
        self._heard = now
        if self._begun:
            return False
        prompt = self.requests == 1 and now - self._asked <= self.patience
        taken = new_series and prompt and not self._ended_by_us
        if taken:
            self.takeovers += 1
            again = now - self._taken < FEUD + self._grudge
            self._grudge = (
                min(max(2.0 * self._grudge, FIRST_PAUSE), LONGEST_PAUSE) if again else 0.0
            )
            self._taken = now
        self._ended_by_us = False
        self.requests = 0
        self._pause = FIRST_PAUSE
        self._next = now + max(self.patience, self._grudge)
        return taken
