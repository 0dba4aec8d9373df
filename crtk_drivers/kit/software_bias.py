"""What is taken off the loads of a force sensor in software: set, measured, told. No I/O.

A bias is never set by itself.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from crtk_drivers.commands import Payload
from crtk_drivers.device import Input, Service
from crtk_drivers.errors import CommandRefused, Reason, TransitionFailed
from crtk_drivers.kit.averaging import Average, Averaging, differ
from crtk_drivers.samples import Wrench

__all__ = ["MOST_LOAD", "SoftwareBias", "check_bias", "load_text"]

Load = NDArray[np.float64]

AVERAGED: Final = 0.3
"""Seconds of measurements of which a bias is the mean."""
CHECKED: Final = 0.1
"""Seconds of measurements by which it is checked."""
DRIFT: Final = 0.005
"""Share of the rated load by which two means may differ besides their noise."""
MOST_LOAD: Final = 1e6
"""N and N·m: beyond any sensor."""


def check_bias(load: Load, stated_in: str, frame_id: str) -> None:
    """Check a bias (6,), N and N·m, that somebody sets.

    Args:
        load: the bias.
        stated_in: frame in which it is stated; empty for that of the sensor.
        frame_id: of the sensor.

    Raises:
        CommandRefused: it is not finite, beyond any sensor, or stated in another frame.
    """
    if stated_in not in ("", frame_id):
        raise CommandRefused(
            "set_bias",
            Reason.WRONG_FRAME,
            f"the bias is stated in {stated_in!r}",
            remedy=f"State it in {frame_id!r}, the sensor's frame.",
        )
    if not np.isfinite(load).all():
        raise CommandRefused(
            "set_bias", Reason.NOT_FINITE, "not finite", remedy="Send six finite numbers."
        )
    if (np.abs(load) > MOST_LOAD).any():
        raise CommandRefused(
            "set_bias",
            Reason.OUT_OF_RANGE,
            f"the bias is {load_text(load)}",
            remedy=f"Send what a sensor can measure, up to {MOST_LOAD:g} N and N·m.",
        )


def load_text(load: Load) -> str:
    """Return a load (6,) for people."""
    force = ", ".join(f"{value:.4g}" for value in load[:3].tolist())
    torque = ", ".join(f"{value:.4g}" for value in load[3:].tolist())
    return f"[{force}] N, [{torque}] N·m"


class SoftwareBias:
    """The bias of a sensor that has none of its own.

    Args:
        load: to begin with (6,), N and N·m, in the sensor's frame.
        rated: what the sensor is made for (6,).
        frame_id: of the sensor.
        where: the device, for messages.
    """

    def __init__(self, load: Load, rated: Load, frame_id: str, where: str) -> None:
        self.load = load
        self._rated = rated
        self._frame_id = frame_id
        self._where = where
        self._averaging: Averaging | None = None

    def take_off(self, loads: Load, times: NDArray[np.float64], spoilt: str = "") -> Load:
        """Return measurements (n, 6) of these times (n,) without the bias; what is averaged takes them in.

        Args:
            loads, times: of the measurements.
            spoilt: why they are none that a bias may be made of; empty if they are.
        """
        averaging = self._averaging
        if averaging is not None:
            averaging.take(loads, times)
            averaging.spoilt = averaging.spoilt or spoilt
            if averaging.done:
                self._averaging = None
        return loads - self.load

    def set(self, load: Load, stated_in: str) -> None:
        """Take this bias (6,) from now on, from any thread.

        Raises:
            CommandRefused: see `check_bias`.
        """
        check_bias(load, stated_in, self._frame_id)
        self.load = load.copy()

    def measure(self) -> Generator[None, None, str]:
        """Make the present load zero; a procedure of the I/O thread. Broken off, it changes nothing.

        Raises:
            TransitionFailed: the load changed meanwhile, or could not be measured.
        """
        before = self.load
        average = yield from self._average(AVERAGED)
        self.load, is_checked = average.mean, False
        try:
            after = yield from self._average(CHECKED)
            left = after.mean - average.mean
            if differ(average, after, left, DRIFT * self._rated):
                raise TransitionFailed(
                    "the load changed while the bias was set; the bias is what it was",
                    where=self._where,
                    remedy="Leave the sensor alone for half a second, and try again.",
                )
            is_checked = True
        finally:
            if not is_checked and self.load is average.mean:
                self.load = before
        return f"software bias {load_text(average.mean)}; left over {load_text(left)}"

    def remove(self) -> Generator[None, None, str]:
        """Take nothing off any more."""
        self.load = np.zeros(6)
        yield from ()
        return "software bias removed"

    def tell(self) -> Generator[None, None, str]:
        """Say what is taken off."""
        yield from ()
        return f"software bias {load_text(self.load)}"

    @property
    def services(self) -> Mapping[str, Service]:
        """What a device with this bias does beyond CRTK."""
        return {
            "bias": Service("make the present load zero, in software", self.measure),
            "unbias": Service("remove the software bias", self.remove),
            "get_bias": Service("tell the software bias", self.tell),
        }

    @property
    def inputs(self) -> Mapping[str, Input]:
        """What a device with this bias takes beyond CRTK."""
        text = "software bias, in the sensor's frame"
        return {"set_bias": Input(text, Payload.WRENCH, self._take)}

    def _take(self, value: Any) -> None:
        assert isinstance(value, Wrench)
        self.set(value.vector, value.frame_id)

    def _average(self, seconds: float) -> Generator[None, None, Average]:
        averaging = self._averaging = Averaging(seconds, time.monotonic())
        while not (averaging.done or averaging.spoilt):
            yield
        if averaging.spoilt:
            raise TransitionFailed(
                f"the measurements cannot be used: {averaging.spoilt}",
                where=self._where,
                remedy="Unload the sensor, or remove the cause, and try again.",
            )
        return averaging.result()
