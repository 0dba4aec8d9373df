"""The haptic devices that are judged in a world: where the force of their motors is.

The scenario is in `promises.py`. This file is imported by the host of a world, in patched Python, so it
imports no pytest.
"""

from __future__ import annotations

from typing import Final

from crtk_drivers.testing.world.promises.pusher import Haptic

_ALL: Final = (
    Haptic(
        device="haply",
        config={"max_force": 2.0, "rate": 200.0},
        force=lambda server: list(server.device.handle.motors),
        most=2.0,
    ),
)
HAPTICS: Final = {haptic.device: haptic for haptic in _ALL}
"""All of them, by the name of the device."""
