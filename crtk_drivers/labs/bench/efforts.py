"""Efforts in slow strokes, there and back: whether their sign is right, and what of them is friction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from crtk_drivers.labs.bench.acquisition import Acquisition, BenchTest, Safety, Subject, Suite
from crtk_drivers.labs.bench.bed import RATIO, SMALL_SPEED, Bed
from crtk_drivers.labs.bench.calls import EFFORT
from crtk_drivers.labs.bench.signals import resolution, slope
from crtk_drivers.labs.bench.trace import JointTrack, Trace
from crtk_drivers.labs.verdicts.estimates import line, mean, within
from crtk_drivers.labs.verdicts.judging import (
    Bound,
    Comparison,
    Findings,
    Measurement,
    Plot,
    Quantity,
    Worse,
)
from crtk_drivers.samples import vector

STROKES: Final = (0.5, 1.0, 2.0)
"""Seconds of a stroke one way, about; longer where a joint would be faster than in any small motion."""

LOOPS: Final = 2
"""Strokes there and back at each speed, at the least."""

TURN: Final = 0.3
"""Seconds of rest where it turns: what follows late is there by then."""

SHARE: Final = 0.8
"""Of the reach of a small motion that a stroke uses."""

MIDDLE: Final = 0.25
"""Share of the way at either end that is no constant speed."""

STEPS: Final = 20.0
"""Steps of the encoder that a stroke has at the least."""

SIGMAS: Final = 3.0
"""Standard errors by which the work of an effort has to be above zero."""

FEWEST: Final = 4
"""Strokes of which something is told."""

TOO_SHORT: Final = "it moves less than twenty steps of its encoder"

TOO_FEW: Final = "too few samples of it at constant speed"

UNEQUAL: Final = 5e-3
"""Share of the effort by which those there and back may differ without friction: no two ways are the same."""

LEAST: Final = 1e-6
"""J: what is less is no work."""

WORK = Quantity(
    "joints.effort.work", "work there and back", "J", Comparison.AT_LEAST, Worse.EITHER, 0.02
)
COULOMB = Quantity.within("joints.friction.coulomb", "dry friction", "N·m or N", 0.1)
VISCOUS = Quantity.within(
    "joints.friction.viscous", "friction that grows with the speed", "N·m·s or N·s/m", 0.5
)
RIPPLE = Quantity.at_most(
    "joints.friction.ripple", "ripple of the effort at constant speed", "N·m or N", 0.1
)


# ---------------------------------------------------------------------------------------------- strokes


def _strokes(bed: Bed) -> None:
    bed.enable()
    home = bed.setpoint
    way = bed.reach(SHARE)
    limits = np.array([limit.velocity for limit in bed.about.capabilities.limits])
    for seconds in STROKES:
        with bed.slowed(min(SMALL_SPEED, float((way / limits).max()) / seconds)):
            for _ in range(max(LOOPS, int(bed.thorough))):
                bed.mark("begin")
                for goal in (vector(home + way), home):
                    bed.move_to(goal)
                    bed.rest(TURN)
                bed.mark("end")
    bed.disable()


STROKES_THERE_AND_BACK: Final = Acquisition(
    "strokes",
    "Moves all joints slowly there and back, at three speeds, by at most 0.08 rad (16 mm).",
    Safety.SMALL,
    _strokes,
    ("move_jp", RATIO, EFFORT),
    suite=Suite.FULL,
)


def _loops(trace: Trace) -> list[JointTrack]:
    joints = trace.joints.by_stamp
    marks = zip(trace.marks("begin"), trace.marks("end"), strict=True)
    return [joints.between(begin, end) for begin, end in marks]


def _lacking(loops: list[JointTrack]) -> tuple[str, ...]:
    """Return why nothing can be reckoned."""
    if not loops or any(loop.at.size < 20 for loop in loops):
        return ("too few samples of a stroke",)
    if not all(np.isfinite(loop.effort).all() for loop in loops):
        return ("it did not measure its efforts all the time",)
    return ()


def _gaps(loops: list[JointTrack], subject: Subject) -> tuple[str, ...]:
    """Return a doubt if samples stayed away in a stroke."""
    return tuple(doubt for loop in loops for doubt in subject.gaps(loop.at))[:1]


def _moving(trace: Trace, loops: list[JointTrack]) -> list[bool]:
    """Return of each joint whether its strokes are more than some steps of its encoder."""
    steps = resolution(trace.joints.position)
    ways = np.min([np.ptp(loop.position, axis=0) for loop in loops], axis=0)
    return [bool(way > max(STEPS * step, 1e-4)) for way, step in zip(ways, steps, strict=True)]


@dataclass(frozen=True)
class _Rubbing:
    """One stroke there and back of one joint, where it goes at constant speed.

    Attributes:
        speed: of it.
        way: of that part of it, one way.
        friction: half of what the efforts there and back differ by: a weight is carried both ways.
        carried: the greater of these efforts.
        late: by how much one sample of delay between position and effort would change that.
        ripple: half of the range in which nine in ten efforts are, about a curve of where it is.
    """

    speed: float
    way: float
    friction: float
    carried: float
    late: float
    ripple: float

    @property
    def work(self) -> float:
        """Of the effort, there and back."""
        return 2.0 * self.friction * self.way


def _rubbing(loop: JointTrack, column: int) -> _Rubbing | None:
    """Return what a stroke tells of one joint; None: too few samples."""
    effort = loop.effort[:, column]
    gone = loop.position[:, column] - loop.position[0, column]
    far = float(gone[np.abs(gone).argmax()])
    turned = float(loop.at[np.abs(gone) >= 0.999 * abs(far)].mean())
    inner = (gone / far > MIDDLE) & (gone / far < 1.0 - MIDDLE)
    speeds, carried, slopes, ripples = [], [], [], []
    for side in (inner & (loop.at < turned), inner & (loop.at > turned)):
        if side.sum() < 8:
            return None
        curve = np.polynomial.Polynomial.fit(gone[side], effort[side], 2)
        speeds.append(abs(slope(loop.at[side], gone[side])))
        # What speeds a joint up for less than a sample is a spike, and its other half may not be seen.
        carried.append(float(np.median(effort[side])))
        slopes.append(slope(gone[side], effort[side]))
        left = effort[side] - curve(gone[side])
        ripples.append(0.5 * float(np.subtract(*np.quantile(left, (0.95, 0.05)))))
    speed = float(np.mean(speeds))
    return _Rubbing(
        speed,
        (1.0 - 2.0 * MIDDLE) * abs(far),
        0.5 * math.copysign(1.0, far) * (carried[0] - carried[1]),
        float(np.abs(carried).max()),
        abs(float(np.mean(slopes))) * speed * float(np.median(np.diff(loop.at))),
        float(np.mean(ripples)),
    )


def _strokes_of(loops: list[JointTrack], column: int) -> list[_Rubbing]:
    return [each for loop in loops if (each := _rubbing(loop, column)) is not None]


def _works(trace: Trace, subject: Subject) -> Findings:
    """What carries a weight there and back has done no work; friction takes some, and gives none."""
    loops = _loops(trace)
    if lacking := _lacking(loops):
        return Findings(doubts=lacking)
    steps = resolution(trace.joints.effort)
    bound = Bound(0.0, "friction takes work: an effort of the right sign gives it")
    found: list[Measurement] = []
    for column, (name, moves) in enumerate(zip(subject.joints, _moving(trace, loops), strict=True)):
        strokes = _strokes_of(loops, column) if moves else []
        if len(strokes) < FEWEST:
            why = TOO_FEW if moves else TOO_SHORT
            found.append(subject.measured(WORK, None, bound, part=name, why=why))
            continue
        works = np.array([each.work for each in strokes])
        work = mean(works)
        unsure = [each.late + 0.5 * steps[column] + UNEQUAL * each.carried for each in strokes]
        doubt = max(
            work.upper - work.value,
            SIGMAS * float(works.std(ddof=1)) / math.sqrt(works.size),
            2.0 * max(unsure) * strokes[0].way,
            LEAST,
        )
        estimate = within(work.value, doubt, works.size)
        why = "" if abs(work.value) > doubt else "too little friction for its effort to tell a sign"
        found.append(subject.measured(WORK, estimate, bound, part=name, why=why))
    return Findings(tuple(found), doubts=_gaps(loops, subject), plots=(_plot(subject, loops),))


def _plot(subject: Subject, loops: list[JointTrack]) -> Plot:
    slowest = loops[-1]
    ways = 1e3 * (slowest.position - slowest.position[0])
    efforts = slowest.effort - slowest.effort.mean(axis=0)
    return Plot.of(
        "Effort over the way, of the slowest stroke, from its mean",
        "mrad or mm",
        "N·m or N",
        *zip(subject.joints, ways.T, efforts.T, strict=True),
    )


def _friction(trace: Trace, subject: Subject) -> Findings:
    loops = _loops(trace)
    if lacking := _lacking(loops):
        return Findings(doubts=lacking)
    found: list[Measurement] = []
    for column, (name, moves) in enumerate(zip(subject.joints, _moving(trace, loops), strict=True)):
        strokes = _strokes_of(loops, column) if moves else []
        if len(strokes) < FEWEST:
            why = TOO_FEW if moves else TOO_SHORT
            found.append(subject.measured(COULOMB, None, part=name, why=why))
            continue
        dry, viscous = line([each.speed for each in strokes], [each.friction for each in strokes])
        found.append(subject.measured(COULOMB, dry, part=name))
        found.append(subject.measured(VISCOUS, viscous, part=name))
        ripple = mean([each.ripple for each in strokes])
        found.append(subject.measured(RIPPLE, ripple, part=name))
    return Findings(tuple(found), doubts=_gaps(loops, subject))


TESTS: Final = (
    BenchTest("J5", "effort sign", "joints", STROKES_THERE_AND_BACK, _works, (WORK,)),
    BenchTest(
        "J6", "friction", "joints", STROKES_THERE_AND_BACK, _friction, (COULOMB, VISCOUS, RIPPLE)
    ),
)
