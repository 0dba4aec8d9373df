"""Kinematics of any serial arm: forward, inverse and Jacobian, on pinocchio.

    chain = read_urdf("arm.urdf", base="base_link", tip="tool0")  # or chain_from_dh(table)
    arm = SerialChain(chain, tool=Pose(vector((0, 0, 0.1)), vector((0, 0, 0, 1))))

pinocchio (the ``kinematics`` extra) is imported when the first `SerialChain` is made, not before.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from enum import StrEnum
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from crtk_drivers.device import Kinematics
from crtk_drivers.errors import ConfigError, KinematicsError, MissingExtra
from crtk_drivers.geometry.quaternions import QUATERNION_TOLERANCE
from crtk_drivers.kinematics.chain import Chain, JointKind
from crtk_drivers.samples import Array, Pose, Vector, frozen

__all__ = ["IkFailure", "InverseKinematicsError", "SerialChain"]

TOLERANCE: Final = 1e-9
"""A pose is reached when both position (m) and rotation vector (rad) are nearer than this."""
CONVERGED: Final = 1e-10
"""A descent ends at this distance, in m and rad."""
MAX_STEPS: Final = 100
"""Most steps of one descent."""
MAX_STEP: Final = 1.0
"""Largest change of a joint in one step, in rad or m: keeps a descent on the branch of its start."""
DAMPING: Final = 0.03
"""Damping per squared error (Sugihara 2011): strong far from the goal, gone at it."""
LEAST_DAMPING: Final = 1e-12
"""Keeps the normal equations solvable at a singularity."""
PATIENCE: Final = 8
"""Steps without progress after which a descent ends."""
PROGRESS: Final = 0.9
"""What counts as progress: the squared error falls below this part of the least so far."""
NEAR: Final = 0.1
"""A reference this near, in rad or m, is followed by Newton's method alone; it is where streams are."""
NEWTON_STEPS: Final = 4
"""Most of these steps."""
ENOUGH_ATTEMPTS: Final = 10
"""After fewer attempts that ended short, a pose is not yet called out of reach."""
EDGE: Final = 1e-10
"""How far rounding may put a joint beyond its limit, in rad or m; it is then put on the limit."""
TURN: Final = 2.0 * math.pi
SEED: Final = 20260101
"""Of the random starts: the same question has the same answer, in every thread and process."""


class IkFailure(StrEnum):
    """Why no joint position was found."""

    OUT_OF_REACH = "out_of_reach"
    """Further away than the links are long, or every descent ended short of the pose."""
    JOINT_LIMITS = "joint_limits"
    """Joint positions that reach it exist, beyond the limits; none was found within."""
    NOT_CONVERGED = "not_converged"
    """Given up for time or steps, mostly at a singularity; it may be reachable."""


class InverseKinematicsError(KinematicsError):
    """A pose without joint position; `reason` says why, for programs."""

    def __init__(self, reason: IkFailure, message: str, *, where: str, remedy: str) -> None:
        super().__init__(message, where=where, remedy=remedy)
        self.reason = reason


class _End(StrEnum):
    CONVERGED = "converged"
    STALLED = "stalled"
    STEPS = "ran out of steps"


class _Descent(NamedTuple):
    """Where a descent ended: joint position in chain order, distance in m and in rad."""

    end: _End
    joints: Vector
    position_error: float
    rotation_error: float


class _Bounds(NamedTuple):
    """A range for each joint, in chain order; `any` if one of them is finite."""

    lower: Vector
    upper: Vector
    any: bool

    @classmethod
    def of(cls, lower: Vector, upper: Vector) -> _Bounds:
        """Return the bounds with their summary."""
        return cls(lower, upper, bool(np.isfinite((lower, upper)).any()))

    def clip(self, joints: Vector) -> Vector:
        """Return `joints` within the bounds."""
        if not self.any:
            return joints
        return np.minimum(np.maximum(joints, self.lower), self.upper)


class _Workspace(threading.local):
    """pinocchio's buffers, one set for each thread that asks."""

    def __init__(self, model: Any) -> None:
        self.data = model.createData()


class SerialChain(Kinematics):
    """A serial arm with a base placement and a tool.

    Arms with more than six axes take the solution that changes their joints least from the reference.
    Arms with fewer reach only some poses exactly, and only those are solved; with `position_only` the
    orientation is left to the arm.

    Args:
        chain: the geometry and the joint limits.
        base: placement of the chain's base in the frame that poses are given in.
        tool: placement of the tool point in the chain's tip.
        frame_id: of the poses that `forward` returns.
        name: of the arm, for errors.
        position_only: `inverse` reaches the position and takes any orientation.
        restarts: most further attempts of `inverse`, from random joint positions.
        time_limit: of `inverse`, in s; looked at between attempts, each of which takes milliseconds.

    Raises:
        MissingExtra: pinocchio is not installed.
        ConfigError: a base or tool that is no pose, or bounds that are not above zero.

    Attributes:
        joints: names, in the order of every joint vector.
        lower, upper: limits (n,) in rad or m, infinite where there is none.
    """

    def __init__(
        self,
        chain: Chain,
        *,
        base: Pose | None = None,
        tool: Pose | None = None,
        frame_id: str = "base",
        name: str = "",
        position_only: bool = False,
        restarts: int = 30,
        time_limit: float = 0.5,
    ) -> None:
        if restarts < 0 or not time_limit > 0.0:
            raise ConfigError(
                f"restarts {restarts}, time limit {time_limit}",
                remedy="Restarts are counted from 0, and the time limit is above 0 s.",
            )
        pin, self._algebra = _libraries()
        self._pin = pin
        self.joints = chain.names
        self.frame_id = frame_id
        self._name = name
        self._position_only = position_only
        self._restarts = restarts
        self._time_limit = time_limit
        # Joint i of the chain is at place self._order[i] of a joint vector.
        self._order = np.array([chain.names.index(joint.name) for joint in chain.joints])
        lower = np.array([joint.lower for joint in chain.joints], dtype=np.float64)
        upper = np.array([joint.upper for joint in chain.joints], dtype=np.float64)
        turns = np.array([joint.kind is JointKind.REVOLUTE for joint in chain.joints])
        self._turning = np.flatnonzero(turns).tolist()
        self._limits = _Bounds.of(lower, upper)
        self._ranges = list(zip(lower.tolist(), upper.tolist(), strict=True))
        self._free = _Bounds.of(np.full_like(lower, -np.inf), np.full_like(upper, np.inf))
        self.lower, self.upper = self._to_vector(lower), self._to_vector(upper)
        self._model, self._frame = _build(
            pin, chain, _placement(pin, "base", base), _placement(pin, "tool", tool)
        )
        self._shoulder = np.array(self._model.jointPlacements[1].translation)
        tool_length = 0.0 if tool is None else float(np.linalg.norm(tool.position))
        self._reach = chain.reach + tool_length
        # Distances are weighed by the size of the arm, so that a small arm does not neglect them.
        self._length_weight = 1.0 / ((chain.links_length + tool_length) or 1.0)
        self._solvable = LEAST_DAMPING * np.eye(6)
        self._workspace = _Workspace(self._model)

    @override
    def forward(self, joints: Vector) -> Pose:
        """Return the pose of the tool point for joint positions (n,), limits or not.

        Raises:
            ValueError: not n finite numbers.
        """
        place = self._place(self._workspace.data, self._to_chain(joints))
        pose = frozen(self._pin.SE3ToXYZQUAT(place))
        return Pose(pose[:3], pose[3:], self.frame_id)

    @override
    def jacobian(self, joints: Vector) -> Array:
        """Return the geometric Jacobian (6, n) at the tool point, in base axes, linear rows first.

        Raises:
            ValueError: not n finite numbers.
        """
        pin = self._pin
        columns = pin.computeFrameJacobian(
            self._model,
            self._workspace.data,
            self._to_chain(joints),
            self._frame,
            pin.LOCAL_WORLD_ALIGNED,
        )
        jacobian: Array = np.empty((6, len(self.joints)))
        jacobian[:, self._order] = columns
        return jacobian

    @override
    def inverse(self, pose: Pose, reference: Vector, *, restarts: int | None = None) -> Vector:
        """Return a joint position (n,) within the limits that takes the tool point to `pose`.

        Newton's method where `reference` is near; else Levenberg-Marquardt from there, and from random
        positions about it, further out each time, if that fails. A descent from the reference follows a
        moving pose on its branch; after a restart the branch may be another, so who streams setpoints
        takes `nearby_inverse`. Whole turns of revolute joints are chosen to be nearest to the reference.

        Args:
            pose: in the base frame, with a unit quaternion.
            reference: joint position (n,) to start from, usually the latest setpoint.
            restarts: instead of that of the constructor; 0: as `nearby_inverse`.

        Raises:
            InverseKinematicsError: none was found; its `reason` says why.
            ValueError: not a pose, or not n finite numbers.
        """
        start = self._to_chain(reference)
        target = _as_se3(self._pin, pose)
        followed = self._follow(target, start)
        if followed is not None:
            return self._to_vector(followed)
        self._check_reach(target)
        deadline = time.monotonic() + self._time_limit
        data = self._workspace.data
        outside: Vector | None = None
        short: list[_Descent] = []
        for seed in self._starts(start, self._restarts if restarts is None else restarts):
            # Without limits first: the way may lead through one, and back by a whole turn.
            descent = self._descend(data, target, seed, self._free)
            if descent.end is _End.CONVERGED:
                joints = self._nearest_turns(descent.joints, start)
                if self._is_within(joints):
                    return self._checked(data, target, joints)
                outside = joints if outside is None else outside
                descent = self._descend(data, target, seed, self._limits)
                if descent.end is _End.CONVERGED:
                    return self._checked(data, target, self._nearest_turns(descent.joints, start))
            short.append(descent)
            if time.monotonic() > deadline:
                if outside is not None:
                    break
                raise self._not_converged(short, f"gave up after {self._time_limit} s")
        raise self._failure(outside, short)

    @override
    def nearby_inverse(self, pose: Pose, reference: Vector) -> Vector:
        return self.inverse(pose, reference, restarts=0)

    def _to_chain(self, joints: Vector) -> Vector:
        """Return a joint vector in the order of the chain."""
        values = np.asarray(joints, dtype=np.float64)
        if values.shape != self._order.shape or not all(map(math.isfinite, values.tolist())):
            raise ValueError(f"{len(self.joints)} finite joint positions are needed, not {values}")
        ordered: Vector = values[self._order]
        return ordered

    def _to_vector(self, values: Vector) -> Vector:
        """Return values in the order of the chain as a read-only joint vector."""
        joints = np.empty_like(values)
        joints[self._order] = values
        joints.setflags(write=False)
        return joints

    def _place(self, data: Any, joints: Vector) -> Any:
        """Return the tool point as pinocchio's SE3, valid until the next call in this thread."""
        self._pin.framesForwardKinematics(self._model, data, joints)
        return data.oMf[self._frame]

    def _starts(self, reference: Vector, restarts: int) -> Iterator[Vector]:
        """Yield the reference, then random positions, spread wider each time."""
        yield reference
        if restarts == 0:
            return
        random = np.random.default_rng(SEED)
        lower, upper = self._limits.lower, self._limits.upper
        low = np.where(np.isfinite(lower), lower, reference - math.pi)
        high = np.where(np.isfinite(upper), upper, reference + math.pi)
        # A range of several turns holds nothing that one turn does not.
        low[self._turning] = np.maximum(low, reference - math.pi)[self._turning]
        high[self._turning] = np.minimum(high, reference + math.pi)[self._turning]
        for attempt in range(1, restarts + 1):
            spread = min(1.0, 4.0 * attempt / restarts)
            anywhere = random.uniform(np.minimum(low, high), np.maximum(low, high))
            yield reference + spread * (anywhere - reference)

    def _follow(self, target: Any, start: Vector) -> Vector | None:
        """Return what is reached from near by in a few steps, None if it is not as simple as that."""
        if self._position_only or start.size < 6:
            return None
        pin, model, frame, data = self._pin, self._model, self._frame, self._workspace.data
        joints, way = start, 0.0
        for _ in range(NEWTON_STEPS):
            error = pin.log6(self._place(data, joints).actInv(target)).vector
            x, y, z, rx, ry, rz = error.tolist()
            position, rotation = math.hypot(x, y, z), math.hypot(rx, ry, rz)
            if position < CONVERGED and rotation < CONVERGED:
                return self._limits.clip(joints) if self._is_within(joints) else None
            if position + rotation > NEAR:
                return None
            jacobian = pin.computeFrameJacobian(model, data, joints, frame, pin.LOCAL)
            step = self._newton_step(jacobian, error)
            way += math.hypot(*step.tolist())
            if not way < NEAR:  # at a singularity it may be anything, and no number
                return None
            joints = joints + step
        return None

    def _newton_step(self, jacobian: Array, error: Vector) -> Vector:
        """Return the smallest change of the joints that takes away an error (6,), to the first order."""
        if jacobian.shape[1] == 6:
            return frozen(self._algebra.PartialPivLU(jacobian).solve(error))
        square = jacobian @ jacobian.T + self._solvable
        return frozen(jacobian.T @ self._algebra.LDLT(square).solve(error))

    def _descend(self, data: Any, target: Any, start: Vector, bounds: _Bounds) -> _Descent:
        """Run Levenberg-Marquardt from `start`, within `bounds`."""
        pin, model, frame, weight = self._pin, self._model, self._frame, self._length_weight
        joints = bounds.clip(start)
        rows = 3 if self._position_only else 6
        error = np.zeros(6)
        least, waited = math.inf, 0
        end = _End.STEPS
        position = rotation = math.inf
        for _ in range(MAX_STEPS):
            to_goal = self._place(data, joints).actInv(target)
            position, rotation = self._distance(to_goal, error)
            square = (weight * position) ** 2 + rotation * rotation
            if square < PROGRESS * least:
                least, waited = square, 0
            else:
                waited += 1
            if max(position, rotation) < CONVERGED:
                break
            if waited > PATIENCE:
                end = _End.STALLED
                break
            error[:3] *= weight
            jacobian = pin.computeFrameJacobian(model, data, joints, frame, pin.LOCAL)[:rows]
            jacobian[:3] *= weight
            gradient = jacobian.T @ error[:rows]
            normal = jacobian.T @ jacobian
            if bounds.any:
                # A joint that is on its limit and pushed against it takes no part.
                held = (joints <= bounds.lower) & (gradient < 0.0)
                held |= (joints >= bounds.upper) & (gradient > 0.0)
                normal[held] = 0.0
                normal[:, held] = 0.0
                gradient[held] = 0.0
            normal.ravel()[:: joints.size + 1] += DAMPING * square + LEAST_DAMPING
            step = self._algebra.LDLT(normal).solve(gradient)
            largest = max(map(abs, step.tolist()))
            if largest > MAX_STEP:
                step *= MAX_STEP / largest
            joints = bounds.clip(joints + step)
        if max(position, rotation) < TOLERANCE:
            end = _End.CONVERGED
        return _Descent(end, joints, position, rotation)

    def _distance(self, to_goal: Any, error: Vector) -> tuple[float, float]:
        """Write what is left, in tool axes, to `error` (6,); return its lengths in m and rad."""
        error[:3] = to_goal.translation
        if not self._position_only:
            error[3:] = self._pin.log3(to_goal.rotation)
        x, y, z, rx, ry, rz = error.tolist()
        return math.hypot(x, y, z), math.hypot(rx, ry, rz)

    def _nearest_turns(self, joints: Vector, reference: Vector) -> Vector:
        """Turn each revolute joint by whole turns to be nearest to `reference`, if within its limits."""
        turned = joints.tolist()
        bounds = self._limits
        for i in self._turning:
            value, lower, upper = turned[i], float(bounds.lower[i]), float(bounds.upper[i])
            value += TURN * round((float(reference[i]) - value) / TURN)
            inside = value
            if value > upper + EDGE:
                inside -= TURN * math.ceil((value - upper - EDGE) / TURN)
            elif value < lower - EDGE:
                inside += TURN * math.ceil((lower - value - EDGE) / TURN)
            turned[i] = inside if lower - EDGE <= inside <= upper + EDGE else value
        return np.array(turned)

    def _is_within(self, joints: Vector) -> bool:
        return all(
            low - EDGE <= joint <= high + EDGE
            for joint, (low, high) in zip(joints.tolist(), self._ranges, strict=True)
        )

    def _beyond(self, joints: Vector) -> NDArray[np.bool_]:
        """Return which joints are beyond their limits."""
        return (joints < self._limits.lower - EDGE) | (joints > self._limits.upper + EDGE)

    def _checked(self, data: Any, target: Any, joints: Vector) -> Vector:
        """Return `joints` as a joint vector after a last look at what it reaches.

        Raises:
            InverseKinematicsError: further away than promised, as a joint many turns away may be.
        """
        joints = self._limits.clip(joints)
        to_goal = self._place(data, joints).actInv(target)
        position, rotation = self._distance(to_goal, np.zeros(6))
        if max(position, rotation) >= TOLERANCE:
            last = _Descent(_End.STALLED, joints, position, rotation)
            raise self._not_converged([last], "rounding of so large numbers")
        return self._to_vector(joints)

    def _check_reach(self, target: Any) -> None:
        distance = _norm(target.translation - self._shoulder)
        if distance > self._reach + TOLERANCE:
            raise self._error(
                IkFailure.OUT_OF_REACH,
                f"the pose is {distance:.4f} m from the first joint; the links reach "
                f"{self._reach:.4f} m",
                "Choose a pose nearer to the arm.",
            )

    def _failure(self, outside: Vector | None, short: list[_Descent]) -> InverseKinematicsError:
        """Return why none of the descents ended at the pose and within the limits."""
        if outside is not None:
            lower, upper = self._limits.lower, self._limits.upper
            beyond = ", ".join(
                f"{self.joints[self._order[i]]} {outside[i]:.4f} ({lower[i]:.4f} to {upper[i]:.4f})"
                for i in np.flatnonzero(self._beyond(outside))
            )
            return self._error(
                IkFailure.JOINT_LIMITS,
                f"the pose was reached only beyond the limits: {beyond}",
                "Choose another orientation, or a pose further from the limits.",
            )
        if len(short) < ENOUGH_ATTEMPTS or any(descent.end is _End.STEPS for descent in short):
            return self._not_converged(short, f"not reached in {len(short)} attempts")
        best = _nearest(short)
        return self._error(
            IkFailure.OUT_OF_REACH,
            f"all {len(short)} attempts ended short of the pose, the best by "
            f"{best.position_error:.3g} m and {best.rotation_error:.3g} rad",
            "Choose a pose that the arm reaches; with fewer than six axes most orientations are none.",
        )

    def _not_converged(self, short: list[_Descent], why: str) -> InverseKinematicsError:
        best = _nearest(short)
        return self._error(
            IkFailure.NOT_CONVERGED,
            f"{why}; the best attempt is {best.position_error:.3g} m and "
            f"{best.rotation_error:.3g} rad away",
            "Give a reference nearer to the pose, or a pose further from a singularity.",
        )

    def _error(self, reason: IkFailure, message: str, remedy: str) -> InverseKinematicsError:
        return InverseKinematicsError(reason, message, where=self._name, remedy=remedy)


def _libraries() -> tuple[Any, Any]:
    """Return pinocchio, and the bindings of Eigen that it is made with, for its decompositions."""
    try:
        import eigenpy
        import pinocchio
    except ModuleNotFoundError:  # a broken installation says itself what it lacks
        raise MissingExtra("pinocchio", "kinematics") from None
    return pinocchio, eigenpy


def _build(pin: Any, chain: Chain, base: Any, tool: Any) -> tuple[Any, int]:
    """Return pinocchio's model of the chain and the index of its tool frame."""
    model = pin.Model()
    kinds = {
        JointKind.REVOLUTE: pin.JointModelRevoluteUnaligned,
        JointKind.PRISMATIC: pin.JointModelPrismaticUnaligned,
    }
    parent, carrier = 0, base
    for joint in chain.joints:
        placement = carrier * _se3(pin, joint.placement)
        parent = model.addJoint(parent, kinds[joint.kind](joint.axis), placement, joint.name)
        carrier = pin.SE3.Identity()
    tip = _se3(pin, chain.tip) * tool
    return model, model.addFrame(pin.Frame("tool", parent, 0, tip, pin.FrameType.OP_FRAME))


def _se3(pin: Any, placement: Array) -> Any:
    return pin.SE3(placement[:3, :3], placement[:3, 3])


def _placement(pin: Any, what: str, pose: Pose | None) -> Any:
    if pose is None:
        return pin.SE3.Identity()
    try:
        return _as_se3(pin, pose)
    except ValueError as error:
        raise ConfigError(
            f"{what}: {error}", remedy="Give a pose with a unit quaternion."
        ) from None


def _as_se3(pin: Any, pose: Pose) -> Any:
    position, orientation = pose.position.tolist(), pose.orientation.tolist()
    if len(position) != 3 or len(orientation) != 4:
        raise ValueError(f"a pose has 3 and 4 numbers, not {len(position)} and {len(orientation)}")
    norm = math.hypot(*orientation)
    # written so that not a number is refused
    if not (all(map(math.isfinite, position)) and abs(norm - 1.0) <= QUATERNION_TOLERANCE):
        raise ValueError(f"position {position} must be finite, quaternion {orientation} unit")
    return pin.XYZQUATToSE3(np.array((*position, *(number / norm for number in orientation))))


def _norm(values: Vector) -> float:
    return math.sqrt(float(values @ values))


def _nearest(descents: list[_Descent]) -> _Descent:
    return min(descents, key=lambda descent: descent.position_error + descent.rotation_error)
