"""dVRK: a PSM on two simulated boards. One that is read: nothing moves, and what counts is what is told; and
one that is driven by efforts."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from bench.reliability.activities import Plan
from bench.reliability.common import UNMOVED, UnmovedRig, frozen, outlived, own_process, passing
from bench.reliability.rig import HELD_UP, Rig
from bench.reliability.table import REST, Absent, Follows, Way
from crtk_driver_dvrk import PLUGIN
from crtk_sim_backends.dvrk import SIM

SAMPLES = 0.5
"""`sample_timeout` of tests, s."""
SEARCH = 3.0
"""s in which all nodes are asked twice whether they are there."""

WAYS = (
    Way("F2", "no board answers", kind="silence", within=SAMPLES),
    *frozen(within=SAMPLES),
    Way("F2", "answers come too late", kind="delay", parameters={"seconds": 0.3}, within=SAMPLES),
    Way("F3", "nobody answers", Follows.STARTS_LATER, "silence", within=4.0),
    passing("F5", "a byte of every 4th reply is changed", "corrupt", every=4),
    passing("F5", "every 4th reply is cut", "short", every=4),
    passing("F5", "every 4th reply is too long", "long", every=4),
    passing("F5", "empty datagrams between replies", "empty", every=2),
    Way("F6", "one board does not answer", kind="mute", parameters={"node": 1}, within=SAMPLES),
    passing("F8", "every 3rd reply is lost", "loss", every=3),
    passing("F8", "every 2nd reply comes twice", "duplicate", every=2),
    passing("F8", "every 5th reply is overtaken", "late", every=5, by=2),
    Way("F9", "the FireWire bus is reset", kind="bus_reset", detail="bus was reset"),
    Way("F9", "a board starts anew", kind="restart", parameters={"node": 1}, detail="bus was reset"),
    Way("F9", "another board answers in its place", kind="other_board", parameters={"node": 1},
        detail="another one"),
    Way("F9", "a board starts anew with other firmware", kind="other_firmware",
        detail="firmware 7", within=SEARCH),
    Way("F12", "an encoder counts beyond its range", kind="encoder_overflow",
        detail="beyond its range"),
    Way("F12", "the supply of encoders", kind="encoder_supply", detail="supply of its encoders"),
    passing("F12", "signals of an encoder that cannot be", "encoder_error"),
    passing("F12", "the watchdog of a board expires", "watchdog"),
    passing("F12", "an amplifier is too hot", "amplifier"),
    passing("F13", "motors have no voltage", "supply_off"),
    passing("F13", "the safety relay stays open", "relay_open"),
    *UNMOVED,
)  # fmt: skip

ABSENT = (
    Absent("F1", "UDP has no connection; a cable that is pulled is F2"),
    Absent("F4", "a datagram arrives whole or not at all"),
    Absent("F7", "no adapter"),
    Absent("F10", "no CAN"),
    Absent("F11", "no heartbeat but the replies, F2; a board that starts anew is F9"),
    Absent("F14", "it is only read: others may drive the arm"),
    Absent("F15", "takes no commands that move"),
    Absent("F16", "nothing is driven, so nothing has to be stopped"),
    Absent("F20", "boards answer whoever asks, and do not tell that another one does"),
)


class DvrkRig(UnmovedRig):
    """The arm."""

    name = "dvrk"
    plugin = PLUGIN
    simulator = SIM
    ways = WAYS
    absent = ABSENT
    values = {  # noqa: RUF012
        "sample_timeout": SAMPLES + HELD_UP,
        "open_timeout": 3.0,
        "rate": 200.0,
        "reply_timeout": 0.03,
    }

    @override
    def joints(self) -> np.ndarray:
        """Counts of the axes that the arm has: nobody moves them."""
        assert self.sim is not None
        first, second = self.sim.control.status()["boards"]
        return np.array([*first["position"], *second["position"][:3]])


SCALE = -7.722695805e-06
"""rad of a count of the joint that is moved."""

STOP = 1.0
"""s in which joints stand after a stop; they coast."""

OFF = {"stands": STOP, "within": 0.2}


def off(name: str, kind: str, detail: str, **parameters: object) -> Way:
    """Return F12: boards tell what must not be."""
    return Way("F12", name, kind=kind, detail=detail, parameters=parameters, **OFF)  # type: ignore[arg-type]


DRIVEN_WAYS = (
    Way("F2", "no board answers", kind="silence", within=SAMPLES, stands=2.0),
    *frozen(within=SAMPLES, stands=2.0),
    Way("F3", "nobody answers", Follows.STARTS_LATER, "silence", within=4.0),
    passing("F5", "every 4th reply is cut", "short", every=4),
    Way("F6", "one board does not answer", kind="mute", parameters={"node": 1}, within=SAMPLES,
        stands=2.0),
    passing("F8", "every 3rd reply is lost", "loss", every=3),
    passing("F8", "every 2nd reply comes twice", "duplicate", every=2),
    passing("F8", "every 3rd write is lost", "write_loss", every=3),
    passing("F8", "every write comes twice", "write_duplicate", every=1),
    passing("F8", "every 3rd write is overtaken", "write_late", every=3, by=2),
    Way("F9", "the FireWire bus is reset", kind="bus_reset", detail="bus was reset", stands=3.0),
    off("the watchdog of a board expires", "watchdog", "watchdog has expired"),
    off("an amplifier trips", "trip", "switched off by the board"),
    off("an amplifier is too hot", "amplifier", "tells a fault"),
    off("the controller is hot", "heat", "hotter than"),
    off("an encoder counts beyond its range", "encoder_overflow", "beyond its range"),
    off("a potentiometer has slipped", "potentiometer", "potentiometer says", axis=1),
    off("another current is measured", "current", "are asked for", axis=1, by=0.43),
    Way("F13", "motors have no voltage", kind="supply_off", detail="lost their voltage", **OFF),  # type: ignore[arg-type]
    Way("F13", "the safety relay opens", kind="relay_open", detail="relay is open", **OFF),  # type: ignore[arg-type]
    *own_process(stop=STOP, stream=0.1),
    *outlived(stands=3.0, activities=("servo_jf",)),
)  # fmt: skip

DRIVEN_ABSENT = (
    Absent("F1", "UDP has no connection; a cable that is pulled is F2"),
    Absent("F4", "a datagram arrives whole or not at all"),
    Absent("F7", "no adapter"),
    Absent("F10", "no CAN"),
    Absent("F11", "no heartbeat but the replies, F2; a board that starts anew is F9"),
    Absent(
        "F14", "another program at the boards is a FAULT, tests/dvrk/faults/test_driven_faults.py"
    ),
    Absent("F20", "boards answer whoever asks; a second host is noticed by what it does, as F14"),
)


class DrivenDvrkRig(Rig):
    """The arm, driven."""

    name = "dvrk-driven"
    plugin = PLUGIN
    simulator = SIM
    sim_options = {"power_delay": 0.02, "patience": 4.0}  # noqa: RUF012
    ways = DRIVEN_WAYS
    absent = DRIVEN_ABSENT
    plan = Plan(0.0, 0.0, effort=1.2, room=1e6)
    activities = (REST, "servo_jf")
    values = {  # noqa: RUF012
        "drive": True,
        "watchdog": 0.3,
        "feedback_timeout": 0.4,
        "sample_timeout": 1.0,
        "open_timeout": 3.0,
        "rate": 200.0,
        "reply_timeout": 0.03,
        "angular_velocity": 2.0,
    }

    @override
    def joints(self) -> np.ndarray:
        assert self.sim is not None
        first, second = self.sim.control.status()["boards"]
        return SCALE * np.array([*first["position"], *second["position"][:3]])

    @override
    def go_home(self) -> None:
        """Let it stand where it is: efforts lead to no place."""
        self.until_still()

    @override
    def by_hand(self) -> None:
        """Set encoders, where a board has started anew since."""
        if any(note.key == "encoders" for note in self.engine.health().notes):
            self.arm.disable()
            self.arm.set_encoders()
