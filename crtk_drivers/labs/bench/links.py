"""The link between driver and device is lost, one way, both ways, or closed: by a relay, without root."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np

from crtk_drivers.labs.bench.acquisition import Acquisition, BenchTest, Safety, Subject, Suite
from crtk_drivers.labs.bench.bed import Bed, Broken
from crtk_drivers.labs.bench.relay import Mode
from crtk_drivers.labs.bench.silence import (
    BACK,
    LOOK,
    MOVED,
    ON_ITS_WAY,
    Silence,
    looked,
    reaction_alone,
    way_alone,
)
from crtk_drivers.labs.bench.stops import begin_motion
from crtk_drivers.labs.bench.trace import Trace
from crtk_drivers.labs.verdicts.estimates import Estimate, exact, within
from crtk_drivers.labs.verdicts.judging import Bound, Findings, Measurement, Quantity
from crtk_drivers.samples import JointState

CUT: Final = 3.0
"""Seconds for which the link is lost."""

PAUSE: Final = 1.0
"""Seconds between two tries to enable it."""

HEARD: Final = 0.5
"""Seconds before its end until which something must be heard of a device that is deaf."""

STANDS: Final = 2e-3
"""rad (m): nearer than that to where it ended, it stands."""

WAYS: Final = (Mode.DEAF, Mode.SILENT, Mode.CLOSED)

TIME = Quantity.at_most("stop.link_lost.time", "time to stand, while only it is heard", "s", 0.02)
WAY = Quantity.at_most("stop.link_lost.distance", "way after the link was lost", "mrad or mm", 3.0)
AFTER = Quantity.at_most("stop.link_lost.after", "way after the link is back", "mrad or mm", 0.5)
TOLD: Final = Silence(
    restamped=Quantity.at_most("loss.link.restamped", "fresh stamps after the last sample", ""),
    invalid=Quantity.at_most("loss.link.invalid", "until data are told as invalid", "s", 0.01),
    fault=Quantity.at_most("loss.link.fault", "until FAULT", "s", 0.02),
)
RETURNS = Quantity.at_most("loss.link.return", "until it measures again", "s", 0.5)


def _lost_in_motion(bed: Bed) -> None:
    cuts = {}
    with bed.through_relay() as relay:
        for mode in WAYS:
            bed.enable()
            home = bed.setpoint
            speed, _ = begin_motion(bed, home)
            before, begin = bed.position, time.monotonic()
            with bed.expecting("a lost link"):
                relay.mode = mode
                took = time.monotonic() - begin
                looks = _positions(bed, CUT)
                relay.mode = Mode.OPEN
                back = bed.wait_until(lambda glance: glance.measures, BACK)
                after = bed.position
                time.sleep(0.5)
                cuts[mode] = {
                    "speed": speed.tolist(),
                    "before": before.tolist(),
                    "took": took,
                    "looks": looks if mode is Mode.DEAF else [],
                    "after": after.tolist(),
                    "later": bed.position.tolist(),
                    "back": back,
                    "state": str(bed.state),
                }
                bed.keep(cuts=cuts)
                _enable_again(bed)
            bed.move_to(home)
            bed.disable()


def _enable_again(bed: Bed) -> None:
    """Bring it to ENABLED; what was held up in the old connection may keep it from that for a moment.

    Raises:
        Broken: it did not get there.
    """
    end = time.monotonic() + BACK
    while True:
        try:
            bed.disable()
            bed.enable()
        except Broken:
            if time.monotonic() > end:
                raise
            time.sleep(PAUSE)
        else:
            return


def _positions(bed: Bed, seconds: float) -> list[tuple[float, list[float]]]:
    """Return when the bench looked, and joint positions (n,), as long as new ones came."""
    looks: list[tuple[float, list[float]]] = []
    last = 0
    begin = time.monotonic()
    while (now := time.monotonic() - begin) < seconds:
        value, stamp = bed.glance().values["measured_js"]
        if stamp.wall_ns > last and isinstance(value, JointState):
            last = stamp.wall_ns
            looks.append((now, value.position.tolist()))
        time.sleep(LOOK)
    return looks


IN_MOTION: Final = Acquisition(
    "link_lost",
    "Cuts the link in motion, for 3 s: commands only, both ways, and by closing it.",
    Safety.FAULT_IN_MOTION,
    _lost_in_motion,
    ("servo_jp", "move_jp", "measured_js"),
    suite=Suite.FULL,
    relayed=True,
)


def _stops_without_link(trace: Trace, subject: Subject) -> Findings:
    found: list[Measurement] = []
    violations = []
    cuts: Mapping[str, Mapping[str, Any]] = subject.kept["cuts"]
    for mode in WAYS:
        cut = cuts.get(mode)
        if cut is None:
            found.append(subject.measured(WAY, None, part=mode, why="it did not come to that"))
            continue
        if not cut["back"]:
            violations.append(f"{mode}: it did not measure again within {BACK:g} s")
            continue
        speed = np.abs(np.asarray(cut["speed"]))
        ways = np.abs(np.subtract(cut["later"], cut["before"]))
        allowed = way_alone(subject, speed)
        worst = int(np.argmax(ways / allowed))
        source = "the way in the time that it declares"
        way = float(ways[worst])
        # Of what it went while the relay was told, nothing counts, or all.
        least = max(0.0, way - float(speed[worst]) * cut["took"])
        found.append(
            subject.measured(
                WAY,
                Estimate(1e3 * way, 1e3 * least, 1e3 * way, 1),
                Bound(1e3 * float(allowed[worst]), source),
                part=f"{mode}: {subject.joints[worst]}",
            )
        )
        moved = np.abs(np.subtract(cut["later"], cut["after"]))
        found.append(
            subject.furthest(
                AFTER,
                moved,
                MOVED,
                "nothing moves because the link is back",
                part=f"{mode}: ",
            )
        )
    looks = cuts[Mode.DEAF]["looks"]
    # A bus whose devices speak when they are asked is dumb when it is deaf: then there is the way alone.
    if looks and looks[-1][0] > CUT - HEARD:
        deceleration = [limit.acceleration for limit in subject.limits]
        slowest = float((np.abs(cuts[Mode.DEAF]["speed"]) / deceleration).max())
        longest = reaction_alone(subject) + slowest + ON_ITS_WAY
        bound = Bound(longest, "the time that it declares, and to slow down")
        found.append(subject.measured(TIME, _time_to_stand(looks, cuts[Mode.DEAF]["took"]), bound))
    return Findings(tuple(found), tuple(violations))


def _time_to_stand(looks: list[tuple[float, list[float]]], took: float) -> Estimate:
    """Return when it stood for good, in s, known to the longest time between two looks, and to the cut."""
    at = np.array([when for when, _ in looks])
    positions = np.array([position for _, position in looks])
    moving = np.flatnonzero(np.abs(positions - positions[-1]).max(axis=1) > STANDS)
    first = int(moving[-1]) + 1 if moving.size else 0
    return within(float(at[first]), float(np.diff(at).max()) + took, len(looks))


def _lost_at_rest(bed: Bed) -> None:
    with bed.through_relay() as relay, bed.expecting("a lost link"):
        relay.mode = Mode.SILENT
        looks = looked(bed, bed.about.sample_timeout + CUT / 4.0)
        relay.mode = Mode.OPEN
        begin = time.monotonic()
        back = bed.wait_until(lambda glance: glance.measures, BACK)
        bed.keep(looks=looks, back=time.monotonic() - begin if back else None, state=str(bed.state))


AT_REST: Final = Acquisition(
    "link_lost_at_rest",
    "Cuts the link while nothing is commanded, as an unplugged cable.",
    Safety.FAULT,
    _lost_at_rest,
    suite=Suite.FULL,
    relayed=True,
)


def _stale(trace: Trace, subject: Subject) -> Findings:
    told, kept = TOLD.judged(subject), subject.kept
    if kept["back"] is None:
        never = f"it did not measure again within {BACK:g} s: {kept['state']}"
        return replace(told, violations=(*told.violations, never))
    longest = Bound(10.0, "the longest pause between two tries, and one try")
    back = subject.measured(RETURNS, exact(kept["back"]), longest)
    return replace(told, measurements=(*told.measurements, back))


TESTS: Final = (
    BenchTest(
        "T8",
        "link lost at rest",
        "loss",
        AT_REST,
        _stale,
        (*TOLD.quantities, RETURNS),
        of_kept=True,
    ),
    BenchTest(
        "S6",
        "link lost",
        "stop",
        IN_MOTION,
        _stops_without_link,
        (TIME, WAY, AFTER),
        of_kept=True,
    ),
)
