"""What is heard of both sides and of the pedals, and what is to be sent."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Generic, TypeVar

from crtk_drivers.samples import JointState, Pose, Twist, Wrench
from crtk_drivers.state import Status

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Heard(Generic[T]):
    """A value, and since when (monotonic, s) it is known: when its stamp was heard first."""

    value: T
    since: float


@dataclass(frozen=True, slots=True)
class Side:
    """What was heard of a leader or a follower.

    Attributes:
        lost: why it counts as gone; empty if it does not.
        status: None for a device that tells none.
        pose: newest valid measured_cp.
        twist: newest valid measured_cv.
        wrench: newest valid wrench, of the follower.
        setpoint: newest valid setpoint_cp, of the follower.
        refusal: what it has refused since the last step; empty if nothing.
        joint: newest valid measured_js, of a gripper.
        joint_setpoint: newest valid setpoint_js, of a gripper.
    """

    lost: str = ""
    status: Status | None = None
    pose: Heard[Pose] | None = None
    twist: Heard[Twist] | None = None
    wrench: Heard[Wrench] | None = None
    setpoint: Heard[Pose] | None = None
    refusal: str = ""
    joint: Heard[JointState] | None = None
    joint_setpoint: Heard[JointState] | None = None


@dataclass(frozen=True, slots=True)
class Inputs:
    """All that was heard until `now` (monotonic, s).

    Attributes:
        leader, follower: both sides.
        leader_gripper, jaw: of both sides, where a gripper leads a jaw.
        clutch, engage: pedals; None if nothing is known of one.
        doubt: why a pedal that is heard does not count; empty if all do.
    """

    now: float
    leader: Side = field(default_factory=Side)
    follower: Side = field(default_factory=Side)
    clutch: Heard[bool] | None = None
    engage: Heard[bool] | None = None
    leader_gripper: Side = field(default_factory=Side)
    jaw: Side = field(default_factory=Side)
    doubt: str = ""


@dataclass(frozen=True, slots=True)
class Commands:
    """What is to be sent now, in this order: the follower's stream, holds, `free`, the leader's force.

    Attributes:
        hold_follower: it stops and stays.
        hold_leader: the same.
        free_leader: a hand may move it.
        follower: servo_cp or servo_cv, in its base axes.
        leader: servo_cf, in its base axes.
        jaw: servo_jp of the follower's jaw, rad (m).
    """

    hold_follower: bool = False
    hold_leader: bool = False
    free_leader: bool = False
    follower: Pose | Twist | None = None
    leader: Wrench | None = None
    jaw: float | None = None
