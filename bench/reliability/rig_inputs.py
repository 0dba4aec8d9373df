"""Inputs: pedals at a simulated event device of Linux. Nothing moves; what counts is what is told of them."""

from __future__ import annotations

from bench.reliability.common import UNMOVED, UnmovedRig, passing
from bench.reliability.table import Absent, Follows, Way
from crtk_driver_inputs import PLUGIN
from crtk_sim_backends.inputs import SIM

WAYS = (
    Way("F3", "it is not plugged in", Follows.STARTS_LATER, "disconnect", within=3.0),
    passing("F5", "bytes that are no event", "garbage"),
    Way("F7", "it is unplugged", kind="disconnect"),
    passing("F8", "events are missing, and it says so", "overrun"),
    *UNMOVED,
)

ABSENT = (
    Absent("F1", "a device of this computer has no connection; one that goes is F7"),
    Absent("F2", "pedals at rest are silent, and the kernel says when they are gone; a mouse that falls "
           "silent while it is pushed is let go: tests/inputs"),
    Absent("F4", "the kernel hands over whole events"),
    Absent("F6", "each pedal is told by itself"),
    Absent("F9", "no sensor that is set"),
    Absent("F10", "no CAN"),
    Absent("F11", "no heartbeat"),
    Absent("F12", "it reports none"),
    Absent("F13", "no safety system"),
    Absent("F14", "nothing is controlled"),
    Absent("F15", "takes no commands"),
    Absent("F16", "nothing moves, so nothing has to be stopped"),
    Absent("F20", "the kernel tells its events to any program"),
)  # fmt: skip


class InputsRig(UnmovedRig):
    """The pedals."""

    name = "inputs"
    plugin = PLUGIN
    simulator = SIM
    ways = WAYS
    absent = ABSENT
    values = {"pedals": {"clutch": 30, "coag": 48}, "sample_timeout": 1.0}  # noqa: RUF012
