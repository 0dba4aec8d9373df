"""From batches of measurements to full-rate blocks and to the values that are published.

The I/O thread calls `Pipeline.take`; bias, tool and orientation may be set from any thread: each setting
replaces one immutable `Compensation`.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from crtk_driver_ati_netft.blocks import MEASUREMENT, Block, BlockReader, BlockRing
from crtk_driver_ati_netft.compensation import GRAVITY, NO_LOAD, UNKNOWN_LOAD, Compensation, Tool
from crtk_driver_ati_netft.stream import Batch
from crtk_drivers.kit.clock_fit import WallClock
from crtk_drivers.kit.sensing.filters import Filter, Gaps, LowPass, Mean
from crtk_drivers.samples import Array, Vector

RING: Final = 1 << 16
"""Measurements that are kept: 8 seconds of the fastest sensor."""
RATE_CHANGE: Final = 0.02
"""Share by which the rate of records must change for the filter to be made anew."""

CLOCK_NOISE: Final = 100_000
"""ns by which the distance of two clocks seems to change from one batch to the next: no clock was set."""

Listener = Callable[[Block], None]

logger = logging.getLogger(__name__)


class Published(NamedTuple):
    """A value to be published.

    `value` (6,) is filtered and compensated, None if what is to be taken off is not known; `raw` (6,) is the
    newest measurement in it; `time` is that of the newest in monotonic seconds, and `wall_ns` in ns since
    the epoch.
    """

    value: Vector | None
    raw: Vector
    time: float
    wall_ns: int


class Pipeline:
    """What becomes of the measurements of one sensor.

    Args:
        rate: of the published values, in Hz.
        low_pass: cut-off in Hz; None for the mean of all measurements since the last value.
        matrix: to the point and the axes of the published values, see `compensation.transfer`.
        gravity: in the world, m/s² (3,).
        where: the device, for messages.
    """

    def __init__(
        self,
        rate: float,
        low_pass: float | None,
        matrix: Array,
        gravity: Vector = GRAVITY,
        where: str = "",
    ) -> None:
        self.ring = BlockRing(RING)
        self._rate = rate
        self._low_pass = low_pass
        self._gravity = gravity
        self._where = where
        self._lock = threading.Lock()
        self._compensation = Compensation(matrix=matrix)
        self._tool: Tool | None = None
        self._rotation: Array | None = None
        self._rotation_ends = -math.inf
        self._filter: Filter = Mean(1)
        self._gaps = Gaps()
        self._record_rate = 0.0
        self._wall_clock = WallClock()
        self._stamp = 0
        self._listeners: tuple[Listener, ...] = ()

    # --------------------------------------------------------------------------- settings, any thread

    @property
    def compensation(self) -> Compensation:
        """What is taken off at present."""
        return self._compensation

    @property
    def tool(self) -> Tool | None:
        """The tool whose weight is taken off."""
        return self._tool

    @property
    def rotation(self) -> Array | None:
        """The rotation of the sensor in the world (3, 3), None if it is not known now."""
        with self._lock:
            return self._rotation if time.monotonic() <= self._rotation_ends else None

    def set_bias(self, bias: Vector) -> None:
        """Take off this bias (6,), in the sensor's frame, N and N·m."""
        with self._lock:
            self._compensation = replace(self._compensation, bias=bias)

    def set_tool(self, tool: Tool | None) -> None:
        """Take off the weight of this tool; while the orientation is not known, no load is known either."""
        with self._lock:
            self._tool = tool
            self._weigh()

    def set_rotation(self, rotation: Array | None, lasts: float = math.inf) -> None:
        """Take the rotation of the sensor in the world (3, 3), which counts for so many s; None: unknown."""
        with self._lock:
            self._rotation = rotation
            self._rotation_ends = time.monotonic() + lasts
            self._weigh()

    def _weigh(self) -> None:
        weight = NO_LOAD
        if self._tool is not None and self._tool.mass:
            weight = UNKNOWN_LOAD
            if self._rotation is not None:
                weight = self._tool.weight(self._rotation, self._gravity)
        self._compensation = replace(self._compensation, weight=weight)

    def _present(self) -> Compensation:
        """Return what is to be taken off now."""
        if self._rotation is not None and time.monotonic() > self._rotation_ends:
            with self._lock:
                if time.monotonic() > self._rotation_ends:
                    self._rotation = None
                    self._weigh()
        return self._compensation

    # ------------------------------------------------------------------------- full rate, any thread

    def reader(self) -> BlockReader:
        """Return a reader of everything from now on."""
        return self.ring.reader()

    def add_listener(self, listener: Listener) -> None:
        """Call `listener` with each block, in the I/O thread; it must return at once.

        One that raises is called no more, and its error is logged.
        """
        with self._lock:
            self._listeners = (*self._listeners, listener)

    def remove_listener(self, listener: Listener) -> None:
        """Call it no more."""
        with self._lock:
            self._listeners = tuple(one for one in self._listeners if one != listener)

    # --------------------------------------------------------------------------------- the I/O thread

    @property
    def delay(self) -> float:
        """By how much the published values lag behind their stamp, in s."""
        return self._filter.delay / self._record_rate if self._record_rate else 0.0

    @property
    def rest(self) -> int:
        """Measurements that are in no value yet."""
        return self._filter.rest

    @property
    def pending(self) -> float:
        """Seconds until the next value can be there."""
        period = 1.0 / self._rate
        return period - self._filter.rest / self._record_rate if self._record_rate else period

    def take(self, batch: Batch, record_rate: float) -> Published | None:
        """Pass measurements on; return the newest value to be published, None if there is none.

        Args:
            batch: as it arrived.
            record_rate: of the measurements in Hz; 0 if unknown.
        """
        compensation = self._present()
        block = np.empty(len(batch), MEASUREMENT)
        block["stamp"] = self._stamps(batch)
        block["ticks"] = batch.ticks
        block["sequence"] = batch.sequence
        block["status"] = batch.status
        block["raw"] = batch.values
        block["wrench"] = compensation.apply(batch.values)
        block.setflags(write=False)
        self.ring.add(block)
        for listener in self._listeners:
            self._tell(listener, block)
        self._tune(record_rate)
        longest = max(1.0 / self._rate, 2.0 * self.delay)
        filtered = self._gaps.filtered(self._filter, batch.values, batch.times, longest)
        if filtered is None:
            return None
        index = len(batch) - 1 - self._filter.rest
        value = compensation.apply(filtered) if compensation.is_known else None
        return Published(
            value, batch.values[index], float(batch.times[index]), int(block["stamp"][index])
        )

    def _stamps(self, batch: Batch) -> NDArray[np.int64]:
        """Return the times of measurements (n,) in ns since the epoch; back only if that clock is set."""
        stamps = (batch.times * 1e9).astype(np.int64) + self._wall_clock.offset()
        back = self._stamp - stamps[0]
        if 0 <= back < CLOCK_NOISE:
            stamps += back + 1
        self._stamp = int(stamps[-1])
        return stamps

    def restart(self) -> None:
        """Forget what was filtered: the stream begins anew."""
        self._filter.reset()

    def _tell(self, listener: Listener, block: Block) -> None:
        try:
            listener(block)
        except Exception:
            logger.exception("%s: a listener failed and is called no more", self._where)
            self.remove_listener(listener)

    def _tune(self, record_rate: float) -> None:
        if not record_rate or abs(record_rate - self._record_rate) <= RATE_CHANGE * record_rate:
            return
        self._record_rate = record_rate
        if self._low_pass is not None and self._low_pass < 0.5 * record_rate:
            self._filter = LowPass(self._low_pass, record_rate)
        else:
            self._filter = Mean(max(1, round(record_rate / self._rate)))
