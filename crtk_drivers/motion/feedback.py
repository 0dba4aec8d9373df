"""What a device measures and what it was told: the values behind ``measured_*``, ``setpoint_*``, ``goal_*``.

Written by the I/O thread (samples, setpoints) and by clients' threads (goals); read by anyone. Each write
replaces one reference, so that a reader always sees values that belong together.

The contents of a setpoint depend on the command that made it:

    servo_jp, servo_cp    position sent; no velocity
    servo_jv              velocity sent; no position
    servo_jf              effort sent; neither position nor velocity
    servo_cv, servo_cf    the hardware's own setpoint if it reports one; setpoint_cp is invalid;
                          servo_cv by joints: their velocity, or the integrated position with it;
                          servo_cf by joints: their effort
    servo_js, servo_cs    of position axes the position, of velocity axes what it leads to
    move_jp, move_cp      p(t) and v(t) of the trajectory
    interpolate_jp, _jr   p(t) and v(t) of the interpolation; _cp, _cr the same by kinematics
    interpolate_jv        v(t); no position
    interpolate_cv        as servo_cv
    interpolate_jf        the effort at the time; neither position nor velocity
    none (holding)        the position held

setpoint_cv is the twist that was sent, or that of the joint velocities; setpoint_cf is valid under servo_cf
and interpolate_cf.

While a servo stream runs, what ``setpoint_*`` say carries the stamp of the command that it came from, so that
anyone can see which commands took effect, and when. Otherwise it is the stamp of the newest sample.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from crtk_drivers.commands import Kind, Space
from crtk_drivers.device import Device, Mode, Setpoint
from crtk_drivers.geometry.frames import (
    WrenchAxes,
    jacobian_from_base,
    relative,
    twist_from_base,
    twist_in_base,
    wrench_from_base,
    wrench_in_base,
)
from crtk_drivers.geometry.rates import turn
from crtk_drivers.samples import (
    EMPTY,
    JointState,
    Matrix,
    Pose,
    Sample,
    Stamp,
    Twist,
    Value,
    Vector,
    Wrench,
    empty,
    joint_state,
    vector,
)
from crtk_drivers.state import OperatingState

_POSITION_MODES = frozenset({None, Mode.JOINT_POSITION, Mode.CARTESIAN_POSITION})


_STREAMING = 2.0
"""Intervals between two positions after which the next one is missing, and the stream stands."""

_TOLERANCE = 1.05
"""By how much a stream may exceed a velocity limit, for its clock is not ours."""

_SLOWEST = 0.1
"""Seconds between two positions, at most, that are of one motion."""

_FURTHEST = 0.02
"""rad (m) that a joint is expected to go in a cycle at most; what goes further was a step."""

_LATE = 2.0
"""Cycles after which a sample is late: the joints have gone on since."""

_SHORT = 1e-6
"""Seconds over which a derivative is taken of the Jacobian."""


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """What goes out in one cycle.

    Attributes:
        setpoint: to be sent.
        joints: what ``setpoint_js`` says of it; None if that follows from the setpoint alone.
        acceleration: (n,) of the joints, for the motion that follows; empty if unknown.
        twist: (6,) of the tool, base axes, the same.
        wrench: (6,) of the tool, base axes, that the setpoint is to make; empty if it is no effort.
    """

    setpoint: Setpoint
    joints: JointState | None = None
    acceleration: Vector = field(default_factory=empty)
    twist: Vector = field(default_factory=empty)
    wrench: Vector = field(default_factory=empty)

    def at_pace(self, pace: float) -> Point:
        """Return it as it is in real time, of which the time of its motion is a share."""
        if pace == 1.0:
            return self
        joints = self.joints
        if joints is not None:
            joints = replace(joints, velocity=vector(joints.velocity * pace))
        acceleration, twist = vector(self.acceleration * pace * pace), vector(self.twist * pace)
        return replace(self, joints=joints, acceleration=acceleration, twist=twist)

    def limited_to(self, setpoint: Setpoint) -> Point:
        """Return it with the setpoint that the limits left: positions clamped, efforts scaled as a whole."""
        wanted = self.setpoint.values
        if setpoint.values is wanted or setpoint.values.tolist() == wanted.tolist():
            return self
        joints, wrench = self.joints, self.wrench
        if setpoint.mode is Mode.JOINT_POSITION and joints is not None:
            joints = replace(joints, position=setpoint.values)
        if setpoint.mode is Mode.JOINT_VELOCITY and joints is not None:
            joints = replace(joints, velocity=setpoint.values)
        if setpoint.mode is Mode.JOINT_EFFORT and wrench.size:
            share = np.linalg.norm(setpoint.values) / np.linalg.norm(wanted)
            wrench = vector(wrench * share)
        return replace(self, setpoint=setpoint, joints=joints, wrench=wrench)


@dataclass(frozen=True, slots=True, eq=False)
class _Active:
    """The setpoint in force: `mode` None means holding, or the hardware's own trajectory.

    `drift` is how fast positions that come without a velocity are moving on, joints (n,) or the tool (6,):
    they were sent at the time `sent`, `interval` after those before.
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


class Feedback:
    """The newest values of one device.

    Args:
        device: asked for kinematics.
        stale_after: seconds after which a sample is no longer valid.

    Attributes:
        axes: of wrenches.
    """

    def __init__(self, device: Device, stale_after: float) -> None:
        self.axes = WrenchAxes()
        self._device = device
        self._capabilities = device.capabilities
        self._stale_after = stale_after
        self._fastest = vector([limit.velocity for limit in device.capabilities.limits])
        self._at_rest = vector(np.zeros(len(self._fastest)))
        self._told = self._at_rest
        self._told_at = -math.inf
        self._sample: Sample | None = None
        self._active = _Active()
        self._cached_pose: tuple[JointState, Pose] | None = None
        self._latched: dict[str, tuple[Value, Stamp]] = {}

    # ----------------------------------------------------------------------------------- written by

    def take(self, sample: Sample) -> None:
        """A new sample arrived. One without values tells of the link only: what was known goes on ageing."""
        if sample.values or self._sample is None:
            self._sample = sample
            self._told, self._told_at = self._at_rest, sample.stamp.monotonic

    def invalidate(self) -> None:
        """The link is lost: what was read last is not valid any more."""
        if self._sample is not None:
            self._sample = replace(self._sample, stamp=Stamp(0, -math.inf))

    def seed(self, now: float) -> bool:
        """The device was enabled: the setpoint is where it is. Return False if that is not known now."""
        if self.sample_age(now) > self._stale_after:
            return False
        self._active = _Active(None, JointState(position=self._measured().position))
        return True

    def sent(self, point: Point, now: float, stamp_ns: int = 0) -> None:
        """A setpoint went out.

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
        before, sent, interval = self._active, now, now - self._active.sent
        drift = EMPTY
        if before.mode is mode and not (joints.velocity.size or twist.size):
            if _is_repeated(before, joints.position, pose):  # between two commands
                drift, sent, interval = before.drift, before.sent, before.interval
            elif 0.0 < interval <= _SLOWEST:
                drift = _drift(mode, before, joints.position, pose, interval)
        self._active = _Active(
            mode, joints, pose, point.acceleration, twist, wrench, drift, stamp_ns, sent, interval
        )

    def stream_ended(self) -> None:
        """No more commands come: the last setpoint stays in force."""
        self._active = replace(self._active, stamp_ns=0)

    def follow_device(self) -> None:
        """The hardware makes its own setpoints from now on."""
        self._active = _Active()

    def hold(self) -> None:
        """Motion was stopped: the setpoint is what the hardware reports as its own.

        If it reports none, a position that was sent is held, and anything else ends where it ends.
        """
        position = self._active.joints.position
        keeps = position.size and self._native("setpoint_js") is None
        self._active = _Active(None, JointState(position=position)) if keeps else _Active()

    def forget_pose(self) -> None:
        """The kinematics are others now: what was computed with them does not count."""
        self._cached_pose = None

    def release(self) -> None:
        """The arm is free: there is no setpoint but where it is."""
        self._active = _Active()

    def latch(self, values: Mapping[str, Value], stamp_ns: int = 0) -> None:
        """Keep what ``goal_*`` or the settings say from now on, with the stamp of the command, if any."""
        stamp = Stamp(stamp_ns or time.time_ns(), time.monotonic())
        self._latched.update({name: (self._named(value), stamp) for name, value in values.items()})

    # -------------------------------------------------------------------------------------- read by

    def sample_age(self, now: float) -> float:
        """Return the seconds since the newest sample was acquired; infinite without one."""
        return math.inf if self._sample is None else now - self._sample.stamp.monotonic

    def latched(self, name: str) -> tuple[Value, Stamp] | None:
        """Return what `latch` kept; None if there never was a value."""
        return self._latched.get(name)

    def get(self, name: str, now: float, state: OperatingState) -> tuple[Value, Stamp] | None:
        """Return a value and its stamp, with `wall_ns` 0 if it is not valid now."""
        sample = self._sample
        if sample is None:
            return None
        frame, _, base_name = name.rpartition("/")
        if frame in ("body", "spatial") and name not in sample.values:
            return self._in_frame(base_name, frame, now, state)
        if frame == "local" and name not in sample.values:
            return self._in_own_base(base_name, now, state)
        stale = now - sample.stamp.monotonic > self._stale_after
        stamp = Stamp(0, sample.stamp.monotonic) if stale else sample.stamp
        if not name.startswith("setpoint_"):
            value = sample.values.get(name)
            if name == "jacobian":
                value = self._jacobian(sample)
            return None if value is None else (value, stamp)
        if state not in (OperatingState.ENABLED, OperatingState.PAUSED):
            stamp = Stamp(0, stamp.monotonic)
        elif self._active.stamp_ns and stamp.wall_ns:
            stamp = Stamp(self._active.stamp_ns, stamp.monotonic)
        setpoints: dict[str, Callable[[Sample, Stamp], tuple[Value, Stamp] | None]] = {
            "setpoint_js": lambda sample, stamp: (self._named(self.joint_setpoint()), stamp),
            "setpoint_cp": self._pose_setpoint,
            "setpoint_cv": self._twist_setpoint,
            "setpoint_cf": self._wrench_setpoint,
        }
        return setpoints[name](sample, stamp)

    def _in_own_base(
        self, name: str, now: float, state: OperatingState
    ) -> tuple[Value, Stamp] | None:
        """Return a pose as it is in the device's own base."""
        found, base = self.get(name, now, state), self._capabilities.base_pose
        if found is None or base is None or not isinstance(found[0], Pose):
            return found
        return replace(relative(base, found[0]), frame_id="local"), found[1]

    def _in_frame(
        self, name: str, frame: str, now: float, state: OperatingState
    ) -> tuple[Value, Stamp] | None:
        """Return a value of the base frame as it is in another frame."""
        found = self.get(name, now, state)
        if found is None:
            return None
        value, stamp = found
        is_setpoint = name.startswith("setpoint_")
        pose = self.reference_pose() if is_setpoint else self._measured_pose()
        if pose is None:
            return value, Stamp(0, stamp.monotonic)
        tool, base = self._capabilities.tool_frame, self._capabilities.base_frame
        told_in = tool if frame == "body" else base
        if isinstance(value, Twist):
            twist = value.vector
            if value.frame_id == tool:
                twist = twist_in_base(twist, "body", pose)
            twist = twist_from_base(twist, frame, pose)
            return Twist(twist[:3], twist[3:], told_in), stamp
        if isinstance(value, Wrench):
            wrench = value.vector
            if value.frame_id == tool:
                wrench = wrench_in_base(wrench, "body", pose)
            if frame == "body" and self.axes.absolute:
                frame, told_in = "", base
            wrench = wrench_from_base(wrench, frame, pose)
            return Wrench(wrench[:3], wrench[3:], told_in), stamp
        assert isinstance(value, Matrix)
        return Matrix(jacobian_from_base(value.values, frame, pose)), stamp

    def joint_setpoint(self) -> JointState:
        """Return the joint setpoint in force, see the table at the top."""
        active, native = self._active, self._native("setpoint_js")
        joint_mode = active.mode is not None and active.mode.space is Space.JOINT
        if joint_mode or active.joints.position.size:
            effort = native.effort if native is not None else EMPTY
            if active.joints.effort.size or not effort.size:
                return active.joints
            return replace(active.joints, effort=effort)
        if native is not None:
            return native
        if active.mode is None:
            return JointState(position=self._measured().position)
        return JointState()

    def reference_joints(self) -> Vector:
        """Return the joint position (n,) that relative commands and kinematics start from."""
        position = self.joint_setpoint().position
        return position if position.size else self._measured().position

    def expected_joints(self, ahead: float) -> Vector:
        """Return where a stream of joint positions (n,) will be `ahead` seconds after the last, at a guess.

        Inverse kinematics has the least to do from there. It is `reference_joints` if nothing streams.
        """
        here, drift = self.reference_joints(), self._active.drift
        if drift.size != here.size or self._active.mode is not Mode.JOINT_POSITION:
            return here
        way = [speed * ahead for speed in drift.tolist()]
        if max(map(abs, way)) > _FURTHEST:
            return here
        return vector([joint + step for joint, step in zip(here.tolist(), way, strict=True)])

    def measured_joints(self) -> Vector:
        """Return the joint position (n,) that was measured last."""
        return self._measured().position

    def measured_state(self) -> tuple[JointState, float]:
        """Return the joints as measured last, and when that was, in monotonic seconds."""
        sample = self._sample
        return self._measured(), -math.inf if sample is None else sample.stamp.monotonic

    def motion(self, now: float) -> tuple[Vector, Vector, Vector]:
        """Return joint position, velocity and acceleration (n,) that a new motion starts from."""
        active = self._active
        position = self.reference_joints()
        velocity, acceleration = self.joint_setpoint().velocity, active.acceleration
        if active.mode is Mode.JOINT_POSITION and self._drifts(now):
            velocity = active.drift
        elif not velocity.size and active.mode not in _POSITION_MODES:
            velocity = self._measured().velocity  # an effort or a twist is in force
        at_rest = vector(np.zeros(position.size))
        return (
            position,
            velocity if velocity.size else at_rest,
            acceleration if acceleration.size else at_rest,
        )

    @property
    def goes_on(self) -> bool:
        """Whether a trajectory of ours begins with the motion that is going on; else it begins at rest."""
        mode = self._active.mode
        if mode is None:
            return False
        return mode.kind is Kind.POSITION or not self._capabilities.stops_between_modes

    def _drifts(self, now: float) -> bool:
        """Whether the positions of a stream, which come without a velocity, are moving on.

        What was faster than anything may move was a step, and leads nowhere.
        """
        active, limits = self._active, self._capabilities.cartesian_limits
        if not active.drift.size or now - active.sent >= _STREAMING * active.interval:
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

        Args:
            native: prefer what the hardware reports as its own, which may know the arm better.
        """
        sample, pose = self._sample, self._active.pose
        if native and sample is not None:
            own = sample.values.get("setpoint_cp")
            if isinstance(own, Pose):
                return own
        if pose.size:
            return Pose(pose[:3], pose[3:], self._capabilities.base_frame)
        joints = self.reference_joints()
        if joints.size and self._capabilities.has_kinematics:
            return self._device.forward_kinematics(joints)
        return self._measured_pose()

    def reference_twist(self, now: float) -> Vector:
        """Return the twist (6,) of the tool, base axes, that a new motion starts from."""
        if self._active.twist.size:
            return self._active.twist
        if self._active.mode is Mode.CARTESIAN_POSITION and self._drifts(now):
            return self._active.drift
        joints, velocity, _ = self.motion(now)
        if not self._capabilities.has_kinematics or not velocity.any():
            return vector(np.zeros(6))
        return vector(self._device.jacobian(joints) @ velocity)

    def reference_twist_change(self, now: float) -> Vector:
        """Return the derivative (6,) of `reference_twist`, as far as it is known."""
        joints, velocity, acceleration = self.motion(now)
        if not self._capabilities.has_kinematics or not (velocity.any() or acceleration.any()):
            return vector(np.zeros(6))
        jacobian = self._device.jacobian(joints)
        ahead = self._device.jacobian(vector(joints + velocity * _SHORT))
        return vector(jacobian @ acceleration + (ahead - jacobian) @ velocity / _SHORT)

    def commanded_wrench(self) -> Vector:
        """Return the wrench (6,), base axes, that was sent last; zero unless one is in force."""
        return self._active.wrench if self._active.wrench.size else vector(np.zeros(6))

    def commanded_effort(self) -> Vector:
        """Return the joint effort (n,) that was sent last; empty unless an effort is in force."""
        is_effort = self._active.mode is Mode.JOINT_EFFORT
        return self._active.joints.effort if is_effort else EMPTY

    def before(self, mode: Mode, now: float = -math.inf) -> Vector:
        """Return what a new setpoint of `mode` is judged by.

        For positions and poses what was sent before them, to find a jump; else the joints as measured, and
        moved on from there if at `now` that was long ago.
        """
        if mode is Mode.JOINT_POSITION:
            return self.reference_joints()
        if mode is Mode.CARTESIAN_POSITION:
            if self._active.pose.size:
                return self._active.pose
            pose = self._measured_pose()
            return EMPTY if pose is None else vector((*pose.position, *pose.orientation))
        return self._moved_on(now)

    def _moved_on(self, now: float) -> Vector:
        """Return where the joints (n,) are by now if they have gone on as they did, or as they were told."""
        here, age = self._measured(), self.sample_age(now)
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
        """Return how far (n,) the joints were told to go by velocities since the newest sample."""
        velocity = self._active.joints.velocity
        if velocity.size != self._told.size or self._active.mode is not Mode.JOINT_VELOCITY:
            return self._told
        return self._told + velocity * max(0.0, now - self._told_at)

    def _measured_pose(self) -> Pose | None:
        sample = self._sample
        value = sample.values.get("measured_cp") if sample is not None else None
        if isinstance(value, Pose):
            return value
        joints = self._measured().position
        if joints.size and self._capabilities.has_kinematics:
            return self._device.forward_kinematics(joints)
        return None

    def _measured(self) -> JointState:
        sample = self._sample
        value = sample.values.get("measured_js") if sample is not None else None
        return value if isinstance(value, JointState) else JointState()

    def _native(self, name: str) -> JointState | None:
        sample = self._sample
        value = sample.values.get(name) if sample is not None else None
        return value if isinstance(value, JointState) else None

    def _named(self, value: Value) -> Value:
        """Return a value as it is told: joints have their names."""
        if not isinstance(value, JointState) or value.name:
            return value
        return replace(value, name=self._capabilities.joints)

    def _pose_setpoint(self, sample: Sample, stamp: Stamp) -> tuple[Value, Stamp] | None:
        active = self._active
        if active.mode not in _POSITION_MODES:
            stamp = Stamp(0, stamp.monotonic)
        if active.pose.size:
            pose = Pose(active.pose[:3], active.pose[3:], self._capabilities.base_frame)
            return pose, stamp
        native = sample.values.get("setpoint_cp")
        if native is not None and not active.joints.position.size:
            return native, stamp
        joints = self.joint_setpoint()
        if not joints.position.size:
            joints = self._measured()
            stamp = Stamp(0, stamp.monotonic)
        if not joints.position.size:
            return None
        if self._cached_pose is None or self._cached_pose[0] is not joints:
            pose = self._device.forward_kinematics(joints.position)
            self._cached_pose = (joints, pose)
        return self._cached_pose[1], stamp

    def _twist_setpoint(self, sample: Sample, stamp: Stamp) -> tuple[Value, Stamp]:
        is_effort = self._active.mode is not None and self._active.mode.kind is Kind.EFFORT
        known = self._active.twist.size or self.joint_setpoint().velocity.size
        twist = self.reference_twist(stamp.monotonic)
        if is_effort or not known:
            stamp = Stamp(0, stamp.monotonic)
        return Twist(twist[:3], twist[3:], self._capabilities.base_frame), stamp

    def _wrench_setpoint(self, sample: Sample, stamp: Stamp) -> tuple[Value, Stamp]:
        wrench = self.commanded_wrench()
        if not self._active.wrench.size:
            stamp = Stamp(0, stamp.monotonic)
        return Wrench(wrench[:3], wrench[3:], self._capabilities.base_frame), stamp

    def _jacobian(self, sample: Sample) -> Matrix | None:
        value = sample.values.get("measured_js")
        if not isinstance(value, JointState) or not self._capabilities.has_kinematics:
            return None
        return Matrix(self._device.jacobian(value.position))


def _is_repeated(before: _Active, position: Vector, pose: Vector) -> bool:
    known = before.joints.position.tolist(), before.pose.tolist()
    return (position.tolist(), pose.tolist()) == known


def _drift(mode: Mode, before: _Active, position: Vector, pose: Vector, interval: float) -> Vector:
    """Return how fast a stream of positions or poses (7,) moves."""
    if mode is Mode.JOINT_POSITION and before.joints.position.size:
        return vector((position - before.joints.position) / interval)
    if mode is Mode.CARTESIAN_POSITION and before.pose.size:
        moved = pose[:3] - before.pose[:3]
        return vector(np.concatenate((moved, turn(pose[3:], before.pose[3:]))) / interval)
    return EMPTY
