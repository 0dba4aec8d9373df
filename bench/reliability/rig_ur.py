"""Universal Robots: one simulated UR5e, commanded by our own control program or by ur-rtde."""

from __future__ import annotations

import socket
from dataclasses import replace
from types import ModuleType
from unittest.mock import patch

import numpy as np
from typing_extensions import override

from bench.reliability.activities import Plan
from bench.reliability.common import frozen, outlived, own_process
from bench.reliability.rig import PATIENCE, Rig
from bench.reliability.table import ANY, NOW_AND_THEN, REST, Absent, Follows, Way
from crtk_driver_ur import PLUGIN, robot
from crtk_driver_ur.library import supervisor
from crtk_driver_ur.native import link, registers
from crtk_drivers.config import DeviceConfig
from crtk_drivers.errors import CrtkError
from crtk_sim_backends.ur import SIM, RunningSim

STOP = 1.0
SAMPLES = 1.0
"""`sample_timeout` of tests, s."""
WATCHDOG = 0.5
"""Declared s after which the controller stops the arm by itself."""
NOTICED = 0.1
"""Declared s in which a condition of the robot is told."""

DASHBOARD = 29999
LOCKED = 0.5
"""Seconds for which tests have a protective stop locked; a real controller has 5."""
RUNNING = 7
"""Robot mode of an arm with power and released brakes."""
PROTECTIVE_STOP = 3
"""Safety mode of an arm that has stopped protectively."""
RTDE = {"port": "rtde"}
_STATES = {"direction": "out", **RTDE}
UNBOUNDED = "ur-rtde's program does not bound what was on its way while the controller hung"
_MOVING = ("servo_jp", "servo_jv", "servo_cv", "interpolate_jp", "move_jp", "move_cp")
_UNMEASURED = (REST, *_MOVING, "servo_cp", "interpolate_jv")
"""What goes on while what is measured does not count: an effort does not."""


def _robot(
    fault: str, name: str, kind: str, detail: str, state: str = "FAULT", repair: str = ""
) -> Way:
    return Way(
        fault,
        name,
        kind=kind,
        states=(state,),
        detail=detail,
        within=NOTICED,
        stands=NOTICED + STOP,
        repair=repair,
    )


def _link(
    fault: str, name: str, kind: str, within: float = SAMPLES, detail: str = "", **more: object
) -> Way:
    return Way(
        fault,
        name,
        kind=kind,
        parameters=more,
        detail=detail,
        within=within,
        stands=max(within, WATCHDOG) + STOP,
    )


WAYS = (
    _link("F1", "RTDE closed", "disconnect", NOTICED, "closed", **RTDE),
    _link("F1", "all connections closed", "disconnect", NOTICED, "closed", port="all"),
    _link("F2", "RTDE silent", "silence", **RTDE),
    Way(
        "F2",
        "the controller hangs",
        kind="stall",
        within=SAMPLES,
        stands=WATCHDOG + STOP,
        freezes=True,
    ),
    *frozen(within=SAMPLES, stands=WATCHDOG + STOP),
    Way(
        "F3",
        "connects and never answers",
        Follows.STARTS_LATER,
        "no_answer",
        RTDE,
        within=10.0,
        activities=(REST,),
    ),
    Way(
        "F4",
        "packages in pieces of 7 bytes",
        Follows.GOES_ON,
        "split",
        {"size": 7, "direction": "out", **RTDE},
    ),
    Way(
        "F4",
        "packages in lumps of 20 ms",
        Follows.GOES_ON,
        "coalesce",
        {"seconds": 0.02, "direction": "out", **RTDE},
    ),
    Way(
        "F4",
        "commands in lumps of 150 ms",
        Follows.GOES_ON,
        "coalesce",
        {"seconds": 0.15, "direction": "in", **RTDE},
    ),
    Way("F4", "states come 35 ms late", Follows.GOES_ON, "delay", {"seconds": 0.035, **_STATES}),
    Way(
        "F4",
        "states come 0.2 s late",
        Follows.GOES_ON,
        "delay",
        {"seconds": 0.2, **_STATES},
        activities=_UNMEASURED,
    ),
    _link("F4", "states come 1.5 s late", "delay", seconds=1.5, **_STATES),
    _link("F5", "a byte of every package is changed", "corrupt", every=1, direction="out", **RTDE),
    _robot("F12", "the arm loses its power", "power_loss", "no power", "DISABLED"),
    _robot("F12", "the control program fails", "script_error", "program was stopped", "PAUSED"),
    _robot(
        "F13", "protective stop", "protective_stop", "protective stop", repair="unlock_protective"
    ),
    _robot("F13", "emergency stop", "emergency_stop", "emergency stop"),
    _robot("F13", "safeguard stop", "safeguard_stop", "safeguard", "PAUSED"),
    _robot("F13", "safety violation", "violation", "safety violation", repair="restart_safety"),
    _robot("F13", "safety fault", "safety_fault", "safety fault", repair="restart_safety"),
    _robot("F14", "local control", "local_control", "teach pendant has control", "PAUSED"),
    _robot(
        "F14", "program stopped at the pendant", "stop_program", "program was stopped", "PAUSED"
    ),
    _robot("F14", "program paused at the pendant", "pause_program", "program was paused", "PAUSED"),
    *own_process(stop=STOP, stream=0.3),
    *outlived(stands=WATCHDOG + STOP, activities=_MOVING),
    Way("F20", "a second driver at the controller", Follows.KEPT_OUT, detail="another program"),
)

ABSENT = (
    Absent("F6", "one package has all joints"),
    Absent("F7", "no adapter"),
    Absent("F8", "TCP loses, doubles and turns round nothing"),
    Absent("F9", "no sensor of its own"),
    Absent("F10", "no CAN"),
    Absent("F11", "no heartbeat but the packages, F2"),
)


FAR_BEHIND = 4.0
"""rad by which a joint may be late on a machine that takes the simulated time away."""

_LENIENT: tuple[tuple[ModuleType, str, float], ...] = (
    (robot, "UNLOCK_AFTER", LOCKED + 0.1),
    (supervisor, "SILENCE_ALLOWED", 2.0),
    (registers, "LOCK_TIMEOUT", 2.0),
    (link, "PROGRAM_START_TIMEOUT", PATIENCE),
)
"""Module, name and seconds: threads and processes may be silent for longer, and an arm is unlocked soon."""

_PATIENT = {
    "frequency": 125.0,
    "sample_timeout": SAMPLES,
    "watchdog_frequency": 2.0,
    "open_timeout": 2.0,
    "limits": {"following_error": FAR_BEHIND},
    "stream_timeout": 0.3,
    "move": {"joint_acceleration": 20.0},
    "servo": {"lookahead": 0.05},
}


class UrNativeRig(Rig):
    """With the driver's own control program."""

    name = "ur native"
    plugin = PLUGIN
    control = "native"
    ways = WAYS
    absent = ABSENT
    plan = Plan(velocity=0.5, far=2.0, linear=0.1, force=20.0, away=0.25, room=0.5)
    activities = (
        REST,
        "servo_jp",
        "servo_jv",
        "servo_cp",
        "servo_cv",
        "servo_cf",
        "interpolate_jp",
        "interpolate_jv",
        "move_jp",
        "move_cp",
        "free",
    )
    values = _PATIENT

    @property
    @override
    def defaults(self) -> dict[str, object]:  # type: ignore[override]
        return {"model": "ur5e", "control": self.control}

    @property
    @override
    def own_config(self) -> DeviceConfig:
        """For a busy machine the watchdog is half as fast as the slowest that users may have."""
        config = self.config
        return config.model_copy(update={"watchdog_frequency": 1.0}) if self.patient else config

    @override
    def start_sim(self) -> RunningSim:
        if not self.patient:
            return SIM.spawn(model="ur5e", realtime=True)
        for module, name, seconds in _LENIENT:
            self._stack.enter_context(patch.object(module, name, seconds))
        return SIM.spawn(model="ur5e", realtime=True, power_seconds=0.1, lock_seconds=LOCKED)

    @override
    def home(self) -> np.ndarray:
        return np.array([0.0, -1.57, 1.57, -1.57, -1.57, 0.0])

    @override
    def joints(self) -> np.ndarray:
        assert self.sim is not None
        return np.array(self.sim.control.outputs("actual_q")["actual_q"])

    @override
    def powered(self) -> bool:
        assert self.sim is not None
        return int(self.sim.control.outputs("robot_mode")["robot_mode"]) == RUNNING

    def unlock_protective(self) -> None:
        """Ask for the service that unlocks a protective stop, until the controller allows it.

        There may be none: an arm without power does not stop protectively.
        """
        sim = self.sim
        assert sim is not None

        def unlocked() -> bool:
            if int(sim.control.outputs("safety_mode")["safety_mode"]) != PROTECTIVE_STOP:
                return True
            try:
                self.arm.unlock_protective_stop()
            except CrtkError:
                return False
            return True

        self.until(unlocked, PATIENCE, "the protective stop is unlocked")

    def restart_safety(self) -> None:
        """Do what a person does at the pendant after a violation or a fault."""
        assert self.sim is not None
        with socket.create_connection((self.sim.host, DASHBOARD), PATIENCE) as peer:
            lines = peer.makefile("rw", newline="\n")
            lines.readline()
            lines.write("restart safety\n")
            lines.flush()
            lines.readline()


class UrRtdeRig(UrNativeRig):
    """With ur-rtde in a child process."""

    name = "ur ur_rtde"
    control = "ur_rtde"
    thorough = False
    activities = tuple(name for name in UrNativeRig.activities if name != "servo_cf")
    ways = tuple(
        replace(way, pending={ANY: UNBOUNDED + NOW_AND_THEN})
        if way.freezes and way.follows is Follows.STOPS
        else way
        for way in WAYS
    )
