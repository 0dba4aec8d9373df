"""A Robotiq gripper that moves: at a robot's tool line, and by the text server of the URCap.

It has no watchdog, and goes on to where it was sent last whatever happens to its driver: in a move that is
the goal, in a stream of positions the last one. What happens to one that holds something is in
tests/robotiq/faults.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from typing_extensions import override

from bench.reliability.activities import Plan
from bench.reliability.common import by_tcp, frozen, outlived, own_process, passing
from bench.reliability.rig import HELD_UP, Rig
from bench.reliability.table import REST, Absent, Follows, Way, single_messages
from crtk_driver_robotiq import PLUGIN
from crtk_sim_backends.robotiq import SIM

SAMPLES = 0.5
"""Declared s after which samples that do not come are a fault."""
STOP = 0.5
"""Declared s in which fingers stand after a stop, though one message of it is lost (docs/robotiq.md)."""
SLOWEST = 0.02
"""Speed in m/s of a 2F-85 that is asked for less."""
OPEN = 0.085
MARGIN = 0.005
TRAVEL = OPEN / SLOWEST
"""Declared s in which fingers that no stop reaches are where they were sent last."""
TAKEOVER = 0.25
"""Declared s after which another program's command is one."""
SHORT = 0.02
"""How far (m) fingers may go after a stop: far less than to the goal of a move, on a busy machine, too."""

_STREAMS = ("servo_jp", "interpolate_jp")
_MOVING = (*_STREAMS, "move_jp")


def _link(port: str) -> tuple[Way, ...]:
    """Return F1 to F4 of the port: no stop reaches the fingers, which go to where they were sent last."""
    return tuple(
        replace(way, stands=TRAVEL, runs_on=True) if way.follows is Follows.STOPS else way
        for way in by_tcp(port, SAMPLES)
    )


def _cut_off(port: str) -> Way:
    """Return the way in which it is closed while no stop comes to it: it goes on, and that is said."""
    return Way(
        "F2",
        "half open as it is closed, which says so",
        Follows.OBEYS,
        "silence",
        {"port": port},
        stands=TRAVEL,
        runs_on=True,
        activities=("move_jp",),
        action="close",
    )


def _heard(fault: str, name: str, kind: str, **parameters: Any) -> Way:
    """Return the way in which a gripper hears, and nothing comes from it that can be used."""
    stands = SAMPLES + STOP
    return Way(fault, name, kind=kind, parameters=parameters, within=SAMPLES, stands=stands)


def _ends_at_once(fault: str, name: str, kind: str, **more: Any) -> Way:
    """Return the way in which the gripper itself ends what it does, and is read meanwhile."""
    return Way(fault, name, kind=kind, stands=STOP, far=SHORT, **more)


_OWN = (
    *frozen(within=SAMPLES, stands=STOP, far=SHORT),  # the stop waits for it, or is sent again
    _ends_at_once(
        "F11",
        "it loses its power and gets it back",
        kind="unpowered",
        within=SAMPLES,
    ),
    _ends_at_once(
        "F12",
        "it is too hot",
        kind="gripper_fault",
        parameters={"code": 8},
        detail="too hot",
    ),
    _ends_at_once(
        "F12",
        "overcurrent, which only a reset clears",
        kind="gripper_fault",
        parameters={"code": 14},
        detail="overcurrent",
    ),
    _ends_at_once(
        "F14",
        "a pendant resets it",
        kind="deactivated",
        states=("DISABLED",),
        detail="not activated",
    ),
    Way(
        "F14",
        "another program sends it elsewhere",
        kind="other_master",
        parameters={"position": 128},
        states=("PAUSED",),
        detail="another program commands it",
        within=TAKEOVER,
        stands=TRAVEL,
        runs_on=True,
        activities=(REST, "move_jp"),  # in a stream the next position is the newer command
    ),
)

_PROCESS = (
    *own_process(stop=STOP, stream=0.3),
    *outlived(stands=STOP, activities=_STREAMS),
    *(
        replace(way, name=f"{way.name} in a move, which it carries out")
        for way in outlived(stands=TRAVEL, activities=("move_jp",))
    ),
)


def _single(**more: Any) -> tuple[Way, ...]:
    """Return F8 of each kind of message: what writes (a command), and what only reads (the status)."""
    kinds = {
        f"{part} that {of}s": {"part": part, "of": of}
        for part in ("request", "answer")
        for of in ("write", "read")
    }
    actions = ("hold", "disable", "pause", "close")
    return single_messages(
        kinds, within=STOP, actions=actions, activities=_MOVING, far=SHORT, **more
    )


WAYS = (
    *_link("tool"),
    _cut_off("tool"),
    _heard("F2", "it hears and does not answer", "unit_silent"),
    Way("F3", "nobody answers", Follows.STARTS_LATER, "unit_silent", within=4.0),
    passing("F5", "every 3rd answer is damaged", "bad_crc", every=3),
    passing("F5", "every 4th answer is cut", "cut", every=4),
    passing("F5", "bytes of nobody before each answer", "noise"),
    _heard("F5", "every answer is damaged", "bad_crc", every=1),
    passing("F8", "every 3rd answer comes twice", "doubled", every=3),
    passing("F8", "answers are late by 30 ms", "late", seconds=0.03),
    *_single(),
    *_OWN,
    *_PROCESS,
)

ABSENT = (
    Absent("F6", "one answer has all there is"),
    Absent("F7", "over TCP it is F1; at a serial line it is the kit's, as with DYNAMIXEL"),
    Absent("F9", "no sensor; one that lost its power is F11"),
    Absent("F10", "no CAN"),
    Absent("F13", "no safety system"),
    Absent("F20", "a tool's line serves any client"),
)


class RobotiqRig(Rig):
    """The gripper at a robot's tool line."""

    name = "robotiq"
    plugin = PLUGIN
    simulator = SIM
    sim_options = {  # noqa: RUF012
        "tool_port": 0,
        "modbus_port": 0,
        "controller_port": 0,
        "urcap_port": 0,
        "sweep_speed": 0.05,  # so slow that a stop that comes to nothing is seen
    }
    ways = WAYS
    absent = ABSENT
    activities = (REST, *_MOVING)
    services = ("activate",)
    plan = Plan(velocity=SLOWEST, far=0.065, ratio=0.01, room=0.005)
    values = {  # noqa: RUF012
        "link": "tool",
        "sample_timeout": SAMPLES + HELD_UP,
        "open_timeout": 3.0,
        "stream_timeout": 0.3,
        "interpolate_timeout": 0.3,
    }
    tolerance = 1e-3  # two counts and a half
    stop_time = STOP
    arrival = 5e-3

    @override
    def joints(self) -> np.ndarray:
        return np.array([self._told("opening")])

    @override
    def home(self) -> np.ndarray:
        return np.array([0.012])

    @override
    def go_home(self) -> None:
        self.arm.trajectory_j.set_ratio_v(1.0)
        super().go_home()

    @property
    @override
    def enable_moves(self) -> bool:
        return self._told("state") != "active" or self._told("fault") >= 10

    @override
    def homeward(self, name: str) -> Plan:
        """Return the plan to the end that is farther, nearly: of home, to open."""
        at = float(self.looks[-1].joints[0])
        is_open = at > OPEN / 2.0
        far = (MARGIN if is_open else OPEN - MARGIN) - at
        return replace(self.plan, far=far, velocity=math.copysign(self.plan.velocity, far))

    plan_of_walk = homeward

    def _told(self, what: str) -> Any:
        assert self.sim is not None
        return self.sim.control.status()[what]


class RobotiqUrcapRig(RobotiqRig):
    """The same by the text server of the URCap."""

    name = "robotiq-urcap"
    ways = (
        *_link("urcap"),
        _cut_off("urcap"),
        _heard("F2", "it hears and does not answer", "unit_silent"),
        Way("F3", "nobody answers", Follows.STARTS_LATER, "unit_silent", within=4.0),
        passing("F8", "answers are late by 30 ms", "late", seconds=0.03),
        *_single(may_lose_link=True),
        *_OWN,
        *_PROCESS,
    )
    absent = (
        *(absent for absent in ABSENT if absent.fault not in ("F6", "F20")),
        Absent(
            "F5",
            "TCP and its checksum; what is no answer is a ProtocolError in the tests of the driver",
        ),
        Absent("F6", "one server answers for all"),
        Absent("F20", "the server serves any client"),
    )
    values = {**RobotiqRig.values, "link": "urcap"}  # noqa: RUF012
