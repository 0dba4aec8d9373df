"""`connect`, and a class for each device of this distribution, for annotations: ``arm: local_devices.Ur``.

What a class has is in `local_devices.pyi`, for type checkers and editors: the commands of its kind, and what
the device has beyond CRTK. At run time all of them are `LocalDevice`.
"""

from __future__ import annotations

from crtk_drivers import plugins
from crtk_drivers.device.device_kind import class_name
from crtk_drivers.front.local import LocalDevice, connect

__all__ = ["LocalDevice", "connect"]


def __getattr__(name: str) -> type[LocalDevice]:
    if name.startswith("_") or name not in map(class_name, plugins.devices()):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return LocalDevice
