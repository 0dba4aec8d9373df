"""A force sensor on an arm: what hangs on it, weighed in several orientations, and where down is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from crtk_drivers.geometry.quaternions import unit
from crtk_drivers.labs.bench.acquisition import Acquisition, BenchTest, Safety, Subject, Suite
from crtk_drivers.labs.bench.bed import Bed
from crtk_drivers.labs.bench.postures import around, least_alike, wrist
from crtk_drivers.labs.bench.signals import noise
from crtk_drivers.labs.bench.trace import Trace
from crtk_drivers.labs.carried import GRAVITY, UNKNOWN
from crtk_drivers.labs.verdicts.estimates import Estimate, exact, mean, student_t, within
from crtk_drivers.labs.verdicts.judging import (
    Bound,
    Findings,
    Measurement,
    Plot,
    Quantity,
)
from crtk_drivers.samples import Array, Vector, vector

POSES: Final = 8
"""Orientations; of fewer than `FEWEST` nothing is said."""

FEWEST: Final = 6

FAR: Final = 1.5
"""rad: how far a joint goes at most from where it is."""

SETTLE: Final = 0.5
WEIGHED: Final = 0.6
"""Seconds in each orientation, in the quick suite."""

MASS_SHARE: Final = 0.02
"""Of the mass that is known, and of the weight that a residual may be."""

CENTER: Final = 5e-3
"""m: how far the centre of mass may be from where it is known to be."""

ANGLE: Final = 2.0
"""deg between where gravity is measured and where the arm says that it is."""

LEAST_SPREAD: Final = 0.15
"""Of the directions of gravity along each axis (at most 0.58): of less no frame is found."""

FELT: Final = 20.0
"""Times the noise of a mean that a weight must be, to say of where it hangs and pulls."""

LEAST_FORCE: Final = 0.05
"""N: a weight, or a residual, that is smaller is none."""

MASS = Quantity.within("force.weight.mass", "mass of the tool", "kg", 2e-3)
CENTER_OFF = Quantity.at_most(
    "force.weight.center", "centre of mass from where it is known", "mm", 0.5
)
RESIDUAL = Quantity.at_most("force.weight.residual", "what no weight explains (rms)", "N", 0.02)
FRAME = Quantity.at_most("force.frame.angle", "gravity of sensor from that of the arm", "deg", 0.2)


# ----------------------------------------------------------------------------------------- the motion


def _down(arm: Bed, joints: Vector) -> Vector | None:
    """Return the direction of gravity (3,) in the axes of the tool at a posture."""
    pose = arm.forward(joints)
    return None if pose is None else UNKNOWN.down(pose.orientation)


def _postures(arm: Bed) -> Iterator[Vector]:
    """Yield postures (n,) in which gravity pulls as differently as can be."""
    far = np.zeros(arm.slides.size)
    far[wrist(arm)] = FAR
    candidates = around(arm, vector(far))
    downs = [_down(arm, vector(each)) for each in candidates]
    pulls = np.array([np.zeros(3) if down is None else down for down in downs])
    for index in least_alike(pulls @ pulls.T, POSES):
        yield vector(candidates[index])


def _weigh(bed: Bed) -> None:
    arm = bed.carrier
    arm.enable()
    home = arm.setpoint
    for goal in _postures(arm):
        if not arm.is_free(goal):
            continue
        arm.move_to(goal)
        bed.rest(SETTLE)
        bed.mark("weigh")
        bed.rest(WEIGHED * bed.thorough)
        bed.mark("weighed")
    arm.move_to(home)
    arm.disable()


WEIGHING: Final = Acquisition(
    "weighing",
    "The arm that carries it turns it into eight orientations.",
    Safety.LARGE,
    _weigh,
    ("measured_cf",),
    suite=Suite.FULL,
    carrier_needs=("move_jp", "measured_js", "measured_cp"),
)


# --------------------------------------------------------------------------------------- what it tells


@dataclass(frozen=True, eq=False)
class _Weighed:
    """Means in each orientation.

    Attributes:
        wrench: (n, 6) in the sensor's frame, with the bias that it has.
        down: (n, 3) direction of gravity in the sensor's frame, as arm and mounting say.
        sigma: (6,) noise of one sample.
        doubt: (6,) noise of a mean.
    """

    wrench: Array
    down: Array
    sigma: Vector
    doubt: Vector


def _weighed(trace: Trace, subject: Subject) -> _Weighed:
    """Return the means.

    Raises:
        LookupError: there are none.
    """
    # As the sensor gives it: what the driver takes off may be wrong, and is no matter of this.
    topic = "raw/measured_cf" if "raw/measured_cf" in trace.rows else "measured_cf"
    wrenches, poses = trace.vectors(topic), trace.poses("carrier/measured_cp")
    means, downs, sigmas, sizes = [], [], [], []
    for begin, end in zip(trace.marks("weigh"), trace.marks("weighed"), strict=False):
        within = wrenches.between(begin, end)
        values = within.values[np.isfinite(within.stamp)]
        when = (poses.at >= begin) & (poses.at <= end) & np.isfinite(poses.stamp)
        if len(values) < 10 or not when.any():
            continue
        means.append(values.mean(axis=0))
        sigmas.append(noise(values))
        sizes.append(len(values))
        arm = unit(vector(poses.orientation[when].mean(axis=0)))
        downs.append(subject.carried.down(arm))
    if not means:
        raise LookupError("wrenches and poses while it was weighed")
    sigma = vector(np.sqrt(np.mean(np.square(sigmas), axis=0)))
    return _Weighed(np.array(means), np.array(downs), sigma, vector(sigma / np.sqrt(min(sizes))))


def _too_few(found: _Weighed) -> tuple[str, ...]:
    if len(found.wrench) < FEWEST:
        return (f"{len(found.wrench)} orientations, {FEWEST} are needed: its space is too narrow",)
    spread = _spread(found.down)
    if spread < LEAST_SPREAD:
        return (
            f"gravity pulled too much alike in all orientations (spread {spread:.2f}, needed "
            f"{LEAST_SPREAD:g}): its space is too narrow",
        )
    return ()


def _spread(downs: Array) -> float:
    centred = downs - downs.mean(axis=0)
    return float(np.linalg.svd(centred / np.sqrt(len(downs)), compute_uv=False)[-1])


def _solved(matrix: Array, right: Vector) -> tuple[Vector, Array]:
    """Return the solution by least squares and the half widths of its 95 % intervals."""
    solution = np.linalg.lstsq(matrix, right, rcond=None)[0]
    left = right - matrix @ solution
    freedom = max(1, right.size - solution.size)
    variance = np.diag(np.linalg.pinv(matrix.T @ matrix)) * float(left @ left) / freedom
    return vector(solution), student_t(freedom) * np.sqrt(np.clip(variance, 0.0, None))


def _crossed(force: Vector) -> Array:
    """Return the matrix (3, 3) that makes v × force of a v."""
    x, y, z = force.tolist()
    return np.array(((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0)))


def _weight(trace: Trace, subject: Subject) -> Findings:
    found = _weighed(trace, subject)
    doubts = _too_few(found)
    if doubts:
        return Findings(doubts=doubts)
    known, count = subject.carried, len(found.wrench)
    pulls = GRAVITY * found.down
    identity = np.tile(np.eye(3), (count, 1))
    forces = found.wrench[:, :3].reshape(-1)
    solution, halves = _solved(np.column_stack((pulls.reshape(-1), identity)), vector(forces))
    mass, weight = float(solution[0]), GRAVITY * abs(float(solution[0]))
    left = (found.wrench[:, :3] - mass * pulls - solution[1:]).reshape(-1, 3)
    residual = float(np.sqrt((left**2).sum(axis=1).mean()))
    allowed = max(3.0 * float(found.sigma[:3].max()), MASS_SHARE * weight, LEAST_FORCE)
    room = MASS_SHARE * known.mass
    bound = Bound(known.mass + room, "the tool of the lab file, 2 %", known.mass - room)
    return Findings(
        (
            subject.measured(
                MASS, within(mass, float(halves[0]), count), bound if known.mass else None
            ),
            *_center(found, subject, mass),
            subject.measured(
                RESIDUAL,
                exact(residual, count),
                Bound(allowed, "three times the noise, 2 % of the weight, or 0.05 N"),
            ),
        ),
        plots=(
            Plot.of(
                "What no weight explains, in each orientation",
                "orientation",
                "N",
                *((axis, range(1, count + 1), left[:, index]) for index, axis in enumerate("xyz")),
            ),
        ),
    )


def _center(found: _Weighed, subject: Subject, mass: float) -> tuple[Measurement, ...]:
    """Return how far the centre of mass is from where the lab file says; nothing if it does not."""
    known = subject.carried
    if not known.mass:
        return ()
    bound = Bound(1e3 * CENTER, "default")
    if not _is_felt(found, GRAVITY * abs(mass)):
        return (subject.measured(CENTER_OFF, None, bound, why="no weight is felt"),)
    count = len(found.wrench)
    pulls = mass * GRAVITY * found.down
    matrix = np.hstack(
        (np.vstack([_crossed(vector(pull)) for pull in pulls]), np.tile(np.eye(3), (count, 1)))
    )
    center, halves = _solved(matrix, vector(found.wrench[:, 3:].reshape(-1)))
    away = 1e3 * float(np.linalg.norm(center[:3] - np.array(known.center_of_mass)))
    doubt = 1e3 * float(np.linalg.norm(halves[:3]))
    estimate = Estimate(away, max(0.0, away - doubt), away + doubt, count)
    return (subject.measured(CENTER_OFF, estimate, bound),)


def _is_felt(found: _Weighed, weight: float) -> bool:
    return weight > max(FELT * float(found.doubt[:3].max()), LEAST_FORCE)


def _frame(trace: Trace, subject: Subject) -> Findings:
    found = _weighed(trace, subject)
    doubts = _too_few(found)
    if doubts:
        return Findings(doubts=doubts)
    # Whatever the axes are: forces are linear in the direction of gravity, beside the bias.
    matrix = np.column_stack((found.down, np.ones(len(found.down))))
    solution, *_ = np.linalg.lstsq(matrix, found.wrench[:, :3], rcond=None)
    pulls = found.wrench[:, :3] - solution[3]
    weights = np.linalg.norm(pulls, axis=1)
    if not _is_felt(found, float(weights.min())):
        return Findings(
            doubts=(f"a weight of {weights.mean():.3f} N is too little to tell where down is",)
        )
    cosines = np.einsum("ni,ni->n", pulls, found.down) / weights
    angles = np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))
    middle = mean(angles)
    estimate = Estimate(middle.value, max(0.0, middle.lower), middle.upper, middle.n)
    bound = Bound(ANGLE, "default; wrong axes are 90 deg off")
    return Findings((subject.measured(FRAME, estimate, bound),))


TESTS: Final = (
    BenchTest("F4", "weight of the tool", "force", WEIGHING, _weight, (MASS, CENTER_OFF, RESIDUAL)),
    BenchTest("F5", "frame of forces", "force", WEIGHING, _frame, (FRAME,)),
)
