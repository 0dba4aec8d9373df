"""A robot behind ros2_control: six simulated joints with forward controllers, over DDS."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from bench.reliability.activities import Plan
from bench.reliability.common import frozen, of_part, outlived, own_process, passing
from bench.reliability.rig import Rig
from bench.reliability.table import REST, Absent, Follows, Way
from crtk_driver_ros2_control import PLUGIN
from crtk_sim_backends.ros2_control import SIM

STOP = 1.5
SAMPLES = 1.0
"""`sample_timeout` of tests, s."""
ANSWERS = 2.0
"""`service_timeout` of tests, s."""
LOOK = 0.5
"""Declared s in which a change of controllers or hardware is noticed: they are asked for every 0.2 s."""
HOLDING = ("servo_jp", "interpolate_jp", "move_jp")
"""What a forward controller of positions stands in when nobody sends any more: it keeps the last one."""


def _states(fault: str, name: str, kind: str, detail: str = "", **parameters: object) -> Way:
    return of_part(fault, name, kind, detail, within=SAMPLES, stop=STOP, **parameters)


def _robot(
    fault: str,
    name: str,
    kind: str,
    detail: str,
    state: str = "FAULT",
    repair: str = "",
    **parameters: object,
) -> Way:
    return Way(
        fault,
        name,
        kind=kind,
        parameters=parameters,
        states=(state,),
        detail=detail,
        within=LOOK,
        stands=LOOK + STOP,
        repair=repair,
    )


WAYS = (
    Way(
        "F1",
        "the network is cut",
        kind="disconnect",
        within=SAMPLES,
        stands=SAMPLES + STOP,
        activities=(REST, *HOLDING),
    ),
    _states("F2", "no joint states", "broadcaster_stops"),
    _states("F2", "joint states repeat one stamp", "frozen", "does not advance"),
    Way(
        "F2",
        "the controller manager does not answer",
        kind="silent_services",
        detail="answer in",
        within=ANSWERS + LOOK,
        stands=ANSWERS + LOOK + STOP,
    ),
    *frozen(within=SAMPLES, stands=STOP),
    Way("F3", "no robot", Follows.STARTS_LATER, "disconnect", within=8.0, activities=(REST,)),
    Way(
        "F3",
        "no joint states",
        Follows.STARTS_LATER,
        "broadcaster_stops",
        within=8.0,
        activities=(REST,),
    ),
    passing("F4", "joint states in two messages", "split"),
    _states("F5", "bytes that are no joint states", "garbage", "cannot be used"),
    _states("F5", "NaN for a position", "not_a_number", "not finite", joint=2),
    passing("F5", "NaN for a velocity", "not_a_number", joint=2, of="velocity"),
    _states("F5", "no stamps", "unstamped", "no stamp"),
    _states("F6", "a joint is missing", "missing", "joint_3", joint=2),
    _states("F6", "a joint is there twice", "twice", "joint_3 is there twice", joint=2),
    passing("F8", "joints in the opposite order", "reorder"),
    passing("F8", "joint states 50 ms late", "delay", seconds=0.05),
    passing("F8", "joint states of another node", "rival"),
    _states("F8", "joint states 2 s late", "delay", seconds=2.0),
    _states("F11", "ros2_control_node is started again", "restart", seconds=2.0),
    _robot("F12", "the hardware is inactive", "hardware_error", "sim_system is inactive"),
    _robot(
        "F12",
        "an error ends the hardware",
        "hardware_error",
        "sim_system is finalized",
        repair="mend",
        to="finalized",
    ),
    _robot("F12", "every controller is inactive", "all_inactive", "nobody holds the joints"),
    _robot(
        "F14",
        "somebody's own controller has the joints",
        "take_joints",
        "admittance_controller",
        "PAUSED",
        "give_back",
    ),
    *own_process(stop=STOP, stream=0.3),
    *outlived(stands=STOP, activities=HOLDING),
)

ABSENT = (
    Absent("F7", "no adapter"),
    Absent("F9", "no sensor; a node that starts again is F11"),
    Absent("F10", "no CAN"),
    Absent("F13", "ros2_control knows no safety system; what hardware tells is F12"),
    Absent(
        "F20",
        "controllers take commands from anybody; whoever publishes them too is told in diagnostics",
    ),
)

_DEFAULTS = {"hardware": ["sim_system"]}
_PATIENT = {
    "sample_timeout": SAMPLES,
    "service_timeout": ANSWERS,
    "open_timeout": 6.0,
    "stop_time": 4.0,
    "lag": 1.0,
    "stream_timeout": 0.3,
}


class Ros2ControlRig(Rig):
    """The robot."""

    name = "ros2-control"
    plugin = PLUGIN
    simulator = SIM
    ways = WAYS
    absent = ABSENT
    plan = Plan(velocity=0.4, far=1.5, effort=4.0, room=1.0)
    activities = (
        REST,
        "servo_jp",
        "servo_jv",
        "servo_jf",
        "interpolate_jp",
        "interpolate_jv",
        "move_jp",
    )
    defaults = _DEFAULTS
    values = _PATIENT
    tolerance = 5e-3
    thorough = False
    belated = LOOK

    @property
    @override
    def named(self) -> str:
        return "/sim_robot"

    @override
    def joints(self) -> np.ndarray:
        assert self.sim is not None
        return np.array(self.sim.control.status()["positions"])

    @override
    def home(self) -> np.ndarray:
        return np.array([0.0, 0.4, 0.8, 0.2, 0.6, 0.0])

    def mend(self) -> None:
        """Somebody brings the hardware, and what tells of it, to active again."""
        self.inject("hardware_mended")

    def give_back(self) -> None:
        """The other controller is inactive again."""
        self.inject("give_joints")
