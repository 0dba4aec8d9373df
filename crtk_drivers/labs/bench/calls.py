"""What goes through the door between a bench and the process of a device."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from crtk_drivers.config import DeviceConfig
from crtk_drivers.device import Capabilities
from crtk_drivers.samples import Stamp, Value, Vector
from crtk_drivers.state import Status

EFFORT: Final = "measured_js.effort"
"""Stands beside CRTK names for a ``measured_js`` that has efforts."""

TOOLS: Final = "*/measured_cp"
"""The same for devices behind it that tell where they are, as the tools of a tracker."""


@dataclass(frozen=True)
class Failed:
    """The answer to a call that was not done: why, and the reason of a refusal."""

    text: str
    reason: str


@dataclass(frozen=True)
class HostOrder:
    """What is to be hosted.

    Attributes:
        plugin: name of the driver.
        config: its configuration; that of a simulator points at one that runs.
        door: path of the Unix socket that is served.
        key: that clients of the door must know.
        pulse: descriptor of an end by which the bench and the host hear each other; below 0: there is none.
    """

    plugin: str
    config: DeviceConfig
    door: str
    key: bytes
    pulse: int = -1


STANDS_STILL: Final = 2.0
"""Seconds without a sign of life of the bench after which a host holds and leaves its device."""

FRESH: Final = 0.1
"""Seconds that a sample may be old of a device that measures."""


@dataclass(frozen=True)
class ClientOrder:
    """A stream that comes from a process of its own.

    Attributes:
        door, key: of the device's process.
        command: ``servo_jv`` or ``servo_jp``.
        home: where the joints are set (n,).
        speed: to which they are brought (n,).
        rate: commands a second.
    """

    door: str
    key: bytes
    command: str
    home: Vector
    speed: Vector
    rate: float


@dataclass(frozen=True)
class About:
    """What a device is, as the bench needs it.

    Attributes:
        name: of the device, with its address.
        capabilities: with the limits that hold in this run.
        commands: CRTK names that it offers, its own readings (``state/holds``), `EFFORT` if it measures
            efforts, and `TOOLS` if it has some.
        silence: seconds without a command after which a servo stream has ended.
        sample_timeout: seconds without a sample after which the link counts as lost.
        stale_after: seconds after which a sample is no longer valid.
        max_step: seconds that a joint may be asked to go in one step.
        has_kinematics: whether it knows where its tool is.
        readings: what it tells of itself, by name.
        is_homed: its positions count.
        services: of its own, by name.
    """

    name: str
    capabilities: Capabilities
    commands: tuple[str, ...]
    silence: float
    sample_timeout: float
    stale_after: float
    max_step: float
    has_kinematics: bool
    readings: Mapping[str, str]
    is_homed: bool
    services: tuple[str, ...] = ()


@dataclass(frozen=True)
class Glance:
    """How a device is at one moment: what interlocks need.

    Attributes:
        status: operating state.
        connected: whether the link is up.
        age: of the newest sample, in s.
        values: ``measured_js``, ``setpoint_js``, ``measured_cp`` and ``measured_cf`` as far as there are any,
            with their stamps.
        refused: commands that were refused so far.
        at: monotonic seconds.
    """

    status: Status
    connected: bool
    age: float
    values: Mapping[str, tuple[Value, Stamp]]
    refused: int
    at: float

    @property
    def measures(self) -> bool:
        """Whether samples come."""
        return self.connected and self.age < FRESH
