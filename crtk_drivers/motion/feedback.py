"""What a device measures and what it was told, as motion starts from it.

Written by the I/O thread, read by anyone: each write replaces one reference, so that a reader always sees
values that belong together. What the fronts tell of it is in `crtk_drivers.motion.told`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from crtk_drivers.commands import Kind, Space
from crtk_drivers.device import Device, Mode
from crtk_drivers.gates.resolved_rate import DAMPING
from crtk_drivers.geometry.frames import (
    WrenchAxes,
)
from crtk_drivers.geometry.rates import turn
from crtk_drivers.motion.point import Point
from crtk_drivers.samples import (
    EMPTY,
    JointState,
    Pose,
    Sample,
    Stamp,
    Vector,
    empty,
    joint_state,
    vector,
)

POSITION_MODES = frozenset({None, Mode.JOINT_POSITION, Mode.CARTESIAN_POSITION})
"""Modes in which a position is in force; None: it is held."""

_STREAMING = 2.0
"""Intervals between two positions after which the next one is missing, and the stream stands."""

_TOLERANCE = 1.05
"""By how much a stream may exceed a velocity limit, for its clock is not ours."""

_SLOWEST = 0.1
"""Seconds between two positions, at most, that are of one motion."""

_MOST_OF_A_PERIOD = 0.7
"""Periods between two setpoints below which their difference alone says too little of the speed."""

_FURTHEST = 0.02
"""rad (m) that a joint is expected to go in a cycle at most; what goes further was a step."""

_LATE = 2.0
"""Cycles after which a sample is late: the joints have gone on since."""

_SHORT = 1e-6
"""Seconds over which a derivative is taken of the Jacobian."""


@dataclass(frozen=True, slots=True, eq=False)
class Active:
    """The setpoint in force: `mode` None means holding, or the hardware's own trajectory.

    `drift` is how fast positions that come without a velocity are moving on, joints (n,) or the tool (6,):
    they were sent at the time `sent`, `interval` after those before. `was_seeded`: here a transition has
    ended, and nothing was sent since.
    """

    mode: Mode | None = None
    joints: JointState = field(default_factory=JointState)
    pose: Vector = field(default_factory=empty)
    acceleration: Vector = field(default_factory=empty)
    twist: Vector = field(default_factory=empty)
    wrench: Vector = field(default_factory=empty)
    drift: Vector = field(default_factory=empty)
    stamp_ns: int = 0
    sent: float = -math.inf
    interval: float = math.inf
    was_seeded: bool = False


class Feedback:
    """The newest values of one device.

    Args:
        device: asked for kinematics.
        stale_after: seconds after which a sample is no longer valid.

    Attributes:
        axes: of wrenches.
        device, stale_after: as given.
        sample: the newest one; None before.
        active: the setpoint in force.
    """

    def __init__(self, device: Device, stale_after: float) -> None:
        self.axes = WrenchAxes()
        self.device = device
        self._capabilities = device.capabilities
        self.stale_after = stale_after
        self._period = 1.0 / device.capabilities.rate
        self._fastest = vector([limit.velocity for limit in device.capabilities.limits])
        self._at_rest = vector(np.zeros(len(self._fastest)))
        self._told = self._at_rest
        self._told_at = -math.inf
        self._measured = JointState(), -math.inf
        self.sample: Sample | None = None
        self.active = Active()

    # ----------------------------------------------------------------------------------- written by

    def take(self, sample: Sample) -> None:
        """Keep a new sample.

        One without values only shows that the link is alive: others go on ageing, and those from before the
        link was lost stay invalid.
        """
        before = self.sample
        if not sample.values and before is not None and before.values:
            if before.stamp.monotonic == -math.inf:
                self.sample = replace(before, stamp=Stamp(0, sample.stamp.monotonic))
            return
        self.sample = sample
        joints, stamp = sample.values.get("measured_js"), sample.stamp
        if isinstance(joints, JointState) and stamp.wall_ns:
            self._measured = joints, stamp.monotonic
            self._told, self._told_at = self._at_rest, stamp.monotonic

    def invalidate(self) -> None:
        """The link is lost: what was read last is not valid any more."""
        if self.sample is not None:
            self.sample = replace(self.sample, stamp=Stamp(0, -math.inf))
            self._measured = self._measured[0], -math.inf

    def seed(self, now: float, since: float) -> bool:
        """Take the measured joint position as the setpoint; return False if it is not known yet.

        Args:
            now: monotonic seconds.
            since: monotonic seconds; joints that were measured before do not count: with its torque or its
                mode a servo may have changed what its positions mean.
        """
        joints, at = self._measured
        if self.joints_age(now) > self.stale_after or (joints.position.size and at < since):
            return False
        self.active = Active(None, JointState(position=joints.position), was_seeded=True)
        return True

    def sent(self, point: Point, now: float, stamp_ns: int = 0) -> None:
        """Keep what went out as the setpoint in force.

        Args:
            point: what was sent, and what is known of the motion.
            now: monotonic seconds.
            stamp_ns: of the servo command that it came from, 0 if that had none.
        """
        mode, values = point.setpoint.mode, point.setpoint.values
        joints, twist, wrench = point.joints, point.twist, point.wrench
        if joints is None:
            in_joints = mode.space is Space.JOINT
            joints = joint_state(mode.kind, values) if in_joints else JointState()
        pose = values if mode is Mode.CARTESIAN_POSITION else EMPTY
        if mode is Mode.CARTESIAN_VELOCITY:
            twist = values
        if mode is Mode.CARTESIAN_EFFORT:
            wrench = values
        self._told, self._told_at = self._way_told(now), now
        before, sent, interval = self.active, now, now - self.active.sent
        drift = EMPTY
        if before.mode is mode and not (joints.velocity.size or twist.size):
            if _is_repeated(before, joints.position, pose):  # between two commands
                drift, sent, interval = before.drift, before.sent, before.interval
            elif 0.0 < interval <= _SLOWEST:
                drift, interval = self._mean_drift(mode, joints.position, pose, interval)
        self.active = Active(
            mode, joints, pose, point.acceleration, twist, wrench, drift, stamp_ns, sent, interval
        )

    def _mean_drift(
        self, mode: Mode, position: Vector, pose: Vector, interval: float
    ) -> tuple[Vector, float]:
        """Return how fast a stream of positions or poses (7,) moves, and over how many seconds that is.

        Setpoints may go out close behind each other, one late and the next early: what they say together
        with the step before them counts.
        """
        before = self.active
        is_short = interval < _MOST_OF_A_PERIOD * self._period
        drift = _drift(mode, before, position, pose, interval)
        if not is_short or not drift.size:
            return drift, interval
        if not before.drift.size:
            return vector(drift * (interval / self._period)), self._period
        whole = before.interval + interval
        return vector((before.drift * before.interval + drift * interval) / whole), whole

    def stream_ended(self) -> None:
        """No more commands come: the last setpoint stays in force."""
        self.active = replace(self.active, stamp_ns=0)

    def follow_device(self) -> None:
        """The hardware makes its own setpoints from now on, or is free: there is none of ours."""
        self.active = Active()

    def hold(self) -> None:
        """Motion was stopped: the setpoint is what the hardware reports as its own.

        If it reports none, a position that was sent is held, and anything else ends where it ends.
        """
        position = self.active.joints.position
        keeps = position.size and self._native("setpoint_js") is None
        self.active = Active(None, JointState(position=position)) if keeps else Active()

    # -------------------------------------------------------------------------------------- read by

    def sample_age(self, now: float) -> float:
        """Return the seconds since the newest sample was acquired; infinite without one."""
        return math.inf if self.sample is None else now - self.sample.stamp.monotonic

    def joints_age(self, now: float) -> float:
        """Return the seconds since the joints were measured; `sample_age` if they never were."""
        joints, at = self._measured
        return now - at if joints.position.size else self.sample_age(now)

    def joint_setpoint(self) -> JointState:
        """Return the joint setpoint in force, see the table in `crtk_drivers.motion.told`."""
        active, native = self.active, self._native("setpoint_js")
        joint_mode = active.mode is not None and active.mode.space is Space.JOINT
        if joint_mode or active.joints.position.size:
            effort = native.effort if native is not None else EMPTY
            if active.joints.effort.size or not effort.size:
                return active.joints
            return replace(active.joints, effort=effort)
        if native is not None:
            return native
        if active.mode is None:
            return JointState(position=self.measured.position)
        return JointState()

    def reference_joints(self) -> Vector:
        """Return the joint position (n,) that relative commands and kinematics start from."""
        position = self.joint_setpoint().position
        return position if position.size else self.measured.position

    def expected_joints(self, ahead: float) -> Vector:
        """Return where a stream of joint positions (n,) will be `ahead` seconds after the last, at a guess.

        Inverse kinematics has the least to do from there. It is `reference_joints` if nothing streams.
        """
        here, drift = self.reference_joints(), self.active.drift
        if drift.size != here.size or self.active.mode is not Mode.JOINT_POSITION:
            return here
        way = [speed * ahead for speed in drift.tolist()]
        if max(map(abs, way)) > _FURTHEST:
            return here
        return vector([joint + step for joint, step in zip(here.tolist(), way, strict=True)])

    def measured_state(self) -> tuple[JointState, float]:
        """Return the joints as measured last, and when that was, in monotonic seconds.

        They may be older than the newest sample: not every one need have them, nor be valid.
        """
        return self._measured

    def motion(self, now: float) -> tuple[Vector, Vector, Vector]:
        """Return joint position, velocity and acceleration (n,) that a new motion starts from."""
        active = self.active
        position = self.reference_joints()
        velocity, acceleration = self.joint_setpoint().velocity, active.acceleration
        if active.mode is Mode.JOINT_POSITION and self._drifts(now):
            velocity = active.drift
        elif not velocity.size and active.mode not in POSITION_MODES:
            velocity = self.measured.velocity  # an effort or a twist is in force
        at_rest = vector(np.zeros(position.size))
        return (
            position,
            velocity if velocity.size else at_rest,
            acceleration if acceleration.size else at_rest,
        )

    @property
    def goes_on(self) -> bool:
        """Whether a trajectory of ours goes on from the present motion; else it begins at rest."""
        mode = self.active.mode
        if mode is None:
            return False
        return mode.kind is Kind.POSITION or not self._capabilities.stops_between_modes

    def _drifts(self, now: float) -> bool:
        """Whether the positions of a stream, which come without a velocity, are moving on.

        What was faster than anything may move was a step, and leads nowhere.
        """
        active, limits = self.active, self._capabilities.cartesian_limits
        since = max(active.interval, self._period)
        if not active.drift.size or now - active.sent >= _STREAMING * since:
            return False
        if active.mode is Mode.JOINT_POSITION:
            return bool((np.abs(active.drift) <= self._fastest * _TOLERANCE).all())
        if limits is None:
            return False
        linear, angular = math.hypot(*active.drift[:3]), math.hypot(*active.drift[3:])
        return (
            linear <= limits.linear_velocity * _TOLERANCE
            and angular <= limits.angular_velocity * _TOLERANCE
        )

    def reference_pose(self, native: bool = False) -> Pose | None:
        """Return the tool pose (base frame) that relative poses start from; None if it is not known.

        Of hardware that measures none it is what that reports as its own setpoint.

        Args:
            native: prefer what the hardware reports as its own, which may know the arm better.
        """
        pose = self.active.pose
        if native and (own := self._own_pose()) is not None:
            return own
        if pose.size:
            return Pose(pose[:3], pose[3:], self._capabilities.base_frame)
        joints, kinematics = self.reference_joints(), self.device.kinematics
        if joints.size and kinematics is not None:
            return kinematics.forward(joints)
        return self._pose_at_rest()

    def reference_twist(self, now: float) -> Vector:
        """Return the twist (6,) of the tool, base axes, that a new motion starts from."""
        if self.active.twist.size:
            return self.active.twist
        if self.active.mode is Mode.CARTESIAN_POSITION and self._drifts(now):
            return self.active.drift
        joints, velocity, _ = self.motion(now)
        kinematics = self.device.kinematics
        if kinematics is None or not velocity.any():
            return vector(np.zeros(6))
        return vector(kinematics.jacobian(joints) @ velocity)

    def reference_twist_change(self, now: float) -> Vector:
        """Return the derivative (6,) of `reference_twist`, as far as it is known."""
        joints, velocity, acceleration = self.motion(now)
        kinematics = self.device.kinematics
        if kinematics is None or not (velocity.any() or acceleration.any()):
            return vector(np.zeros(6))
        jacobian = kinematics.jacobian(joints)
        ahead = kinematics.jacobian(vector(joints + velocity * _SHORT))
        return vector(jacobian @ acceleration + (ahead - jacobian) @ velocity / _SHORT)

    def commanded_wrench(self) -> Vector:
        """Return the wrench (6,), base axes, that was sent last; zero unless one is in force."""
        return self.active.wrench if self.active.wrench.size else vector(np.zeros(6))

    def commanded_effort(self) -> Vector:
        """Return the joint effort (n,) that was sent last; empty unless an effort is in force."""
        is_effort = self.active.mode is Mode.JOINT_EFFORT
        return self.active.joints.effort if is_effort else EMPTY

    def before(self, mode: Mode, now: float = -math.inf) -> Vector:
        """Return what a new setpoint of `mode` is judged by.

        For positions and poses what was sent before them, to find a jump; else the joints as measured, and
        moved on from there if at `now` that was long ago.
        """
        if mode is Mode.JOINT_POSITION:
            return self.reference_joints()
        if mode is Mode.CARTESIAN_POSITION:
            if self.active.pose.size:
                return self.active.pose
            pose = self._pose_at_rest()
            return EMPTY if pose is None else vector((*pose.position, *pose.orientation))
        return self.moved_on(now)

    def moved_on(self, now: float) -> Vector:
        """Return where the joints (n,) may be now: gone on as measured or as told, whichever is further."""
        here, age = self._measured[0], self.joints_age(now)
        if not _LATE / self._capabilities.rate < age < math.inf or self._told.size != len(
            here.position
        ):
            return here.position
        way = self._way_told(now)
        if here.velocity.size == way.size:
            went_on = age * here.velocity
            way = np.where(np.abs(went_on) > np.abs(way), went_on, way)
        return vector(here.position + way)

    def _way_told(self, now: float) -> Vector:
        """Return how far (n,) the joints were told to go by velocities or twists since the newest sample."""
        velocity = self._velocity_told(now)
        if velocity.size != self._told.size:
            return self._told
        return vector(self._told + velocity * max(0.0, now - self._told_at))

    def _velocity_told(self, now: float) -> Vector:
        """Return the joint velocity (n,) in force; empty if there is none, or nobody asks for it yet."""
        active, here = self.active, self._measured[0].position
        if active.mode is Mode.JOINT_VELOCITY:
            return active.joints.velocity
        is_late = self.joints_age(now) > _LATE / self._capabilities.rate
        is_twist = active.mode is Mode.CARTESIAN_VELOCITY and here.size == self._told.size
        kinematics = self.device.kinematics
        if not (is_late and is_twist) or kinematics is None:
            return EMPTY
        rates, _ = DAMPING.rates(kinematics.jacobian(vector(here + self._told)), active.twist)
        return rates

    def measured_pose(self) -> Pose | None:
        """Return the tool pose (base frame) as measured, or by kinematics; None if it is not known."""
        sample = self.sample
        value = sample.values.get("measured_cp") if sample is not None else None
        if isinstance(value, Pose):
            return value
        joints, kinematics = self.measured.position, self.device.kinematics
        if joints.size and kinematics is not None:
            return kinematics.forward(joints)
        return None

    def _pose_at_rest(self) -> Pose | None:
        return self.measured_pose() or self._own_pose()

    def _own_pose(self) -> Pose | None:
        """Return the setpoint (base frame) that the hardware reports as its own; None if it does not."""
        sample = self.sample
        own = sample.values.get("setpoint_cp") if sample is not None else None
        return own if isinstance(own, Pose) else None

    @property
    def measured(self) -> JointState:
        """The joints of the newest sample; empty before, or if it has none."""
        sample = self.sample
        value = sample.values.get("measured_js") if sample is not None else None
        return value if isinstance(value, JointState) else JointState()

    def _native(self, name: str) -> JointState | None:
        sample = self.sample
        value = sample.values.get(name) if sample is not None else None
        return value if isinstance(value, JointState) else None


def _is_repeated(before: Active, position: Vector, pose: Vector) -> bool:
    known = before.joints.position.tolist(), before.pose.tolist()
    return (position.tolist(), pose.tolist()) == known


def _drift(mode: Mode, before: Active, position: Vector, pose: Vector, interval: float) -> Vector:
    """Return how fast a stream of positions or poses (7,) moves."""
    if mode is Mode.JOINT_POSITION and before.joints.position.size:
        return vector((position - before.joints.position) / interval)
    if mode is Mode.CARTESIAN_POSITION and before.pose.size:
        moved = pose[:3] - before.pose[:3]
        return vector(np.concatenate((moved, turn(pose[3:], before.pose[3:]))) / interval)
    return EMPTY
