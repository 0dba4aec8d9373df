"""One of the sensors at a unit: its scale, its bias, what it measured last."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from crtk_drivers.kit.software_bias import SoftwareBias
from crtk_drivers.samples import Value, Wrench, vector

__all__ = ["MEASURED", "Cell"]

MEASURED: Final = ("measured_cf", "raw/measured_cf")
SMALLEST: Final = np.array([10.0, 10.0, 10.0, 0.5, 0.5, 0.5])
"""N and N·m of which a load may drift by a small share while a bias is set; no unit tells its range."""

Block = NDArray[np.float64]


class Cell:
    """A sensor. Torques that it does not measure are 0.

    Args:
        scale: N and N·m of one count, of three axes or of six.
        bias: in software, to begin with (6,), N and N·m.
        frame_id: its frame.
        where: for messages.
    """

    def __init__(self, scale: Block, bias: Block, frame_id: str, where: str) -> None:
        self._scale = scale
        self._frame_id = frame_id
        self.bias = SoftwareBias(bias, SMALLEST, frame_id, where)
        self._raw = np.zeros(6)
        self._measured = np.zeros(6)

    def loads(self, counts: Block) -> Block:
        """Return loads (n, 6), N and N·m, of counts (n, axes)."""
        loads = np.zeros((len(counts), 6))
        loads[:, : len(self._scale)] = counts * self._scale
        return loads

    def take(self, loads: Block, times: Block, spoilt: str = "") -> None:
        """Take loads (n, 6), N and N·m, that were measured at times (n,), unless they were `spoilt` so."""
        self._raw = loads[-1]
        self._measured = self.bias.take_off(loads, times, spoilt)[-1]

    @property
    def values(self) -> Mapping[str, Value]:
        """What it measured last, by `MEASURED`."""
        pair = (self._measured, self._raw)
        return {
            name: Wrench(vector(load[:3]), vector(load[3:]), self._frame_id)
            for name, load in zip(MEASURED, pair, strict=True)
        }
