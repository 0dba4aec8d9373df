"""What the page of simulated drives shows: a gauge for each axis, beside the bus."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from crtk_sim_backends.can import scene as bus
from crtk_sim_backends.canopen.axis import Axis
from crtk_sim_backends.canopen.config import SimConfig
from crtk_sim_backends.canopen.drive import Drive
from crtk_sim_backends.canopen.nmt import OPERATIONAL
from crtk_sim_backends.canopen.objects import MODES
from crtk_sim_backends.page import Gauge, Gauges, Scene, button


def scene(config: SimConfig, host: str, nodes: Sequence[int]) -> Scene:
    """Return what does not change."""
    found = bus.scene(config, host)
    first = nodes[0] if nodes else 0
    drives = (
        button(f"drive {first} faults", "fault", node=first),
        button(f"drive {first} stuck", "stuck", node=first),
        button(f"cable of drive {first} out", "silent", node=first),
        button(f"drive {first} boots", "reset", node=first),
        button("motor supply off", "supply_off"),
        button("safe torque off", "safe_torque_off"),
        button("TPDOs 20 ms late", "late_tpdo", delay=0.02),
    )
    return {
        **found,
        "title": "CANopen drives",
        "detail": f"{len(nodes)} on {found['detail']}",
        "buttons": (*drives, bus.LOST, bus.BUS_OFF) if nodes else bus.BUTTONS,
    }


def gauges(drives: Iterable[Drive]) -> Gauges:
    """Return where the motors are between their limit switches."""
    return {
        "title": "Motors",
        "unit": "revolutions",
        "rate": "1/s",
        "digits": 3,
        "gauges": [_gauge(drive, axis) for drive in drives for axis in drive.axes],
    }


def _gauge(drive: Drive, axis: Axis) -> Gauge:
    motor = axis.motor
    number = f".{axis.number}" if len(drive.axes) > 1 else ""
    return {
        "name": f"node {drive.node_id}{number}",
        "low": motor.config.negative_limit,
        "high": motor.config.positive_limit,
        "value": motor.revolutions,
        "goal": axis.shown(0x60FC) / axis.units.increments if axis.powered else None,
        "rate": motor.velocity / math.tau,
        "state": _state(drive, axis),
    }


def _state(drive: Drive, axis: Axis) -> tuple[str, str]:
    words = [drive.state.name, axis.machine.state.name, MODES.get(axis.shown(0x6061), "no mode")]
    text = ", ".join(words).lower().replace("_", " ")
    if axis.machine.faulted:
        return f"{text}, error {axis.value(0x603F):04X}h", "bad"
    return text, "good" if axis.machine.enabled and drive.state is OPERATIONAL else ""
