"""For authors of drivers and tests: what a plugin is tested with.

contract    `DeviceContract`, a test class that every device must pass; subclass it (needs pytest)
clock       `FakeClock`, for an `Engine` whose time a test controls
loopback    `LoopbackDevice`, a complete device without hardware
lab_tests   the plugin of pytest for a lab's own tests
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from crtk_drivers.testing.clock import FakeClock
    from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice

__all__ = ["FakeClock", "LoopbackConfig", "LoopbackDevice"]

# Imported when first used: every pytest of the environment imports this package, for `lab_tests`.
_MODULES = {"FakeClock": "clock", "LoopbackConfig": "loopback", "LoopbackDevice": "loopback"}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
