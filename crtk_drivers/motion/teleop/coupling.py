"""From where the leader is to what the follower is sent, and from what that feels to what the leader is sent.

A pose of the follower is the one it had when they were coupled, moved as the leader has moved since:
``p = p0 + scale · A (l - l0)``, ``q = A (ql · ql0⁻¹) A⁻¹ · q0``, where `A` turns the leader's base axes into
those of the follower. So the first pose is ``p0, q0`` to the last bit, whatever scale and axes are.
"""

from __future__ import annotations

import math

import numpy as np

from crtk_drivers.geometry.quaternions import (
    QUATERNION_TOLERANCE,
    quaternion_from_rotvec,
    quaternion_product,
    rotated,
    unit,
)
from crtk_drivers.geometry.rates import inverse, turn
from crtk_drivers.motion.teleop.teleop_settings import ForceSettings, LimitsSettings, TeleopSettings
from crtk_drivers.samples import Pose, Twist, Vector, Wrench, vector

ZERO = vector((0.0, 0.0, 0.0))
LARGEST = 1e9
"""In m, m/s, N, ...: what is beyond is no measurement, and is not multiplied by anything."""


def is_measured(numbers: Vector) -> bool:
    """Whether all of them are numbers, and none is beyond `LARGEST`."""
    return bool((np.abs(numbers) <= LARGEST).all())


def is_pose(pose: Pose) -> bool:
    """Whether a pose is measured, and its quaternion one of unit length."""
    return (
        pose.position.size == 3
        and pose.orientation.size == 4
        and is_measured(pose.position)
        and abs(math.hypot(*pose.orientation.tolist()) - 1.0) <= QUATERNION_TOLERANCE
    )


def distances(one: Pose, other: Pose) -> tuple[float, float]:
    """Return how far two poses are apart, in m and rad."""
    way = one.position - other.position
    angle = turn(one.orientation, other.orientation)
    return math.hypot(*way.tolist()), math.hypot(*angle.tolist())


def goal_of(settings: TeleopSettings, leader: Pose, at: Pose, start: Pose) -> Pose:
    """Return where the leader wants the follower.

    Args:
        leader: where it is.
        at: where it was when they were coupled.
        start: where the follower was then.
    """
    axes = settings.leader_axes
    position, orientation = start.position, start.orientation
    if settings.translation == "follows":
        way = settings.scale * (leader.position - at.position)
        position = position + vector(rotated(axes, *way.tolist()))
    has_turned = not np.array_equal(leader.orientation, at.orientation)
    if settings.orientation != "locked" and has_turned:
        turned = turn(leader.orientation, at.orientation).tolist()
        delta = quaternion_from_rotvec(vector(rotated(axes, *turned)))
        orientation = unit(quaternion_product(delta, orientation))
    return Pose(position, orientation, start.frame_id)


def approach(limits: LimitsSettings, command: Pose, goal: Pose, dt: float) -> Pose:
    """Return the pose that is sent after `command`, `dt` s later: `goal`, or as near as the speeds allow."""
    way = goal.position - command.position
    position = command.position + _at_most(way, limits.speed * dt)
    angle = turn(goal.orientation, command.orientation)
    most = limits.turn_speed * dt
    if math.hypot(*way.tolist()) <= limits.speed * dt:
        position = goal.position
    if math.hypot(*angle.tolist()) <= most:
        orientation = goal.orientation
    else:
        step = quaternion_from_rotvec(vector(_at_most(angle, most)))
        orientation = unit(quaternion_product(step, command.orientation))
    if np.dot(orientation, command.orientation) < 0.0:  # the same one, and the nearer four numbers
        orientation = vector(-orientation)
    return Pose(position, orientation, goal.frame_id)


def misalignment(settings: TeleopSettings, leader: Pose, follower: Pose) -> float:
    """Return by which angle, in rad, the leader's handle is turned from the follower's tool."""
    there = quaternion_product(settings.leader_axes, leader.orientation)
    angle = turn(quaternion_product(there, settings.tool), follower.orientation)
    return math.hypot(*angle.tolist())


def wanted_by_way(settings: TeleopSettings, leader: Pose, at: Pose) -> Twist:
    """Return the velocity of the follower, not limited, for a leader that is away from `at`."""
    way = _beyond(leader.position - at.position, settings.deadband)
    angle = _beyond(turn(leader.orientation, at.orientation), settings.turn_deadband)
    return _scaled(settings, way, angle)


def wanted_by_speed(settings: TeleopSettings, leader: Twist) -> Twist:
    """Return the velocity of the follower, not limited, for a leader that moves."""
    return _scaled(settings, leader.linear, leader.angular)


def approach_twist(limits: LimitsSettings, command: Twist, wanted: Twist, dt: float) -> Twist:
    """Return the velocity that is sent after `command`, `dt` s later, within all limits."""
    linear = _at_most(wanted.linear, limits.speed) - command.linear
    angular = _at_most(wanted.angular, limits.turn_speed) - command.angular
    return Twist(
        _at_most(command.linear + _at_most(linear, limits.acceleration * dt), limits.speed),
        _at_most(
            command.angular + _at_most(angular, limits.turn_acceleration * dt), limits.turn_speed
        ),
    )


def reflected(
    settings: TeleopSettings, force: ForceSettings, wrench: Wrench, follower: Pose, share: float
) -> Wrench:
    """Return what the leader is sent: in its base axes, scaled, and clipped by magnitude.

    Args:
        wrench: that acts on the follower; of ``body/measured_cf`` in its tool's axes.
        follower: its pose.
        share: of it that is felt, 0 to 1.
    """
    there = inverse(settings.leader_axes)
    if force.source == "body/measured_cf":
        there = quaternion_product(there, follower.orientation)
    pushed = force.gain * share * vector(rotated(there, *wrench.force.tolist()))
    turned = force.turn_gain * share * vector(rotated(there, *wrench.torque.tolist()))
    return Wrench(_at_most(pushed, force.most), _at_most(turned, force.most_torque))


def _scaled(settings: TeleopSettings, linear: Vector, angular: Vector) -> Twist:
    axes = settings.leader_axes
    follows, turns = settings.translation == "follows", settings.orientation != "locked"
    return Twist(
        vector(rotated(axes, *(settings.scale * linear).tolist())) if follows else ZERO,
        vector(rotated(axes, *(settings.turn_scale * angular).tolist())) if turns else ZERO,
    )


def _beyond(way: Vector, dead: float) -> Vector:
    """Return what of a vector is longer than `dead`."""
    length = math.hypot(*way.tolist())
    return ZERO if length <= dead else way * ((length - dead) / length)


def _at_most(way: Vector, most: float) -> Vector:
    """Return a vector that is no longer than `most`."""
    length = math.hypot(*way.tolist())
    return way if length <= most else way * (most / length)
