"""A force sensor by itself: does a bias hold, is it doubted after a power cut, is a saturation told."""

from __future__ import annotations

import time
from typing import Final

import numpy as np

from crtk_drivers.device import Severity
from crtk_drivers.labs.bench.acquisition import Acquisition, BenchTest, Safety, Subject, Suite
from crtk_drivers.labs.bench.bed import Bed
from crtk_drivers.labs.bench.signals import noise, resolution
from crtk_drivers.labs.bench.silence import BACK, BUSY, LOOK
from crtk_drivers.labs.bench.trace import Trace
from crtk_drivers.labs.verdicts.estimates import Estimate, exact, student_t
from crtk_drivers.labs.verdicts.judging import Bound, Findings, Quantity
from crtk_drivers.samples import Wrench, vector
from crtk_drivers.state import OperatingState

HELD: Final = 1.0
"""Seconds for which a bias must hold, in the quick suite."""

PIECE: Final = 0.1
"""Seconds of one mean: how these scatter says how well a bias can be."""

SURE: Final = 5.0
"""Times that scatter that a bias may leave."""

LEAST: Final = np.repeat((1e-3, 1e-4), 3)
"""N and N·m: what is less is nothing."""

OFF: Final = 1.0
"""Seconds that the sensor is without power."""

AFTER: Final = 0.5
"""Seconds for which it is looked at then."""

OVERLOAD: Final = 1e6
"""N: beyond any sensor."""

TOLD_WITHIN: Final = 0.5
WAITED: Final = 2.0
"""Seconds in which a saturation is to be told, and that are waited for it."""

STAYS: Final = 0.2
"""Seconds that it is told for."""

LEFT = Quantity.at_most("force.bias.left", "what a bias leaves", "N or N·m", 0.01)
TRUSTED = Quantity.at_most("force.power.trusted", "valid data without a doubt of the bias", "")
TOLD = Quantity.at_most("force.saturation.told", "until saturation is told", "s", 0.05)


# ------------------------------------------------------------------------------------------------ bias


def _bias(bed: Bed) -> None:
    bed.rest(0.3)
    bed.note(answer=bed.service("bias"))
    bed.mark("biased")
    bed.rest(HELD * bed.thorough)
    bed.mark("end")


BIAS: Final = Acquisition(
    "bias",
    "Asks for a bias, and leaves it until the end of the run.",
    Safety.ENABLE,
    _bias,
    ("measured_cf", "bias"),
)


def _holds(trace: Trace, subject: Subject) -> Findings:
    track = trace.vectors("measured_cf").between(trace.mark("biased"), trace.mark("end"))
    values = track.values[np.isfinite(track.stamp)]
    size = max(1, round(PIECE * subject.rate))
    count = len(values) // size
    if count < 5:
        return Findings(doubts=(f"{len(values)} valid samples after the bias",))
    pieces = values[: count * size].reshape(count, size, 6).mean(axis=1)
    scatter = np.maximum(noise(pieces), 0.5 * resolution(values) / np.sqrt(size))
    allowed = np.maximum(SURE * scatter, LEAST)
    left = np.abs(pieces.mean(axis=0))
    worst = int(np.argmax(left / allowed))
    half = student_t(count - 1) * float(pieces[:, worst].std(ddof=1)) / np.sqrt(count)
    value = float(left[worst])
    return Findings(
        (
            subject.measured(
                LEFT,
                Estimate(value, max(0.0, value - half), value + half, count),
                Bound(float(allowed[worst]), "five times the scatter of 0.1 s, or 1 mN, 0.1 mN·m"),
                part=("fx", "fy", "fz", "tx", "ty", "tz")[worst],
            ),
        ),
        doubts=subject.gaps(track.stamp),
    )


# ------------------------------------------------------------------------------------------ power cycle


def _doubts_bias(bed: Bed) -> bool:
    return any(note.key == "bias" and note.severity > Severity.INFO for note in bed.notes)


def _power(bed: Bed) -> None:
    looks = []
    with bed.expecting("a sensor without power"):
        bed.inject("reboot", seconds=OFF)
        begin = time.monotonic()
        back = None
        while (now := time.monotonic() - begin) < (BACK if back is None else back + AFTER):
            _, stamp = bed.glance().values["measured_cf"]
            looks.append((now, stamp.wall_ns, _doubts_bias(bed)))
            if back is None and now > OFF and stamp.wall_ns:
                back = now
            time.sleep(LOOK)
    bed.keep(looks=looks, back=back)


POWER: Final = Acquisition(
    "power",
    "Takes its power away from the simulated sensor for 1 s.",
    Safety.FAULT,
    _power,
    ("measured_cf", "bias"),
    suite=Suite.FULL,
)


def _doubted(trace: Trace, subject: Subject) -> Findings:
    looks, back = subject.kept["looks"], subject.kept["back"]
    if back is None:
        return Findings(violations=(f"it did not measure again within {BACK:g} s",))
    if all(stamp for _, stamp, _ in looks):
        return Findings(doubts=("its data were valid all the time: had it no power?",))
    trusted = sum(bool(stamp) and not doubted for at, stamp, doubted in looks if at >= back)
    bound = Bound(0.0, "a bias is unknown after the sensor was off, and that is told")
    return Findings((subject.measured(TRUSTED, exact(trusted, len(looks)), bound),))


# ------------------------------------------------------------------------------------------- saturation


def _tells(bed: Bed) -> str:
    """Return how a device tells that it cannot measure what acts on it; empty if it does not."""
    glance = bed.glance()
    _, stamp = glance.values["measured_cf"]
    if glance.status.state is OperatingState.FAULT:
        return f"FAULT: {glance.status.cause}"
    if not stamp.wall_ns:
        return "its data are invalid"
    return "; ".join(note.text for note in bed.notes if note.severity is Severity.ERROR)


def _saturate(bed: Bed) -> None:
    before = _tells(bed)
    told, after = "", None
    with bed.expecting("a saturated sensor"):
        begin = time.monotonic()
        bed.load(Wrench(vector((0.0, 0.0, OVERLOAD)), vector((0.0, 0.0, 0.0))))
        while not told and time.monotonic() < begin + WAITED:
            time.sleep(LOOK)
            first, after = _tells(bed), time.monotonic() - begin
            if first:  # a sample that is late is no saturation
                bed.rest(STAYS)
                told = first if _tells(bed) else ""
        bed.load(Wrench(vector((0.0, 0.0, 0.0)), vector((0.0, 0.0, 0.0))))
        quiet = bed.wait_until(lambda _: not _tells(bed), BACK)
    bed.keep(before=before, told=told, after=after, quiet=quiet)


SATURATION: Final = Acquisition(
    "saturation",
    "Loads the simulated sensor beyond its range.",
    Safety.FAULT,
    _saturate,
    ("measured_cf",),
    suite=Suite.FULL,
    loads=True,
)


def _told(trace: Trace, subject: Subject) -> Findings:
    kept = subject.kept
    if kept["before"]:
        return Findings(doubts=(f"it told an error before: {kept['before']}",))
    if not kept["told"]:
        return Findings(violations=(f"it did not tell within {WAITED:g} s that it is saturated",))
    found = subject.measured(
        TOLD,
        Estimate(kept["after"], max(0.0, kept["after"] - 2.0 * LOOK), kept["after"], 1),
        Bound(TOLD_WITHIN, "default"),
        why=kept["told"],
    )
    wrong = () if kept["quiet"] else (f"it tells it {BACK:g} s after the load was gone",)
    return Findings((found,), wrong, subject.too_busy(BUSY))


TESTS: Final = (
    BenchTest("F2", "bias", "force", BIAS, _holds, (LEFT,)),
    BenchTest("F3", "saturation", "force", SATURATION, _told, (TOLD,), of_kept=True),
    BenchTest("F6", "bias after a power cut", "force", POWER, _doubted, (TRUSTED,), of_kept=True),
)
