"""A Robotiq gripper at a robot's tool line, at rest.

It has no watchdog, and goes on to where it was sent last whatever happens to its driver: what happens to one
that moves or holds something is in tests/robotiq/faults. Here are the link and the process.
"""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from bench.reliability.activities import Plan
from bench.reliability.common import UNMOVED, by_tcp, passing
from bench.reliability.rig import HELD_UP, Rig
from bench.reliability.table import REST, Absent, Follows, Way
from crtk_driver_robotiq import PLUGIN
from crtk_sim_backends.robotiq import SIM

SAMPLES = 0.5
"""Declared s after which samples that do not come are a fault."""


WAYS = (
    *by_tcp("tool", SAMPLES),
    Way("F2", "it hears and does not answer", kind="unit_silent", within=SAMPLES),
    Way("F3", "nobody answers", Follows.STARTS_LATER, "unit_silent", within=4.0),
    passing("F5", "every 3rd answer is damaged", "bad_crc", every=3),
    passing("F5", "every 4th answer is cut", "cut", every=4),
    passing("F5", "bytes of nobody before each answer", "noise"),
    Way("F5", "every answer is damaged", kind="bad_crc", parameters={"every": 1}, within=SAMPLES),
    passing("F8", "every 3rd answer comes twice", "doubled", every=3),
    passing("F8", "answers are late by 30 ms", "late", seconds=0.03),
    Way("F12", "it is too hot", kind="gripper_fault", parameters={"code": 8}, detail="too hot"),
    *UNMOVED,
)

ABSENT = (
    Absent("F6", "one answer has all there is"),
    Absent("F7", "over TCP it is F1; at a serial line it is the kit's, as with DYNAMIXEL"),
    Absent("F9", "no sensor; one that lost its power is activated anew, which moves it"),
    Absent("F10", "no CAN"),
    Absent("F11", "no heartbeat but the answers, F2"),
    Absent("F13", "no safety system"),
    Absent("F14", "another master moves it, and that is no motion of the driver's"),
    Absent("F15", "goes to where it was sent last, by a stream as by a move"),
    Absent("F16", "no watchdog: goes to where it was sent last"),
    Absent("F20", "a tool's line serves any client"),
)


class RobotiqRig(Rig):
    """The gripper."""

    name = "robotiq"
    plugin = PLUGIN
    simulator = SIM
    sim_options = {"tool_port": 0, "modbus_port": 0, "urcap_port": 0}  # noqa: RUF012
    ways = WAYS
    absent = ABSENT
    activities = (REST,)
    plan = Plan(velocity=0.02, far=0.01, room=0.02)
    values = {"link": "tool", "sample_timeout": SAMPLES + HELD_UP, "open_timeout": 3.0}  # noqa: RUF012

    @override
    def joints(self) -> np.ndarray:
        assert self.sim is not None
        return np.array([self.sim.control.status()["opening"]])

    @override
    def home(self) -> np.ndarray:
        return np.array([0.04])
