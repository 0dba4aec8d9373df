"""Defects of a simulated transducer, for a bench that must find them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from crtk_sim_backends.kit.loads import Array


@dataclass(frozen=True, kw_only=True)
class TransducerDefects:
    """What is wrong with what is measured; forces in N, torques in N·m by the same number.

    Attributes:
        seed: of all that is random.
        noise: standard deviation on each axis.
        line: amplitude of a line on each axis, at `line_frequency` Hz.
        drift: of each axis, in N/s and N·m/s.
        scale: factor on all axes: a known mass has another one.
        exchanged: two axes, 0 to 5, whose values are exchanged.
        bias_left: share of the load that a bias leaves.
        hides_saturation: 1: no status bit says that an axis is saturated.
    """

    seed: int = 1
    noise: float = 0.0
    line: float = 0.0
    line_frequency: float = 50.0
    drift: float = 0.0
    scale: float = 1.0
    exchanged: tuple[int, ...] = ()
    bias_left: float = 0.0
    hides_saturation: int = 0

    def __post_init__(self) -> None:
        within = all(0 <= axis < 6 for axis in self.exchanged)
        if not within or len(self.exchanged) not in (0, 2):
            raise ValueError("defects: exchanged takes two axes of 0 to 5, such as exchanged=0+2")


class Wrongs:
    """Makes of a load what a transducer with defects measures.

    Args:
        defects: of the transducer.
    """

    def __init__(self, defects: TransducerDefects) -> None:
        self._defects = defects
        self._random = np.random.default_rng(defects.seed)

    def measured(self, load: Array, times: Array) -> Array:
        """Return what is measured (n, 6) of a load at times (n,), s since the start."""
        defects = self._defects
        found: Array = defects.scale * load
        if defects.exchanged:
            one, other = defects.exchanged
            found[:, [one, other]] = found[:, [other, one]]
        wave = np.sin(2.0 * math.pi * defects.line_frequency * times)
        found += (defects.line * wave + defects.drift * times)[:, None]
        if defects.noise:
            found += self._random.normal(0.0, defects.noise, found.shape)
        return found
