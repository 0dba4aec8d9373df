"""Latency: how late joints follow pseudo-random steps, by correlation of what was sent and what came."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from crtk_drivers.labs.bench.acquisition import BUSY, Acquisition, BenchTest, Safety, Subject, Suite
from crtk_drivers.labs.bench.bed import Bed
from crtk_drivers.labs.bench.signals import resolution
from crtk_drivers.labs.bench.trace import Trace
from crtk_drivers.labs.verdicts.estimates import mean
from crtk_drivers.labs.verdicts.judging import (
    Bound,
    Comparison,
    Findings,
    Measurement,
    Plot,
    Quantity,
    Worse,
)
from crtk_drivers.samples import JointState, Vector, vector

SEQUENCE: Final = (1, 1, 1, 1, 0, 0, 0, 1, 0, 0, 1, 1, 0, 1, 0)
"""Of the greatest length of four bits: repeated, it looks like itself at no other delay."""

ROUNDS: Final = 2
"""Times that the sequence is judged, and once more for each times as thorough; before those, once more."""

SHORTEST: Final = 0.1
"""Seconds of one bit, at the least; at the most it is `LONGEST`."""

LONGEST: Final = 0.3

SHARE: Final = 0.35
"""Of the reach of a small motion that a step uses."""

SHARE_OF_LIMITS: Final = 0.2
"""Share of the velocity and acceleration limits that the edge of a step uses."""

STEPS: Final = 20.0
"""Steps of the encoder that a step has at the least."""

ALIKE: Final = 0.6
"""Correlation at the delay that is told, below which nothing is told."""

GRID: Final = 1e-3
"""Seconds between the delays that are tried."""

LATENCY = Quantity.at_most("motion.latency.delay", "latency", "ms", 2.0)
PEAK = Quantity(
    "motion.latency.peak", "correlation at that delay", "", Comparison.TOLD, Worse.LOWER, 0.05
)


def _steps(home: Vector, step: Vector, bit: float) -> Callable[[float], JointState]:
    """Return the sequence about `home`, each edge rounded over half a bit."""
    levels = [sign - 0.5 for sign in SEQUENCE]

    def value(t: float) -> JointState:
        index = int(t / bit)
        before = 0.0 if index == 0 else levels[(index - 1) % len(levels)]
        after = levels[index % len(levels)]
        into = min(1.0, 2.0 * (t / bit - index))
        share = before + (after - before) * (0.5 - 0.5 * math.cos(math.pi * into))
        return JointState(position=vector(home + share * step))

    return value


def _random_steps(bed: Bed) -> None:
    bed.enable()
    home = bed.setpoint
    own = bed.about.capabilities
    velocity = np.array([limit.velocity for limit in own.limits])
    acceleration = np.array([limit.acceleration for limit in own.limits])
    lag = 0.0 if own.following is None else own.following.lag
    reach = bed.reach(SHARE)
    edges = np.maximum(
        0.5 * math.pi * reach / (SHARE_OF_LIMITS * velocity),
        math.pi * np.sqrt(0.5 * reach / (SHARE_OF_LIMITS * acceleration)),
    )
    bit = min(max(SHORTEST, 2.0 * lag, 2.0 * float(edges.max())), LONGEST)
    allowed = SHARE_OF_LIMITS * np.minimum(
        velocity * bit / math.pi, acceleration * 0.5 * (bit / math.pi) ** 2
    )
    step = vector(np.minimum(reach, allowed))
    rounds = ROUNDS + int(bed.thorough)
    bed.note(step=step.tolist(), bit=bit, rounds=rounds, stream_rate=bed.stream_rate)
    bed.mark("begin")
    bed.stream("servo_jp", _steps(home, step, bit), (1 + rounds) * bit * len(SEQUENCE))
    bed.mark("end")
    bed.rest(bed.about.silence + 0.1)
    bed.move_to(home)
    bed.disable()


RANDOM_STEPS: Final = Acquisition(
    "random_steps",
    "Streams pseudo-random steps of all joints, at most 0.035 rad (7 mm), their edges rounded to a fifth of "
    "the limits.",
    Safety.SMALL,
    _random_steps,
    ("servo_jp", "move_jp", "measured_js"),
    suite=Suite.FULL,
)


def delay(
    sent_at: Vector, sent: Vector, at: Vector, values: Vector, longest: float
) -> tuple[float, float]:
    """Return by how many seconds `values` look like what was sent before, and how much (1: the same).

    Args:
        sent_at, sent: what was sent, and when; between two of them it is a straight line.
        at, values: what was measured.
        longest: delay in s that is tried.
    """
    measured = values - values.mean()
    size = float(np.linalg.norm(measured))
    delays = np.arange(0.0, longest, GRID)
    alike = np.zeros(delays.size)
    for index, late in enumerate(delays):
        asked = np.interp(at - late, sent_at, sent)
        asked -= asked.mean()
        both = size * float(np.linalg.norm(asked))
        alike[index] = float(asked @ measured) / both if both > 0.0 else 0.0
    best = int(np.argmax(alike))
    found = float(delays[best])
    if 0 < best < delays.size - 1:
        before, peak, after = alike[best - 1 : best + 2]
        bend = before - 2.0 * peak + after
        found += 0.5 * GRID * float((before - after) / bend) if bend < 0.0 else 0.0
    return found, float(alike[best])


def _latency(trace: Trace, subject: Subject) -> Findings:
    notes = trace.notes
    joints = trace.joints.by_stamp
    sent_at, sent = trace.positions_sent("servo_jp")
    begin, length = trace.mark("begin"), notes["bit"] * len(SEQUENCE)
    windows = [
        (begin + index * length, begin + (index + 1) * length)
        for index in range(1, 1 + notes["rounds"])
    ]
    parts = [joints.between(*window) for window in windows]
    doubts = (
        *subject.too_busy(BUSY),
        *[doubt for part in parts for doubt in subject.gaps(part.at)][:1],
    )
    if min(part.at.size for part in parts) < 50:
        return Findings(doubts=("too few samples", *doubts))
    allowed = subject.lag + 5.0 * subject.period + 1.0 / notes["stream_rate"]
    steps = resolution(joints.position)
    found: dict[int, list[tuple[float, float]]] = {}
    for column, step in enumerate(notes["step"]):
        if step >= max(STEPS * steps[column], 1e-9):
            found[column] = [
                delay(
                    sent_at, sent[:, column], part.at, part.position[:, column], 3.0 * allowed + 0.2
                )
                for part in parts
            ]
    if not found:
        return Findings(doubts=("a step is less than twenty steps of the encoder", *doubts))
    return Findings(
        tuple(_told(subject, found, allowed)),
        doubts=doubts,
        plots=(_plot(trace, windows[0], max(found, key=lambda each: notes["step"][each])),),
    )


def _told(
    subject: Subject, found: dict[int, list[tuple[float, float]]], allowed: float
) -> list[Measurement]:
    """Return the latency of the joint that is latest, and of those that do not look like what was sent."""
    bound = Bound(1e3 * allowed, "the declared lag, five periods and one of the stream")
    peaks = {column: min(peak for _, peak in each) for column, each in found.items()}
    told = [
        subject.measured(
            LATENCY,
            None,
            bound,
            part=subject.joints[column],
            why=f"it does not look like what was sent: {peak:.2f}, where 1 is the same",
        )
        for column, peak in peaks.items()
        if peak < ALIKE
    ]
    alike = {
        column: [1e3 * late for late, _ in each]
        for column, each in found.items()
        if peaks[column] >= ALIKE
    }
    if alike:
        worst = max(alike, key=lambda column: float(np.mean(alike[column])))
        name = subject.joints[worst]
        told.append(subject.measured(LATENCY, mean(alike[worst]), bound, part=name))
        told.append(subject.measured(PEAK, mean([peak for _, peak in found[worst]]), part=name))
    return told


def _plot(trace: Trace, window: tuple[float, float], column: int) -> Plot:
    at, sent = trace.positions_sent("servo_jp")
    joints = trace.joints.by_stamp.between(*window)
    within = (at >= window[0]) & (at <= window[1])
    middle = float(joints.position[:, column].mean())
    return Plot.of(
        "Steps: asked and measured",
        "time, s",
        "mrad or mm",
        ("asked", at[within], 1e3 * (sent[within][:, column] - middle)),
        ("measured", joints.at, 1e3 * (joints.position[:, column] - middle)),
    )


TESTS: Final = (BenchTest("M6", "latency", "motion", RANDOM_STEPS, _latency, (LATENCY, PEAK)),)
