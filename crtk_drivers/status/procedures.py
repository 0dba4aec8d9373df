"""Procedures of a device while they run: those of state commands, services and free drive."""

from __future__ import annotations

import logging
import math

from crtk_drivers.device import Answer, Steps

logger = logging.getLogger(__name__)


class Procedure:
    """One procedure (`crtk_drivers.device.Steps`), resumed once a cycle. Belongs to the I/O thread.

    Args:
        steps: of the device.
        where: the device, for messages.
        deadline: monotonic seconds at which it must have ended.

    Attributes:
        answer: what it returned, empty if that was nothing.
    """

    answer = ""

    def __init__(self, steps: Steps | Answer, where: str, deadline: float = math.inf) -> None:
        self._steps = steps
        self._where = where
        self._deadline = deadline

    def step(self) -> bool:
        """Resume it; return whether it has ended, also when it is asked again.

        Raises:
            Exception: whatever the device raises; it has ended by that.
        """
        try:
            next(self._steps)
        except StopIteration as end:
            self.answer = end.value or self.answer
            return True
        return False

    def is_overdue(self, now: float) -> bool:
        """Whether its deadline has passed."""
        return now > self._deadline

    def close(self) -> None:
        """End it before its own end: its ``finally`` blocks run now, and what they raise is logged."""
        try:
            self._steps.close()
        except Exception:
            logger.exception("%s: a procedure that was interrupted failed to clean up", self._where)
