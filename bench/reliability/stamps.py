"""By how much a stamp is younger than what it stands on: what was measured beside what was true. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

__all__ = ["WINDOW", "Look", "held_up", "too_young"]

WINDOW: Final = 3.0
"""Seconds before a stamp in which it is looked for where joints have been."""

GAP: Final = 0.1
"""Seconds between two looks between which nobody knows how joints went."""


class Look(NamedTuple):
    """Where the joints really were: somewhen between when it was asked and answered (monotonic s)."""

    at: float
    joints: np.ndarray
    done: float


def too_young(looks: Sequence[Look], position: np.ndarray, stamp: float, tolerance: float) -> float:
    """Return the seconds by which a stamp is too young at the least; 0.0 where nothing shows it.

    A measurement may be younger than its stamp, which harms nobody. So it is as old as its stamp says if
    the joints were there at any time since. Doubts about when a look saw them are in favour of the stamp.
    Nothing is shown where they were there at no time in `WINDOW`, as at the end of a swing that no look met.

    Args:
        looks: in order; the last one was asked for after the measurement had come.
        position: (n,) that was measured.
        stamp: of it, in monotonic seconds.
        tolerance: how far (rad, m) a joint may be from where it seems to be.
    """
    recent = [look for look in looks[-_reach(looks, stamp) :] if look.joints.size == position.size]
    if not position.size or not recent or recent[0].done > stamp:
        return 0.0
    times = np.array([look.done for look in recent])[::-1]
    truth = np.array([look.joints for look in recent])[::-1]
    low = np.minimum.accumulate(truth, axis=0) - tolerance
    high = np.maximum.accumulate(truth, axis=0) + tolerance
    inside = (low <= position) & (position <= high)
    if not inside[-1].all():
        return 0.0
    latest = min(
        _reached(times, low, high, position, joint, int(first))
        for joint, first in enumerate(inside.argmax(axis=0))
    )
    return max(0.0, stamp - latest)


def held_up(looks: Sequence[Look], pause: float) -> float:
    """Return the longest time (s) that the machine gave no time to whoever looks, in the last `WINDOW`.

    Args:
        looks: in order.
        pause: seconds between two of them.
    """
    recent = looks[-_reach(looks, looks[-1].done) :] if looks else looks
    gaps = [after.at - before.done for before, after in pairwise(recent)]
    return max(0.0, max(gaps, default=0.0) - pause)


def _reach(looks: Sequence[Look], stamp: float) -> int:
    """Return how many of the last looks reach back to `WINDOW` before the stamp."""
    count = 0
    for look in reversed(looks):
        count += 1
        if look.done < stamp - WINDOW:
            break
    return count


def _reached(
    times: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    position: np.ndarray,
    joint: int,
    first: int,
) -> float:
    """Return the latest time since which a joint was there, between two looks by its way between them."""
    if first == 0:
        return float(times[0])
    later, earlier = float(times[first - 1]), float(times[first])
    if later - earlier > GAP:
        return later
    near, far, at = (
        (low[first - 1, joint], low[first, joint], position[joint])
        if position[joint] < low[first - 1, joint]
        else (-high[first - 1, joint], -high[first, joint], -position[joint])
    )
    return later - (later - earlier) * float((near - at) / (near - far))
