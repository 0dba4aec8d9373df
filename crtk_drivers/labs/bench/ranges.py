"""The range of each joint reads on: no jump within it, as of an encoder that wraps."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from crtk_drivers.device import Capabilities
from crtk_drivers.labs.bench.acquisition import Acquisition, BenchTest, Safety, Subject, Suite
from crtk_drivers.labs.bench.bed import ROOM, Bed
from crtk_drivers.labs.bench.signals import resolution
from crtk_drivers.labs.bench.trace import Trace
from crtk_drivers.labs.verdicts.estimates import exact
from crtk_drivers.labs.verdicts.judging import (
    Bound,
    Comparison,
    Findings,
    Plot,
    Quantity,
    Verdict,
    Worse,
)
from crtk_drivers.samples import vector

SLOWED: Final = 0.5
"""Share of its velocity limit at which a joint goes through its range, at the most."""

UNSEEN: Final = 0.05
"""Share of the time of a joint in which samples may stay away for five periods and more."""

JUMP = Quantity.at_most(
    "joints.range.step", "largest step of a sample over what the velocity limit allows", "", 0.2
)
SEEN = Quantity(
    "joints.range.seen",
    "share of the range that was gone through",
    "%",
    Comparison.TOLD,
    Worse.LOWER,
    5.0,
)


def _ratio(own: Capabilities) -> float:
    """Return the share of the speed of its moves with which no joint is faster than `SLOWED`."""
    moves = own.move_limits or own.limits
    pairs = zip(own.limits, moves, strict=True)
    return min(1.0, *(SLOWED * limit.velocity / move.velocity for limit, move in pairs))


def _through(bed: Bed) -> None:
    bed.enable()
    home = bed.setpoint
    left_out: dict[str, str] = {}
    bed.keep(left_out=left_out, done=False)
    own = bed.about.capabilities
    with bed.slowed(_ratio(own)):
        for joint, (name, limit) in enumerate(zip(own.joints, own.limits, strict=True)):
            bed.mark(f"begin {joint}")
            for end in (limit.lower, limit.upper):
                goal = home.copy()
                goal[joint] += np.clip(ROOM * (end - home[joint]), -math.tau, math.tau)
                if bed.is_free(vector(goal)):
                    bed.move_to(vector(goal))
                else:
                    left_out[name] = "its tool would leave its space"
            bed.move_to(home)
            bed.mark(f"end {joint}")
    bed.keep(done=True)
    bed.disable()


THROUGH: Final = Acquisition(
    "ranges",
    "Moves one joint after the other through nine tenths of its range, at half its speed at most.",
    Safety.LARGE,
    _through,
    ("move_jp", "measured_js"),
    suite=Suite.FULL,
)


def _steps(trace: Trace, subject: Subject) -> Findings:
    """Each step between two samples, over the way that the velocity limit allows in the time between them.

    Where a joint jumps its move does not arrive: what was seen until then is judged all the same.
    """
    joints = trace.joints.by_stamp
    if joints.at.size < 20:
        return Findings(doubts=(f"{joints.at.size} samples",))
    resolved = resolution(joints.position)
    found: list[tuple[float, str]] = []
    shares: list[float] = []
    gaps: list[str] = []
    lines = []
    for column, (name, limit) in enumerate(zip(subject.joints, subject.limits, strict=True)):
        begun, ended = trace.marks(f"begin {column}"), trace.marks(f"end {column}")
        if not begun:
            break
        part = joints.between(begun[0], ended[0] if ended else joints.at[-1])
        if part.at.size < 20:
            continue
        position = part.position[:, column]
        times = np.maximum(np.diff(part.at), subject.period)
        unseen = float(times[times > 5.0 * subject.period].sum() / times.sum())
        if unseen > UNSEEN:
            gaps.append(f"no samples came of {name} in {100.0 * unseen:.0f} % of the time")
        allowed = limit.velocity * times + resolved[column]
        found.append((float((np.abs(np.diff(position)) / allowed).max()), name))
        shares.append(100.0 * float(np.ptp(position)) / (limit.upper - limit.lower))
        lines.append((name, part.at - part.at[0], position))
    if not found:
        return Findings(doubts=("too few samples",))
    value, name = max(found)
    kept = subject.kept
    why = "; ".join(f"{each}: {told}" for each, told in kept["left_out"].items())
    jump = subject.measured(
        JUMP,
        exact(value, joints.at.size),
        Bound(1.5, "what the velocity limit allows, and half of it"),
        part=name,
        why=why,
    )
    doubts = gaps[:1]
    if not kept["done"] and jump.verdict is not Verdict.FAIL:
        doubts.append("it did not get to the end of its motion")
    least = int(np.argmin(shares))
    return Findings(
        (jump, subject.measured(SEEN, exact(shares[least]), part=found[least][1])),
        doubts=tuple(doubts),
        plots=(Plot.of("Through the range", "time, s", "rad or m", *lines),),
    )


TESTS: Final = (
    BenchTest("J7", "range reads on", "joints", THROUGH, _steps, (JUMP, SEEN), of_kept=True),
)
