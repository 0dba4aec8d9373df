"""Copley: three simulated drives at one line, by points."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from bench.reliability.activities import HOME, Plan
from bench.reliability.common import frozen, of_part, outlived, own_process, passing
from bench.reliability.motor_controllers import FOLLOWED, SEARCH, SPEED, SWITCH, TURN, with_homing
from bench.reliability.rig import HELD_UP, Rig
from bench.reliability.table import REST, Absent, Follows, Way, asked_to_stop
from crtk_driver_copley import PLUGIN
from crtk_driver_copley.plugin import TYPICAL
from crtk_sim_backends.copley import SIM

SAMPLES = 0.5
"""`sample_timeout` of tests, s."""
STOP = 0.7
LEAD, PERIOD = 6, 0.04
BUFFER = LEAD * PERIOD
"""Seconds that drives go on for by themselves."""
TOLD = 0.4
"""Seconds in which a fault is told: it is believed when it is told twice."""
STUCK = 1.25
"""Seconds as `common.STALL`, with periods of 60 ms: what the line carries of three axes."""
AGAIN = 2.0
"""Declared s in which it connects again, and stops an axis that homes by itself."""
_MOVING = (*FOLLOWED, HOME)


def _drive(name: str, kind: str, detail: str, **more: object) -> Way:
    return of_part("F12", name, kind, detail, within=TOLD, stop=STOP, **more)


_MESSAGES = {
    "stop (t 0)": "t 0",
    "look at the trajectory (0xc9)": "g r0xc9",
    "look at the status (0xa0)": "g r0xa0",
}
"""What people call a message on the way to a stop, and a text that it has."""
_NOT_HEARD = {"lost": "lost_once", "not answered": "mute_once"}


def _single_messages() -> tuple[Way, ...]:
    """Return F8 of one message on the way to a stop that ends homing: it is not heard, or not answered."""
    switches = {**_MESSAGES, "desired state (0x24)": "s r0x24"}
    return tuple(
        Way("F8", f"{effect}: {message} after {action}", Follows.OBEYS, kind, {"text": text},
            stands=STOP + BUFFER, activities=(HOME,), action=action)
        for action in ("hold", "disable", "close")
        for message, text in (_MESSAGES if action == "hold" else switches).items()
        for effect, kind in _NOT_HEARD.items()
    )  # fmt: skip


WAYS = (
    Way("F2", "the line is silent", kind="silence", parameters={"port": "serial"}, within=SAMPLES,
        stands=SAMPLES + BUFFER + STOP, activities=(REST, *FOLLOWED)),
    Way("F2", "the line is silent for a moment while it homes", kind="silence",
        parameters={"port": "serial"}, within=SAMPLES, freezes=True, stands=AGAIN + STOP,
        activities=(HOME,)),
    *frozen(within=SAMPLES, stands=BUFFER + STOP, moment=0.04, activities=(REST, *FOLLOWED)),
    Way("F3", "nobody answers", Follows.STARTS_LATER, "silence", {"port": "serial"}, within=10.0),
    passing("F5", "a byte of every 31st answer is changed", "corrupt", every=31),
    passing("F5", "a byte of every 31st command is changed", "garbled", every=31),
    passing("F5", "every 37th answer ends in the middle", "half_line", every=37),
    passing("F5", "noise before every 13th answer", "garbage", every=13),
    passing("F6", "every 37th command is not heard", "lost", every=37),
    Way("F6", "a drive behind the first one is gone", kind="node_gone", parameters={"node": 1},
        detail="e 32", within=SAMPLES, stands=SAMPLES + BUFFER + STOP),
    Way("F7", "unplugged, and another tty later", kind="disconnect", parameters={"port": "serial"},
        detail="the adapter is gone", within=0.2, stands=BUFFER + STOP, activities=(REST, *FOLLOWED)),
    Way("F7", "unplugged, and another tty later, while it homes", kind="disconnect",
        parameters={"port": "serial"}, detail="the adapter is gone", within=0.2, freezes=True,
        stands=AGAIN + STOP, activities=(HOME,)),
    passing("F8", "every 37th answer is lost", "mute", every=37),
    passing("F8", "every 11th answer comes twice", "doubled", every=11),
    passing("F8", "every answer is 5 ms late", "late", every=1, seconds=0.005),
    Way("F11", "the first drive starts anew", kind="reset", within=SAMPLES + TOLD,
        stands=SAMPLES + BUFFER + STOP),
    Way("F11", "a drive behind it starts anew", kind="reset", parameters={"node": 1},
        within=TOLD, stands=TOLD + STOP, activities=_MOVING),
    _drive("its encoder", "latch", "joint_2: encoder error", node=1, bit=7),
    _drive("over-temperature", "latch", "joint_1: drive too hot", node=0, bit=3),
    _drive("under-voltage", "status", "joint_1: under-voltage", bits=1 << 3),
    _drive("its enable input", "input_off", "joint_3: its enable input is off", node=2),
    Way("F14", "another program stops an axis", kind="foreign_stop", within=SAMPLES,
        stands=SAMPLES + STOP, activities=_MOVING),
    *asked_to_stop(STOP + BUFFER, (HOME,)),
    *_single_messages(),
    *own_process(stop=STOP + BUFFER, stream=0.3, stuck=STUCK),
    *outlived(stands=BUFFER + STOP, activities=FOLLOWED),
    *outlived(stands=SEARCH + STOP, activities=(HOME,), when=" while it homes"),
    Way("F20", "a second driver at the port", Follows.KEPT_OUT, detail="in use"),
)  # fmt: skip

ABSENT = (
    Absent("F1", "a serial line has no connection; an adapter that goes is F7"),
    Absent("F4", "lines end with a carriage return, however they are cut: tests/copley/unit"),
    Absent("F9", "no sensor; a drive that starts anew is F11"),
    Absent("F10", "no CAN but behind the first drive, F6"),
    Absent("F13", "a safety input is F12"),
)


class CopleyRig(Rig):
    """The arm."""

    name = "copley"
    plugin = PLUGIN
    simulator = SIM
    ways = WAYS
    absent = ABSENT
    plan = Plan(velocity=0.5, far=2.0, room=0.3)
    activities = (REST, *_MOVING)
    homes_on = SEARCH
    belated = TOLD
    values = {  # noqa: RUF012
        **with_homing(
            TYPICAL["joints"],
            offset=SWITCH,  # where it is after homing
            homing={"method": "switch_positive", "speed": SPEED, "slow": 0.2},
        ),
        "sample_timeout": SAMPLES + HELD_UP,
        "reply_timeout": 0.05,
        "pvt_lead": LEAD,
        "pvt_period": PERIOD,
        "open_timeout": 5.0,
        "stream_timeout": 0.3,
        "limits": {"max_step": 0.3},  # cycles of 20 ms, and a pause of 50 ms
    }

    @override
    def joints(self) -> np.ndarray:
        assert self.sim is not None
        return np.array(self.sim.control.status()["position"]) / TURN

    @override
    def powered(self) -> bool:
        assert self.sim is not None
        return any(self.sim.control.status()["on"])

    @override
    def home(self) -> np.ndarray:
        return np.zeros(3)
