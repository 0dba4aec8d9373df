"""For authors of drivers and tests: what a plugin is tested with.

contract    `DeviceContract`, a test class that every device must pass; subclass it (needs pytest)
clock       `FakeClock`, for an `Engine` whose time a test controls
loopback    `LoopbackDevice`, a complete device without hardware
"""

from crtk_drivers.testing.clock import FakeClock
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice

__all__ = ["FakeClock", "LoopbackConfig", "LoopbackDevice"]
