"""What must not move a device: to enable it, hold still and disable it, and commands that it must refuse."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from crtk_drivers.labs.bench.acquisition import Acquisition, BenchTest, Safety, Subject
from crtk_drivers.labs.bench.bed import Bed
from crtk_drivers.labs.bench.door import Refused
from crtk_drivers.labs.bench.signals import largest_line, noise, resolution
from crtk_drivers.labs.bench.trace import JointTrack, Trace
from crtk_drivers.labs.verdicts.estimates import exact, in_percent
from crtk_drivers.labs.verdicts.judging import (
    Bound,
    Comparison,
    Findings,
    Plot,
    Quantity,
    Worse,
)
from crtk_drivers.samples import JointState, Pose, Value, Vector, vector

BEFORE: Final = 0.4
SETTLES: Final = 0.4
AFTER: Final = 1.0
IDLE: Final = 3.0
"""Seconds of the quick suite for which it holds still."""

AUDIBLE: Final = 5e-5
"""rad (m): a line in the spectrum that is smaller is none."""

MOVED: Final = 1e-3
"""rad (m): what counts as a motion, where the noise is smaller."""

MOVED_AT_DISABLE: Final = 5e-3
"""rad (m): how far a joint may settle when its brake takes over."""

NOISE_ALONE: Final = "six times the noise, 1 to 5 mrad"
"""Where what counts as a motion comes from."""

ENABLED_STAYS = Quantity.at_most("staying.enable.moved", "largest way at enable", "mrad or mm", 0.2)
DISABLED_STAYS = Quantity.at_most(
    "staying.disable.moved", "largest way at disable", "mrad or mm", 0.5
)
REFUSED = Quantity.at_least("staying.refusals.refused", "refused of what must be", "%")
REASONS = Quantity.at_least("staying.refusals.reasons", "refusals with the reason that fits", "%")
REFUSED_STAYS = Quantity.at_most(
    "staying.refusals.moved", "largest way meanwhile", "mrad or mm", 0.2
)
HUNTING = Quantity.at_most("joints.hunting.line", "largest line above 5 Hz", "mrad or mm", 0.02)
HUNTING_AT = Quantity(
    "joints.hunting.frequency", "its frequency", "Hz", Comparison.TOLD, Worse.EITHER, 1.0
)


def still(subject: Subject, joints: JointTrack) -> Vector:
    """Return what counts as a motion of each joint (n,): six times its noise, two steps, or `MOVED`."""
    if joints.at.size < 3:
        return np.full(len(subject.joints), MOVED)
    found: Vector = np.maximum(6.0 * noise(joints.position), 2.0 * resolution(joints.position))
    return np.maximum(found, MOVED)


def away(joints: JointTrack, begin: float, end: float, home: Vector) -> Vector:
    """Return how far each joint (n,) was at most from `home` between two times."""
    part = joints.between(begin, end).position
    found: Vector = np.abs(part - home).max(axis=0) if len(part) else np.full(home.size, np.nan)
    return found


# ------------------------------------------------------------------------------------ enable and disable


def _transitions(bed: Bed) -> None:
    bed.rest(BEFORE)
    bed.mark("enable")
    bed.enable()
    bed.rest(SETTLES)
    bed.mark("idle")
    bed.rest(IDLE * bed.thorough)
    bed.mark("disable")
    bed.disable()
    bed.rest(AFTER)
    bed.mark("end")


TRANSITIONS: Final = Acquisition(
    "transitions",
    "Enables it, lets it hold still, and disables it.",
    Safety.ENABLE,
    _transitions,
    ("measured_js",),
)


def _stays(trace: Trace, subject: Subject) -> Findings:
    joints = trace.joints
    enable, disable, end = (trace.mark(text) for text in ("enable", "disable", "end"))
    before = joints.between(enable - BEFORE, enable)
    settled = joints.between(disable - 0.5 * AFTER, disable)
    if not (before.at.size and settled.at.size):
        return Findings(doubts=("no samples before a command",))
    moved = np.minimum(still(subject, before), MOVED_AT_DISABLE)
    at_enable = away(joints, enable, disable, before.position.mean(axis=0))
    at_disable = away(joints, disable, end, settled.position.mean(axis=0))
    settles = np.maximum(moved, MOVED_AT_DISABLE)
    n = joints.at.size
    return Findings(
        (
            subject.furthest(ENABLED_STAYS, at_enable, moved, NOISE_ALONE, n=n),
            subject.furthest(DISABLED_STAYS, at_disable, settles, "a brake that settles", n=n),
        ),
        plots=(
            subject.ways_told(
                "Way of each joint through enable and disable",
                joints.at,
                joints.position - before.position.mean(axis=0),
            ),
        ),
    )


# --------------------------------------------------------------------------------------------- refusals


def _bad_commands(bed: Bed) -> Iterator[tuple[str, Value, tuple[str, ...]]]:
    """Yield what must be refused: command, value, and the reasons that fit."""
    here = bed.setpoint
    size = here.size
    limits = bed.about.capabilities.limits
    broken = here.copy()
    broken[-1] = math.nan
    endless = here.copy()
    endless[0] = math.inf
    beyond = here.copy()
    beyond[0] = limits[0].upper + 0.01 * (limits[0].upper - limits[0].lower)
    for name in ("servo_jp", "move_jp", "interpolate_jp"):
        if not bed.offers(name):
            continue
        yield name, JointState(position=broken), ("not_finite",)
        yield name, JointState(position=endless), ("not_finite",)
        if here.size > 1:
            yield name, JointState(position=here[:-1]), ("wrong_size",)
        yield name, JointState(position=np.append(here, 0.0)), ("wrong_size",)
        yield name, JointState(position=vector(())), ("empty", "wrong_size")
    if bed.offers("move_jp"):
        yield "move_jp", JointState(position=beyond), ("out_of_range",)
    if bed.offers("servo_jp") and size:
        step = here.copy()
        room = limits[0].upper - here[0] > here[0] - limits[0].lower
        far = 0.5 * (limits[0].upper - here[0] if room else limits[0].lower - here[0])
        step[0] += far
        if abs(far) > 4.0 * bed.about.max_step * limits[0].velocity:
            yield "servo_jp", JointState(position=step), ("step_too_large",)
    pose = bed.forward(here)
    if pose is not None:
        for name in ("servo_cp", "move_cp"):
            if bed.offers(name):
                flat = Pose(pose.position, vector((0.0, 0.0, 0.0, 0.0)), pose.frame_id)
                yield name, flat, ("bad_quaternion",)
                yield name, Pose(pose.position, pose.orientation, "elsewhere"), ("wrong_frame",)


def _refusals(bed: Bed) -> None:
    sent: list[tuple[str, str, str]] = []

    def offer(name: str, value: Value, reasons: tuple[str, ...]) -> None:
        try:
            bed.submit(name, value)
            told = ""
            bed.submit("hold")
        except Refused as refusal:
            told = refusal.reason or "no reason"
        sent.append((name, "|".join(reasons), told))

    bed.rest(BEFORE)
    bed.mark("disabled")
    here = bed.position
    for name in ("servo_jp", "move_jp", "interpolate_jp"):
        if bed.offers(name):
            offer(name, JointState(position=here), ("not_enabled",))
    bed.rest(BEFORE)
    bed.mark("enable")
    bed.enable()
    bed.rest(BEFORE)
    bed.mark("enabled")
    for name, value, reasons in tuple(_bad_commands(bed)):
        offer(name, value, reasons)
        if not sent[-1][2]:  # what takes this may take the next one too
            break
    bed.rest(AFTER)
    bed.mark("end")
    bed.note(sent=sent, state=str(bed.state))
    bed.disable()


REFUSALS: Final = Acquisition(
    "refusals",
    "Sends what must be refused: NaN, wrong sizes, out of range, too far, another frame; all while DISABLED.",
    Safety.SMALL,
    _refusals,
    ("measured_js", "move_jp", "hold"),
)


def _refuses(trace: Trace, subject: Subject) -> Findings:
    sent: list[list[str]] = trace.notes["sent"]
    joints = trace.joints
    marks = {text: trace.mark(text) for text in ("disabled", "enable", "enabled", "end")}
    before = joints.between(0.0, marks["disabled"])
    rest = joints.between(marks["enabled"] - 0.5 * BEFORE, marks["enabled"])
    moved = np.minimum(still(subject, before), MOVED_AT_DISABLE)
    ways = np.maximum(
        away(joints, marks["disabled"], marks["enable"], before.position.mean(axis=0)),
        away(joints, marks["enabled"], marks["end"], rest.position.mean(axis=0)),
    )
    refused = [told for _, _, told in sent if told]
    fitting = [told for _, reasons, told in sent if told in reasons.split("|")]
    accepted = [
        f"{name} that is {reasons} was accepted" for name, reasons, told in sent if not told
    ]
    other = [
        f"{name} that is {reasons} was refused as {told}"
        for name, reasons, told in sent
        if told and told not in reasons.split("|")
    ]
    state = trace.notes["state"]
    return Findings(
        (
            subject.measured(
                REFUSED,
                in_percent(exact(len(refused) / len(sent), len(sent))),
                Bound(100.0, "nothing that is wrong reaches hardware"),
                why="; ".join(accepted),
            ),
            subject.measured(
                REASONS,
                in_percent(exact(len(fitting) / max(1, len(refused)), len(refused))),
                Bound(100.0, "every refusal has a reason"),
                why="; ".join(other),
            ),
            subject.furthest(REFUSED_STAYS, ways, moved, NOISE_ALONE, n=joints.at.size),
        ),
        violations=(*accepted, *(() if state == "ENABLED" else (f"bad commands led to {state}",))),
    )


# ---------------------------------------------------------------------------------------------- hunting


def _hunts(trace: Trace, subject: Subject) -> Findings:
    joints = trace.joints.between(trace.mark("idle"), trace.mark("disable"))
    if joints.at.size < 50:
        return Findings(doubts=(f"{joints.at.size} samples",))
    rate = (joints.at.size - 1) / (joints.at[-1] - joints.at[0])
    lines = [largest_line(column, rate, above=5.0) for column in joints.position.T]
    steps = resolution(joints.position)
    ratios = [
        amplitude / max(3.0 * floor, 0.5 * float(step), AUDIBLE)
        for (_, amplitude, floor), step in zip(lines, steps, strict=True)
    ]
    worst = int(np.argmax(ratios))
    frequency, amplitude, floor = lines[worst]
    bound = max(3.0 * floor, 0.5 * float(steps[worst]), AUDIBLE)
    name = subject.joints[worst]
    course = joints.position[:, worst] - joints.position[:, worst].mean()
    return Findings(
        (
            subject.measured(
                HUNTING,
                exact(1e3 * amplitude, joints.at.size),
                Bound(
                    1e3 * bound, "three times the floor of its spectrum, half a step, or 0.05 mrad"
                ),
                part=name,
            ),
            subject.measured(HUNTING_AT, exact(frequency), part=name),
        ),
        plots=(
            Plot.of(
                f"{name}, ENABLED and at rest",
                "time, s",
                "mrad or mm",
                ("", joints.at, 1e3 * course),
            ),
        ),
    )


TESTS: Final = (
    BenchTest(
        "M1",
        "enable and disable stay",
        "staying",
        TRANSITIONS,
        _stays,
        (ENABLED_STAYS, DISABLED_STAYS),
        guards=True,
    ),
    BenchTest("J2", "hunting", "joints", TRANSITIONS, _hunts, (HUNTING, HUNTING_AT)),
    BenchTest(
        "S8",
        "refusals",
        "staying",
        REFUSALS,
        _refuses,
        (REFUSED, REASONS, REFUSED_STAYS),
        guards=True,
    ),
)
