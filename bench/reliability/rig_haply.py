"""Haply: an Inverse3 and its grip at a simulated Inverse service.

It has no joints that a driver could move: what is watched is the impulse that its motors have given, which
goes on as long as a force is exerted and stands when none is.
"""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from bench.reliability.activities import Plan
from bench.reliability.common import by_tcp, frozen, outlived, own_process, passing
from bench.reliability.rig import HELD_UP, Rig
from bench.reliability.table import REST, Absent, Way
from crtk_driver_haply import PLUGIN
from crtk_sim_backends.haply import SIM

SAMPLES = 0.5
"""`sample_timeout` of tests, s."""
STOP = 0.1
_UNREADABLE = {"malformed": "no JSON", "half": "half of each", "nan": "NaN", "huge": "1e300 m/s"}


WAYS = (
    *by_tcp("service", SAMPLES),
    passing("F4", "in frames of 50 bytes", "fragments"),
    Way("F2", "messages are not answered", kind="mute", within=SAMPLES, stands=SAMPLES + STOP),
    *frozen(within=SAMPLES, stands=STOP),
    passing("F5", "members that nobody knows", "more"),
    *(
        Way("F5", f"answers are {words}", kind=kind, within=SAMPLES, stands=SAMPLES + STOP)
        for kind, words in _UNREADABLE.items()
    ),
    Way("F6", "its grip sleeps", kind="asleep", states=("PAUSED",), detail="asleep", stands=STOP),
    Way("F6", "its grip is off", kind="no_grip", states=("PAUSED",), detail="VerseGrip",
        stands=STOP),
    Way("F7", "the Inverse3 is unplugged", kind="vanish", detail="no Inverse3", stands=STOP),
    Way("F12", "it is not calibrated", kind="uncalibrated", states=("DISABLED",),
        detail="not calibrated", stands=STOP),
    *own_process(stop=STOP, stream=0.3),
    *outlived(stands=0.2, activities=("servo_cf",)),
)  # fmt: skip

ABSENT = (
    Absent("F8", "TCP loses, doubles and turns round nothing"),
    Absent("F9", "a service that starts anew has closed its connections, F1"),
    Absent("F10", "no CAN"),
    Absent("F11", "no heartbeat but the answers, F2"),
    Absent("F13", "no safety system that its simulation channel tells of"),
    Absent("F14", "nobody at the device takes over"),
    Absent("F20", "a service serves several clients; that one is there is not told"),
)


class HaplyRig(Rig):
    """The device."""

    name = "haply"
    plugin = PLUGIN
    simulator = SIM
    ways = WAYS
    absent = ABSENT
    plan = Plan(velocity=0.0, far=0.0, force=1.0)
    activities = (REST, "servo_cf")
    values = {  # noqa: RUF012
        "sample_timeout": SAMPLES + HELD_UP,
        "open_timeout": 5.0,
        "stream_timeout": 0.3,
        "rate": 200.0,
        "ramp": 0.0,
    }

    @override
    def joints(self) -> np.ndarray:
        assert self.sim is not None
        return np.array([self.sim.control.status()["impulse"]])
