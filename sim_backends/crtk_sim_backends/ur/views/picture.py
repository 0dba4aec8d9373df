"""What a live picture of the controller shows, ready for JSON: small, it is asked for many times a second."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from crtk_sim_backends.ur.controller import Controller
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
        **{name: outputs[name] for name in _OUTPUTS},
    }
