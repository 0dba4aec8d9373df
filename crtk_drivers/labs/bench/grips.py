"""A gripper: do its fingers go as far as they are sent, does it know what it holds, and keep that; how hard
does it press on a force sensor that lies between them."""

from __future__ import annotations

from typing import Final

import numpy as np

from crtk_drivers.labs.bench.acquisition import Acquisition, BenchTest, Safety, Subject, Suite
from crtk_drivers.labs.bench.bed import Bed
from crtk_drivers.labs.bench.signals import rest_time
from crtk_drivers.labs.bench.trace import Trace
from crtk_drivers.labs.verdicts.estimates import exact, in_percent, mean
from crtk_drivers.labs.verdicts.judging import Bound, Findings, Plot, Quantity
from crtk_drivers.plugins import SimFault
from crtk_drivers.samples import Array, Wrench, vector

HOLDS: Final = "holds"
"""The reading of a gripper that says whether it holds something."""

STROKES: Final = 5
GRIPS: Final = 10
"""In the quick suite as well: fewer say nothing of a share."""

SLOWED: Final = 0.5
"""Share of its speed at which it opens and closes."""

SETTLES: Final = 0.3
"""Seconds after a move in which a grip is known, and the fingers stand."""

OPENS: Final = 0.015
"""m by which the fingers open beyond a block between two grips."""

LET_GO: Final = 1.0
"""Seconds for which a grip is looked at once the gripper is DISABLED."""

FELT: Final = 0.3
"""Seconds for which a force is measured."""

GRIPS_WITHIN: Final = 20.0
"""% by which the force of a grip may be off."""

ARRIVES: Final = 0.01
"""Share of the stroke that the fingers may be off where they were sent."""

ERROR = Quantity.at_most("grip.stroke.error", "end off where it was sent", "% of the stroke", 0.1)
SPREAD = Quantity.at_most("grip.stroke.spread", "spread of an end", "% of the stroke", 0.1)
CLAIMED = Quantity.at_most("grip.stroke.claimed", "closings on nothing that count as a grip", "")
TIME = Quantity.told("grip.stroke.time", "to close, at half its speed", "s", 0.02)

KNOWN = Quantity.at_least("grip.block.known", "grips that it knows of", "%", 1.0)
WIDTH = Quantity.at_most("grip.block.width", "opening off the width of the block", "mm", 0.1)
KEPT = Quantity.at_most("grip.block.kept", "way of the fingers once DISABLED", "mm", 0.1)

FORCE = Quantity.within("grip.force.error", "force of the grip off the one that is known", "%", 2.0)


def _holds(bed: Bed) -> bool:
    return bed.readings.get(HOLDS) == str(True)


# ----------------------------------------------------------------------------------------------- strokes


def _open_and_close(bed: Bed) -> None:
    held, claimed = _holds(bed), 0
    bed.keep(held=held, claimed=claimed, done=False)
    if held:
        return
    limit = bed.about.capabilities.limits[0]
    bed.enable()
    with bed.slowed(SLOWED):
        for number in range(STROKES):
            for name, end in (("open", limit.upper), ("close", limit.lower)):
                bed.mark(f"{name} {number}")
                bed.move_to(vector((end,)))
                bed.rest(SETTLES)
                bed.mark(f"{name} {number} end")
            claimed += _holds(bed)
            bed.keep(claimed=claimed)
        bed.move_to(vector((limit.upper,)))
    bed.disable()
    bed.keep(done=True)


STROKE: Final = Acquisition(
    "grip_strokes",
    "Opens and closes a gripper with nothing between its fingers, as far as it goes, at half its speed.",
    Safety.LARGE,
    _open_and_close,
    ("move_jp", "measured_js", f"state/{HOLDS}"),
    suite=Suite.FULL,
    without=("block",),
)


def _goes(trace: Trace, subject: Subject) -> Findings:
    kept = subject.kept
    if kept["held"]:
        return Findings(doubts=("it holds something: take that away",))
    if not kept["done"]:
        return Findings(doubts=("it did not get to the end of its motion",))
    joints, limit = trace.joints, subject.limits[0]
    stroke = limit.upper - limit.lower
    errors, spreads, times = [], [], []
    for name, end in (("open", limit.upper), ("close", limit.lower)):
        ends = []
        for number in range(STROKES):
            begun, ended = (trace.mark(f"{name} {number}{text}") for text in ("", " end"))
            part = joints.between(begun, ended)
            still = part.position[part.at >= ended - 0.5 * SETTLES, 0]
            if not still.size:
                return Findings(doubts=("no samples came at the end of a stroke",))
            ends.append(float(still.mean()))
            if name == "close":
                times.append(rest_time(part.at, part.position, begun, vector((ARRIVES * stroke,))))
        errors.append(float(np.abs(np.array(ends) - end).max()))
        spreads.append(float(np.ptp(ends)))
    worst = int(np.argmax(errors))
    where = ("opened", "closed")[worst]
    bound = Bound(100.0 * ARRIVES, "default")
    return Findings(
        (
            subject.measured(
                ERROR, exact(100.0 * errors[worst] / stroke, STROKES), bound, part=where
            ),
            subject.measured(SPREAD, exact(100.0 * max(spreads) / stroke, STROKES), bound),
            subject.measured(
                CLAIMED,
                exact(float(kept["claimed"]), STROKES),
                Bound(0.0, "there was nothing to hold"),
            ),
            subject.measured(TIME, mean(times)),
        ),
        plots=(Plot.of("Strokes", "time, s", "mm", ("", joints.at, 1e3 * joints.position[:, 0])),),
    )


# ------------------------------------------------------------------------------------------------- block


def _grip(bed: Bed) -> None:
    width = float(bed.features["block"])
    limit = bed.about.capabilities.limits[0]
    grips: list[tuple[bool, float]] = []
    bed.keep(width=width, grips=grips, stroke=limit.upper - limit.lower)
    if not limit.lower < width < limit.upper:
        return
    apart = vector((min(limit.upper, width + OPENS),))
    with bed.happening(SimFault.BLOCK, width=width):
        bed.enable()
        with bed.slowed(SLOWED):
            for number in range(GRIPS):
                bed.move_to(apart)
                bed.keep(held_open=_holds(bed))
                bed.mark(f"grip {number}")
                bed.move_to(vector((limit.lower,)))
                bed.rest(SETTLES)
                grips.append((_holds(bed), float(bed.position[0])))
        bed.disable()
        bed.rest(LET_GO)
        bed.keep(after=float(bed.position[0]))
        bed.enable()
        with bed.slowed(SLOWED):
            bed.move_to(apart)
        bed.disable()


BLOCK: Final = Acquisition(
    "grips",
    "Grips a block of known width ten times, and is disabled with it between its fingers.",
    Safety.LARGE,
    _grip,
    ("move_jp", "measured_js", f"state/{HOLDS}"),
    suite=Suite.FULL,
    features=("block",),
    sim_fault=SimFault.BLOCK,
)


def _grips(trace: Trace, subject: Subject) -> Findings:
    kept = subject.kept
    grips, width = kept["grips"], kept["width"]
    if len(grips) < GRIPS:
        return Findings(
            doubts=(
                f"{len(grips)} of {GRIPS} grips of {1e3 * width:g} mm were carried out: its fingers go from "
                f"{1e3 * subject.limits[0].lower:g} to {1e3 * subject.limits[0].upper:g} mm",
            )
        )
    known = sum(holds for holds, _ in grips)
    off = 1e3 * np.array([at - width for _, at in grips])
    found = [
        subject.measured(
            KNOWN,
            in_percent(exact(known / len(grips), len(grips))),
            Bound(100.0, "each of them is one"),
        ),
        subject.measured(WIDTH, exact(float(np.abs(off).max()), len(off)), Bound(1.0, "default")),
    ]
    if "after" in kept:
        way = abs(kept["after"] - grips[-1][1])
        allowed = Bound(10.0 * kept["stroke"], "1 % of the stroke: a grip outlives its program")
        found.append(subject.measured(KEPT, exact(1e3 * way), allowed))
    wrong = ("it holds the block with its fingers open",) if kept["held_open"] else ()
    return Findings(tuple(found), wrong)


# ------------------------------------------------------------------------------------------------- force


def _squeeze(bed: Bed) -> None:
    gripper, width = bed.carrier, float(bed.features["block"])
    limit = gripper.about.capabilities.limits[0]
    bed.keep(done=0, known=float(bed.features["grip"]))
    if not limit.lower < width < limit.upper:
        return
    apart = vector((min(limit.upper, width + OPENS),))
    with gripper.happening(SimFault.BLOCK, width=width):
        gripper.enable()
        with gripper.slowed(SLOWED):
            for number in range(STROKES):
                for name, goal in (("apart", apart), ("grip", vector((limit.lower,)))):
                    gripper.move_to(goal)
                    _feel(bed)
                    bed.rest(SETTLES)
                    bed.mark(name)
                    bed.rest(FELT)
                    bed.mark(f"{name} end")
                bed.keep(done=number + 1)
            gripper.move_to(apart)
        gripper.disable()


def _feel(bed: Bed) -> None:
    """Let a simulated sensor feel the fingers of the simulated gripper."""
    force = bed.carrier.pressing()
    if force is not None:
        bed.load(Wrench(vector((0.0, 0.0, -force)), vector((0.0, 0.0, 0.0))))


SQUEEZE: Final = Acquisition(
    "squeezes",
    "The gripper closes on this sensor, which lies between its fingers, five times.",
    Safety.LARGE,
    _squeeze,
    ("measured_cf",),
    suite=Suite.FULL,
    features=("block", "grip"),
    carrier_needs=("move_jp", "measured_js"),
    carrier_fault=SimFault.BLOCK,
    loads=True,
)


def _presses(trace: Trace, subject: Subject) -> Findings:
    done, known = subject.kept["done"], subject.kept["known"]
    if done < STROKES:
        return Findings(doubts=(f"{done} of {STROKES} grips were carried out",))
    track = trace.vectors("measured_cf")
    means: dict[str, list[Array]] = {}
    for name in ("apart", "grip"):
        for begin, end in zip(trace.marks(name), trace.marks(f"{name} end"), strict=True):
            part = track.between(begin, end)
            force = part.values[np.isfinite(part.stamp), :3]
            if not len(force):
                return Findings(doubts=("no valid samples came of a grip",))
            means.setdefault(name, []).append(force.mean(axis=0))
    forces = np.linalg.norm(np.subtract(means["grip"], means["apart"]), axis=1)
    error = mean(100.0 * (forces / known - 1.0))
    told = f"{forces.mean():.3g} N, {known:g} N are known"
    found = subject.measured(FORCE, error, Bound(GRIPS_WITHIN, "default", -GRIPS_WITHIN), why=told)
    line = ("", track.at, np.linalg.norm(track.values[:, :3] - means["apart"][0], axis=1))
    return Findings((found,), plots=(Plot.of("Force between the fingers", "time, s", "N", line),))


TESTS: Final = (
    BenchTest("G1", "stroke", "grip", STROKE, _goes, (ERROR, SPREAD, CLAIMED, TIME), of_kept=True),
    BenchTest("G3", "a block", "grip", BLOCK, _grips, (KNOWN, WIDTH, KEPT), of_kept=True),
    BenchTest("G2", "force of the grip", "grip", SQUEEZE, _presses, (FORCE,)),
)
