"""Loopback and virtual arm: there is no wire, so what fails is made to fail in the driver's own process."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from bench.reliability import disturbed
from bench.reliability.activities import Plan
from bench.reliability.common import own_process
from bench.reliability.rig import Rig
from bench.reliability.table import REST, Absent, Follows, Way
from crtk_driver_virtual import PLUGIN as VIRTUAL
from crtk_driver_virtual.device import VirtualDevice
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.testing.loopback import PLUGIN as LOOPBACK
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice

STOP = 1.0
SAMPLES = 1.0
"""`sample_timeout` of tests, s."""

ABSENT = (
    Absent("F4", "no wire"),
    Absent("F6", "one sample has all joints"),
    Absent("F7", "no adapter"),
    Absent("F8", "no wire"),
    Absent("F9", "no sensor"),
    Absent("F10", "no bus"),
    Absent("F11", "no nodes"),
    Absent("F13", "no safety system"),
    Absent("F16", "it exists in the driver's process only, and ends with it"),
    Absent("F19", "it ends with its driver; with another driver it is another arm"),
    Absent("F20", "it belongs to the process that made it"),
)

WAYS = (
    Way(
        "F1",
        "the link is lost",
        kind=disturbed.LOST,
        detail="the link is gone",
        within=0.05,
        stands=0.05 + STOP,
    ),
    Way(
        "F2",
        "no samples",
        kind=disturbed.SILENT,
        detail="the newest sample is",
        within=SAMPLES,
        stands=SAMPLES + STOP,
    ),
    Way(
        "F3",
        "does not answer",
        Follows.STARTS_LATER,
        kind=disturbed.LOST,
        detail="no answer",
        activities=(REST,),
    ),
    Way(
        "F5",
        "not a number in every sample",
        kind=disturbed.NOT_FINITE,
        within=SAMPLES,
        stands=SAMPLES + STOP,
    ),
    Way(
        "F12",
        "an error of the hardware",
        kind=disturbed.ERROR,
        detail="reports an error",
        within=0.05,
        stands=0.05 + STOP,
    ),
    Way(
        "F14",
        "somebody else has control",
        kind=disturbed.TAKEN_OVER,
        states=("PAUSED",),
        detail="has control",
        within=0.05,
        stands=0.05 + STOP,
    ),
    *(way for way in own_process(stop=STOP, stream=0.3) if way.fault != "F19"),
)

_PATIENT = {"sample_timeout": SAMPLES, "stream_timeout": 0.3}
_QUICK = {**_PATIENT, "acceleration": 20.0, "rate": 200.0}


class _Seen(LoopbackDevice):
    """The gantry, whose true position can be asked for."""

    @property
    def where(self) -> np.ndarray:
        """Of all axes, m and rad."""
        return self._position.copy()


def _gantry(config: LoopbackConfig) -> LoopbackDevice:
    return _Seen(config)


class _MemoryRig(Rig):
    ways = WAYS
    absent = ABSENT
    values = _PATIENT

    @override
    def open(self, *, start: bool = True, wait: bool = True) -> None:
        """It is another arm."""
        self.looks.clear()
        super().open(start=start, wait=wait)

    def _device(self) -> LoopbackDevice | VirtualDevice:
        inner = self.disturbed.inner
        assert isinstance(inner, LoopbackDevice | VirtualDevice)
        return inner


class LoopbackRig(_MemoryRig):
    """The gantry."""

    name = "loopback"
    plugin = DevicePlugin(LOOPBACK.name, LOOPBACK.summary, LOOPBACK.config, _gantry)
    thorough = False
    plan = Plan(
        velocity=0.3, far=0.9, effort=6.0, linear=0.2, force=4.0, away=0.8, ratio=0.5, room=0.15
    )
    activities = (
        REST,
        "servo_jp",
        "servo_jv",
        "servo_jf",
        "servo_cp",
        "servo_cv",
        "servo_cf",
        "interpolate_jp",
        "interpolate_jv",
        "interpolate_cp",
        "move_jp",
        "move_cp",
        "free",
    )

    @override
    def joints(self) -> np.ndarray:
        self.disturbed.look()
        device = self._device()
        assert isinstance(device, _Seen)
        return device.where


class VirtualRig(_MemoryRig):
    """The arm with dynamics."""

    name = "virtual"
    plugin = VIRTUAL
    plan = Plan(velocity=0.5, far=1.5, effort=20.0, linear=0.2, force=40.0, away=0.25, room=0.3)
    values = _QUICK
    activities = LoopbackRig.activities

    @override
    def home(self) -> np.ndarray:
        return np.array([0.0, 0.4, 1.4, 0.0, 1.3416, 0.0])

    @override
    def joints(self) -> np.ndarray:
        self.disturbed.look()
        device = self._device()
        assert isinstance(device, VirtualDevice)
        return np.array(device.plant.position)
