"""A Robotiq force sensor as a CRTK device: it measures, and that is all.

The operating state means what it means for every sensor: ENABLED says that somebody relies on it, and an
error ends it in FAULT; what is measured is published in any state.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from typing import Final

import numpy as np
from typing_extensions import override

from crtk_driver_robotiq.ft300.config import Ft300Config
from crtk_driver_robotiq.ft300.link import Batch, SensorLink
from crtk_driver_robotiq.ft300.registers import Identity
from crtk_driver_robotiq.ft300.stream import PERIOD
from crtk_drivers.device import (
    Capabilities,
    Condition,
    Input,
    Note,
    Sensor,
    Service,
    Severity,
    StopPolicy,
)
from crtk_drivers.errors import CrtkError, DeviceFault
from crtk_drivers.kit.software_bias import SoftwareBias
from crtk_drivers.samples import Sample, Stamp, Wrench, vector
from crtk_drivers.state import OperatingState

__all__ = ["RATED", "Ft300Device"]

RATED: Final = np.array([300.0, 300.0, 300.0, 30.0, 30.0, 30.0])
"""N and N·m (FT 300-S instruction manual, 6.2)."""
AXES: Final = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
FROZEN: Final = 2.0
"""Seconds for which it may repeat one measurement: there is noise in its hundredths of a newton."""
LATCH: Final = 0.5
"""Seconds for which an overload is told after it is over."""

logger = logging.getLogger(__name__)


class Ft300Device(Sensor):
    """One sensor."""

    def __init__(self, config: Ft300Config) -> None:
        self._config = config
        self._aborted = self._is_open = False
        self._link = SensorLink(config, lambda: self._aborted and not self._is_open)
        self._bias = SoftwareBias(
            np.array(config.bias), RATED, config.frame_id, f"robotiq-ft300 {self.address}"
        )
        self.identity: Identity | None = None
        """What the sensor said of itself when it was connected last."""
        self.peak = 0.0
        """The highest share of its rated load that any axis has borne."""
        self._newest = np.full(6, np.nan)
        self._changed = 0.0
        self._is_frozen = False
        self._over = ("", -np.inf)
        self._capabilities = Capabilities(
            measured=("measured_cf", "raw/measured_cf"),
            rate=1.0 / PERIOD if config.streams else config.rate,
            paced_by_stream=config.streams,
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
        return self._config.place

    @override
    def open(self, deadline: float) -> None:
        self.identity = identity = self._link.open(deadline)
        self._newest, self._is_frozen = np.full(6, np.nan), False
        self._is_open = True
        logger.info("%s: %s", self._link.where, identity.described)

    @override
    def abort_open(self) -> None:
        self._aborted = True

    @override
    def close(self) -> None:
        self._is_open = False
        self._link.close()

    @override
    def read(self, deadline: float) -> Sample | None:
        batch = self._link.read(deadline)
        if batch is None:
            return None
        self._watch(batch)
        spoilt = "they do not change any more" if self._is_frozen else ""
        newest, measured = batch.loads[-1], self._bias.take_off(*batch, spoilt)[-1]
        at = float(batch.times[-1])
        return Sample(
            Stamp(0, at) if self._is_frozen else Stamp.at(at),
            {
                "measured_cf": self._wrench(measured),
                "raw/measured_cf": self._wrench(newest),
            },
        )

    def _wrench(self, load: np.ndarray) -> Wrench:
        return Wrench(vector(load[:3]), vector(load[3:]), self._config.frame_id)

    def _watch(self, batch: Batch) -> None:
        """See whether it goes on measuring, and whether it bears too much."""
        now = float(batch.times[-1])
        whole = np.vstack((self._newest, batch.loads))
        if (whole[1:] != whole[:-1]).any():
            self._changed = now
        self._newest = batch.loads[-1]
        self._is_frozen = now - self._changed > FROZEN
        shares = np.abs(batch.loads).max(axis=0) / RATED
        worst = int(shares.argmax())
        share = float(shares[worst])
        self.peak = max(self.peak, share)
        if share > self._config.alarm:
            self._over = f"{AXES[worst]} bears {share:.0%} of its rated load", now + LATCH

    @property
    @override
    def obstacles(self) -> tuple[CrtkError, ...]:
        if not self._is_frozen:
            return ()
        remedy = "Take its power away and give it back, and enable again."
        return (DeviceFault(self.condition.reason, where=self._link.where, remedy=remedy),)

    @property
    @override
    def condition(self) -> Condition:
        if not self._is_frozen:
            return Condition()
        return Condition(OperatingState.FAULT, "it is frozen: it repeats one measurement")

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        bias = {
            f"bias_{axis.lower()}": value
            for axis, value in zip(AXES, self._bias.load.tolist(), strict=True)
        }
        return {**self._link.counters, "peak_of_rated": self.peak, **bias}

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        found = []
        text, until = self._over
        if time.monotonic() < until:
            found.append(Note(Severity.WARNING, "overload", text))
        if self.identity is not None:
            found.append(Note(Severity.INFO, "sensor", self.identity.described))
        return tuple(found)

    @property
    @override
    def services(self) -> Mapping[str, Service]:
        return self._bias.services

    @property
    @override
    def inputs(self) -> Mapping[str, Input]:
        return self._bias.inputs
