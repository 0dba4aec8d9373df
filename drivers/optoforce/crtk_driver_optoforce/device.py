"""An OptoForce unit as a CRTK device: one sensor, or four of them behind it.

Connected, it measures in any state. ENABLED says that somebody relies on it: an error ends it in FAULT.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Final

import numpy as np
from typing_extensions import override

from crtk_driver_optoforce.cell import MEASURED, Cell
from crtk_driver_optoforce.config import OptoForceConfig
from crtk_driver_optoforce.frames import STATUS, sensor_concerned
from crtk_driver_optoforce.link import OptoForceLink
from crtk_drivers.device import (
    Answer,
    Capabilities,
    Condition,
    Device,
    Input,
    Note,
    Sensor,
    Service,
    Severity,
    StopPolicy,
)
from crtk_drivers.kit.device_behind import DeviceBehind
from crtk_drivers.kit.sensing.load_monitor import LoadMonitor
from crtk_drivers.kit.sensing.status_words import combined
from crtk_drivers.samples import Sample, Stamp
from crtk_drivers.state import OperatingState

__all__ = ["OptoForceDevice"]

STOP: Final = StopPolicy(0.0, "has nothing that moves")


class OptoForceDevice(Sensor):
    """One unit with all that hangs at it."""

    def __init__(self, config: OptoForceConfig) -> None:
        self._config = config
        self._aborted = False
        self._link = OptoForceLink(config, lambda: self._aborted)
        self._monitor = LoadMonitor(STATUS, 1.0, config.on_saturation)
        self._concerned = ""
        self._doubt = ""
        self._zeroed = False
        several = config.sensors > 1
        frames = [
            f"{config.frame_id}_{number + 1}" if several else config.frame_id
            for number in range(config.sensors)
        ]
        scales = [config.scale_of(number) for number in range(config.sensors)]
        self._cells = [
            Cell(np.array(scale), np.array(config.bias), frame, f"optoforce {config.port}, {frame}")
            for scale, frame in zip(scales, frames, strict=True)
        ]
        self.newest: Sample | None = None
        """The stamp of what was measured last; None while it is not connected."""
        self._children = {
            f"sensor_{number + 1}": CellDevice(self, cell, frames[number], float(config.rate))
            for number, cell in enumerate(self._cells if several else ())
        }
        self._capabilities = Capabilities(
            measured=() if several else MEASURED,
            rate=float(config.rate),
            paced_by_stream=True,
            base_frame=config.frame_id,
            tool_frame=config.frame_id,
            transition_timeout=10.0,
            stop=STOP,
        )

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def address(self) -> str:
        return self._config.port

    @property
    @override
    def children(self) -> Mapping[str, Device]:
        return self._children

    @property
    @override
    def followers(self) -> frozenset[str]:
        return frozenset(self._children)

    @override
    def open(self, deadline: float) -> None:
        self._link.open(deadline)
        self._monitor.clear()
        if self._zeroed:
            self._doubt = "the connection was lost, and its own zero with it"

    @property
    def is_open(self) -> bool:
        """Whether the unit is connected."""
        return self._link.is_open

    @override
    def abort_open(self) -> None:
        self._aborted = True

    @override
    def close(self) -> None:
        self.newest = None
        self._link.close()

    @override
    def read(self, deadline: float) -> Sample | None:
        batch = self._link.read(deadline)
        if batch is None:
            return None
        axes, now = self._config.axes, time.monotonic()
        word = combined(batch.status)
        if word:
            self._concerned = sensor_concerned(word)
        self._monitor.take(batch.status, np.empty((0, 6)), now)
        spoilt = self._of(self._monitor.error(now) or self._monitor.saturation(now))
        for number, cell in enumerate(self._cells):
            loads = cell.loads(batch.counts[:, number * axes : (number + 1) * axes])
            cell.take(loads, batch.times, spoilt)
        at = float(batch.times[-1])
        stamp = Stamp.at(at) if self._monitor.is_valid(batch.status) else Stamp(0, at)
        single = self._cells[0].values if not self._children else {}
        self.newest = Sample(stamp, single)
        return self.newest

    @property
    @override
    def condition(self) -> Condition:
        reason = self._monitor.fault(time.monotonic())
        return Condition(OperatingState.FAULT, self._of(reason)) if reason else Condition()

    def _of(self, reason: str) -> str:
        """Return a reason with the sensor that it is of."""
        return f"{reason} ({self._concerned})" if reason and self._concerned else reason

    # -------------------------------------------------------------------------------------------- bias

    @property
    @override
    def services(self) -> Mapping[str, Service]:
        own = {
            "sensor_bias": Service("make the present load zero, in the unit", self._zero),
            "sensor_unbias": Service("remove the unit's own zero", self._remove_zero),
        }
        return own if self._children else {**self._cells[0].bias.services, **own}

    def _zero(self) -> Answer:
        self._doubt = "it was being zeroed in the unit, and that was not finished"
        yield from self._link.zeroing(True)
        self._zeroed, self._doubt = True, ""
        return "zeroed in the unit, until it loses its power or is connected anew"

    def _remove_zero(self) -> Answer:
        self._doubt = "its own zero was being removed, and that was not finished"
        yield from self._link.zeroing(False)
        self._zeroed, self._doubt = False, ""
        return "its own zero is removed"

    @property
    @override
    def inputs(self) -> Mapping[str, Input]:
        return {} if self._children else self._cells[0].bias.inputs

    # ------------------------------------------------------------------------------------- diagnostics

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        monitor = self._monitor
        return {
            **self._link.counters,
            "error_records": float(monitor.error_records),
            "saturated_records": float(monitor.saturated_records),
        }

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        now = time.monotonic()
        number = self._link.serial_number
        zero = (
            f"{self._doubt}. Zero it anew, unloaded (sensor_bias), or leave it so (sensor_unbias)"
            if self._doubt
            else ""
        )
        found = [
            (Severity.ERROR, "status", self._of(self._monitor.error(now))),
            (Severity.ERROR, "saturation", self._of(self._monitor.saturation(now))),
            (Severity.WARNING, "zero", zero),
            (Severity.INFO, "sensor", f"serial number {number}" if number else ""),
        ]
        return tuple(Note(severity, key, text) for severity, key, text in found if text)


class CellDevice(DeviceBehind, Sensor):
    """One of four sensors. It has no operating state of its own.

    Args:
        unit: at which it hangs.
        cell: that it is.
        frame_id: its frame.
        rate: of its measurements, in Hz.
    """

    def __init__(self, unit: OptoForceDevice, cell: Cell, frame_id: str, rate: float) -> None:
        capabilities = Capabilities(
            measured=MEASURED,
            rate=rate,
            base_frame=frame_id,
            tool_frame=frame_id,
            stop=STOP,
        )
        super().__init__(unit, frame_id, capabilities, "the unit")
        self._unit = unit
        self._cell = cell
        self._told: Sample | None = None

    @property
    @override
    def is_linked(self) -> bool:
        return self._unit.is_open

    @override
    def open(self, deadline: float) -> None:
        self._told = None
        super().open(deadline)

    @override
    def read(self, deadline: float) -> Sample | None:
        """Return what the unit has just brought."""
        self.check_link()
        newest = self._unit.newest
        if newest is None or newest is self._told:
            return None
        self._told = newest
        return Sample(newest.stamp, self._cell.values)

    @property
    @override
    def services(self) -> Mapping[str, Service]:
        return self._cell.bias.services

    @property
    @override
    def inputs(self) -> Mapping[str, Input]:
        return self._cell.bias.inputs
