"""A Robotiq FT 300: its stream through a robot's tool line. Nothing moves; what counts is what is told."""

from __future__ import annotations

from bench.reliability.common import UNMOVED, UnmovedRig, by_tcp, frozen, passing
from bench.reliability.rig import HELD_UP
from bench.reliability.table import Absent, Follows, Way
from crtk_driver_robotiq.ft300 import PLUGIN
from crtk_sim_backends.robotiq.ft300 import SIM

SAMPLES = 0.5
"""Declared s after which samples that do not come are a fault."""
FROZEN = 2.0


WAYS = (
    *by_tcp("tool", SAMPLES),
    Way("F2", "it repeats one measurement", kind="frozen", within=FROZEN, detail="frozen"),
    *frozen(within=SAMPLES),
    Way("F3", "nobody answers", Follows.STARTS_LATER, "unit_silent", within=4.0),
    passing("F5", "every 4th measurement is damaged", "bad_crc", every=4),
    passing("F5", "every 4th measurement is cut", "cut", every=4),
    passing("F5", "bytes of nobody between measurements", "noise"),
    Way(
        "F5",
        "every measurement is damaged",
        kind="bad_crc",
        parameters={"every": 1},
        within=SAMPLES,
    ),
    passing("F8", "every 3rd measurement is left out", "left_out", every=3),
    passing("F8", "every 3rd measurement comes twice", "doubled", every=3),
    Way("F9", "it loses its power", kind="unpowered", within=SAMPLES),
    Way("F14", "another program ends its stream", kind="other_master", within=SAMPLES),
    *UNMOVED,
)

ABSENT = (
    Absent("F6", "one measurement has all axes"),
    Absent("F7", "over TCP it is F1; at a serial line it is the kit's, as with DYNAMIXEL"),
    Absent("F10", "no CAN"),
    Absent("F11", "no heartbeat but the measurements, F2"),
    Absent("F12", "it reports none"),
    Absent("F13", "no safety system"),
    Absent("F15", "takes no commands that move"),
    Absent("F16", "nothing moves, so nothing has to be stopped"),
    Absent("F20", "at a tool's line it serves any client, and what another does is F14"),
)


class Ft300Rig(UnmovedRig):
    """The sensor."""

    name = "robotiq-ft300"
    plugin = PLUGIN
    simulator = SIM
    sim_options = {"tool_port": 0, "modbus_port": 0}  # noqa: RUF012
    ways = WAYS
    absent = ABSENT
    values = {"link": "tool", "sample_timeout": SAMPLES + HELD_UP, "open_timeout": 3.0}  # noqa: RUF012
