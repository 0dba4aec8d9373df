"""Homing, again and again: is zero found where it was before?

What the encoders of a device tell goes on through a homing, but for one step: by that its new zero is off the
old one. A joint that stands shows it plainly, one that moves beside what its velocity explains.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from crtk_drivers.labs.bench.acquisition import Acquisition, BenchTest, Safety, Subject, Suite
from crtk_drivers.labs.bench.bed import Bed
from crtk_drivers.labs.bench.signals import noise, resolution
from crtk_drivers.labs.bench.trace import JointTrack, Trace
from crtk_drivers.labs.verdicts.estimates import mean
from crtk_drivers.labs.verdicts.judging import Findings, Plot, Quantity
from crtk_drivers.samples import Array, Vector

HOMINGS: Final = 5
"""In the quick suite as well: fewer say nothing of a spread."""

BEFORE: Final = 0.3
"""Seconds for which it is looked at while it stands, before the first one and after each."""

LEAST: Final = 1e-4
"""rad (m): zeros that are that near to each other are one."""

WINDOW: Final = 5
"""Samples of which the median velocity counts."""

SPREAD = Quantity.at_most("joints.homing.spread", "spread of zero", "mrad or mm", 0.02)
TIME = Quantity.told("joints.homing.time", "to home", "s", 0.1)


def _home(bed: Bed) -> None:
    bed.keep(done=0)
    bed.enable()
    bed.rest(BEFORE)
    for number in range(HOMINGS):
        bed.mark("home")
        bed.home_again()
        bed.mark("homed")
        bed.rest(BEFORE)
        bed.keep(done=number + 1)
    bed.mark("end")
    bed.disable()


HOMING: Final = Acquisition(
    "homings",
    "Lets it forget its zero and home, five times.",
    Safety.LARGE,
    _home,
    ("measured_js",),
    suite=Suite.FULL,
    homes=True,
)


def _steps(part: JointTrack) -> tuple[Vector, Vector]:
    """Return the step of each joint (n,) that nothing explains, and what else there is of such steps."""
    # A driver that derives the velocity tells one sample of a wild one as zero moves: the median has none.
    velocity = np.pad(np.nan_to_num(part.velocity), ((WINDOW // 2,) * 2, (0, 0)), mode="edge")
    smooth = np.median(np.lib.stride_tricks.sliding_window_view(velocity, WINDOW, axis=0), axis=-1)
    left = np.diff(part.position, axis=0)
    left -= 0.5 * (smooth[1:] + smooth[:-1]) * np.diff(part.at)[:, None]
    order = np.argsort(np.abs(left), axis=0)
    largest, second = (np.take_along_axis(left, order[-k : -k + 1 or None], axis=0) for k in (1, 2))
    return largest[0], np.abs(second[0])


def _repeats(trace: Trace, subject: Subject) -> Findings:
    done = subject.kept["done"]
    if done < HOMINGS:
        return Findings(doubts=(f"it homed {done} of {HOMINGS} times",))
    joints = trace.joints.by_stamp
    begun, ended, end = trace.marks("home"), trace.marks("homed"), trace.mark("end")
    zeros: list[Array] = [np.zeros(len(subject.joints))]
    doubt = np.zeros(len(subject.joints))
    for begin, until in zip(begun, [*begun[1:], end], strict=True):
        part = joints.between(begin - 0.5 * BEFORE, until - 0.5 * BEFORE)
        if part.at.size < 3 or subject.gaps(part.at):
            return Findings(doubts=("it does not tell where its joints are all the time",))
        step, rest = _steps(part)
        zeros.append(zeros[-1] + step)
        doubt = np.maximum(doubt, rest)
    still = joints.between(begun[0] - BEFORE, begun[0])
    steps = resolution(still.position)
    allowed = np.maximum(np.maximum(2.0 * steps, 6.0 * noise(still.position)), LEAST)
    every = np.array(zeros)
    found = subject.furthest(
        SPREAD,
        np.ptp(every, axis=0),
        allowed,
        "two steps of the encoder, six times its noise, or 0.1 mrad (mm)",
        doubts=2.0 * doubt,
        n=HOMINGS,
    )
    took = mean([until - begin for begin, until in zip(begun, ended, strict=True)])
    numbers = np.arange(HOMINGS + 1.0)
    lines = ((name, numbers, 1e3 * way) for name, way in zip(subject.joints, every.T, strict=True))
    return Findings(
        (found, subject.measured(TIME, took)),
        plots=(Plot.of("Where zero is, from where it was", "homing", "mrad or mm", *lines),),
    )


TESTS: Final = (BenchTest("J8", "homing", "joints", HOMING, _repeats, (SPREAD, TIME)),)
