"""Two devices at once: do they tell one motion at one time, and does one go on when the other breaks."""

from __future__ import annotations

import json
import math
import time
from typing import Final

import numpy as np

from crtk_drivers.labs.bench.acquisition import Acquisition, BenchTest, Safety, Subject, Suite
from crtk_drivers.labs.bench.bed import Bed, Broken, Process
from crtk_drivers.labs.bench.silence import BACK
from crtk_drivers.labs.bench.trace import Trace
from crtk_drivers.labs.carried import UNKNOWN
from crtk_drivers.labs.verdicts.estimates import exact, in_percent, mean, share
from crtk_drivers.labs.verdicts.judging import (
    Bound,
    Findings,
    Plot,
    Quantity,
)
from crtk_drivers.samples import JointState, Vector, vector
from crtk_drivers.state import OperatingState

SEEN: Final = 8.0
"""Seconds of the motion that both see, in the quick suite."""

SINES: Final = ((0.5, 0.6), (1.3, 0.4))
"""Frequencies (Hz) of the motion, with their shares of the reach."""

BEGIN: Final = 1.0
"""Seconds in which it gets to its amplitude."""

PIECES: Final = 6
"""Parts of the motion, of which each has its own time between the two."""

LONGEST: Final = 0.3
"""Seconds by which one may be behind the other, to be found."""

STEP: Final = 1e-3
"""Seconds between two tries."""

ALIKE: Final = 0.6
"""Least correlation of what both tell of the motion."""

APART: Final = 20.0
"""ms between the times at which two devices tell one thing."""

BEFORE: Final = 2.0
BROKEN_FOR: Final = 2.0
AFTER: Final = 1.0
"""Seconds before the one breaks, while it is broken, and after it is mended."""

STEADY: Final = 1.5
"""Seconds for which it must measure again, within `BACK`."""

LOOK: Final = 0.02

LATE: Final = 0.5
"""Per cent of periods, over those that were late before."""

BUSY: Final = 2e-3

LAG = Quantity.within("together.motion.lag", "forces behind the pose", "ms", 2.0)
ALSO_LATE = Quantity.at_most("together.neighbours.late", "late periods of the other one", "%", 0.3)
STATES = Quantity.at_most("together.neighbours.states", "changes of state of the other one", "")


# -------------------------------------------------------------------------- one motion, seen by two


def _turning_most(arm: Bed) -> tuple[int, float]:
    """Return the joint whose small motion turns gravity most in the tool's axes, and its reach."""
    home, reach = arm.setpoint, arm.reach(0.8)

    def down(joints: Vector) -> Vector:
        pose = arm.forward(joints)
        if pose is None:
            raise Broken("the device that carries it does not know where its tool is")
        return UNKNOWN.down(pose.orientation)

    here = down(home)
    turns = [
        float(np.linalg.norm(down(vector(home + reach * (np.arange(home.size) == joint))) - here))
        for joint in range(home.size)
    ]
    best = int(np.argmax(turns))
    return best, float(reach[best])


def _turn(bed: Bed) -> None:
    arm = bed.carrier
    arm.enable()
    home = arm.setpoint
    joint, reach = _turning_most(arm)
    axis = np.arange(home.size) == joint

    def along(t: float) -> JointState:
        wave = sum(part * math.sin(2.0 * math.pi * f * t) for f, part in SINES)
        return JointState(position=home + axis * (min(1.0, t / BEGIN) * reach * wave))

    bed.mark("turn")
    arm.stream("servo_jp", along, BEGIN + SEEN * bed.thorough)
    bed.mark("turned")
    arm.move_to(home)
    arm.disable()


TURNING: Final = Acquisition(
    "turning",
    "The arm that carries it turns it to and fro by one joint, 0.1 rad at most.",
    Safety.SMALL,
    _turn,
    ("measured_cf",),
    suite=Suite.FULL,
    carrier_needs=("servo_jp", "move_jp", "measured_js", "measured_cp"),
)


def _lag(trace: Trace, subject: Subject) -> Findings:
    begin, end = trace.mark("turn") + BEGIN, trace.mark("turned")
    poses, wrenches = trace.poses("carrier/measured_cp"), trace.vectors("measured_cf")
    posed = np.isfinite(poses.stamp)
    felt = (wrenches.stamp > begin) & (wrenches.stamp < end)
    if posed.sum() < 100 or felt.sum() < 100:
        return Findings(doubts=(f"{posed.sum()} poses and {felt.sum()} wrenches that are valid",))
    downs = np.array([subject.carried.down(vector(each)) for each in poses.orientation[posed]])
    forces = wrenches.values[felt, :3]
    told, made = wrenches.stamp[felt], poses.stamp[posed]
    # Along the one direction in which gravity was turned, and in which the force changed with it.
    course = (downs - downs.mean(axis=0)) @ np.linalg.svd(downs - downs.mean(axis=0))[2][0]
    expected = np.interp(told, made, course)
    weights = (forces - forces.mean(axis=0)).T @ (expected - expected.mean())
    along = forces @ (weights / np.linalg.norm(weights))
    tries = np.arange(-LONGEST, LONGEST, STEP)
    lags, alike = [], []
    for piece in np.array_split(np.arange(told.size), PIECES):
        likeness = [
            float(np.corrcoef(along[piece], np.interp(told[piece] - lag, made, course))[0, 1])
            for lag in tries
        ]
        best = int(np.argmax(likeness))
        lags.append(1e3 * float(tries[best]))
        alike.append(likeness[best])
    if not min(alike) >= ALIKE:
        return Findings(
            doubts=(
                f"what both tell is too little alike (correlation {min(alike):.2f}, needed {ALIKE:g}): does "
                "anything hang on it?",
            )
        )
    force = along - along.mean()
    return Findings(
        (subject.measured(LAG, mean(lags), Bound(APART, "default", -APART)),),
        doubts=(*subject.gaps(wrenches.stamp), *subject.too_busy(5e-3)),
        plots=(
            Plot.of(
                "One motion, as both tell it",
                "time, s",
                "each by its greatest",
                ("pose", told, expected / np.abs(expected).max()),
                ("force", told, force / np.abs(force).max()),
            ),
        ),
    )


# ------------------------------------------------------------------------------ one of them breaks


def _is_steady(bed: Bed) -> bool:
    """Wait until a device that was broken measures, without a FAULT; return whether it came to that."""
    end = time.monotonic() + BACK
    since = math.inf
    while (now := time.monotonic()) < end:
        glance = bed.glance()
        if not glance.measures or glance.status.state is OperatingState.FAULT:
            since = math.inf
        elif now - (since := min(since, now)) > STEADY:
            return True
        time.sleep(LOOK)
    return False


def _break(bed: Bed) -> None:
    arm = bed.carrier
    arm.enable()
    arm.rest(BEFORE * bed.thorough)
    bed.mark("break")
    with bed.expecting("a device that is broken"):
        with bed.frozen(Process.SIMULATOR):
            arm.rest(BROKEN_FOR)
        arm.rest(AFTER)
        bed.mark("mended")
        arm.disable()
        if not _is_steady(bed):
            raise Broken(f"it did not measure again within {BACK:g} s")


BREAKING: Final = Acquisition(
    "breaking",
    "Takes all time from the simulator, while the device that carries it is ENABLED.",
    Safety.FAULT,
    _break,
    suite=Suite.FULL,
    carrier_needs=("measured_js",),
)


def _neighbours(trace: Trace, subject: Subject) -> Findings:
    broken, mended = trace.mark("break"), trace.mark("mended")
    stamps = trace.joint_states("carrier/measured_js").stamp
    made = np.unique(stamps[np.isfinite(stamps)])
    before = np.diff(made[(made > broken - BEFORE) & (made < broken)])
    after = np.diff(made[(made > broken) & (made < mended)])
    if before.size < 50 or after.size < 50:
        return Findings(doubts=(f"{before.size} and {after.size} samples of the other one",))
    period = float(np.median(before))
    usual = in_percent(share(int((before > 2.0 * period).sum()), before.size))
    late = in_percent(share(int((after > 2.0 * period).sum()), after.size))
    states = [
        said["text"]
        for _, arrival, _, value in trace.rows.get("carrier/events", ())
        if (said := json.loads(value.value))["kind"] == "state"
        and broken < 1e-9 * (arrival - trace.begin) < mended
    ]
    return Findings(
        (
            subject.measured(
                ALSO_LATE, late, Bound(usual.upper + LATE, "what was late before, and 0.5 %")
            ),
            subject.measured(
                STATES,
                exact(len(states)),
                Bound(0.0, "a fault on one does not stop its neighbours"),
                why=", ".join(states),
            ),
        ),
        doubts=subject.too_busy(BUSY),
    )


TESTS: Final = (
    BenchTest("X1", "two devices in step", "together", TURNING, _lag, (LAG,)),
    BenchTest("X2", "neighbours go on", "together", BREAKING, _neighbours, (ALSO_LATE, STATES)),
)
