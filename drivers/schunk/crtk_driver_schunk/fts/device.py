"""An FTS as a CRTK device: it measures, and that is all.

Connected, it measures in any state. ENABLED says that somebody relies on it: an error ends it in FAULT.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np
from typing_extensions import override

from crtk_driver_schunk.fts.config import FtsConfig
from crtk_driver_schunk.fts.frames import STATUS, Op
from crtk_driver_schunk.fts.stream import Batch, FtsStream
from crtk_drivers.device import (
    Answer,
    Capabilities,
    Condition,
    Input,
    Note,
    Sensor,
    Service,
    Severity,
    Steps,
    StopPolicy,
)
from crtk_drivers.errors import ConnectionLost
from crtk_drivers.kit import until
from crtk_drivers.kit.clock_fit import WallClock
from crtk_drivers.kit.sensing.filters import Filter, Gaps, LowPass, Mean
from crtk_drivers.kit.sensing.load_monitor import LoadMonitor
from crtk_drivers.kit.software_bias import SoftwareBias, load_text
from crtk_drivers.samples import Array, Sample, Stamp, Wrench
from crtk_drivers.state import OperatingState

__all__ = ["FtsDevice"]

PASSED: Final = 0.1
"""Seconds of measurements that were on their way when the sensor was tared."""
LONGEST: Final = 5.0
"""Seconds after which measurements that do not come are not waited for."""
SMALLEST: Final = np.array([100.0, 100.0, 100.0, 5.0, 5.0, 5.0])
"""N and N·m of which a load may drift by a small share while a bias is set; no box tells its own range."""


class FtsDevice(Sensor):
    """One sensor."""

    def __init__(self, config: FtsConfig) -> None:
        self._config = config
        self._aborted = False
        self._stream = FtsStream(config, lambda: self._aborted)
        self._monitor = LoadMonitor(STATUS, 1.0, config.on_saturation)
        self._filter: Filter = Mean(1)
        self._gaps = Gaps()
        where = f"schunk-fts {self.address}"
        self._bias = SoftwareBias(np.array(config.bias), SMALLEST, config.frame_id, where)
        self._newest = np.zeros(6)
        self._newest_since = 0.0
        self._wall_clock = WallClock()
        self._doubt = ""
        self._was_open = self._just_opened = False
        self._due = 0.0
        self._capabilities = Capabilities(
            measured=("measured_cf", "raw/measured_cf"),
            rate=config.rate,
            paced_by_stream=True,
            base_frame=config.frame_id,
            tool_frame=config.frame_id,
            transition_timeout=10.0,
            stop=StopPolicy(0.0, "has nothing that moves"),
        )

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def address(self) -> str:
        return f"{self._config.host}:{self._config.tcp_port}"

    @override
    def open(self, deadline: float) -> None:
        self._stream.open(deadline)
        rate = float(self._stream.rate)
        low_pass = self._config.low_pass
        if low_pass is not None and low_pass < 0.5 * rate:
            self._filter = LowPass(low_pass, rate)
        else:
            self._filter = Mean(max(1, round(rate / self._config.rate)))
        self._monitor.clear()
        if self._was_open:
            self._doubt = "the connection was lost"
        self._was_open = self._just_opened = True
        self._due = 0.0

    @override
    def abort_open(self) -> None:
        self._aborted = True

    @override
    def close(self) -> None:
        self._stream.close()

    @override
    def read(self, deadline: float) -> Sample | None:
        while True:
            batch = self._stream.receive(deadline, min(self._due, deadline))
            if batch is None:
                return None
            self._follow(batch)
            longest = max(1.0 / self._config.rate, 2.0 * self._filter.delay / self._stream.rate)
            filtered = self._gaps.filtered(self._filter, batch.values, batch.times, longest)
            now = time.monotonic()
            spoilt = self._monitor.error(now) or self._monitor.saturation(now)
            self._bias.take_off(batch.values, batch.times, spoilt)
            rate = self._stream.rate
            self._due = time.monotonic() + 1.0 / self._config.rate - self._filter.rest / rate
            if filtered is not None:
                return self._sample(filtered, batch)

    def _follow(self, batch: Batch) -> None:
        now = time.monotonic()
        self._monitor.take(batch.status, batch.values, now)
        just_opened, self._just_opened = self._just_opened, False
        if batch.restarted and not just_opened:
            raise ConnectionLost(
                "the box was restarted: its tare is gone",
                where=self._stream.where,
                remedy="The driver connects again. Set the bias anew.",
            )

    def _sample(self, filtered: Array, batch: Batch) -> Sample:
        index = len(batch) - 1 - self._filter.rest
        at = float(batch.times[index])
        stamp = Stamp(int(1e9 * at) + self._wall_clock.offset(), at)
        if not self._monitor.is_value_valid(self._filter.rest):
            stamp = Stamp(0, at)
        self._newest, self._newest_since = filtered, float(batch.times[0])
        values = {
            "measured_cf": self._wrench(filtered - self._bias.load),
            "raw/measured_cf": self._wrench(batch.values[index].copy()),
        }
        return Sample(stamp, values)

    def _wrench(self, load: Array) -> Wrench:
        load.setflags(write=False)
        return Wrench(load[:3], load[3:], self._config.frame_id)

    @property
    @override
    def condition(self) -> Condition:
        reason = self._monitor.fault(time.monotonic())
        return Condition(OperatingState.FAULT, reason) if reason else Condition()

    # -------------------------------------------------------------------------------------------- bias

    @property
    @override
    def services(self) -> Mapping[str, Service]:
        own = self._bias.services
        return {
            **own,
            "bias": replace(own["bias"], run=self._measure),
            "sensor_bias": Service("make the present load zero, in the sensor (tare)", self._tare),
            "sensor_unbias": Service("remove the sensor's own tare", self._reset_tare),
        }

    def _measure(self) -> Answer:
        told = yield from self._bias.measure()
        self._doubt = ""
        return told

    def _tare(self) -> Answer:
        self._doubt = "it was being tared, and that was not finished"
        yield from self._asked(Op.TARE)
        yield from self._bias.remove()
        self._doubt = ""
        return f"tared; it measures {load_text(self._newest)}. Software bias removed"

    def _reset_tare(self) -> Answer:
        before, self._doubt = self._doubt, "its tare was being removed, and that was not finished"
        yield from self._asked(Op.RESET_TARE)
        self._doubt = before
        return f"tare removed; it measures {load_text(self._newest)}"

    def _asked(self, op: Op) -> Steps:
        yield from self._stream.asking(op)
        passed = time.monotonic() + PASSED
        # By when they were measured: what a thread finds that was held up was on its way before.
        yield from until(lambda: self._newest_since > passed, LONGEST)

    @property
    @override
    def inputs(self) -> Mapping[str, Input]:
        return self._bias.inputs

    # ------------------------------------------------------------------------------------- diagnostics

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        monitor = self._monitor
        return {
            **self._stream.counters,
            "record_rate": self._stream.clock_fit.tick_rate,
            "error_records": float(monitor.error_records),
            "saturated_records": float(monitor.saturated_records),
        }

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        now = time.monotonic()
        bias = f"unknown: {self._doubt}. Set the bias anew, with the sensor unloaded"
        found = [
            (Severity.ERROR, "status", self._monitor.error(now)),
            (Severity.ERROR, "saturation", self._monitor.saturation(now)),
            (Severity.WARNING, "notice", ", ".join(self._monitor.notices)),
            (Severity.WARNING, "bias", bias if self._doubt else ""),
            (Severity.INFO, "sensor", self._stream.name),
        ]
        return tuple(Note(severity, key, text) for severity, key, text in found if text)
