"""A tracker: what it sees of its tools, how well, at which scale; what it tells of one it does not see."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from crtk_drivers.geometry.quaternions import quaternion_product, rotvec_from_quaternion
from crtk_drivers.labs.bench.acquisition import Acquisition, BenchTest, Safety, Subject, Suite
from crtk_drivers.labs.bench.bed import Bed
from crtk_drivers.labs.bench.calls import TOOLS
from crtk_drivers.labs.bench.signals import noise
from crtk_drivers.labs.bench.trace import PoseTrack, Trace
from crtk_drivers.labs.verdicts.estimates import deviation, exact, in_percent, mean, share, within
from crtk_drivers.labs.verdicts.judging import Bound, Findings, Measurement, Plot, Quantity
from crtk_drivers.plugins import SimFault
from crtk_drivers.samples import Array, Pose, vector

BEGINS: Final = 0.5
"""Seconds after which a tracker that was enabled tells where its tools are."""

SEEN: Final = 3.0
"""Seconds in which they are looked at, in the quick suite."""

MOVED: Final = 2e-3
"""m: a tool whose place varies by more does not stand still."""

COVERED: Final = 1.0
"""Seconds for which a tool is covered."""

LATE: Final = 0.25
"""Seconds after which a covered tool may not be told any more, and an uncovered one is waited for at most."""

VALID = Quantity.at_least("tracking.view.valid", "share of valid poses", "%", 0.5)
NOISE = Quantity.told("tracking.view.noise", "noise of the position, rms", "mm", 0.02)
TURN_NOISE = Quantity.told("tracking.view.turn", "noise of the orientation, rms", "mrad", 0.1)
SCALE = Quantity.within(
    "tracking.scale.error", "way between two tools off the known one", "%", 0.02
)
RESTAMPED = Quantity.at_most("tracking.cover.restamped", "valid poses of a covered tool", "")
BACK = Quantity.at_most("tracking.cover.return", "until an uncovered tool is told again", "s", 0.05)


def _tools(trace: Trace) -> Iterator[tuple[str, PoseTrack]]:
    """Yield the names of the devices behind it that tell where they are, and what they told."""
    for topic in sorted(trace.rows):
        name, _, told = topic.partition("/")
        if told == "measured_cp":
            yield name, trace.poses(topic)


def fresh(track: PoseTrack, begin: float, end: float) -> list[int]:
    """Return the numbers of the samples from `begin` to `end` that are valid, of each measurement one."""
    _, first = np.unique(track.stamp, return_index=True)
    seen = np.isfinite(track.stamp) & (track.at >= begin) & (track.at <= end)
    return [index for index in first.tolist() if seen[index]]


# -------------------------------------------------------------------------------------------------- view


def _look(bed: Bed) -> None:
    bed.keep(bar=bed.features.get("bar"))
    bed.enable()
    bed.rest(BEGINS)
    bed.mark("begin")
    bed.rest(SEEN * bed.thorough)
    bed.mark("end")
    bed.disable()


VIEW: Final = Acquisition(
    "view", "Looks at the tools of a tracker.", Safety.ENABLE, _look, (TOOLS,)
)


def _sees(trace: Trace, subject: Subject) -> Findings:
    begin, end = trace.mark("begin"), trace.mark("end")
    found: list[Measurement] = []
    lines = []
    for name, track in _tools(trace):
        during = (track.at >= begin) & (track.at <= end)
        valid = during & np.isfinite(track.stamp)
        seen = share(int(valid.sum()), max(1, int(during.sum())))
        found.append(
            subject.measured(
                VALID, in_percent(seen), Bound(99.0, "a tool in view is seen"), part=name
            )
        )
        at = fresh(track, begin, end)
        if len(at) < 20:
            found.append(subject.measured(NOISE, None, why=f"{len(at)} valid poses", part=name))
            continue
        position = track.position[at]
        if np.ptp(position, axis=0).max() > MOVED:
            found.append(subject.measured(NOISE, None, why="it does not stand still", part=name))
            continue
        turns = _turns(track.orientation[at])
        for quantity, values in ((NOISE, position), (TURN_NOISE, turns)):
            rms = 1e3 * float(np.linalg.norm(noise(values)))
            found.append(
                subject.measured(quantity, deviation(rms, len(at) - 1, len(at)), part=name)
            )
        away = 1e3 * np.linalg.norm(position - position.mean(axis=0), axis=1)
        lines.append((name, track.stamp[at], away))
    if not found:
        return Findings(doubts=("nothing came of any tool",))
    plots = (Plot.of("Tools off their mean", "time, s", "mm", *lines),) if lines else ()
    return Findings(tuple(found), plots=plots)


def _turns(orientations: Array) -> Array:
    """Return rotation vectors (N, 3) in rad, from the first orientation (N, 4) to each."""
    back = vector(orientations[0] * (-1.0, -1.0, -1.0, 1.0))
    found: Array = np.array(
        [rotvec_from_quaternion(quaternion_product(vector(each), back)) for each in orientations]
    )
    return found


# ------------------------------------------------------------------------------------------------- scale


def _scale(trace: Trace, subject: Subject) -> Findings:
    tools = list(_tools(trace))
    if len(tools) != 2:
        return Findings(
            doubts=(f"it has {len(tools)} tools: configure the two that are on the bar alone",)
        )
    frames = {
        value.frame_id
        for name, _ in tools
        for *_, value in trace.rows[f"{name}/measured_cp"]
        if isinstance(value, Pose)
    }
    if len(frames) > 1:
        return Findings(
            doubts=(f"they are told in {', '.join(sorted(frames))}: leave `reference` out",)
        )
    begin, end = trace.mark("begin"), trace.mark("end")
    places: list[dict[float, Array]] = []
    for _, track in tools:
        at = fresh(track, begin, end)
        places.append({float(track.stamp[index]): track.position[index] for index in at})
    both = sorted(places[0].keys() & places[1].keys())
    if len(both) < 20:
        return Findings(doubts=(f"both were seen at the same time in {len(both)} frames",))
    known = subject.kept["bar"]
    ways = np.array([np.linalg.norm(places[0][at] - places[1][at]) for at in both])
    return Findings(
        (
            subject.measured(
                SCALE,
                mean(100.0 * (ways / known - 1.0)),
                Bound(0.2, "default", -0.2),
                part=" to ".join(name for name, _ in tools),
            ),
        )
    )


# ------------------------------------------------------------------------------------------------- cover


def _cover(bed: Bed) -> None:
    bed.enable()
    bed.rest(BEGINS)
    with bed.expecting("a covered tool"):
        with bed.happening(SimFault.COVER):
            bed.mark("covered")
            bed.rest(COVERED)
            bed.mark("uncovered")
        bed.rest(COVERED)
    bed.mark("end")
    bed.disable()


COVER: Final = Acquisition(
    "cover",
    "Covers a tool of the simulated tracker for 1 s.",
    Safety.FAULT,
    _cover,
    (TOOLS,),
    suite=Suite.FULL,
    sim_fault=SimFault.COVER,
)


def _loses(trace: Trace, subject: Subject) -> Findings:
    covered, uncovered, end = (trace.mark(text) for text in ("covered", "uncovered", "end"))
    told: list[tuple[int, str, float]] = []
    for name, track in _tools(trace):
        if not np.isfinite(track.stamp[track.at < covered]).any():
            continue  # nobody saw it before
        during = (track.stamp >= covered + LATE) & (track.stamp < uncovered)
        after = track.stamp[(track.stamp > uncovered) & (track.stamp <= end)]
        back = float(after[0] - uncovered) if after.size else np.inf
        told.append((int(during.sum()), name, back))
    if not told:
        return Findings(doubts=("no tool was seen before",))
    count, name, back = min(told)
    bound = Bound(0.0, "a pose that is not measured has stamp 0")
    found = [subject.measured(RESTAMPED, exact(count), bound, part=name)]
    if count == 0 and np.isfinite(back):
        period = 2.0 * subject.period
        found.append(
            subject.measured(
                BACK, within(back, min(back, period)), Bound(LATE, "default"), part=name
            )
        )
    wrong = () if np.isfinite(back) else (f"{name} was not told again within {COVERED:g} s",)
    return Findings(tuple(found), wrong)


TESTS: Final = (
    BenchTest("K1", "view and noise", "tracking", VIEW, _sees, (VALID, NOISE, TURN_NOISE)),
    BenchTest("K2", "scale", "tracking", VIEW, _scale, (SCALE,), features=("bar",)),
    BenchTest("K3", "a covered tool", "tracking", COVER, _loses, (RESTAMPED, BACK)),
)
