"""Galil: three axes of one simulated controller, by position tracking."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from bench.reliability.activities import HOME, Plan
from bench.reliability.common import by_tcp, frozen, of_part, outlived, own_process, passing
from bench.reliability.motor_controllers import FOLLOWED, SEARCH, SPEED, SWITCH, TURN, with_homing
from bench.reliability.rig import HELD_UP, Rig
from bench.reliability.table import REST, Absent, Way, asked_to_stop
from crtk_driver_galil import PLUGIN
from crtk_driver_galil.plugin import TYPICAL
from crtk_sim_backends.galil import SIM

SAMPLES = 0.5
"""Declared s after which records that do not come are a fault."""
REPLY = 1.0
"""Declared s after which a command that is not answered is a fault."""
FAR_BEHIND = 4.0
"""rad by which a joint may be late on a machine that takes the simulated time away."""
STOP = 0.7
AGAIN = 1.0
"""Declared s in which it connects again, and stops an axis that homes by itself."""
_MOVING = (*FOLLOWED, HOME)


def _axis(name: str, kind: str, detail: str, **more: object) -> Way:
    return of_part("F12", name, kind, detail, within=0.2, stop=STOP, **more)


WAYS = (
    *(
        way
        for way in by_tcp("command", REPLY)
        if way.fault in ("F3", "F4")
    ),
    Way("F1", "the connection is closed", kind="disconnect", parameters={"port": "command"}, stands=STOP,
        activities=(REST, *FOLLOWED)),
    Way("F1", "the connection is closed for a moment while it homes", kind="disconnect",
        parameters={"port": "command"}, freezes=True, stands=AGAIN + STOP, activities=(HOME,)),
    Way("F2", "commands are not answered", kind="mute", within=REPLY + SAMPLES,
        stands=REPLY + SAMPLES + STOP, activities=FOLLOWED),
    Way("F2", "no data records come", kind="no_records", within=SAMPLES, stands=SAMPLES + STOP),
    *frozen(within=SAMPLES, stands=STOP, activities=(REST, *FOLLOWED)),
    passing("F5", "a byte of every 4th record is changed", "corrupt", every=4),
    passing("F5", "every 4th record is cut", "short", every=4),
    passing("F8", "every 3rd record is lost", "loss", every=3),
    passing("F8", "every 2nd record comes twice", "duplicate", every=2),
    passing("F8", "every 5th record is overtaken", "late", every=5, by=2),
    passing("F14", "a program writes lines of its own", "chatter"),
    Way("F9", "the controller starts anew", kind="reset", within=SAMPLES, stands=STOP),
    _axis("its amplifier", "amplifier", "over-current", status=1),
    _axis("its motor loses its power", "motor_off", "its motor is off", axis="A"),
    Way("F12", "its encoder", kind="encoder_failure", parameters={"axis": "A"},
        detail="encoder failure", within=0.2, stands=0.2 + STOP),
    *asked_to_stop(STOP, (HOME,)),
    *own_process(stop=STOP, stream=0.3),
    *outlived(stands=STOP, activities=FOLLOWED),
    *outlived(stands=SEARCH + STOP, activities=(HOME,), when=" while it homes"),
)  # fmt: skip

ABSENT = (
    Absent("F6", "one record has all axes"),
    Absent("F7", "no serial line"),
    Absent("F10", "no CAN"),
    Absent("F11", "no heartbeat but the records, F2"),
    Absent("F13", "its abort input is a stop code, F12"),
    Absent("F20", "a controller serves eight clients; who asks for records last gets them, F2"),
)


class GalilRig(Rig):
    """The arm."""

    name = "galil"
    plugin = PLUGIN
    simulator = SIM
    ways = WAYS
    absent = ABSENT
    plan = Plan(velocity=0.5, far=2.0, room=0.3)
    activities = (REST, *_MOVING)
    homes_on = SEARCH
    values = {  # noqa: RUF012
        **with_homing(
            TYPICAL["joints"], homing={"method": "home", "speed": SPEED, "position": SWITCH}
        ),
        "sample_timeout": SAMPLES + HELD_UP,
        "reply_timeout": REPLY + HELD_UP,
        "open_timeout": 5.0,
        "limits": {"following_error": FAR_BEHIND},
        "stream_timeout": 0.3,
    }

    @override
    def joints(self) -> np.ndarray:
        assert self.sim is not None
        return np.array(self.sim.control.status()["position"][:3]) / TURN

    @override
    def home(self) -> np.ndarray:
        return np.zeros(3)
