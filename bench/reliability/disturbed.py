"""A device that fails in the driver's own process: what no simulator behind a wire can do to it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from typing_extensions import override

from crtk_drivers.device import Condition, Device, Goal, Setpoint
from crtk_drivers.errors import ConnectionFailed, ConnectionLost
from crtk_drivers.samples import JointState, Sample
from crtk_drivers.state import OperatingState
from crtk_drivers.wrappers.forwarding import WrappedDevice

STUCK = "own stuck"
DEFECT = "own defect"
LOST = "own lost"
SILENT = "own silent"
NOT_FINITE = "own not finite"
ERROR = "own error"
TAKEN_OVER = "own taken over"
KINDS = frozenset({STUCK, DEFECT, LOST, SILENT, NOT_FINITE, ERROR, TAKEN_OVER})
"""Named apart from those of simulators."""

_CONDITIONS = {
    ERROR: Condition(OperatingState.FAULT, "the hardware reports an error"),
    TAKEN_OVER: Condition(OperatingState.PAUSED, "somebody else has control"),
}


class DisturbedDevice(WrappedDevice):
    """Passes on to the device inside, except for the fault that is on. Thread-safe.

    Attributes:
        on_motion: called by the I/O thread once each motion (a setpoint, a move) was given to the device.
    """

    def __init__(self, inner: Device) -> None:
        super().__init__(inner)
        self.on_motion: Callable[[], object] = lambda: None
        self._fault = ""
        self._over = threading.Event()
        self._over.set()
        self._lock = threading.Lock()

    def begin(self, kind: str) -> None:
        """Begin one of `KINDS`, until `end`."""
        self._fault = kind
        if kind == STUCK:
            self._over.clear()

    def end(self) -> None:
        """End it."""
        self._fault = ""
        self._over.set()

    def look(self) -> None:
        """Let a device that moves while it is read go on, whatever its driver does."""
        with self._lock:
            self.inner.read(0.0)

    @property
    @override
    def condition(self) -> Condition:
        return _CONDITIONS.get(self._fault) or self.inner.condition

    @override
    def open(self, deadline: float) -> None:
        if self._fault == LOST:
            raise ConnectionFailed("no answer", where=self.address, remedy="Is it on?")
        with self._lock:
            self.inner.open(deadline)

    @override
    def write(self, setpoint: Setpoint) -> None:
        self.inner.write(setpoint)
        self.on_motion()

    @override
    def move(self, goal: Goal) -> None:
        self.inner.move(goal)
        self.on_motion()

    @override
    def read(self, deadline: float) -> Sample | None:
        if self._fault == STUCK:
            self._over.wait()
        if self._fault == DEFECT:
            raise RuntimeError("a defect of the driver")
        if self._fault == LOST:
            raise ConnectionLost("the link is gone", where=self.address, remedy="Is it on?")
        with self._lock:
            sample = self.inner.read(deadline)
        if self._fault == SILENT:
            return None
        if self._fault == NOT_FINITE and sample is not None:
            return _spoilt(sample)
        return sample


def _spoilt(sample: Sample) -> Sample:
    values = dict(sample.values)
    joints = values.get("measured_js")
    if isinstance(joints, JointState):
        position = joints.position.copy()
        position[0] = np.nan
        values["measured_js"] = replace(joints, position=position)
    return Sample(sample.stamp, values)
