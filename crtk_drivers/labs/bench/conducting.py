"""What goes between a run and the process that conducts it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from crtk_drivers.config import SpaceConfig
from crtk_drivers.labs.bench.calls import About
from crtk_drivers.labs.lab_file import CarriedEntry


@dataclass(frozen=True)
class DeviceOrder:
    """A device that is to be tested.

    Attributes:
        name: in the lab.
        plugin, values, sim, sim_options: as in the lab file.
        space: for the run; None: as the device's own limits say.
        on: name of the device that carries it or its markers, if that is in this run.
        coupled: what of that its simulator follows; None if nothing.
    """

    name: str
    plugin: str
    values: Mapping[str, Any]
    sim: bool
    sim_options: Mapping[str, Any]
    space: SpaceConfig | None
    on: str = ""
    coupled: CarriedEntry | None = None


@dataclass(frozen=True)
class RunOrder:
    """A run.

    Attributes:
        devices: in their order.
        folder: for recordings and logs.
        thorough, features: see `Bed`.
        locks: files of `locks.alone`, which everything holds that moves a device.
    """

    devices: tuple[DeviceOrder, ...]
    folder: Path
    thorough: float
    locks: tuple[int, ...]
    features: Mapping[str, bool | float | str] = field(default_factory=dict)


@dataclass(frozen=True)
class Reached:
    """A device measures; or `trouble` says why it does not. The answer is which acquisitions are wanted."""

    device: str
    about: About | None
    trouble: str = ""


@dataclass(frozen=True)
class Began:
    """An acquisition begins."""

    device: str
    acquisition: str


@dataclass(frozen=True)
class Acquired:
    """An acquisition has ended; the answer is whether the device may be moved any more.

    Attributes:
        device, acquisition: which.
        seconds: that it took.
        recording: its file.
        lateness: of the bench's own timer, in s.
        trouble: why it was not carried out to the end.
        kept: what the acquisition wrote down beside it.
        tripped: the watch stopped the device.
        broken: a procedure failed, or nobody looked: the device is not used any more.
    """

    device: str
    acquisition: str
    seconds: float
    recording: Path
    lateness: tuple[float, ...] = ()
    trouble: str = ""
    kept: Mapping[str, Any] = field(default_factory=dict)
    tripped: bool = False
    broken: bool = False


@dataclass(frozen=True)
class Asked:
    """The operator is to do something. Nothing is answered: what he does is seen of the device."""

    what: str


@dataclass(frozen=True)
class Lost:
    """A device did not answer when it was to be held or left: told at once. Nothing is answered."""

    device: str
