"""An arm with a marker that a tracker sees: do both tell one motion, and is the arm where it was sent.

Pose accuracy and repeatability are those of ISO 9283 (AP, RP = l + 3 S), with the tracker as the instrument.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from crtk_drivers.errors import CalibrationError
from crtk_drivers.geometry.frames import inverse_pose, product
from crtk_drivers.labs.bench.acquisition import Acquisition, BenchTest, Safety, Subject, Suite
from crtk_drivers.labs.bench.bed import Bed, Broken
from crtk_drivers.labs.bench.calls import TOOLS
from crtk_drivers.labs.bench.postures import around, least_alike, wrist
from crtk_drivers.labs.bench.trace import PoseTrack, Trace
from crtk_drivers.labs.bench.tracking import BEGINS, fresh
from crtk_drivers.labs.calibration import HandEye, hand_eye
from crtk_drivers.labs.calibration.stacks import mean_pose
from crtk_drivers.labs.calibration.stillness import distance
from crtk_drivers.labs.verdicts.estimates import Estimate, deviation, student_t, within
from crtk_drivers.labs.verdicts.judging import Bound, Findings, Measurement, Plot, Quantity
from crtk_drivers.samples import Array, Pose, Vector, vector

PLACES: Final = 14
"""In which pairs of poses are taken."""

FEWEST: Final = 10
"""Of these, in which the marker must be seen."""

TURNS: Final = 0.8
MOVES: Final = 0.2
SLIDES: Final = 0.05
"""rad, rad, m: how far a joint of the wrist, another one, and one that slides go from where they are."""

SETTLE: Final = 0.5
STOOD: Final = 0.4
"""Seconds in each place: before it is looked at, and in which it is."""

LEAST: Final = 5
"""Poses of which a mean is made."""

POSES: Final = 5
CYCLES: Final = 5
MOST_CYCLES: Final = 30
"""Poses of ISO 9283, and how often each is gone to: in the quick suite, and at most."""

MM: Final = 1e3

RESIDUAL = Quantity.at_most(
    "tracking.hand_eye.residual", "marker off where the arm has it, rms", "mm", 0.05
)
TURNED = Quantity.at_most(
    "tracking.hand_eye.turn", "marker turned off where the arm has it, rms", "deg", 0.02
)
ACCURACY = Quantity.told("tracking.pose.accuracy", "pose accuracy AP", "mm", 0.1)
TURN_ACCURACY = Quantity.told("tracking.pose.turn_accuracy", "pose accuracy AP, turn", "deg", 0.05)
REPEATS = Quantity.told("tracking.pose.repeatability", "pose repeatability RP, l + 3 S", "mm", 0.05)
TURN_REPEATS = Quantity.told(
    "tracking.pose.turn_repeatability", "pose repeatability RP, turn, l + 3 S", "deg", 0.05
)


# ---------------------------------------------------------------------------------------- the motion


def _postures(arm: Bed) -> tuple[Array, list[Pose]]:
    """Return postures (k, n) around where it is to which the way is free, and the tool's pose in each.

    In a space that is too narrow there are few or none, which shows when they are judged.

    Raises:
        Broken: it does not know where its tool is.
    """
    far = np.where(arm.slides > 0.5, SLIDES, MOVES)
    far[wrist(arm)] = TURNS
    free, poses = [], []
    for joints in around(arm, vector(far)):
        pose = arm.forward(vector(joints))
        if pose is None:
            raise Broken("the device that carries the marker does not know where its tool is")
        if arm.is_free(vector(joints)):
            free.append(joints)
            poses.append(pose)
    return np.array(free).reshape(-1, far.size), poses


def _go(bed: Bed, joints: Vector, name: str) -> None:
    """Let the arm stand in a place, if the way there from where it is is free, and mark what is seen then."""
    arm = bed.carrier
    if not arm.is_free(joints):
        return
    arm.move_to(joints)
    bed.rest(SETTLE)
    bed.mark(name)
    bed.rest(STOOD)
    bed.mark(f"{name} end")


def _pair(bed: Bed, free: Array, poses: Sequence[Pose]) -> None:
    """Go to places in which the tool is turned as differently as can be."""
    turned = np.array([pose.orientation for pose in poses]).reshape(-1, 4)
    for index in least_alike(np.abs(turned @ turned.T), PLACES):
        _go(bed, vector(free[index]), "place")


def _begin(bed: Bed) -> Vector:
    """Let the tracker track and the arm be enabled; return where its joints (n,) are."""
    bed.enable()
    bed.carrier.enable()
    bed.rest(BEGINS)
    return bed.carrier.setpoint


def _end(bed: Bed, home: Vector) -> None:
    bed.carrier.move_to(home)
    bed.carrier.disable()
    bed.disable()


def _stand(bed: Bed) -> None:
    home = _begin(bed)
    _pair(bed, *_postures(bed.carrier))
    _end(bed, home)


def _cycle(bed: Bed) -> None:
    arm = bed.carrier
    home = _begin(bed)
    free, poses = _postures(arm)
    _pair(bed, free, poses)
    places = np.array([pose.position for pose in poses]).reshape(-1, 3)
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    goals = free[least_alike(1.0 - apart, POSES)]
    sent = [arm.forward(vector(goal)) for goal in goals]
    bed.note(sent=[[*pose.position, *pose.orientation] for pose in sent if pose is not None])
    for _ in range(min(MOST_CYCLES, round(CYCLES * bed.thorough))):
        for number, goal in enumerate(goals):
            _go(bed, vector(goal), f"pose {number}")
    _end(bed, home)


CARRIER_NEEDS: Final = ("move_jp", "measured_js", "measured_cp")

STANDING: Final = Acquisition(
    "standing",
    f"The arm with its marker stands in {PLACES} places, turned differently.",
    Safety.LARGE,
    _stand,
    (TOOLS,),
    suite=Suite.FULL,
    carrier_needs=CARRIER_NEEDS,
    is_marked=True,
)

CYCLING: Final = Acquisition(
    "cycling",
    f"The arm with its marker stands in {PLACES} places, and goes round {POSES} poses again and again.",
    Safety.LARGE,
    _cycle,
    (TOOLS,),
    suite=Suite.FULL,
    carrier_needs=CARRIER_NEEDS,
    is_marked=True,
)


# --------------------------------------------------------------------------------------- what it tells


def _mean(track: PoseTrack, begin: float, end: float) -> Pose | None:
    """Return the mean of what was valid between two times; None if that was too little."""
    at = fresh(track, begin, end)
    if len(at) < LEAST:
        return None
    return mean_pose([Pose(vector(track.position[i]), vector(track.orientation[i])) for i in at])


def _seen(trace: Trace, topic: str, name: str) -> Iterator[Pose | None]:
    """Yield the mean pose in each place of a name, None where it was not seen."""
    track = trace.poses(topic)
    for begin, end in zip(trace.marks(name), trace.marks(f"{name} end"), strict=True):
        yield _mean(track, begin, end)


def _aligned(trace: Trace, marker: str) -> HandEye:
    """Return where tracker and marker are.

    Raises:
        CalibrationError: the marker was seen in too few places, or these tell too little.
    """
    told = _seen(trace, "carrier/measured_cp", "place")
    pairs = list(zip(told, _seen(trace, f"{marker}/measured_cp", "place"), strict=True))
    both = [(arm, seen) for arm, seen in pairs if arm is not None and seen is not None]
    if len(both) < FEWEST:
        raise CalibrationError(
            f"{marker} was seen in {len(both)} of {len(pairs)} places, {FEWEST} are needed"
        )
    arms, seen = zip(*both, strict=True)
    return hand_eye(arms, seen, worst=math.inf, unlike=math.inf)


def _residuals(trace: Trace, subject: Subject) -> Findings:
    found: list[Measurement] = []
    lines = []
    for marker in subject.markers:
        try:
            aligned = _aligned(trace, marker)
        except CalibrationError as error:
            return Findings(doubts=(error.message,))
        count = len(aligned.residuals)
        freedom = 3 * count - 6  # of six numbers each of position and turn, two poses are found
        for quantity, value, bound in (
            (RESIDUAL, MM * aligned.residual, 1.0),
            (TURNED, math.degrees(aligned.turned), 0.3),
        ):
            estimate = deviation(value, freedom, count)
            found.append(subject.measured(quantity, estimate, Bound(bound, "default"), part=marker))
        lines.append((marker, range(1, count + 1), MM * aligned.residuals[:, 0]))
    plots = (Plot.of("Marker off where the arm has it", "place", "mm", *lines),)
    return Findings(tuple(found), plots=plots)


@dataclass(frozen=True, eq=False)
class _Arrived:
    """How an arm came to one pose.

    Attributes:
        off: of the mean from where it was sent: m, rad.
        away: (n, 2) of each from the mean: m, rad.
    """

    off: tuple[float, float]
    away: Array


def _arrived(sent: Pose, found: Sequence[Pose]) -> _Arrived:
    middle = mean_pose(found)
    return _Arrived(distance(sent, middle), np.array([distance(middle, pose) for pose in found]))


def _repeatability(away: Vector) -> Estimate:
    """Return l + 3 S of distances from the mean (ISO 9283)."""
    n, spread = away.size, float(away.std(ddof=1))
    doubt = student_t(n - 1) * spread / math.sqrt(n) + 3.0 * (
        deviation(spread, n - 1, n).upper - spread
    )
    return within(float(away.mean()) + 3.0 * spread, doubt, n)


def _accuracy(off: float, away: Vector, aligned: float) -> Estimate:
    """Return how far the mean is from where it was sent, with the doubts of mean and alignment."""
    rms = float(np.sqrt(np.mean(away**2)))
    doubt = student_t(away.size - 1) * rms / math.sqrt(away.size) + aligned
    return Estimate(off, max(0.0, off - doubt), off + doubt, away.size)


def _iso(trace: Trace, subject: Subject) -> Findings:
    found: list[Measurement] = []
    for marker in subject.markers:
        try:
            aligned = _aligned(trace, marker)
        except CalibrationError as error:
            return Findings(doubts=(error.message,))
        tool = inverse_pose(aligned.marker)
        arrived = []
        for number, numbers in enumerate(trace.notes["sent"]):
            sent = Pose(vector(numbers[:3]), vector(numbers[3:]))
            seen = _seen(trace, f"{marker}/measured_cp", f"pose {number}")
            came = [
                product(aligned.tracker, product(pose, tool)) for pose in seen if pose is not None
            ]
            if len(came) > 1:
                arrived.append((f"{marker}, pose {number + 1}", _arrived(sent, came)))
        if len(arrived) < POSES:
            return Findings(doubts=(f"{marker} was seen in {len(arrived)} of {POSES} poses",))
        share = 2.0 / math.sqrt(len(aligned.residuals))
        for column, unit, rest, accuracy, repeats in (
            (0, MM, aligned.residual, ACCURACY, REPEATS),
            (1, math.degrees(1.0), aligned.turned, TURN_ACCURACY, TURN_REPEATS),
        ):
            offs = [
                (
                    name,
                    _accuracy(
                        unit * its.off[column], unit * its.away[:, column], unit * share * rest
                    ),
                )
                for name, its in arrived
            ]
            spreads = [(name, _repeatability(unit * its.away[:, column])) for name, its in arrived]
            for quantity, each in ((accuracy, offs), (repeats, spreads)):
                name, worst = max(each, key=lambda named: named[1].value)
                found.append(subject.measured(quantity, worst, part=name))
    return Findings(tuple(found))


TESTS: Final = (
    BenchTest("K4", "hand-eye", "tracking", STANDING, _residuals, (RESIDUAL, TURNED)),
    BenchTest(
        "M9",
        "pose accuracy and repeatability",
        "tracking",
        CYCLING,
        _iso,
        (ACCURACY, REPEATS, TURN_ACCURACY, TURN_REPEATS),
    ),
)
