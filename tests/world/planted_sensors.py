"""Mistakes that are planted into drivers of sensors, trackers and haptic devices; see `planted.py`.

This file is imported in patched Python, so it imports no pytest.
"""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import Any, Final

import numpy as np
from world.haptics import HAPTICS
from world.instruments import INSTRUMENTS
from world.planted import BELIEVED, MOVES, NOT_ENABLED, SCENARIOS, planted

from crtk_driver_ati_netft import services as netft_services
from crtk_driver_ati_netft.pipeline import Pipeline
from crtk_driver_ati_netft.stream import RdtStream
from crtk_driver_haply.force import ForceInForce
from crtk_driver_ndi.tool import ToolDevice
from crtk_drivers.kit.sensing import filters
from crtk_drivers.kit.software_bias import SoftwareBias
from crtk_drivers.samples import Sample
from crtk_drivers.testing.world import instrument_user, pusher

WATCH, PUSH = "watch", "push"
NOT_SO: Final = "it was not so"
MIXED: Final = "a bias is mixed"
BIAS: Final = "a bias is wrong"
SENDS: Final = "it sends after close"

vars(SCENARIOS).update(
    {
        f"{name}_{WATCH}": functools.partial(instrument_user.watch, instrument=instrument)
        for name, instrument in INSTRUMENTS.items()
    }
    | {
        f"{name}_{PUSH}": functools.partial(pusher.push, haptic=haptic)
        for name, haptic in HAPTICS.items()
    }
)


@planted("ati-netft", WATCH, MIXED, NOT_SO, seeds=40)
def mean_goes_on_over_a_gap() -> None:
    """What was measured before a gap is averaged with what follows it."""
    filters.behind_gap = lambda times, before, longest: -1


@planted("ati-netft", WATCH, MIXED, seeds=10)
def force_and_torque_have_two_biases() -> None:
    """The torque of the first value after a change has the bias of before."""
    plain = Pipeline._present

    def present(self: Any) -> Any:
        now = plain(self)
        before, self._before = self.__dict__.get("_before", now), now
        mixed = np.concatenate((now.bias[:3], before.bias[3:]))
        return replace(now, bias=mixed)

    Pipeline._present = present


@planted("ati-netft", WATCH, BIAS, seeds=20)
def bias_is_not_checked() -> None:
    """A bias is set, however the load has changed meanwhile."""
    netft_services.differ = lambda one, other, difference, allowed: False


@planted("ati-netft", WATCH, SENDS, seeds=5)
def sensor_is_not_told_to_stop() -> None:
    """The stream goes on when the driver is closed."""
    RdtStream._stop = lambda self: None


@planted("optoforce", WATCH, BIAS, seeds=20)
def bias_that_failed_stays() -> None:
    """A bias that was refused by its check is in force."""
    plain = SoftwareBias._average

    def average(self: Any, seconds: float) -> Any:
        found = yield from plain(self, seconds)
        self.load = self.load.copy()  # so it is not known again
        return found

    SoftwareBias._average = average


@planted("ndi", WATCH, NOT_SO, seeds=10)
def tool_that_is_missing_stays_where_it_was() -> None:
    """A tool that is missing has its last pose, with the stamp of the frame."""
    plain = ToolDevice.read

    def read(self: Any, deadline: float) -> Any:
        found = plain(self, deadline)
        stream = self._tracker.stream
        if found is None or not found.values or stream is None:
            return found
        return Sample(stream.stamp, found.values)

    ToolDevice.read = read


@planted("haply", PUSH, "moves after close", MOVES, NOT_ENABLED, BELIEVED, seeds=5)
def force_is_not_dropped() -> None:
    """A force goes on until there is another one, also after a stop."""
    plain = ForceInForce.__init__

    def begin(self: Any, ramp: float, lasts: float) -> None:
        plain(self, ramp, math.inf)

    ForceInForce.__init__ = begin
    ForceInForce.drop = lambda self: None
