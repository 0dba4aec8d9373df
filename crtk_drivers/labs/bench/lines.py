"""Straight lines of the tool: how far it is from them, and how even its speed is."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from crtk_drivers.labs.bench.acquisition import BUSY, Acquisition, BenchTest, Safety, Subject, Suite
from crtk_drivers.labs.bench.bed import PLACES, Bed, Broken
from crtk_drivers.labs.bench.signals import resolution
from crtk_drivers.labs.bench.trace import Trace
from crtk_drivers.labs.verdicts.estimates import exact, within
from crtk_drivers.labs.verdicts.judging import (
    Bound,
    Findings,
    Measurement,
    Plot,
    Quantity,
)
from crtk_drivers.samples import Array, Pose, Vector, vector

LENGTHS: Final = (0.2, 0.1, 0.05)
"""m: of the lines that are looked for, the longest first."""

SHARES: Final = (0.1, 0.5, 1.0)
"""Of the speed that moves have."""

FURTHEST: Final = 6.0
"""rad (m) of the joints a metre of a line: more is near a singularity."""

LONGEST: Final = 20.0
"""Seconds of one line."""

WINDOW: Final = 0.04
"""Seconds over which a speed is taken."""

EVEN: Final = 0.9
"""Share of the greatest speed above which a line is at its speed; the ends of that are left out."""

AT_SPEED: Final = 0.2
"""Seconds at its speed that a line has at the least, for something to be told of that."""

STALL: Final = 3.0
"""Periods without a sample that make the speed of a line worth nothing."""

DISTANCE = Quantity.at_most("motion.line.distance", "greatest distance from a line", "mm", 0.05)
RIPPLE = Quantity.at_most("motion.line.ripple", "ripple of the speed", "%", 1.0)


# -------------------------------------------------------------------------------------------- acquisition


def _lines(bed: Bed) -> None:
    bed.enable()
    home = bed.setpoint
    begin = bed.forward(home)
    end = None if begin is None else _free_line(bed, begin, home)
    if begin is None or end is None:
        bed.note(lines=[])
        bed.disable()
        return
    for ratio in SHARES:
        with bed.slowed(ratio):
            for goal in (end, begin):
                bed.mark("begin")
                _move(bed, goal)
                bed.rest(0.2)
                bed.mark("end")
    bed.note(
        lever=bed.lever,
        lines=[
            [share, start.position.tolist(), goal.position.tolist()]
            for share in SHARES
            for start, goal in ((begin, end), (end, begin))
        ],
    )
    bed.move_to(home)
    bed.disable()


def _free_line(bed: Bed, begin: Pose, home: Vector) -> Pose | None:
    """Return the end of the longest line that is free, along the axis that asks least of the joints."""
    for length in LENGTHS:
        found: list[tuple[float, int, Pose]] = []
        for index, way in enumerate(np.vstack((np.eye(3), -np.eye(3)))):
            joints = _joints_on(bed, begin, vector(length * way), home)
            if joints is not None:
                far = float(np.abs(np.diff(joints, axis=0)).max()) * (len(joints) - 1) / length
                goal = Pose(
                    vector(begin.position + length * way), begin.orientation, begin.frame_id
                )
                found.append((far, index, goal))
        if found and min(found)[0] < FURTHEST:
            return min(found)[2]
    return None


def _joints_on(bed: Bed, begin: Pose, way: Vector, home: Vector) -> Array | None:
    """Return the joints (k, n) along a line; None where they, or the tool, would leave their space."""
    near, found = home, [home]
    for share in np.linspace(0.0, 1.0, PLACES)[1:]:
        pose = Pose(vector(begin.position + share * way), begin.orientation, begin.frame_id)
        joints = bed.inverse(pose, near)
        if joints is None or not bed.is_free(joints):
            return None
        near = joints
        found.append(joints)
    return np.array(found)


def _move(bed: Bed, goal: Pose) -> None:
    bed.submit("move_cp", goal)
    if not bed.wait_until(lambda glance: not glance.status.is_busy, LONGEST):
        raise Broken(f"move_cp did not end within {LONGEST:g} s")


LINES: Final = Acquisition(
    "lines",
    "Moves the tool there and back along a line of at most 0.2 m, at 10, 50 and 100 % of the speed of moves.",
    Safety.LARGE,
    _lines,
    ("move_cp", "move_jp", "measured_js", "measured_cp"),
    suite=Suite.FULL,
)


# ----------------------------------------------------------------------------------------------- analysis


def _from_line(points: Array, begin: Vector, end: Vector) -> Vector:
    """Return how far points (N, 3) are from a line, and from its ends beyond these."""
    way = end - begin
    along = np.clip((points - begin) @ way / float(way @ way), 0.0, 1.0)
    found: Vector = np.linalg.norm(points - begin - np.outer(along, way), axis=1)
    return found


def _speeds(at: Vector, points: Array, way: Vector, window: float) -> tuple[Vector, Vector]:
    """Return speeds along a way, each taken over `window` s, and when."""
    along = points @ way / float(np.linalg.norm(way))
    later = np.searchsorted(at, at + window)
    whole = np.flatnonzero(later < at.size)
    times = at[later[whole]] - at[whole]
    return 0.5 * (at[later[whole]] + at[whole]), (along[later[whole]] - along[whole]) / times


def _ripple(at: Vector, speeds: Vector) -> float:
    """Return by which share an even speed goes up and down, as a sine would; NaN if it is too short."""
    fast = np.flatnonzero(speeds > EVEN * np.quantile(speeds, 0.9))
    if not fast.size:
        return math.nan
    begin, end = at[fast[0]], at[fast[-1]]
    room = 0.15 * (end - begin)
    even = speeds[(at > begin + room) & (at < end - room)]
    if end - begin - 2.0 * room < AT_SPEED or even.size < 10:
        return math.nan
    return float(math.sqrt(2.0) * even.std() / even.mean())


def _stalls(at: Vector, subject: Subject) -> tuple[str, ...]:
    """Return a doubt if something stood still in a line: in its speed that is a ripple like any other."""
    longest = float(np.diff(at).max())
    if longest <= STALL * subject.period:
        return ()
    return (f"no sample came for {1e3 * longest:.0f} ms in the midst of a line",)


def _straight(trace: Trace, subject: Subject) -> Findings:
    lines = trace.notes["lines"]
    if not lines:
        return Findings(doubts=("no line from where it is lies within its space",))
    tool = trace.poses("measured_cp")
    window = max(WINDOW, 4.0 * subject.period)
    furthest: list[tuple[float, str]] = []
    ripples: dict[str, list[float]] = {}
    rough: dict[str, float] = {}
    # By which the steps of its encoders move the tool.
    step = float(resolution(trace.joints.position).max()) * trace.notes["lever"]
    doubts: list[str] = []
    speeds_told, distances_told = [], []
    for (share, start, goal), begin, end in zip(
        lines, trace.marks("begin"), trace.marks("end"), strict=True
    ):
        at, points = tool.acquired(begin, end)
        if at.size < 20:
            return Findings(doubts=("too few poses of a line",))
        doubts.extend((*_stalls(at, subject), *subject.uneven(at)))
        ends = np.asarray(start), np.asarray(goal)
        away = _from_line(points, *ends)
        name = f"{100.0 * share:.0f} %"
        furthest.append((1e3 * float(away.max()), name))
        times, speeds = _speeds(at, points, ends[1] - ends[0], window)
        ripple = _ripple(times, speeds)
        if math.isfinite(ripple):
            ripples.setdefault(name, []).append(100.0 * ripple)
            rough[name] = 100.0 * step / (window * float(np.quantile(speeds, 0.9)))
        speeds_told.append((name, times - begin, speeds))
        distances_told.append((name, at - begin, 1e3 * away))
    distance, name = max(furthest)
    found: list[Measurement] = [
        subject.measured(DISTANCE, exact(distance, len(furthest)), Bound(1.0, "default"), part=name)
    ]
    for name, values in ripples.items():
        middle, spread = float(np.mean(values)), 0.5 * float(np.ptp(values))
        found.append(
            subject.measured(
                RIPPLE,
                within(middle, spread + rough[name], len(values)),
                Bound(5.0, "default"),
                part=name,
            )
        )
    if not ripples:
        why = f"none of its lines is for {AT_SPEED:g} s at its speed"
        found.append(subject.measured(RIPPLE, None, why=why))
    return Findings(
        tuple(found),
        doubts=(*subject.too_busy(BUSY), *doubts[:1]),
        plots=(
            Plot.of("Speed along the lines", "time, s", "m/s", *speeds_told[::2]),
            Plot.of("Distance from the lines", "time, s", "mm", *distances_told[::2]),
        ),
    )


TESTS: Final = (BenchTest("M11", "straight line", "motion", LINES, _straight, (DISTANCE, RIPPLE)),)
