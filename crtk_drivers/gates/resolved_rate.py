"""Cartesian streams (servo_cv, servo_cp, servo_cr) on joints, through the Jacobian.

The joint velocities of a twist are those of the Jacobian's inverse (the smallest, if there are more joints
than axes; the nearest twist, if fewer), with three exceptions, in this order:

1. Near a singularity, damping. Along a singular direction whose singular value s is below
   `Damping.threshold` t, the inverse 1/s is replaced by s / (s² + d²) with d² = (t/2)² · (1 - (s/t)²). It
   grows from nothing at t, so that there is no jump, and the inverse is never above 1.16/t; at the
   singularity the direction is given up, while all others are exact. Singular values depend on units:
   here m and rad.
2. Velocity limits, and the room to the position limits. A joint that moves outwards may be as fast as can
   still be stopped at its limit with half of its acceleration. What is too fast is scaled as a whole, so
   that the direction is kept; with a joint at its limit and moving outwards, everything stands still.
   Moving inwards is free, also from beyond a limit.
3. Acceleration limits, if the velocity before is given: the change is scaled as a whole. Position limits
   go before: a joint that could not be stopped otherwise is stopped anyway.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from crtk_drivers.device import CartesianLimits, JointLimits
from crtk_drivers.gates.braking import NEGLIGIBLE, braking_way, stoppable_speed
from crtk_drivers.geometry.rates import turn
from crtk_drivers.samples import Array, Pose, Vector, vector


@dataclass(frozen=True, slots=True)
class Damping:
    """How a singularity is met.

    Attributes:
        threshold: the singular value of the Jacobian below which a direction is damped. A joint does not
            move faster than 1.16/threshold rad/s for each m/s or rad/s.

    Raises:
        ValueError: not above zero.
    """

    threshold: float = 0.05

    def __post_init__(self) -> None:
        if not 0.0 < self.threshold < math.inf:
            raise ValueError(f"the threshold is {self.threshold}, not above zero")

    def gains(self, singular_values: Vector) -> Vector:
        """Return what stands for the inverses of the singular values."""
        t = self.threshold
        shares = np.minimum(singular_values / t, 1.0)
        gains: Vector = singular_values / (singular_values**2 + (t / 2.0) ** 2 * (1.0 - shares**2))
        return gains

    def rates(self, jacobian: Array, twist: Vector) -> tuple[Vector, bool]:
        """Return the joint velocities (n,) of a twist (6,), and whether they are damped.

        Args:
            jacobian: (6, n) in the axes of the twist.
            twist: linear before angular.
        """
        left, sizes, right = np.linalg.svd(jacobian, full_matrices=False)
        rates: Vector = right.T @ (self.gains(sizes) * (left.T @ twist))
        return rates, bool(sizes[-1] < self.threshold)


DAMPING: Final = Damping()
"""That of whoever says nothing else."""


@dataclass(frozen=True, slots=True, eq=False)
class JointRate:
    """What the joints do.

    Attributes:
        velocity: (n,) in rad/s (m/s).
        scale: in [0, 1], by how much limits made it slower.
        is_damped: near a singularity, a part of the twist is given up.
    """

    velocity: Vector
    scale: float
    is_damped: bool


class ResolvedRate:
    """Turns twists and poses into joint velocities.

    Args:
        limits: one a joint.
        cartesian_limits: of the tool; None if it has none.
        cycle: seconds for which a velocity will be in force.
        damping: near singularities.
    """

    def __init__(
        self,
        limits: Sequence[JointLimits],
        cartesian_limits: CartesianLimits | None,
        cycle: float,
        damping: Damping = DAMPING,
    ) -> None:
        self._bounds = [
            (
                limit.lower,
                limit.upper,
                limit.velocity,
                limit.acceleration / 2.0,
                braking_way(limit.velocity, limit.acceleration / 2.0, cycle),
            )
            for limit in limits
        ]
        self._slews = [
            (-limit.acceleration * cycle, limit.acceleration * cycle) for limit in limits
        ]
        self._cartesian = cartesian_limits
        self._cycle = cycle
        self._damping = damping

    def follow_twist(
        self, joints: Vector, jacobian: Array, twist: Vector, before: Vector | None = None
    ) -> JointRate:
        """Return the joint velocity of a twist (servo_cv).

        Args:
            joints: (n,) where they are (the setpoint).
            jacobian: (6, n) there, geometric, at the tool point, in base axes.
            twist: (6,) of the tool point in base axes, linear before angular, in m/s and rad/s.
            before: (n,) velocity in force now; None leaves acceleration unlimited.

        Raises:
            ValueError: not finite, or of wrong sizes.
        """
        if jacobian.shape != (6, joints.size) or twist.shape != (6,):
            raise ValueError(f"a Jacobian {jacobian.shape} for {joints.size} joints, {twist.shape}")
        if not (math.isfinite(sum(twist.tolist())) and math.isfinite(float(jacobian.sum()))):
            raise ValueError("a twist or Jacobian that is not finite")
        wanted, is_damped = self._inverse(jacobian, self._slowed(twist))
        velocity, scale = self._limited(joints, wanted, before)
        return JointRate(velocity, scale, is_damped)

    def follow_pose(
        self,
        joints: Vector,
        pose: Pose,
        jacobian: Array,
        goal: Pose,
        time: float,
        before: Vector | None = None,
    ) -> JointRate:
        """Return the joint velocity that takes the tool from `pose` towards `goal` (servo_cp, servo_cr).

        Args:
            joints, jacobian, before: as for `follow_twist`.
            pose: of the tool with these joints.
            goal: in the same frame.
            time: seconds in which it would be there, were there no limits; a few cycles.
        """
        way = np.concatenate(
            (goal.position - pose.position, turn(goal.orientation, pose.orientation))
        )
        return self.follow_twist(joints, jacobian, way / max(time, self._cycle), before)

    def limited(self, joints: Vector, wanted: Vector, before: Vector) -> Vector:
        """Return a joint velocity (n,) within the limits, see the module.

        Args:
            joints: (n,) where they are.
            wanted: (n,) velocity.
            before: (n,) velocity in force now.
        """
        return self._limited(joints, wanted, before)[0]

    def _inverse(self, jacobian: Array, twist: Vector) -> tuple[Vector, bool]:
        """Return the joint velocity (n,) of a twist without limits, and whether it is damped."""
        if jacobian.shape[1] == 6:
            try:
                inverse = np.linalg.inv(jacobian)
            except np.linalg.LinAlgError:
                pass
            else:
                # The norm is at least the inverse of the smallest singular value: nothing is damped here.
                if float(np.vdot(inverse, inverse)) * self._damping.threshold**2 <= 1.0:
                    return inverse @ twist, False
        return self._damping.rates(jacobian, twist)

    def _slowed(self, twist: Vector) -> Vector:
        """Scale a twist as a whole into the tool's velocity limits."""
        if self._cartesian is None:
            return twist
        x, y, z, rx, ry, rz = twist.tolist()
        excess = max(
            math.hypot(x, y, z) / self._cartesian.linear_velocity,
            math.hypot(rx, ry, rz) / self._cartesian.angular_velocity,
        )
        return twist / excess if excess > 1.0 else twist

    def _limited(
        self, joints: Vector, wanted: Vector, before: Vector | None
    ) -> tuple[Vector, float]:
        """Return the velocity (n,) within the limits, and by how much all of `wanted` was scaled."""
        targets, cycle = wanted.tolist(), self._cycle
        rooms = [
            (
                -top if here - low >= way else -stoppable_speed(here - low, brake, cycle),
                top if high - here >= way else stoppable_speed(high - here, brake, cycle),
            )
            for here, (low, high, top, brake, way) in zip(
                joints.tolist(), self._bounds, strict=True
            )
        ]
        targets = [
            min(max(value, low), high) if abs(value) <= NEGLIGIBLE * top else value
            for value, (low, high), (_, _, top, _, _) in zip(
                targets, rooms, self._bounds, strict=True
            )
        ]
        scale = _fitting(targets, rooms)
        velocity = [value * scale for value in targets]
        if before is None:
            return vector(velocity), scale
        start = before.tolist()
        change = [new - old for new, old in zip(velocity, start, strict=True)]
        share = _fitting(change, self._slews)
        # Each by itself: what is left over from before may have any direction.
        slewed = [
            min(max(old + step * share, down), up)
            for old, step, (down, up) in zip(start, change, rooms, strict=True)
        ]
        return vector(slewed), scale


def _fitting(values: list[float], bounds: Sequence[tuple[float, float]]) -> float:
    """Return the largest share in [0, 1] of a vector that is within bounds around zero."""
    share = 1.0
    for value, (low, high) in zip(values, bounds, strict=True):
        bound = high if value > 0.0 else low
        if abs(value) > abs(bound):
            share = min(share, bound / value)
    return share
