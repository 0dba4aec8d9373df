"""The transducer and its electronics: a block of measurements at a time, and the clock they are made by.

Measurements are numbered from 0 at power-up. They are made a few milliseconds ahead of their time, so that
the stream has only to send them; :meth:`Sensor.change` makes those anew whose time has not come.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from crtk_sim_backends.kit.loads import Array, Load
from crtk_sim_backends.netft.defects import TransducerDefects, Wrongs
from crtk_sim_backends.netft.settings import Settings

SATURATES_AT: Final = 1.1
"""Of the rated load: beyond it an axis measures no more (assumed: real gages have some room)."""

_AHEAD: Final = 1 / 32  # s of measurements in one block
_WRAP: Final = 2**32
_LONG_AGO: Final = -(2**40)


class Clock:
    """When each measurement is made: number to monotonic time and back.

    Args:
        now: monotonic time of measurement 0, s.
        rate: measurements per second.
    """

    def __init__(self, now: float, rate: float) -> None:
        self._time = now
        self._index = 0
        self._offset = 0.0
        self.rate = rate

    def index_at(self, now: float) -> int:
        """Return the number of the last measurement made by a monotonic time."""
        return self._index + int(np.floor((now - self._time) * self.rate))

    def time_of(self, index: int) -> float:
        """Return the monotonic time of a measurement."""
        return self._time + (index - self._index) / self.rate

    def load_times(self, first: int, count: int) -> Array:
        """Return the times of measurements (count,) for loads, s since the start, without stand-stills."""
        times: Array = (
            np.arange(first - self._index, first - self._index + count) / self.rate
            + self._time
            - self._offset
        )
        return times

    def set_rate(self, index: int, rate: float) -> None:
        """Make measurements at another rate after the one with a number."""
        self._time, self._index, self.rate = self.time_of(index), index, rate

    def stand_still(self, seconds: float) -> None:
        """Let everything be later: the box stood still."""
        self._time += seconds
        self._offset += seconds

    def begin_loads(self, now: float) -> None:
        """Let the time of loads begin at a monotonic time."""
        self._offset = now

    def restart(self, now: float) -> None:
        """Begin with measurement 0 at a monotonic time; the time of loads goes on."""
        self._time, self._index = now, 0


@dataclass(frozen=True)
class Block:
    """Measurements that follow each other, the first one numbered `first`.

    Attributes:
        ft: ft_sequence of each (n,).
        status: status words (n,).
        counts: (n, 6).
        smooth: load behind the low-pass (n, 6), N and N·m, in the transducer's frame.
        saturated: number of the last measurement in which each axis was saturated (n, 6).
        breached, latched: monitor conditions that are and have been breached, one bit for each (n,).
    """

    first: int
    ft: NDArray[np.uint32]
    status: NDArray[np.uint32]
    counts: NDArray[np.int32]
    smooth: Array
    saturated: NDArray[np.int64]
    breached: NDArray[np.uint16]
    latched: NDArray[np.uint16]

    @property
    def end(self) -> int:
        """Number of the first measurement behind it."""
        return self.first + self.ft.size


@dataclass(frozen=True)
class Measurement:
    """One measurement; fields as in `Block`."""

    ft: int
    status: int
    counts: tuple[int, ...]
    smooth: Array
    breached: int
    latched: int


@dataclass
class Trouble:
    """What is wrong with the electronics.

    Attributes:
        status: bits that are set in every status word.
        overloaded: axes whose gages are at their end.
        push: wrench (6,) that acts besides the load, N and N·m.
        drift: of the clock, as a fraction.
    """

    status: int = 0
    overloaded: tuple[int, ...] = ()
    push: Array = field(default_factory=lambda: np.zeros(6))
    drift: float = 0.0


class Sensor:
    """The measurements of one box.

    Args:
        settings: of the box.
        load: what acts on the transducer.
        now: monotonic time of the start, s.
        first_ft: ft_sequence of the first measurement.
        defects: of the transducer.
    """

    def __init__(
        self,
        settings: Settings,
        load: Load,
        now: float,
        first_ft: int = 0,
        defects: TransducerDefects | None = None,
    ) -> None:
        self.load = load
        self._wrongs = None if defects is None else Wrongs(defects)
        self._bias_left = 0.0 if defects is None else defects.bias_left
        self._hides_saturation = defects is not None and bool(defects.hides_saturation)
        self.carried = np.zeros(6)
        """Wrench of what hangs on it, besides the load: N and N·m."""
        self.trouble = Trouble()
        self._settings = settings
        self._first_ft = first_ft
        self.clock = Clock(now, settings.internal_rate)
        self.clock.begin_loads(now)
        self.peaks = np.zeros((2, 6), np.int64)  # highest and lowest counts
        self._frozen: tuple[int, NDArray[np.int32]] | None = None
        self._kernel_of = (1.0, 0)  # weight and size
        self._kernel: Array = np.zeros((0, 0))
        self._fading: Array = np.zeros((0, 1))
        self._forget()
        self._prepare()
        self.block = self._make(0)

    def _prepare(self) -> None:
        """Work out what the settings mean for every measurement."""
        settings = self._settings
        self._limit = settings.rated * SATURATES_AT
        matrix = settings.configuration.matrix * settings.counts_per_si[:, None]
        self._gain = np.ascontiguousarray(matrix.T)
        self._zero = settings.bias @ self._gain
        self._conditions = [
            (np.uint16(n), condition)
            for n, condition in enumerate(settings.conditions)
            if condition.enabled and condition.axis >= 0
        ]
        if not settings.conditions_enabled or not settings.profile.monitor:
            self._conditions = []
        self._weight = settings.profile.smoothing(settings.filter_code, settings.internal_rate)

    def _forget(self) -> None:
        self._smooth: Array | None = None
        self._saturated = np.full(6, _LONG_AGO, np.int64)
        self._latched = 0
        self.peaks[:] = 0

    @property
    def rate(self) -> float:
        """Measurements per second by the host's clock."""
        return self._settings.internal_rate * (1.0 + self.trouble.drift)

    def measurement(self, now: float) -> Measurement:
        """Return the newest measurement."""
        block = self.block
        i = max(0, min(self.clock.index_at(now) - block.first, block.ft.size - 1))
        return Measurement(
            int(block.ft[i]),
            int(block.status[i]),
            tuple(block.counts[i].tolist()),
            block.smooth[i],
            int(block.breached[i]),
            int(block.latched[i]),
        )

    # What changes it

    def next_block(self) -> None:
        """Go on to the measurements behind the present block."""
        self._keep(self.block.end - 1)
        self.block = self._make(self.block.end)

    def change(self, now: float) -> None:
        """Make those measurements anew whose time has not come: something has changed."""
        last = max(self.block.first - 1, min(self.clock.index_at(now), self.block.end - 1))
        self._keep(last)
        if self.rate != self.clock.rate:
            self.clock.set_rate(last, self.rate)
        self._prepare()
        self.block = self._make(last + 1)

    def clear_latch(self, now: float) -> None:
        """Forget breached monitor conditions."""
        self.change(now)
        self._latched = 0
        self.change(now)

    def set_bias(self, now: float) -> None:
        """Let the present load be the bias."""
        self._settings.bias = (1.0 - self._bias_left) * self.measurement(now).smooth

    def freeze(self, now: float) -> None:
        """Repeat the newest measurement from now on."""
        newest = self.measurement(now)
        self._frozen = newest.ft, np.array(newest.counts, np.int32)

    def thaw(self) -> None:
        """Measure again."""
        self._frozen = None

    def power_up(self, now: float) -> None:
        """Begin anew at a time: numbers from 0, no bias, nothing latched."""
        self._settings.bias = np.zeros(6)
        self._frozen = None
        self._first_ft = 0
        self._forget()
        self.clock.restart(now)
        self.clock.set_rate(0, self.rate)
        self._prepare()
        self.block = self._make(0)

    # Inside

    def _keep(self, last: int) -> None:
        """Take over the state of the present block after its measurement numbered `last`."""
        block, i = self.block, last - self.block.first
        if i < 0:
            return
        self._smooth = block.smooth[i]
        self._saturated = block.saturated[i]
        self._latched = int(block.latched[i])
        if self._settings.peaks_enabled:
            counts = block.counts[: i + 1]
            self.peaks[0] = np.maximum(self.peaks[0], counts.max(axis=0))
            self.peaks[1] = np.minimum(self.peaks[1], counts.min(axis=0))

    def _make(self, first: int) -> Block:
        settings = self._settings
        size = max(8, int(settings.internal_rate * _AHEAD))
        numbers = np.arange(first, first + size)
        times = self.clock.load_times(first, size)
        load = self.load.wrench(times) + self.carried + self.trouble.push
        if self._wrongs is not None:
            load = self._wrongs.measured(load, times)
        for axis in self.trouble.overloaded:
            load[:, axis] = 2.0 * self._limit[axis]
        saturated = self._saturation(numbers, load)
        smooth = self._low_pass(np.clip(load, -self._limit, self._limit))
        scaled = np.rint(smooth @ self._gain - self._zero)
        counts = np.clip(scaled, -(2**31), 2**31 - 1).astype(np.int32)
        breached = self._breached(counts)
        latched = np.bitwise_or.accumulate(breached)
        latched |= np.uint16(self._latched)
        ft = ((numbers + self._first_ft) % _WRAP).astype(np.uint32)
        if self._frozen is not None:
            ft[:], counts[:] = self._frozen
        status = self._status(numbers, saturated, latched)
        return Block(first, ft, status, counts, smooth, saturated, breached, latched)

    def _saturation(self, numbers: NDArray[np.int64], load: Array) -> NDArray[np.int64]:
        beyond = np.abs(load) > self._limit
        if not beyond.any():
            return np.broadcast_to(self._saturated, load.shape)
        last = np.where(beyond, numbers[:, None], self._saturated)
        found: NDArray[np.int64] = np.maximum.accumulate(last, axis=0)
        return found

    def _low_pass(self, load: Array) -> Array:
        weight = self._weight
        if weight >= 1.0:
            return load
        size = load.shape[0]
        if (weight, size) != self._kernel_of:
            steps = np.arange(size)
            powers: Array = (1.0 - weight) ** np.maximum(0, steps[:, None] - steps)
            self._kernel_of = weight, size
            self._kernel = np.tril(weight * powers)
            self._fading = np.asarray((1.0 - weight) ** (steps + 1.0))[:, None]
        before = load[0] if self._smooth is None else self._smooth
        smooth: Array = self._kernel @ load + self._fading * before
        return smooth

    def _breached(self, counts: NDArray[np.int32]) -> NDArray[np.uint16]:
        breached = np.zeros(len(counts), np.uint16)
        for n, condition in self._conditions:
            values = counts[:, condition.axis].astype(np.int64) * condition.compare
            over = values > condition.value * condition.compare
            breached |= over.astype(np.uint16) << n
        return breached

    def _status(
        self,
        numbers: NDArray[np.int64],
        saturated: NDArray[np.int64],
        latched: NDArray[np.uint16],
    ) -> NDArray[np.uint32]:
        profile = self._settings.profile
        status = np.full(numbers.size, self.trouble.status, np.uint32)
        status[latched != 0] |= np.uint32(profile.monitor)
        is_long_ago = (saturated[-1] < numbers[0] - profile.hold).all()
        if is_long_ago or self._hides_saturation:
            return status
        held = saturated >= numbers[:, None] - profile.hold
        for axis in np.flatnonzero(held.any(axis=0)):
            status[held[:, axis]] |= np.uint32(profile.saturated[axis])
        return status
