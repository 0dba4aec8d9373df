"""What a live picture of the controller shows, ready for JSON: small, as it is asked for many times a second.

The control socket answers the requests ``arm`` (once) and ``picture`` (each time).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from crtk_sim_backends.ur.config import SimConfig
from crtk_sim_backends.ur.controller import Controller
from crtk_sim_backends.ur.models import ALPHA
from crtk_sim_backends.ur.pace import Pace, Statistics

_OUTPUTS = (
    "actual_q",
    "actual_qd",
    "target_q",
    "actual_current",
    "actual_TCP_pose",
    "actual_TCP_force",
    "tcp_offset",
    "speed_scaling",
    "target_speed_fraction",
)


def arm(config: SimConfig, host: str) -> dict[str, Any]:
    """Return what does not change: names, the kinematic table (m, rad), limits (rad, rad/s; None: none)."""
    model = config.robot
    return {
        "title": model.title,
        "version": ".".join(map(str, config.software[:3])),
        "host": host,
        "a": model.a,
        "d": model.d,
        "alpha": ALPHA,
        "position": [limit if math.isfinite(limit) else None for limit in model.position],
        "velocity": model.velocity,
    }


def picture(
    controller: Controller,
    pace: Pace,
    statistics: Statistics,
    clients: Mapping[str, int],
    faults: Sequence[str],
) -> dict[str, Any]:
    """Return what changes; outputs by their RTDE names, in RTDE's units."""
    outputs = controller.outputs
    return {
        "time": controller.time,
        "speed": pace.speed,
        "reached": pace.reached,
        "robot_mode": controller.robot_mode.name,
        "safety_mode": controller.safety_mode.name,
        "runtime_state": controller.runtime_state.name,
        "program": controller.program_name,
        "remote": controller.remote,
        "popup": controller.popup_text,
        "clients": clients,
        "faults": faults,
        "ticks": statistics.ticks,
        "late": statistics.late,
        "skipped": statistics.skipped,
        "worst_delay": statistics.worst_delay,
        "busy": statistics.busy,
        **{name: outputs[name] for name in _OUTPUTS},
    }
