"""A device in plain Python: the CRTK methods, in this process."""

from crtk_drivers.front.local_devices import LocalDevice, connect

__all__ = [
    "LocalDevice",
    "connect",
]
