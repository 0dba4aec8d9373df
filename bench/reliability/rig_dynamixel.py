"""Dynamixel: the six joints of arm6 and its gripper on one simulated bus, without gravity."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from bench.reliability.activities import Plan
from bench.reliability.common import frozen, of_part, outlived, own_process
from bench.reliability.rig import HELD_UP, Rig
from bench.reliability.table import REST, Absent, Follows, Way, single_messages
from crtk_driver_dynamixel import PLUGIN
from crtk_sim_backends.dynamixel import SIM

ID = 5
JOINT = "joint wrist_angle (servo 5 on main)"
SERVOS = ",".join(
    [*(f"{id}:xm540-w270" for id in (1, 2, 3)), *(f"{id}:xm430-w350" for id in (4, 5, 6, 7))]
)
STOP = 1.0
SILENT = 0.5
"""Declared s after which a servo that does not answer is a fault."""
WATCHDOG = 0.4
BOOT = 2.0
"""Seconds in which the driver may notice that a servo has started again."""

_MOVING = ("servo_jp", "servo_jv", "servo_jf", "interpolate_jv", "move_jp", "move_cp")


def _servo(
    fault: str, name: str, kind: str, detail: str, within: float = SILENT, **more: object
) -> Way:
    return of_part(fault, name, kind, detail, within=within, stop=STOP, id=ID, **more)


WAYS = (
    Way("F2", "the adapter hands over nothing", kind="stall", within=SILENT, stands=SILENT + STOP),
    *frozen(within=SILENT, stands=SILENT + STOP),
    Way(
        "F3",
        "no servo has power",
        Follows.STARTS_LATER,
        kind="power_off",
        within=10.0,
        activities=(REST,),
    ),
    Way("F4", "bytes come in lumps of 4 ms", Follows.GOES_ON, "latency", {"milliseconds": 4.0}),
    Way("F4", "bytes come in lumps of 16 ms", Follows.GOES_ON, "latency", {"milliseconds": 16.0}),
    Way("F5", "a byte of every 5th reply is changed", Follows.GOES_ON, "corrupt", {"every": 5}),
    Way("F5", "every 5th reply has a wrong CRC", Follows.GOES_ON, "crc", {"every": 5}),
    Way("F5", "noise before every 3rd reply", Follows.GOES_ON, "noise", {"every": 3}),
    Way("F6", "every 5th reply is lost", Follows.GOES_ON, "drop", {"every": 5}),
    _servo("F6", "no reply of one servo", "drop", f"{JOINT} does not answer"),
    _servo("F6", "one servo hears nothing and says nothing", "silent", f"{JOINT} does not answer"),
    Way(
        "F7",
        "unplugged, and another tty later",
        kind="unplug",
        detail="the adapter is gone",
        within=0.1,
        stands=WATCHDOG + STOP,
    ),
    Way("F8", "every 5th instruction is lost", Follows.GOES_ON, "lost", {"every": 5}),
    Way(
        "F8",
        "replies overtaken by the next instruction",
        Follows.GOES_ON,
        "late",
        {"every": 29, "seconds": 0.03},
    ),
    Way(
        "F8",
        "every reply is 8 ms late",
        Follows.GOES_ON,
        "late",
        {"every": 1, "seconds": 0.008},
    ),
    *single_messages(
        {
            "group write": {"code": 0x83},
            "write": {"code": 0x03},
            "group read": {"code": 0x82},
            "read": {"code": 0x02},
        },
        within=STOP,
        actions=("hold", "disable", "close"),
        activities=_MOVING,
    ),
    Way("F8", "the adapter echoes what it sends", Follows.GOES_ON, "echo"),
    _servo("F11", "one servo loses its power", "power_off", JOINT, within=SILENT),
    _servo("F12", "overload", "overload", f"{JOINT}: overload"),
    _servo("F12", "overheating", "overheat", f"{JOINT}: overheating", temperature=95.0),
    _servo("F12", "input voltage", "voltage", f"{JOINT}: input voltage", volts=8.0),
    _servo("F12", "encoder", "hardware_error", f"{JOINT}: motor encoder", bit=3),
    *own_process(stop=STOP, stream=0.3),
    *outlived(stands=WATCHDOG + STOP, activities=_MOVING),
    Way("F20", "a second driver at the port", Follows.KEPT_OUT, detail="in use"),
)

ABSENT = (
    Absent("F1", "a serial line has no connection; an adapter that goes is F7"),
    Absent("F9", "no sensor; a servo that starts again is F11"),
    Absent("F10", "no CAN"),
    Absent("F13", "servos have no safety system; what they detect themselves is F12"),
    Absent("F14", "nobody but the host can command a servo"),
)


_DEFAULTS = {"arm": "arm6", "fast_read": False}
_PATIENT = {
    "rate": 100.0,
    "sample_timeout": 3.0,
    "open_timeout": 10.0,
    "latency_budget": 0.02,
    "silent_timeout": SILENT + HELD_UP,
    "slow_interval": 0.05,
    "watchdog": WATCHDOG + HELD_UP,
    "stream_timeout": 0.3,
}


class DynamixelRig(Rig):
    """The arm."""

    name = "dynamixel"
    plugin = PLUGIN
    simulator = SIM
    sim_options = {"servos": SERVOS, "realtime": True, "trace_size": 1000}  # noqa: RUF012
    ways = WAYS
    absent = ABSENT
    plan = Plan(velocity=0.5, far=2.0, effort=0.3, linear=0.1, away=0.12, room=0.3)
    activities = (
        REST,
        "servo_jp",
        "servo_jv",
        "servo_jf",
        "servo_cp",
        "servo_cv",
        "interpolate_jp",
        "interpolate_jv",
        "move_jp",
        "move_cp",
        "free",
    )
    defaults = _DEFAULTS
    values = _PATIENT
    tolerance = 5e-3  # three counts of 1.5 mrad
    belated = BOOT

    @override
    def home(self) -> np.ndarray:
        return np.array([0.0, 0.3, -0.5, 0.0, 0.4, 0.0])

    def by_hand(self) -> None:
        """A servo without an effort stays where it coasted to; what its own limits exclude, it refuses."""
        assert self.sim is not None
        if self.status.state == "ENABLED":
            self.arm.hold()
        self.until_still()
        limits = self.engine.capabilities.limits
        for id, (at, limit) in enumerate(zip(self.joints(), limits, strict=True), 1):
            if not limit.lower <= at <= limit.upper:
                angle = float(np.clip(at, limit.lower, limit.upper))
                self.sim.control.call("place", id=id, angle=angle)

    @override
    def joints(self) -> np.ndarray:
        return np.array(self._told("angle"))

    @override
    def powered(self) -> bool:
        return any(self._told("torque"))

    def _told(self, what: str) -> list[float]:
        assert self.sim is not None
        servos = self.sim.control.outputs()
        return [servos[f"bus1/{id}"][what] for id in range(1, 7)]
