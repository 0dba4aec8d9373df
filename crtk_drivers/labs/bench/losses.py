"""What is lost while a device runs: the device falls silent, the driver is killed or gets no time."""

from __future__ import annotations

import time
from typing import Final

import numpy as np

from crtk_drivers.labs.bench.acquisition import Acquisition, BenchTest, Safety, Subject, Suite
from crtk_drivers.labs.bench.bed import Bed, Process
from crtk_drivers.labs.bench.calls import Glance
from crtk_drivers.labs.bench.silence import BACK, MOVED, Silence, looked, way_alone
from crtk_drivers.labs.bench.stops import begin_motion
from crtk_drivers.labs.bench.trace import Trace
from crtk_drivers.labs.verdicts.estimates import exact
from crtk_drivers.labs.verdicts.judging import Bound, Findings, Measurement, Quantity
from crtk_drivers.samples import Array
from crtk_drivers.state import OperatingState

SILENT: Final = 0.7
"""Seconds of silence, beside the time after which the link counts as lost."""

DEAD: Final = 3.0
"""Seconds for which the driver is not there."""

TOLD: Final = Silence(
    restamped=Quantity.at_most("loss.silence.restamped", "fresh stamps after the last sample", ""),
    invalid=Quantity.at_most("loss.silence.invalid", "until data are told as invalid", "s", 0.01),
    fault=Quantity.at_most("loss.silence.fault", "until FAULT", "s", 0.02),
)
RETURNS = Quantity.at_most("loss.return.time", "until it measures again", "s", 0.5)
RETURN_MOVED = Quantity.at_most("loss.return.moved", "largest way meanwhile", "mrad or mm", 0.2)
KILLED_WAY = Quantity.at_most("stop.driver_killed.distance", "way after kill -9", "mrad or mm", 3.0)
FROZEN_WAY = Quantity.at_most(
    "stop.driver_frozen.distance", "way while it is frozen", "mrad or mm", 3.0
)
FROZEN_AFTER = Quantity.at_most(
    "stop.driver_frozen.after", "way after it goes on", "mrad or mm", 0.5
)


def _is_back(glance: Glance) -> bool:
    return glance.measures and glance.status.state is OperatingState.DISABLED


def _silence(bed: Bed) -> None:
    bed.enable()
    bed.rest(0.3)
    before = bed.position
    with bed.expecting("a silent device"):
        with bed.frozen(Process.SIMULATOR):
            looks = looked(bed, bed.about.sample_timeout + SILENT)
        begin = time.monotonic()
        back = bed.wait_until(_is_back, BACK)
    bed.keep(
        looks=looks,
        back=time.monotonic() - begin if back else None,
        state=str(bed.state),
        before=before.tolist(),
        after=bed.position.tolist(),
    )


SILENCE: Final = Acquisition(
    "device_silent",
    "Takes all time from the simulator while the device is ENABLED, as a device that falls silent.",
    Safety.FAULT,
    _silence,
    ("measured_js", "move_jp"),
    suite=Suite.FULL,
)


def _stale(trace: Trace, subject: Subject) -> Findings:
    return TOLD.judged(subject)


def _way(subject: Subject, before: str, after: str) -> Array:
    """Return the way of each joint (n,) between two positions that were kept."""
    found: Array = np.abs(np.subtract(subject.kept[after], subject.kept[before]))
    return found


def _stops_alone(subject: Subject, quantity: Quantity, after: str) -> Measurement:
    way = _way(subject, "before", after)
    allowed = way_alone(subject, np.asarray(subject.kept["speed"]))
    return subject.furthest(quantity, way, allowed, "the way in the time that it declares")


def _returns(trace: Trace, subject: Subject) -> Findings:
    kept = subject.kept
    if kept["back"] is None:
        return Findings(
            violations=(f"it did not come back to DISABLED within {BACK:g} s: {kept['state']}",)
        )
    return Findings(
        (
            subject.measured(
                RETURNS,
                exact(kept["back"]),
                Bound(10.0, "the longest pause between two tries, and one try"),
            ),
            subject.furthest(
                RETURN_MOVED,
                _way(subject, "before", "after"),
                MOVED,
                "a brake that settles",
            ),
        ),
        violations=() if kept["state"] == "DISABLED" else (f"it came back {kept['state']}",),
    )


def _killed(bed: Bed) -> None:
    bed.enable()
    home = bed.setpoint
    speed, _ = begin_motion(bed, home)
    at_kill = bed.position
    bed.kill_driver()
    time.sleep(DEAD)
    bed.revive_driver()
    after = bed.position
    bed.keep(
        speed=speed.tolist(), before=at_kill.tolist(), after=after.tolist(), state=str(bed.state)
    )
    bed.enable()
    bed.move_to(home)
    bed.disable()


KILLED: Final = Acquisition(
    "driver_killed",
    "Kills the driver's process in motion, and starts it again.",
    Safety.FAULT_IN_MOTION,
    _killed,
    ("servo_jp", "move_jp", "measured_js"),
    suite=Suite.FULL,
)


def _stops_without_driver(trace: Trace, subject: Subject) -> Findings:
    found = _stops_alone(subject, KILLED_WAY, "after")
    state = subject.kept["state"]
    return Findings((found,), () if state == "DISABLED" else (f"it came back {state}",))


def _frozen(bed: Bed) -> None:
    bed.enable()
    home = bed.setpoint
    speed, _ = begin_motion(bed, home)
    before = bed.position
    with bed.expecting("a frozen driver"):
        with bed.frozen(Process.DRIVER):
            time.sleep(DEAD)
        # What the driver tells at once is what it knew before.
        bed.wait_until(lambda glance: glance.measures, BACK)
        after = bed.position
        bed.rest(0.5)
        later = bed.position
        bed.keep(
            speed=speed.tolist(), before=before.tolist(), after=after.tolist(), later=later.tolist()
        )
        bed.disable()
        bed.enable()
    bed.move_to(home)
    bed.disable()


FROZEN: Final = Acquisition(
    "driver_frozen",
    "Takes all time from the driver's process in motion, for 3 s.",
    Safety.FAULT_IN_MOTION,
    _frozen,
    ("servo_jp", "move_jp", "measured_js"),
    suite=Suite.FULL,
)


def _stops_frozen(trace: Trace, subject: Subject) -> Findings:
    return Findings(
        (
            _stops_alone(subject, FROZEN_WAY, "later"),
            subject.furthest(
                FROZEN_AFTER,
                _way(subject, "after", "later"),
                MOVED,
                "nothing moves because the driver goes on",
            ),
        )
    )


TESTS: Final = (
    BenchTest("T6", "stale is never fresh", "loss", SILENCE, _stale, TOLD.quantities),
    BenchTest("T7", "coming back", "loss", SILENCE, _returns, (RETURNS, RETURN_MOVED)),
    BenchTest(
        "S4", "driver killed", "stop", KILLED, _stops_without_driver, (KILLED_WAY,), of_kept=True
    ),
    BenchTest(
        "S5",
        "driver frozen",
        "stop",
        FROZEN,
        _stops_frozen,
        (FROZEN_WAY, FROZEN_AFTER),
        of_kept=True,
    ),
)
