"""Time that a test steps: it stands in for the module `time` of those who ask and wait."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from types import ModuleType
from typing import Final
from unittest.mock import patch

EPOCH_NS: Final = 1_700_000_000_000_000_000
BEGIN_NS: Final = 10**12


class Steps:
    """Time that passes in steps, in each of which something is done.

    Args:
        period: of the steps, in s.

    Attributes:
        step: what is done in each.
    """

    def __init__(self, period: float) -> None:
        self.step: Callable[[], None] = lambda: None
        self._period = round(1e9 * period)
        self._now = BEGIN_NS

    def monotonic(self) -> float:
        return 1e-9 * self._told()

    def time_ns(self) -> int:
        return EPOCH_NS + self._told()

    def time(self) -> float:
        return 1e-9 * self.time_ns()

    def _told(self) -> int:
        """Return ns that nobody was told before."""
        self._now += 1
        return self._now

    def let_pass(self, seconds: float) -> None:
        """Let time pass within a step."""
        self._now += round(1e9 * seconds)

    def go_on(self) -> None:
        """Do the next step."""
        self._now = self._next()
        self.step()

    def sleep(self, seconds: float) -> None:
        """Do the steps that begin in that time."""
        end = self._now + round(1e9 * seconds)
        while self._next() <= end:
            self.go_on()
        self._now = max(self._now, end)

    def wait(self, condition: Callable[[], object], timeout: float) -> bool:
        """Do steps until a condition holds; return whether it does in time."""
        end = self._now + round(1e9 * timeout)
        while not condition():
            if self._now >= end:
                return False
            self.go_on()
        return True

    def _next(self) -> int:
        return (self._now // self._period + 1) * self._period

    @contextmanager
    def instead_of_time(self, *modules: ModuleType) -> Iterator[None]:
        """Within, `time` of these modules is this."""
        with ExitStack() as stack:
            for module in modules:
                stack.enter_context(patch.object(module, "time", self))
            yield
