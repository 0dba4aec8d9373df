"""What the controller's page shows: its arm, modes, joints, tool, and how well it keeps its times."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from crtk_sim_backends.page import Chain, Gauge, Live, Row, Scene, button, fault_row
from crtk_sim_backends.ur.config import SimConfig
from crtk_sim_backends.ur.models import ALPHA, RobotModel
from crtk_sim_backends.ur.pace import LATE

JOINTS: Final = ("base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3")

GOOD: Final = frozenset({"RUNNING", "NORMAL", "PLAYING"})
BAD: Final = frozenset({"PROTECTIVE_STOP", "ROBOT_EMERGENCY_STOP", "VIOLATION", "FAULT"})
_IDENTITY: Final = (1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
_BUTTONS: Final = (
    button("protective stop", "protective_stop"),
    button("emergency stop", "emergency_stop"),
    button("safeguard stop", "safeguard_stop"),
    button("reduced mode", "reduced_mode"),
    button("push 60 N", "external_force", wrench=[0.0, 0.0, 60.0, 0.0, 0.0, 0.0]),
    button("power loss", "power_loss"),
    button("cable out", "silence", port="all"),
    button("controller hangs", "stall"),
)


def chain(model: RobotModel) -> Chain:
    """Return the arm's own links, or the model's: frames of Denavit and Hartenberg, m."""
    own = model.calibration
    theta = own.theta if own else (0.0,) * 6
    a, d, alpha = (own.a, own.d, own.alpha) if own else (model.a, model.d, ALPHA)
    links = [_link(*row) for row in zip(theta, a, d, alpha, strict=True)]
    return {"joints": [_IDENTITY, *links[:-1]], "tip": links[-1]}


def _link(theta: float, a: float, d: float, alpha: float) -> tuple[float, ...]:
    """Return the transform behind a joint: turn and move along z, then along x."""
    s, c = math.sin(theta), math.cos(theta)
    sa, ca = math.sin(alpha), math.cos(alpha)
    return (c, -s * ca, s * sa, a * c, s, c * ca, -c * sa, a * s, 0.0, sa, ca, d)


def scene(config: SimConfig, host: str) -> Scene:
    """Return what does not change."""
    model = config.robot
    return {
        "title": model.title,
        "detail": "software " + ".".join(map(str, config.software[:3])),
        "host": host,
        "buttons": _BUTTONS,
        "notes": {
            "periods": f"Of {1e3 / model.frequency:g} ms. Late: begun more than {1e3 * LATE:g} ms after its "
            "time, and made up for. Left out: after more than 100 ms. Both tell that this machine is "
            "busy, and nothing about the arm."
        },
        "chain": chain(model),
    }


def live(model: RobotModel, found: Mapping[str, Any]) -> Live:
    """Return what changes, from :func:`crtk_sim_backends.ur.views.picture.picture`."""
    pose, force = found["actual_TCP_pose"], found["actual_TCP_force"]
    clients = [f"{name} {count}" for name, count in found["clients"].items() if count]
    return {
        "gauges": [
            {
                "title": "Joints",
                "unit": "deg",
                "rate": "deg/s",
                "digits": 2,
                "gauges": [_joint(model, found, index) for index in range(6)],
            }
        ],
        "sections": {
            "State": [
                _mode("robot", found["robot_mode"]),
                _mode("safety", found["safety_mode"]),
                _mode("program", found["runtime_state"]),
                ("name", found["program"] or "none", ""),
                ("control", "remote" if found["remote"] else "local", ""),
                ("speed slider", f"{100 * found['target_speed_fraction']:.0f} %", ""),
                ("scaling", f"{100 * found['speed_scaling']:.0f} %", ""),
                ("pop-up", found["popup"] or "none", "fair" if found["popup"] else ""),
            ],
            "Tool": [
                ("position, m", _numbers(pose[:3], 4), ""),
                ("rotation, rad", _numbers(pose[3:], 3), ""),
                ("force, N", _numbers(force[:3], 1), ""),
            ],
            "Simulator": [
                fault_row(found["faults"]),
                (
                    "time",
                    f"{found['time']:.1f} s, {found['reached']:.2f} of {found['speed']:g}",
                    "",
                ),
                ("clients", ", ".join(clients) or "none", ""),
                (
                    "periods",
                    f"{found['late']} late, {found['skipped']} left out of {found['ticks']}",
                    "",
                ),
            ],
        },
        "faults": found["faults"],
        "q": found["actual_q"],
        "tool": found["tcp_offset"],
    }


def _joint(model: RobotModel, found: Mapping[str, Any], index: int) -> Gauge:
    limit = model.position[index]
    degrees = math.degrees(limit) if math.isfinite(limit) else None
    return {
        "name": JOINTS[index],
        "low": None if degrees is None else -degrees,
        "high": degrees,
        "value": math.degrees(found["actual_q"][index]),
        "goal": math.degrees(found["target_q"][index]),
        "rate": math.degrees(found["actual_qd"][index]),
    }


def _mode(name: str, mode: str) -> Row:
    return name, mode, "good" if mode in GOOD else "bad" if mode in BAD else "fair"


def _numbers(values: Any, digits: int) -> str:
    return "  ".join(f"{value:.{digits}f}" for value in values)
