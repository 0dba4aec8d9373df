"""What a simulated gripper says of itself, as data: instances, and bytes as they are in its memory."""

from __future__ import annotations

import struct

from crtk_sim_backends.schunk.gripper.config import SimConfig
from crtk_sim_backends.schunk.gripper.models import FIELDBUSES, MODELS


def order_of(fieldbus: str) -> str:
    """Return the order of bytes in numbers, as `struct` names it."""
    return ">" if fieldbus == "profinet" else "<"


def parameters(config: SimConfig) -> dict[int, bytes]:
    """Return the values of its parameters, by instance."""
    order = order_of(config.fieldbus)
    numbers = {
        0x0540: 5.0,  # release distance
        0x0600: 1e3 * config.lower,
        0x0608: 1e3 * config.upper,
        0x0630: 1e3 * config.speed,
        0x0650: 1e3 * config.grip_speed,
        0x0658: 0.5 * config.max_force,
        0x0660: config.max_force,
    }
    return {
        **{instance: struct.pack(f"{order}f", value) for instance, value in numbers.items()},
        0x0500: bytes((MODELS[config.model],)),
        0x1130: bytes((FIELDBUSES[config.fieldbus],)),
        0x1000: b"CRTKSIM".ljust(16, b"\0"),
        0x1118: b"5.3.1".ljust(22, b"\0"),
    }
