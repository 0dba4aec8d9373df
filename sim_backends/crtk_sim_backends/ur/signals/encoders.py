"""Encoders of conveyors: two, each with pulses at its inputs or with tick counts that programs set.

Source: URScript manual 5.x, chapter "motion", `encoder_...`. The filter is not published: this one
lags behind neither a belt at rest nor one of constant speed.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import exp, floor
from typing import Any, Final

RANGES: Final[Mapping[int, tuple[int, int]]] = {
    0: (-(2**31), 2**31),
    1: (0, 2**8),
    2: (0, 2**16),
    3: (0, 2**24),
    4: (0, 2**32),
}
"""First tick count, and that behind the last, by `range_id` of `encoder_enable_set_tick_count`."""

PULSE_RANGE: Final = (0, 2**16)
"""Range of a filtered count of pulses."""

COUNT: Final = 2
PULSE_FILTER_TIME: Final = 0.02
COUNT_FILTER_TIME: Final = 0.1  # for counts that are set some ten times a second
"""s, in which a change of speed is seen."""

_STILL: Final = 1e-3  # ticks, and ticks/s


class Encoder:
    """One encoder; ticks are counted without end inside, and told within a range.

    Args:
        dt: control period, s.

    Attributes:
        ticks: filtered count since it was enabled.
        rate: its speed, ticks/s.
        belt: ticks/s of what turns an encoder with pulses.
    """

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self._decay = 0.0  # of the filter, in a period
        self._range: tuple[int, int] | None = None
        self._has_pulses = self._has_direction = False
        self._position: float | None = None  # ticks that were measured; None before the first
        self.belt = 0.0
        self.ticks = self.rate = 0.0

    @property
    def enabled(self) -> bool:
        """Whether it counts."""
        return self._range is not None

    @property
    def accepts_counts(self) -> bool:
        """Whether a program may set its count."""
        return self.enabled and not self._has_pulses

    def count_pulses(self, *, has_direction: bool) -> None:
        """Count the pulses at its inputs, backwards too where two inputs tell the direction."""
        self._enable(PULSE_RANGE, PULSE_FILTER_TIME)
        self._has_pulses, self._has_direction = True, has_direction

    def take_counts(self, limits: tuple[int, int]) -> None:
        """Have counts of this range set."""
        self._enable(limits, COUNT_FILTER_TIME)

    def disable(self) -> None:
        """Count nothing."""
        self._enable(None, COUNT_FILTER_TIME)

    def _enable(self, limits: tuple[int, int] | None, filter_time: float) -> None:
        self._range = limits
        self._decay = exp(-self._dt / filter_time)
        self._has_pulses = False
        self._position = None
        self.ticks = self.rate = 0.0

    def set_count(self, count: int) -> bool:
        """Take a count; False where its range does not have it."""
        if self._range is None or not self._range[0] <= count < self._range[1]:
            return False
        if self._position is None:
            self._position = self.ticks = float(count)
        else:
            self._position += self.unwound(count - self._position)
        return True

    def unwound(self, delta: float) -> float:
        """Difference between two counts, which has gone past no end of the range."""
        if self._range is None:
            return delta
        span = self._range[1] - self._range[0]
        return (delta + 0.5 * span) % span - 0.5 * span

    @property
    def filtered(self) -> float:
        """Filtered count within the range; 0 where it counts nothing."""
        return 0.0 if self._range is None else _within(self.ticks, *self._range)

    @property
    def raw(self) -> int:
        """Count as it was measured, 32 bits with a sign."""
        return int(_within(floor(self._position or 0.0), *RANGES[0]))

    def step(self) -> None:
        """Count what a control period brings."""
        if self._has_pulses:
            speed = self.belt if self._has_direction else abs(self.belt)
            self._position = (self._position or 0.0) + speed * self._dt
        position = self._position or 0.0  # between ticks, too: the controller interpolates
        self.ticks += self.rate * self._dt
        error = position - self.ticks
        self.ticks += (1.0 - self._decay * self._decay) * error
        self.rate += (1.0 - self._decay) ** 2 / self._dt * error
        if abs(error) < _STILL and abs(self.rate) < _STILL:
            self.ticks, self.rate = position, 0.0


class Encoders:
    """All of them, as programs and RTDE see them.

    Args:
        outputs: process image by RTDE output variable name.
        dt: control period, s.
    """

    def __init__(self, outputs: dict[str, Any], dt: float) -> None:
        self._outputs = outputs
        self._encoders = [Encoder(dt) for _ in range(COUNT)]

    def __getitem__(self, index: int) -> Encoder:
        return self._encoders[index]

    def move(self, index: int, ticks: float) -> None:
        """Turn the one with this index by so many ticks a second, if it has pulses."""
        self._encoders[index].belt = ticks

    def step(self) -> None:
        """Count what a control period brings."""
        for i, encoder in enumerate(self._encoders):
            if encoder.enabled:
                encoder.step()
                self._outputs[f"encoder{i}_raw"] = encoder.raw


def _within(ticks: float, first: int, behind: int) -> float:
    return (ticks - first) % (behind - first) + first
