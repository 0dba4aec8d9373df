"""One open rig of the table of faults at a time, for tests that go through its cells driver by driver."""

from __future__ import annotations

from bench.reliability.rig import Rig
from bench.reliability.rigs import RIGS

__all__ = ["SLOW", "FaultRigs"]

SLOW = {
    *("copley", "dvrk", "dvrk-driven", "ros2-control", "haply"),
    *("force-dimension", "openhaptics", "optoforce", "raven", "inputs"),
}
"""Drivers whose wire is DDS, or a line of one question at a time: a machine that runs all tests delays them
by more than an arm may be behind. Their own tests ask the same in less time."""


class FaultRigs:
    """The rig of one driver, and another one after it was left in a state that nobody knows."""

    def __init__(self) -> None:
        self._rig: Rig | None = None

    def of(self, name: str) -> Rig:
        """Return the open rig of a driver."""
        if self._rig is not None and self._rig.name != name:
            self.drop()
        if self._rig is None:
            self._rig = RIGS[name]().__enter__()
        return self._rig

    def drop(self) -> None:
        """Close the rig that is open, if one is."""
        rig, self._rig = self._rig, None
        if rig is not None:
            rig.__exit__(None, None, None)
