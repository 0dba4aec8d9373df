"""Fewer values out of many: the mean of a window, or a low-pass. Both have a gain of exactly one at rest."""

from __future__ import annotations

import math
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

Block = NDArray[np.float64]
"""(n, axes), oldest first."""

LONGEST: Final = 64
"""Values that the low-pass filters at once."""


class Filter(Protocol):
    """Takes values in blocks of any size and knows the newest result."""

    @property
    def delay(self) -> float:
        """Group delay at rest, in values."""

    @property
    def rest(self) -> int:
        """Values taken that are not in any result yet."""

    def take(self, values: Block) -> Block | None:
        """Return the newest result (axes,), None if there is no new one."""

    def reset(self) -> None:
        """Forget everything: the next value begins anew."""


def behind_gap(times: NDArray[np.float64], before: float, longest: float) -> int:
    """Return the index of the first value behind the last gap; -1 if there is none.

    Args:
        times: of values (n,), s, ascending.
        before: of the value before them; infinite if there was none.
        longest: s between two values that are no gap.
    """
    gaps = np.flatnonzero(np.diff(times, prepend=before) > longest)
    return int(gaps[-1]) if gaps.size else -1


class Gaps:
    """Finds the gaps in one stream, and lets its filter begin anew behind them."""

    def __init__(self) -> None:
        self._newest = math.inf

    def filtered(
        self, by: Filter, values: Block, times: NDArray[np.float64], longest: float
    ) -> Block | None:
        """Return the newest result of a filter, which mixes nothing across a gap; None if there is none.

        Args:
            by: the filter.
            values, times: what was measured (n, axes), and when (n,), in s.
            longest: s between two values that are no gap.
        """
        before, self._newest = self._newest, float(times[-1])
        behind = behind_gap(times, before, longest)
        if behind >= 0:
            by.reset()
            values = values[behind:]
        return by.take(values)


class Mean:
    """The mean of each window of so many values.

    Args:
        window: values.
    """

    def __init__(self, window: int) -> None:
        if window < 1:
            raise ValueError(f"a window of {window} values")
        self.window = window
        self._rest: Block = np.empty((0, 0))

    @property
    def delay(self) -> float:
        """See `Filter`."""
        return (self.window - 1) / 2.0

    @property
    def rest(self) -> int:
        """See `Filter`."""
        return len(self._rest)

    def take(self, values: Block) -> Block | None:
        """See `Filter`."""
        if len(self._rest):
            values = np.concatenate((self._rest, values))
        whole = len(values) // self.window * self.window
        self._rest = values[whole:]
        if not whole:
            return None
        last = values[whole - self.window : whole]
        first = last[0]
        # from its first value, so that the mean of equal values is that value to the last bit
        result: Block = first + np.add.reduce(last - first) / self.window
        return result

    def reset(self) -> None:
        """See `Filter`."""
        self._rest = np.empty((0, 0))


class LowPass:
    """A Butterworth low-pass of second order (bilinear transform, exact at its cut-off).

    Its state is what a constant input would leave, plus deviations from it: a load that rests comes out
    as it went in.

    Args:
        cutoff: -3 dB frequency in Hz.
        rate: of the values, in Hz; above twice the cut-off.
    """

    def __init__(self, cutoff: float, rate: float) -> None:
        if not 0.0 < cutoff < 0.5 * rate:
            raise ValueError(f"a cut-off of {cutoff:g} Hz needs values at more than twice that")
        self.cutoff = cutoff
        self.rate = rate
        g, damping = math.tan(math.pi * cutoff / rate), math.sqrt(2.0)
        scale = 1.0 / (1.0 + g * (g + damping))
        # Two integrators (trapezoidal): s1 is at rest 0, s2 the value.
        a, b, c = scale, g * scale, g * g * scale
        step = np.array([[2.0 * a - 1.0, -2.0 * b], [2.0 * b, 1.0 - 2.0 * c]])
        push = np.array([2.0 * b, 2.0 * c])
        read, through = np.array([b, 1.0 - c]), c
        power = np.eye(2)
        response = np.empty(LONGEST)
        pushes = np.empty((LONGEST, 2))
        powers = np.empty((LONGEST + 1, 2, 2))
        for i in range(LONGEST):
            powers[i] = power
            pushes[i] = power @ push
            response[i] = through if i == 0 else read @ pushes[i - 1]
            power = step @ power
        powers[LONGEST] = power
        lag = np.subtract.outer(np.arange(LONGEST), np.arange(LONGEST))
        self._response = np.where(lag >= 0, response[np.maximum(lag, 0)], 0.0)
        self._pushes = pushes[::-1].T.copy()
        self._powers = powers
        self._read = read
        self.rest = 0
        self._state: tuple[Block, Block] | None = None

    @property
    def delay(self) -> float:
        """See `Filter`."""
        return math.sqrt(2.0) / (2.0 * math.tan(math.pi * self.cutoff / self.rate))

    def take(self, values: Block) -> Block | None:
        """See `Filter`."""
        results = self.filter(values)
        return results[-1] if len(results) else None

    def filter(self, values: Block) -> Block:
        """Return a result for each value (n, axes)."""
        if not len(values):
            return values
        state = self._state or (np.zeros(values.shape[1]), values[0])
        parts = []
        for begin in range(0, len(values), LONGEST):
            part, state = self._filter_part(values[begin : begin + LONGEST], *state)
            parts.append(part)
        self._state = state
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def _filter_part(
        self, values: Block, speed: Block, base: Block
    ) -> tuple[Block, tuple[Block, Block]]:
        n = len(values)
        off = values - base
        fading = self._powers[:n, :, 0] @ self._read
        results: Block = base + self._response[:n, :n] @ off + np.outer(fading, speed)
        pushed = self._pushes[:, LONGEST - n :] @ off
        power = self._powers[n]
        return results, (
            power[0, 0] * speed + pushed[0],
            base + (power[1, 0] * speed + pushed[1]),
        )

    def reset(self) -> None:
        """See `Filter`."""
        self._state = None
