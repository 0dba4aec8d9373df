"""The devices of a lab that is up, by their names: ``crtk_drivers.lab("lab.toml").arm.move_jp(...)``."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Self

from typing_extensions import override

from crtk_drivers.client.remote import CONNECT_TIMEOUT, RemoteDevice, connect
from crtk_drivers.labs.lab_outline import load_outline
from crtk_drivers.ros import environment

__all__ = ["LabDevices", "lab"]


class LabDevices(Mapping[str, RemoteDevice]):
    """Connected devices, by name as items and as attributes. Closed at the end of a ``with`` statement.

    Args:
        devices: by name.
    """

    def __init__(self, devices: Mapping[str, RemoteDevice]) -> None:
        self._devices = dict(devices)

    def close(self) -> None:
        """Leave all of them; they go on as they are."""
        for device in self._devices.values():
            device.close()

    @override
    def __getitem__(self, name: str) -> RemoteDevice:
        return self._devices[name]

    def __getattr__(self, name: str) -> RemoteDevice:
        devices = self.__dict__.get("_devices", {})
        if name not in devices:
            raise AttributeError(f"the lab has no device {name!r}. It has: {', '.join(devices)}.")
        found: RemoteDevice = devices[name]
        return found

    @override
    def __iter__(self) -> Iterator[str]:
        return iter(self._devices)

    @override
    def __len__(self) -> int:
        return len(self._devices)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def lab(path: str | Path, *only: str, timeout: float = CONNECT_TIMEOUT) -> LabDevices:
    """Connect to the devices of a lab, which ``crtk-driver up`` has brought up.

    They may be on several machines, and their drivers need not be installed on this one.
    What the lab file says of ROS 2 in `environment`, such as the domain, holds for this process from now on.
    A context or node that was made before stays in the domain that it was made in.

    Args:
        path: of the lab file.
        only: names of the devices that are wanted; none: all.
        timeout: seconds in which all of them must be found.

    Raises:
        MissingExtra, ConfigError: ROS 2 cannot be used here, or the file is wrong.
        ConnectionFailed: a device is not there; those that were found are left again.
    """
    deadline = time.monotonic() + timeout
    found: dict[str, RemoteDevice] = {}
    try:
        described = load_outline(path)
        namespaces = described.namespaces(only)
        environment.adopt(described.environment)
        for name, namespace in namespaces.items():
            left = max(0.0, deadline - time.monotonic())
            found[name] = connect(namespace, timeout=left)
    except BaseException:
        LabDevices(found).close()
        raise
    return LabDevices(found)
