"""OptoForce: a unit with one sensor at a serial line. Nothing moves; what counts is what is told of loads."""

from __future__ import annotations

from bench.reliability.common import UNMOVED, UnmovedRig, frozen, passing
from bench.reliability.table import Absent, Follows, Way
from crtk_driver_optoforce import PLUGIN
from crtk_sim_backends.optoforce import SIM

SAMPLES = 0.5
"""`sample_timeout` of tests, s."""
SERIAL = {"port": "serial"}


WAYS = (
    Way("F2", "nothing crosses the line", kind="silence", parameters=SERIAL, within=SAMPLES),
    Way("F2", "it sends no measurements", kind="stopped", within=SAMPLES),
    Way("F2", "it repeats one measurement", kind="frozen", within=SAMPLES),
    *frozen(within=SAMPLES),
    Way("F3", "nothing crosses the line", Follows.STARTS_LATER, "silence", SERIAL, within=4.0),
    passing("F4", "byte by byte", "split", size=1, **SERIAL),
    passing("F4", "in lumps of 20 ms", "coalesce", seconds=0.02, **SERIAL),
    passing("F5", "every 4th measurement is damaged", "bad_sum", every=4),
    passing("F5", "every 4th measurement is cut", "cut", every=4),
    passing("F5", "bytes of nobody between measurements", "noise"),
    Way("F5", "every measurement is damaged", kind="bad_sum", parameters={"every": 1},
        within=SAMPLES),
    Way("F7", "it is unplugged", kind="disconnect", parameters=SERIAL, within=SAMPLES),
    passing("F8", "every 3rd measurement is left out", "left_out", every=3),
    passing("F8", "every 3rd measurement comes twice", "doubled", every=3),
    Way("F12", "its data acquisition fails", kind="status", parameters={"word": 0x2000},
        detail="data acquisition"),
    *UNMOVED,
    Way("F20", "a second driver at its port", Follows.KEPT_OUT, detail="in use"),
)  # fmt: skip

ABSENT = (
    Absent("F1", "a serial line has no connection; a unit that goes is F7"),
    Absent("F6", "one measurement has all axes"),
    Absent("F9", "one that starts anew is set anew, and goes on: tests/optoforce"),
    Absent("F10", "no CAN"),
    Absent("F11", "no heartbeat but the measurements, F2"),
    Absent("F13", "no safety system"),
    Absent("F14", "nobody but the host can set it"),
    Absent("F15", "takes no commands that move"),
    Absent("F16", "nothing moves, so nothing has to be stopped"),
)


class OptoForceRig(UnmovedRig):
    """The unit."""

    name = "optoforce"
    plugin = PLUGIN
    simulator = SIM
    ways = WAYS
    absent = ABSENT
    values = {"sample_timeout": SAMPLES, "open_timeout": 3.0}  # noqa: RUF012
