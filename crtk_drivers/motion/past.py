"""What a device told at a moment that has gone by, made later: who keeps moments keeps references only."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from crtk_drivers.motion.feedback import Active, Feedback
from crtk_drivers.motion.told import Told
from crtk_drivers.samples import Sample, Stamp, Value
from crtk_drivers.state import OperatingState

Moment = tuple[int, Sample, Active, OperatingState]
"""The end of a cycle that brought a sample: time (ns since the epoch), sample, setpoint in force, state."""


class Past:
    """Tells of moments, one after the other, as `Told` tells of the present. Belongs to one thread.

    Args:
        feedback: of the device.
    """

    def __init__(self, feedback: Feedback) -> None:
        self._feedback = Feedback(feedback.device, math.inf)
        self._feedback.axes = feedback.axes
        self._told = Told(self._feedback)

    def values(self, moment: Moment, names: Iterable[str]) -> Iterator[tuple[str, Value, Stamp]]:
        """Yield what was told of names then, where there was something to tell."""
        _, sample, active, state = moment
        if not sample.values:  # it only showed that the link was alive
            return
        feedback = self._feedback
        feedback.take(sample)
        feedback.active = active
        for name in names:
            found = self._told.get(name, sample.stamp.monotonic, state)
            if found is not None:
                yield name, *found
