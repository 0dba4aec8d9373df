"""Endurance: a slow cycle for minutes: does it go on arriving where it did, is it refused, is it late."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from crtk_drivers.labs.bench.acquisition import BUSY, Acquisition, BenchTest, Safety, Subject, Suite
from crtk_drivers.labs.bench.bed import SMALL_SPEED, Bed
from crtk_drivers.labs.bench.signals import noise, resolution
from crtk_drivers.labs.bench.trace import Trace
from crtk_drivers.labs.verdicts.estimates import exact, in_percent, share
from crtk_drivers.labs.verdicts.judging import (
    Bound,
    Findings,
    Quantity,
)
from crtk_drivers.samples import Array, JointState, vector

MINUTES: Final = 1.0
"""Of the quick suite; ten times as long in a nightly one."""

CYCLE: Final = 4.0
"""Seconds of one cycle; longer where a joint would be faster than in any small motion."""

SETTLES: Final = 0.4
"""Seconds of rest after a cycle, of which the last quarter is the arrival."""

SHARE: Final = 0.6
"""Of the reach of a small motion that a cycle uses either way."""

FEWEST: Final = 6
"""Arrivals of which a drift is told."""

MOST_LATE: Final = 0.5
"""% of the periods of a device that may be late."""

DRIFT = Quantity.at_most("motion.endurance.drift", "drift of where it arrives", "mrad or mm", 0.2)
REFUSED = Quantity.at_most("motion.endurance.refused", "commands refused", "", 0.5)
LATE = Quantity.at_most("motion.endurance.late", "periods over twice the declared", "%", 0.2)


def _cycles(bed: Bed) -> None:
    bed.enable()
    home = bed.setpoint
    reach = bed.reach(SHARE)
    limits = np.array([limit.velocity for limit in bed.about.capabilities.limits])
    # A sine that swells and fades is at most 1.3 times as fast as one of the same amplitude.
    cycle = max(CYCLE, 1.3 * 2.0 * math.pi * float((reach / (SMALL_SPEED * limits)).max()))

    def swing(t: float) -> JointState:
        turn = 2.0 * math.pi * min(t / cycle, 1.0)
        return JointState(position=vector(home + reach * math.sin(turn) * math.sin(0.5 * turn)))

    sent = refused = 0
    for _ in range(max(FEWEST, round(60.0 * MINUTES * bed.thorough / (cycle + SETTLES)))):
        counted = bed.insist("servo_jp", swing, cycle + 2.0 / bed.stream_rate)
        sent, refused = sent + counted[0], refused + counted[1]
        bed.rest(SETTLES)
        bed.mark("there")
    bed.note(sent=sent, refused=refused)
    bed.disable()


CYCLES: Final = Acquisition(
    "endurance",
    "Goes through a slow cycle of all joints again and again, for ten minutes, by at most 0.06 rad (12 mm).",
    Safety.SMALL,
    _cycles,
    ("servo_jp", "measured_js"),
    suite=Suite.NIGHTLY,
)


def _arrivals(trace: Trace) -> Array:
    """Return where the joints were (k, n) at the end of each cycle."""
    joints = trace.joints
    return np.array(
        [
            joints.between(at - 0.25 * SETTLES, at).position.mean(axis=0)
            for at in trace.marks("there")
        ]
    )


def _as_late(subject: Subject) -> tuple[str, ...]:
    """Return a doubt if the bench's own timer was late nearly as often as a device may be."""
    late = np.mean(np.asarray(subject.lateness) > subject.period) if subject.lateness else 0.0
    if 100.0 * late <= 0.5 * MOST_LATE:
        return ()
    return (f"the machine is too busy: {100.0 * late:.1f} % of the bench's own looks were late",)


def _endures(trace: Trace, subject: Subject) -> Findings:
    ends = _arrivals(trace)
    if len(ends) < FEWEST or not np.isfinite(ends).all():
        return Findings(doubts=(f"{len(ends)} arrivals",))
    third = len(ends) // 3
    first, last = ends[:third], ends[-third:]
    drift = np.abs(last.mean(axis=0) - first.mean(axis=0))
    repeats = noise(ends)
    steps = resolution(trace.joints.position)
    allowed = np.maximum.reduce([9.0 * repeats, 2.0 * steps, np.full(repeats.size, 1e-3)])
    made = np.unique(trace.joints.by_stamp.at)
    late = share(int((np.diff(made) > 2.0 * subject.period).sum()), made.size - 1)
    notes = trace.notes
    at = np.array(trace.marks("there"))
    return Findings(
        (
            subject.furthest(
                DRIFT,
                drift,
                allowed,
                "nine times its spread, two steps of its encoder, or 1 mrad",
                doubts=2.0 * repeats * math.sqrt(2.0 / third),
                n=len(ends),
            ),
            subject.measured(
                REFUSED, exact(notes["refused"], notes["sent"]), Bound(0.0, "it may do all of that")
            ),
            subject.measured(LATE, in_percent(late), Bound(MOST_LATE, "default")),
        ),
        doubts=(*subject.too_busy(BUSY), *_as_late(subject)),
        plots=(subject.ways_told("Arrivals, from the first", at, ends - ends[0]),),
    )


TESTS: Final = (BenchTest("M12", "endurance", "motion", CYCLES, _endures, (DRIFT, REFUSED, LATE)),)
