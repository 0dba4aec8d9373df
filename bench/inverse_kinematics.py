"""Inverse kinematics of a UR5e: success and time, ours and that of libraries from PyPI.

Poses are those of random joint positions within half a turn; the same ones, in the same order and turn
about, for every solver. An answer counts when the closed form says that it reaches the pose to 1e-9 m
and rad within the joint limits. "Far" starts from a random joint position, "stream" 0.01 rad away.

The rivals are left out where they are not installed. To measure them, in an environment of their own:

    python3 -m venv rivals && rivals/bin/pip install '.[kinematics]' ikpy roboticstoolbox-python
    rivals/bin/python -m bench.inverse_kinematics
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from bench.report import options, show
from crtk_driver_ur.kinematics import ArmKinematics
from crtk_driver_ur.models import MODELS
from crtk_drivers.errors import KinematicsError
from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from crtk_drivers.kinematics.chain import DHJoint, chain_from_dh
from crtk_drivers.kinematics.serial import SerialChain
from crtk_drivers.samples import Array, Pose, Vector

ACCURACY = 1e-9
STREAM_STEP = 0.01
"""Joint distance from the reference to the goal of the stream, in rad."""

MODEL = MODELS["ur5e"]
A = (0.0, MODEL.a2, MODEL.a3, 0.0, 0.0, 0.0)
ALPHA = (math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0)
D = (MODEL.d1, 0.0, 0.0, MODEL.d4, MODEL.d5, MODEL.d6)
LIMIT = 2 * math.pi

Solve = Callable[[Pose, Vector], Vector | None]


@dataclass
class Solver:
    """One way to solve; `share` is the part of the poses that it is given, as slow ones take minutes."""

    name: str
    solve: Solve
    share: float = 1.0
    seconds: list[float] = field(default_factory=list)
    reached: int = 0


def ours(restarts: int | None) -> Solve:
    """`SerialChain` from the DH table."""
    rows = zip(A, ALPHA, D, strict=True)
    arm = SerialChain(
        chain_from_dh(
            DHJoint(str(i), a, alpha, d, lower=-LIMIT, upper=LIMIT)
            for i, (a, alpha, d) in enumerate(rows)
        )
    )

    def solve(pose: Pose, reference: Vector) -> Vector | None:
        try:
            return arm.inverse(pose, reference, restarts=restarts)
        except KinematicsError:
            return None

    return solve


def closed_form() -> Solve:
    """The UR driver's own."""
    arm = ArmKinematics(MODEL)

    def solve(pose: Pose, reference: Vector) -> Vector | None:
        try:
            return arm.inverse(pose, reference)
        except KinematicsError:
            return None

    return solve


def roboticstoolbox() -> Solve:
    """Levenberg-Marquardt in C++ with 100 restarts; its own settings but for the tolerance."""
    import roboticstoolbox as rtb

    rows = zip(A, ALPHA, D, strict=True)
    links = [rtb.RevoluteDH(a=a, alpha=t, d=d, qlim=(-LIMIT, LIMIT)) for a, t, d in rows]
    ets = rtb.DHRobot(links).ets()

    def solve(pose: Pose, reference: Vector) -> Vector | None:
        found = ets.ik_LM(matrix(pose), q0=reference, tol=1e-19)
        return np.asarray(found.q) if found.success else None

    return solve


def ikpy() -> Solve:
    """Bounded least squares of scipy, with its own settings but for the tolerance."""
    from ikpy.chain import Chain
    from ikpy.link import DHLink, OriginLink

    rows = zip(A, ALPHA, D, strict=True)
    links = [
        DHLink(name=str(i), d=d, a=a, alpha=alpha, bounds=(-LIMIT, LIMIT))
        for i, (a, alpha, d) in enumerate(rows)
    ]
    chain = Chain([OriginLink(), *links], active_links_mask=[False] + [True] * 6)

    def solve(pose: Pose, reference: Vector) -> Vector | None:
        start = np.concatenate(((0.0,), reference))
        found = chain.inverse_kinematics_frame(
            matrix(pose), initial_position=start, orientation_mode="all", tol=1e-15
        )
        return np.asarray(found[1:])

    return solve


def matrix(pose: Pose) -> Array:
    """Return a pose as a homogeneous matrix (4, 4)."""
    result = np.eye(4)
    result[:3, :3] = matrix_from_quaternion(pose.orientation)
    result[:3, 3] = pose.position
    return result


def solvers() -> Iterator[Solver]:
    """Yield what is installed."""
    yield Solver("crtk_drivers, closed form (UR only)", closed_form())
    yield Solver("crtk_drivers, SerialChain", ours(None))
    yield Solver("crtk_drivers, SerialChain, restarts=0", ours(0))
    for name, make, share in (
        ("roboticstoolbox, ik_LM (C++)", roboticstoolbox, 1.0),
        ("ikpy", ikpy, 0.02),
    ):
        try:
            yield Solver(name, make(), share)
        except ImportError:
            print(f"left out, not installed: {name}")


def reaches(joints: Vector | None, pose: Pose) -> bool:
    """Say whether `joints` are within the limits and reach `pose`, by the closed form."""
    if joints is None or not (np.abs(joints) <= LIMIT).all():
        return False
    found = ArmKinematics(MODEL).place(joints.tolist())
    rotation, target = np.reshape(found[:9], (3, 3)), matrix(pose)
    # the angle of a small rotation is the length of its skew part
    skew = rotation @ target[:3, :3].T
    turned = math.hypot(skew[2, 1] - skew[1, 2], skew[0, 2] - skew[2, 0], skew[1, 0] - skew[0, 1])
    is_turned = turned / 2.0 >= ACCURACY or np.trace(skew) < 0.0
    return math.dist(found.position, pose.position) < ACCURACY and not is_turned


def measure(poses: int, *, far: bool) -> list[Solver]:
    """Give every solver its poses, turn about."""
    arm = ArmKinematics(MODEL)
    random = np.random.default_rng(7)
    measured = list(solvers())
    for i in range(poses):
        goal = random.uniform(-math.pi, math.pi, 6)
        away = random.uniform(-math.pi, math.pi, 6)
        reference = away if far else goal + STREAM_STEP * np.sign(away)
        pose = arm.forward(goal)
        for solver in measured:
            if i >= poses * solver.share:
                continue
            begin = time.perf_counter()
            found = solver.solve(pose, reference)
            solver.seconds.append(time.perf_counter() - begin)
            solver.reached += reaches(found, pose)
    return measured


def main() -> None:
    """Measure and print."""
    given = options(__doc__ or "", poses=(10_000, "that each solver is given, the slow ones fewer"))
    for title, far in (("Far", True), ("Stream", False)):
        rows = []
        for solver in measure(given.poses, far=far):
            micro = np.array(solver.seconds) * 1e6
            times = (micro.mean(), *np.percentile(micro, (50, 99)))
            rows.append(
                [
                    solver.name,
                    f"{micro.size}",
                    f"{100.0 * solver.reached / micro.size:.2f}",
                    *(f"{value:.0f}" for value in times),
                ]
            )
        show(title, ["", "poses", "reached %", "mean µs", "p50 µs", "p99 µs"], rows)


if __name__ == "__main__":
    main()
