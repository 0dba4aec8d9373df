"""Numbers out of signals: lines, sines, noise, when something came to rest. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from crtk_drivers.samples import Array, Vector


@dataclass(frozen=True, slots=True)
class Sine:
    """``amplitude · sin(2π f t + phase)``, with what is left over as an rms."""

    amplitude: float
    phase: float
    rms: float


def fit_sine(at: Vector, values: Vector, frequency: float) -> Sine:
    """Return the sine of a known frequency that fits best, beside a line.

    Raises:
        ValueError: fewer than eight values.
    """
    if at.size < 8:
        raise ValueError(f"{at.size} samples of a sine")
    angle = 2.0 * math.pi * frequency * at
    columns = np.column_stack((np.sin(angle), np.cos(angle), np.ones_like(at), at - at.mean()))
    solution, *_ = np.linalg.lstsq(columns, values, rcond=None)
    left = values - columns @ solution
    in_phase, quadrature = float(solution[0]), float(solution[1])
    return Sine(
        math.hypot(in_phase, quadrature),
        math.atan2(quadrature, in_phase),
        float(np.sqrt(np.mean(left**2))),
    )


def noise(values: Array) -> Vector:
    """Return the standard deviation of each column (N, n) about its own slow drift."""
    if len(values) < 3:
        return np.zeros(values.shape[1])
    steps = np.arange(len(values), dtype=float)
    columns = np.column_stack((np.ones_like(steps), steps))
    solution, *_ = np.linalg.lstsq(columns, values, rcond=None)
    found: Vector = np.std(values - columns @ solution, axis=0, ddof=2 if len(values) > 2 else 0)
    return found


def resolution(values: Array) -> Vector:
    """Return the smallest step that each column (N, n) makes; 0 where it makes none."""
    found = np.zeros(values.shape[1])
    for index, column in enumerate(values.T):
        steps = np.diff(np.unique(column))
        found[index] = steps.min() if steps.size else 0.0
    return found


def slope(at: Vector, values: Vector) -> float:
    """Return the slope of the line that fits best."""
    centred = at - at.mean()
    weight = float(centred @ centred)
    return float(centred @ (values - values.mean())) / weight if weight > 0.0 else math.nan


def rest_time(at: Vector, position: Array, since: float, tolerance: Vector) -> float:
    """Return the seconds after `since` at which every column stays within its tolerance of where it ends.

    Args:
        at: (N,) in s.
        position: (N, n).
        since: on the axis of `at`.
        tolerance: (n,).

    Returns:
        0 if it did not move any more; NaN without samples after `since`.
    """
    after = at >= since
    if not after.any():
        return math.nan
    away = np.abs(position[after] - position[-1]) > tolerance
    moving = np.flatnonzero(away.any(axis=1))
    if not moving.size:
        return 0.0
    times = at[after]
    return float(times[min(moving[-1] + 1, times.size - 1)] - since)


def largest_line(
    values: Vector, rate: float, above: float, window: float = 2.0
) -> tuple[float, float, float]:
    """Return frequency, amplitude and floor of the largest line in the spectrum (Welch, Hann window).

    Args:
        values: evenly sampled.
        rate: samples a second.
        above: Hz below which nothing is looked for.
        window: seconds of one piece; pieces overlap by half.

    Returns:
        Hz, the amplitude of a sine, and the median amplitude of all other bins.

    Raises:
        ValueError: shorter than one piece.
    """
    size = int(window * rate)
    if values.size < size or size < 8:
        raise ValueError(f"{values.size / rate:.1f} s are too short for a spectrum")
    shape = np.hanning(size)
    pieces = [values[begin : begin + size] for begin in range(0, values.size - size + 1, size // 2)]
    power = np.mean(
        [np.abs(np.fft.rfft((piece - piece.mean()) * shape)) ** 2 for piece in pieces], axis=0
    )
    amplitude = 2.0 * np.sqrt(power) / shape.sum()
    frequency = np.fft.rfftfreq(size, 1.0 / rate)
    looked = np.flatnonzero(frequency > above)
    best = int(looked[np.argmax(amplitude[looked])])
    others = looked[np.abs(looked - best) > 2]
    return float(frequency[best]), float(amplitude[best]), float(np.median(amplitude[others]))
