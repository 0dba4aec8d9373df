"""What was measured, with the interval in which it lies at 95 % confidence.

The interval decides: a value alone cannot tell a device that is worse from one that was measured too shortly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

Z: Final = 1.959964
"""Two-sided 95 % of the normal distribution."""

_STUDENT: Final = (
    *(12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228),
    *(2.201, 2.179, 2.160, 2.145, 2.131, 2.120, 2.110, 2.101, 2.093, 2.086),
)
"""Two-sided 95 % of Student's t for 1 to 20 degrees of freedom."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value, the interval that holds it at 95 % confidence, and of how many observations it was made.

    Raises:
        ValueError: something is no number, or the interval does not hold the value.
    """

    value: float
    lower: float
    upper: float
    n: int

    def __post_init__(self) -> None:
        if not self.lower <= self.value <= self.upper:
            raise ValueError(f"{self.value} is not within {self.lower} to {self.upper}")


def student_t(freedom: int) -> float:
    """Return the two-sided 95 % quantile of Student's t; exact to 0.002."""
    if freedom < 1:
        return math.inf
    if freedom <= len(_STUDENT):
        return _STUDENT[freedom - 1]
    return Z + 2.4 / freedom + 2.0 / freedom**2


def exact(value: float, n: int = 1) -> Estimate:
    """Return what was counted, or is known without doubt."""
    return Estimate(value, value, value, n)


def within(value: float, doubt: float, n: int = 1) -> Estimate:
    """Return a value that is known to `doubt` either way, as by the period of the samples."""
    return Estimate(value, value - doubt, value + doubt, n)


def deviation(value: float, freedom: int, n: int) -> Estimate:
    """Return a standard deviation, or an rms of residuals, of so many degrees of freedom."""
    return within(value, Z * value / math.sqrt(2.0 * freedom), n)


def wider(found: Estimate, doubt: float) -> Estimate:
    """Return an estimate with a doubt on top, either way, that its observations have in common."""
    return Estimate(found.value, found.lower - doubt, found.upper + doubt, found.n)


def scaled(found: Estimate, factor: float) -> Estimate:
    """Return an estimate in another unit; a factor below 0 turns its interval round."""
    ends = sorted((factor * found.lower, factor * found.upper))
    return Estimate(factor * found.value, ends[0], ends[1], found.n)


def in_percent(found: Estimate) -> Estimate:
    """Return a share in hundredths."""
    return scaled(found, 100.0)


def mean(values: ArrayLike) -> Estimate:
    """Return the mean of repeated trials, by Student's t. One trial has no interval but infinity.

    Raises:
        ValueError: no values, or not finite ones.
    """
    found = _checked(values)
    middle = float(found.mean())
    if found.size == 1:
        return Estimate(middle, -math.inf, math.inf, 1)
    half = student_t(found.size - 1) * float(found.std(ddof=1)) / math.sqrt(found.size)
    return Estimate(middle, middle - half, middle + half, found.size)


def line(x: ArrayLike, y: ArrayLike) -> tuple[Estimate, Estimate]:
    """Return where the line that fits best begins, at 0, and its slope, by Student's t.

    Raises:
        ValueError: not as many of one as of the other, none of them, not finite, or all at one `x`.
    """
    at, found = _checked(x), _checked(y)
    n, middle = found.size, float(at.mean())
    spread = float(((at - middle) ** 2).sum())
    if at.size != n or spread == 0.0:
        raise ValueError(f"{n} values at {np.unique(at).size} places are no line")
    slope = float((at - middle) @ found) / spread
    begin = float(found.mean()) - slope * middle
    left = float(((found - begin - slope * at) ** 2).sum())
    t = student_t(n - 2)
    sigma = math.sqrt(left / (n - 2)) if n > 2 else math.inf
    doubts = (sigma * math.sqrt(1.0 / n + middle**2 / spread), sigma / math.sqrt(spread))
    return (
        Estimate(begin, begin - t * doubts[0], begin + t * doubts[0], n),
        Estimate(slope, slope - t * doubts[1], slope + t * doubts[1], n),
    )


def share(hits: int, n: int) -> Estimate:
    """Return the share of `hits` among `n`, by Wilson's score interval.

    Raises:
        ValueError: nothing was counted, or more hits than that.
    """
    if not 0 <= hits <= n or n == 0:
        raise ValueError(f"{hits} of {n}")
    found = hits / n
    scale = 1.0 + Z**2 / n
    middle = (found + Z**2 / (2 * n)) / scale
    half = Z * math.sqrt(found * (1.0 - found) / n + Z**2 / (4 * n**2)) / scale
    return Estimate(found, max(0.0, min(found, middle - half)), max(found, middle + half), n)


def quantile(values: ArrayLike, at: float) -> Estimate:
    """Return a quantile, with the order statistics between which it lies.

    Args:
        values: observations.
        at: above 0 and below 1.

    Raises:
        ValueError: no values, or not finite ones.
    """
    found = np.sort(_checked(values))
    n = found.size
    middle = float(np.quantile(found, at))
    half = Z * math.sqrt(n * at * (1.0 - at))
    first, last = math.floor(n * at - half) - 1, math.ceil(n * at + half)
    lower = float(found[max(0, first)])
    # Past the greatest observation nothing is known, but that it is rare.
    upper = float(found[min(n - 1, last)])
    return Estimate(middle, min(lower, middle), max(upper, middle), n)


def greatest(values: ArrayLike) -> Estimate:
    """Return the greatest of what was seen: it is certain, and says nothing of what was not seen."""
    found = _checked(values)
    return exact(float(found.max()), found.size)


def _checked(values: ArrayLike) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    found = np.asarray(values, dtype=np.float64).ravel()
    if found.size == 0:
        raise ValueError("no observations")
    if not np.isfinite(found).all():
        raise ValueError("an observation is not finite")
    return found
