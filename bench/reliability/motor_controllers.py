"""What the rigs of Copley and Galil share: joints, and a home switch of the first one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

TURN = 100_000 / (2.0 * math.pi)
"""Counts per rad of their joints."""
SWITCH = 20_000 / TURN
"""Where the simulated home switches are, rad."""
SPEED = 0.3
"""rad/s at which a joint looks for its switch."""
SEARCH = 1.5 * SWITCH / SPEED
"""Seconds in which a controller finds the switch: by itself, also where the link is lost (their pages)."""

FOLLOWED = ("servo_jp", "servo_jv", "interpolate_jp", "interpolate_jv", "move_jp")
"""Activities in which the driver sends each setpoint; a controller homes by itself."""


def with_homing(joints: Mapping[str, Mapping[str, Any]], **settings: Any) -> dict[str, Any]:
    """Return the configuration of `joints` of which the first one homes, by these settings of it."""
    first = next(iter(joints))
    return {"joints": {**joints, first: {**joints[first], **settings}}}
