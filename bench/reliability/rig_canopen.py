"""CANopen: three simulated drives on a hub, as one arm."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from typing_extensions import override

from bench.reliability.activities import HOME, Plan
from bench.reliability.common import frozen, of_part, outlived, own_process
from bench.reliability.rig import HELD_UP, Rig
from bench.reliability.table import REST, Absent, Follows, Way, asked_to_stop, single_messages
from crtk_driver_canopen import PLUGIN
from crtk_sim_backends.canopen import SIM

COUNT = 3
MOVING = 1
"""Node of the joint that moves."""
GEAR = 100.0
NODE = 2
JOINT = f"joint joint_{NODE} (node {NODE})"
US = "native*"
"""This computer's name on the hub."""

PERIOD = 0.01
STOP = 1.0
MISSED = 0.2
"""Declared s after which PDOs that do not come are a fault."""
HEARTBEAT = 0.5
"""Declared s after which a node that is not heard, and a master that is not heard, is a fault."""
BOOT = 2.0
"""Seconds in which the driver may notice that a node has started again."""

_SLOW = ("servo_jp", "servo_jv", "servo_jf", "interpolate_jp", "interpolate_jv")
"""What is behind by less than a following error after 0.3 s."""
_UNMEASURED = (REST, "servo_jp", "servo_jv", "interpolate_jp", "interpolate_jv", "move_jp")
"""What goes on while what is measured does not count: an effort does not."""
_MOVING = (*_SLOW, "move_jp", HOME)
DRIVES = Path(__file__).with_name("canopen_drives.yaml")
SWITCH = 20.0 * 2.0 * math.pi / GEAR
"""Where the home switch is that it says, rad."""


def _drive(
    fault: str, name: str, kind: str, detail: str, within: float = MISSED, **more: Any
) -> Way:
    return of_part(fault, name, kind, detail, within=within, stop=STOP, node=NODE, **more)


def _bus(name: str, kind: str, detail: str) -> Way:
    return Way(
        "F10",
        name,
        kind=kind,
        parameters={"node": US},
        detail=detail,
        within=MISSED,
        stands=HEARTBEAT + STOP,
    )


def _through(fault: str, name: str, kind: str, **parameters: Any) -> Way:
    return Way(fault, name, Follows.GOES_ON, kind, parameters)


WAYS = (
    Way(
        "F2",
        "no node hears or is heard",
        kind="silent",
        within=HEARTBEAT,
        stands=HEARTBEAT + STOP,
    ),
    *frozen(within=HEARTBEAT, stands=HEARTBEAT + STOP, activities=(REST, *_SLOW)),
    Way(
        "F3",
        "a node that is silent",
        Follows.STARTS_LATER,
        kind="silent",
        parameters={"node": NODE},
        within=10.0,
        activities=(REST,),
    ),
    _through("F5", "error frames, 200 a second", "error_frames", rate=200.0),
    _drive("F6", "a node does not send its PDOs", "no_tpdo", f"node {NODE} does not send its PDOs"),
    _drive(
        "F6",
        "a node sends its PDOs late",
        "late_tpdo",
        f"node {NODE} sends its PDOs too late",
        delay=0.009,
    ),
    Way(
        "F6",
        "a node does not hear its setpoints",
        kind="drop",
        parameters={"id": 0x200 + MOVING},
        detail=f"node {MOVING}",
        within=HEARTBEAT,
        stands=HEARTBEAT + STOP,
        activities=("servo_jp", "interpolate_jp", "move_jp", "servo_jv"),
    ),
    _through("F8", "every 40th frame is lost", "drop", every=40),
    _through("F8", "every 2nd frame comes twice", "duplicate", every=2),
    _through("F8", "frames are late by 0.5 ms", "delay", seconds=0.0005),
    _through("F8", "frames are late by 20 ms", "delay", seconds=0.02),
    Way(
        "F8",
        "frames are late by 50 ms",
        Follows.GOES_ON,
        "delay",
        {"seconds": 0.05},
        activities=_UNMEASURED,
    ),
    *single_messages(
        {
            "setpoint (RPDO)": {"id": 0x200 + MOVING},
            "SYNC": {"id": 0x080, "sender": US},
            "SDO request": {"id": 0x600 + MOVING},
            "SDO reply": {"id": 0x580 + MOVING},
            "TPDO": {"id": 0x180 + MOVING},
            "heartbeat of ours": {"id": 0x700 + 127},
        },
        within=STOP,
        actions=("hold", "disable", "close"),
        activities=_MOVING,
    ),
    _bus("bus-off", "bus_off", "bus-off"),
    _bus("interface down", "down", "interface is down"),
    _bus("no room to send", "full", "no room to send"),
    Way(
        "F10",
        "what is sent is lost",
        kind="listen_only",
        parameters={"node": US},
        within=HEARTBEAT,
        stands=HEARTBEAT + STOP,
    ),
    _drive(
        "F11",
        "a node's heartbeat is lost",
        "no_heartbeat",
        f"node {NODE} is not heard any more",
        within=HEARTBEAT,
    ),
    _drive("F11", "a node boots by itself", "reset", f"node {NODE} has started anew"),
    _drive("F11", "a node loses its power", "power_off", f"node {NODE}"),
    _drive("F12", "over-current", "fault", JOINT, error="over_current"),
    _drive("F12", "motor supply is off", "supply_off", f"{JOINT}"),
    Way(
        "F12",
        "the motor does not turn",
        kind="stuck",
        parameters={"node": MOVING},
        detail=f"joint_{MOVING}",
        within=HEARTBEAT,
        stands=HEARTBEAT + STOP,
        lags=True,
        activities=("servo_jp", "interpolate_jp", "move_jp", HOME),
    ),
    _drive("F13", "safe torque off", "safe_torque_off", JOINT),
    _drive("F14", "local control", "local_control", f"{JOINT}: remote (bit 9) has gone to 0"),
    *asked_to_stop(STOP, (HOME,)),
    *own_process(stop=STOP, stream=0.3),
    *outlived(stands=HEARTBEAT + STOP, activities=_MOVING),
    Way("F20", "a second master on the bus", Follows.KEPT_OUT, detail="another master"),
)

ABSENT = (
    Absent("F1", "a CAN bus has no connection; a bus that goes is F10"),
    Absent("F4", "a CAN frame arrives whole or not at all"),
    Absent("F7", "an adapter that goes is an interface that is down: F10"),
    Absent("F9", "no sensor; a drive that starts again is F11"),
)

HOMING: Mapping[str, Any] = {
    "method": 24,
    "speed_switch": 0.3,
    "speed_zero": 0.3,
    "acceleration": 10.0,
    "position": SWITCH,
}

VALUES: Mapping[str, Any] = {
    "joints": {
        f"joint_{node}": {
            "node": node,
            "gear": GEAR,
            "lower": -3.0,
            "upper": 3.0,
            "velocity": 2.0,
            "acceleration": 30.0,
            "effort": 20.0,
            "modes": ("csp", "csv", "cst"),
            **({"homing": HOMING} if node == MOVING else {}),
        }
        for node in range(1, COUNT + 1)
    },
}


_PATIENT = {
    "period": PERIOD,
    "missed_cycles": 100,
    "sample_timeout": 2.0,  # more than these take, which name the node
    "heartbeat": {"ours_timeout": HEARTBEAT + HELD_UP, "drives_timeout": HEARTBEAT + HELD_UP},
    "open_timeout": 10.0,
    "stream_timeout": 0.3,
}


class CanopenRig(Rig):
    """The arm."""

    name = "canopen"
    plugin = PLUGIN
    simulator = SIM
    sim_options = {"nodes": COUNT, "realtime": True, "drives": str(DRIVES)}  # noqa: RUF012
    ways = WAYS
    absent = ABSENT
    plan = Plan(velocity=0.5, far=2.0, effort=3.0, room=0.5)
    belated = BOOT
    activities = (
        REST,
        "servo_jp",
        "servo_jv",
        "servo_jf",
        "interpolate_jp",
        "interpolate_jv",
        "move_jp",
        HOME,
    )
    defaults = VALUES
    values = _PATIENT

    @override
    def joints(self) -> np.ndarray:
        return np.array(self._told("revolutions")) * 2.0 * math.pi / GEAR

    @override
    def powered(self) -> bool:
        return any(self._told("powered"))

    def _told(self, what: str) -> list[float]:
        assert self.sim is not None
        told = self.sim.control.status()["drives"]
        return [told[str(node)]["axes"][0][what] for node in range(1, COUNT + 1)]
