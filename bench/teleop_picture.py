"""The picture of the page on teleoperation, from its states: ``python -m bench.teleop_picture``."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from bench.tracker_pictures import DOCS, alone
from crtk_drivers.labs.verdicts.judging import Plot, Series
from crtk_drivers.motion.teleop import Coupled, Heard, Inputs, Phase, Side, TeleopSettings, step
from crtk_drivers.samples import Pose, vector
from crtk_drivers.state import OperatingState, Status

PERIOD: Final = 0.005
SECONDS: Final = 12.0
PRESSED: Final = ((0.5, 4.0), (5.5, 9.5), (10.2, 11.7))
"""When the pedal is: in the second time the follower faults."""
FAULT: Final = (7.0, 8.0)
READY: Final = Status(OperatingState.ENABLED, True)
FAULTED: Final = Status(OperatingState.FAULT, True)


def within(time: float, *spans: tuple[float, float]) -> bool:
    """Return whether a time is in one of them."""
    return any(begin <= time < end for begin, end in spans)


def run() -> Plot:
    """Return the way of a hand, and that of the follower at half the scale."""
    settings = TeleopSettings(leader="hand", follower="arm", scale=0.5, engage={"topic": "/pedal"})
    coupled, arm = Coupled(), Pose(vector((0.0, 0.0, 0.0)), vector((0.0, 0.0, 0.0, 1.0)))
    times = np.arange(0.0, SECONDS, PERIOD)
    hands, arms, phases = [], [], []
    for now in times.tolist():
        x = 0.06 * math.sin(1.3 * now) + 0.02 * math.sin(3.1 * now)
        hand = Pose(vector((x, 0.0, 0.0)), arm.orientation)
        status = FAULTED if within(now, FAULT) else READY
        heard = Inputs(
            now,
            Side("", READY, Heard(hand, now)),
            Side("", status, Heard(arm, now)),
            engage=Heard(within(now, *PRESSED), now),
        )
        coupled, commands = step(settings, coupled, heard)
        if isinstance(commands.follower, Pose):
            arm = commands.follower
        hands.append(1e3 * x)
        arms.append(1e3 * float(arm.position[0]))
        phases.append(-100.0 + (10.0 if coupled.phase is Phase.FOLLOWING else 0.0))
    seen = tuple(times.tolist())
    lines = (("hand", hands), ("follower", arms), ("coupled (high) or not", phases))
    title = "Half of the hand's way while the pedal is pressed; the follower faults from 7 s to 8 s"
    return Plot(title, "time, s", "mm", tuple(Series(name, seen, tuple(y)) for name, y in lines))


def main() -> None:
    """Draw it."""
    text = alone(run())
    (DOCS / "teleop.svg").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
