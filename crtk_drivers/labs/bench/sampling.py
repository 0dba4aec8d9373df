"""At rest: do samples come as declared, with true stamps, and how noisy are they."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from crtk_drivers.labs.bench.acquisition import Acquisition, BenchTest, Safety, Subject, Suite
from crtk_drivers.labs.bench.bed import Bed
from crtk_drivers.labs.bench.signals import largest_line, noise, resolution, slope
from crtk_drivers.labs.bench.trace import Trace
from crtk_drivers.labs.verdicts.estimates import exact, in_percent, quantile, share, within
from crtk_drivers.labs.verdicts.judging import (
    Bound,
    Findings,
    Measurement,
    Plot,
    Quantity,
)
from crtk_drivers.samples import Vector

REST: Final = 3.0
"""Seconds of the quick suite."""

SAMPLES: Final = 800
"""That are taken at the least: of fewer, nothing can be said of half a per cent."""

LONGEST: Final = 10.0
"""Seconds after which the quick suite goes on all the same."""

STREAMS: Final = ("measured_js", "measured_cf", "measured_cp", "measured_cv")

BUSY: Final = 2e-3
"""Seconds by which the bench's own timer may be late, where a quarter of a period is less."""

PARTS: Final = 20
"""Into which a run is divided to compare the device's clock: of each the sample that came quickest counts."""

SLOW: Final = 0.02
"""Share of its rate by which a device may be off, where frequencies are looked for."""

MAINS: Final = (50.0, 60.0)


def _rest(bed: Bed) -> None:
    slow = min(LONGEST, SAMPLES / bed.about.capabilities.rate)
    bed.rest(max(REST, slow) * bed.thorough)


AT_REST: Final = Acquisition(
    "rest", "Reads, and does nothing else.", Safety.READ, _rest, suite=Suite.REST
)

RATE = Quantity.within("sampling.rate.error", "rate against declared", "%", 0.3)
LOSS = Quantity.at_most("sampling.rate.gaps", "share of lost cycles", "%", 0.1)
JITTER = Quantity.at_most("sampling.jitter.p99", "p99 of the period's error", "% of a period", 5.0)
LATE = Quantity.at_most("sampling.jitter.late", "periods over twice the declared", "%", 0.2)
ORDER = Quantity.at_most("sampling.stamps.order", "stamps that do not increase", "")
FUTURE = Quantity.at_most("sampling.stamps.future", "stamps in the future", "")
CLOCK = Quantity.within("sampling.stamps.slope", "device's clock against host's", "ppm", 100.0)
TOGETHER = Quantity.at_least(
    "sampling.stamps.together", "poses and wrenches with the stamp of the joints", "%"
)
AGE = Quantity.at_most("sampling.age.p99", "p99 of the age on arrival", "ms", 1.0)
SIGMA = Quantity.told("joints.noise.sigma", "noise at rest", "mrad or mm", 0.02)
DRIFT = Quantity.at_most("joints.noise.drift", "drift at rest", "mrad or mm a minute", 0.5)
FORCE_SIGMA = Quantity.told("force.noise.sigma", "noise of the greatest force", "N", 0.02)
TORQUE_SIGMA = Quantity.told("force.noise.torque", "noise of the greatest torque", "N·m", 0.002)
FORCE_LINE = Quantity.at_most("force.noise.mains", "line of the mains over the floor", "", 1.0)
FORCE_DRIFT = Quantity.told("force.noise.drift", "drift of a force", "N a minute", 0.5)


def _main_stream(trace: Trace) -> tuple[Vector, Vector]:
    """Return arrival and stamp of what the device measures first of all."""
    for topic in STREAMS:
        track = trace.joint_states(topic)
        if track.at.size:
            return track.at, track.stamp
    return np.empty(0), np.empty(0)


def _hardly_any(count: int) -> Findings:
    """A device that is connected, and of which hardly a sample is valid."""
    return Findings(violations=(f"{count} valid samples in {REST:g} s, though it is connected",))


def _rate(trace: Trace, subject: Subject) -> Findings:
    _, stamp = _main_stream(trace)
    fresh = stamp[np.isfinite(stamp)]
    if fresh.size < 10:
        return _hardly_any(fresh.size)
    made = np.unique(fresh)
    period = subject.period
    span = made[-1] - made[0]
    rate = (made.size - 1) / span
    error = 100.0 * (rate * period - 1.0)
    doubt = 100.0 * period / span
    missing = int(np.maximum(0.0, np.round(np.diff(made) / period) - 1.0).sum())
    count = int(made.size) + missing

    def found(waited: float) -> Findings:
        slow = max(error, min(0.0, error + 100.0 * waited))
        lost = share(max(0, missing - math.ceil(waited * count)), count)
        return Findings(
            (
                subject.measured(RATE, within(slow, doubt, made.size), Bound(1.0, "default", -1.0)),
                subject.measured(LOSS, in_percent(lost), Bound(0.5, "default")),
            ),
            doubts=subject.too_busy(max(0.25 * subject.period, BUSY)),
        )

    return subject.on_a_free_machine(found)


def _jitter(trace: Trace, subject: Subject) -> Findings:
    _, stamp = _main_stream(trace)
    made = np.unique(stamp[np.isfinite(stamp)])
    if made.size < 100:
        return Findings(doubts=(f"{made.size} valid samples",))
    period = subject.period
    steps = np.diff(made)
    errors = np.abs(steps - period) / period
    many = int((steps > 2.0 * period).sum())

    def found(waited: float) -> Findings:
        late = share(max(0, many - math.ceil(waited * steps.size)), steps.size)
        p99 = quantile(errors, _without(waited))
        return Findings(
            (
                subject.measured(JITTER, in_percent(p99), Bound(25.0, "default")),
                subject.measured(LATE, in_percent(late), Bound(0.5, "default")),
            ),
            doubts=subject.too_busy(max(0.25 * subject.period, BUSY)),
            plots=(
                Plot.of(
                    "Time between two samples",
                    "time, s",
                    "ms",
                    ("", made[1:] - made[0], 1e3 * steps),
                ),
            ),
        )

    return subject.on_a_free_machine(found)


def _without(waited: float) -> float:
    """Return which quantile is the p99 of what is left without a share of the time."""
    return 0.99 - min(waited, 0.49)


def _quickest(delays: Vector) -> NDArray[np.intp]:
    """Return which samples came quickest, one of each part of the time: the others had to wait.

    What keeps a sample waiting makes it late and never early, so that a line through all of them tells of the
    load of the machine.
    """
    parts = np.array_split(np.arange(delays.size), min(PARTS, delays.size // 5))
    return np.array([part[np.argmin(delays[part])] for part in parts])


def _stamps(trace: Trace, subject: Subject) -> Findings:
    at, stamp = _main_stream(trace)
    valid = np.isfinite(stamp)
    at, stamp = at[valid], stamp[valid]
    if stamp.size < 10:
        return Findings(doubts=(f"{stamp.size} valid samples",))
    backwards = int((np.diff(stamp) <= 0.0).sum())
    future = int((stamp > at + 1e-4).sum())
    quick = _quickest(at - stamp)
    pace = slope(at[quick], stamp[quick])
    ppm = 1e6 * (pace - 1.0)
    # A line through n stamps with this jitter has its slope no better than that.
    spread = float(np.std(stamp[quick] - pace * at[quick]))
    doubt = 2e6 * spread * np.sqrt(12.0 / quick.size) / max(at[-1] - at[0], 1e-3)
    found: list[Measurement] = [
        subject.measured(
            ORDER, exact(backwards, stamp.size), Bound(0.0, "CRTK: time of measurement")
        ),
        subject.measured(
            FUTURE, exact(future, stamp.size), Bound(0.0, "CRTK: time of measurement")
        ),
        subject.measured(
            CLOCK,
            within(ppm, float(doubt), stamp.size),
            Bound(500.0, "largest slew of NTP", -500.0),
        ),
    ]
    joints = {row[2] for row in trace.rows.get("measured_js", ())}
    others = [
        row[2]
        for topic in ("measured_cp", "measured_cv")
        for row in trace.rows.get(topic, ())
        if row[2]
    ]
    if joints and others:
        hits = sum(made in joints for made in others)
        found.append(
            subject.measured(
                TOGETHER,
                in_percent(exact(hits / len(others), len(others))),
                Bound(100.0, "CRTK: what is derived has the stamp of its source"),
            )
        )
    return Findings(tuple(found))


def _age(trace: Trace, subject: Subject) -> Findings:
    at, stamp = _main_stream(trace)
    valid = np.isfinite(stamp)
    ages = 1e3 * (at[valid] - stamp[valid])
    if ages.size < 20:
        return _hardly_any(ages.size)
    bound = Bound(2e3 * subject.period + 2.0, "two periods and 2 ms")
    plot = Plot.of("Age on arrival", "time, s", "ms", ("", at[valid], ages))

    def found(waited: float) -> Findings:
        return Findings(
            (subject.measured(AGE, quantile(ages, _without(waited)), bound),),
            doubts=subject.too_busy(max(0.25 * subject.period, BUSY)),
            plots=(plot,),
        )

    return subject.on_a_free_machine(found)


def _noise(trace: Trace, subject: Subject) -> Findings:
    joints = trace.joints
    if joints.at.size < 20:
        return Findings(doubts=(f"{joints.at.size} samples",))
    steps = resolution(joints.position)
    sigma = noise(joints.position)
    seconds = joints.at[-1] - joints.at[0]
    drifts = np.array([abs(slope(joints.at, column)) * 60.0 for column in joints.position.T])
    # The slope of noise alone, which a line of this length finds.
    doubts = 2.0 * sigma * np.sqrt(12.0 / joints.at.size) / seconds * 60.0
    room = np.maximum.reduce([2.0 * steps, 3.0 * sigma, np.full(sigma.size, 1e-4)]) * 60.0 / seconds
    return Findings(
        (
            subject.measured(SIGMA, exact(1e3 * float(sigma.max()), joints.at.size)),
            subject.furthest(
                DRIFT,
                drifts,
                room,
                "three times the noise, or two steps, over the time",
                doubts=doubts,
                n=joints.at.size,
            ),
        ),
        plots=(
            subject.ways_told(
                "Positions at rest, from their mean",
                joints.at,
                joints.position - joints.position.mean(axis=0),
            ),
        ),
    )


def _force(trace: Trace, subject: Subject) -> Findings:
    track = trace.vectors("measured_cf")
    if track.at.size < 50:
        return Findings(doubts=(f"{track.at.size} samples",))
    sigma = noise(track.values)
    worst = int(np.argmax(sigma[:3]))
    rate = (track.at.size - 1) / (track.at[-1] - track.at[0])
    found = [
        subject.measured(FORCE_SIGMA, exact(float(sigma[:3].max()), track.at.size)),
        subject.measured(TORQUE_SIGMA, exact(float(sigma[3:].max()), track.at.size)),
        subject.measured(
            FORCE_DRIFT,
            exact(
                60.0 * max(abs(slope(track.at, column)) for column in track.values.T[:3]),
                track.at.size,
            ),
        ),
    ]
    if rate > 2.2 * max(MAINS):
        frequency, amplitude, floor = largest_line(track.values[:, worst], rate, above=5.0)
        is_mains = any(abs(frequency - line) < 1.0 for line in MAINS)
        ratio = amplitude / floor if is_mains and floor > 0.0 else 0.0
        found.append(
            subject.measured(
                FORCE_LINE,
                exact(ratio, track.at.size),
                Bound(6.0, "six times the floor of the spectrum"),
            )
        )
    slow = abs(rate * subject.period - 1.0) > SLOW
    return Findings(
        tuple(found),
        doubts=(f"{rate:.0f} samples came a second, of {subject.rate:g}",) if slow else (),
        plots=(
            Plot.of(
                "Forces at rest",
                "time, s",
                "N",
                *((axis, track.at, track.values[:, index]) for index, axis in enumerate("xyz")),
            ),
        ),
    )


TESTS: Final = (
    BenchTest("T1", "rate and loss", "sampling", AT_REST, _rate, (RATE, LOSS), guards=True),
    BenchTest("T2", "jitter", "sampling", AT_REST, _jitter, (JITTER, LATE), guards=True),
    BenchTest(
        "T3",
        "stamps and clock",
        "sampling",
        AT_REST,
        _stamps,
        (ORDER, FUTURE, CLOCK, TOGETHER),
        guards=True,
    ),
    BenchTest("T4", "age", "sampling", AT_REST, _age, (AGE,), guards=True),
    BenchTest("J1", "noise and drift", "joints", AT_REST, _noise, (SIGMA, DRIFT), ("measured_js",)),
    BenchTest(
        "F1",
        "noise, lines and drift of forces",
        "force",
        AT_REST,
        _force,
        (FORCE_SIGMA, TORQUE_SIGMA, FORCE_LINE, FORCE_DRIFT),
        ("measured_cf",),
    ),
)
