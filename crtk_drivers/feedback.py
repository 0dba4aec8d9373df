"""What a device measures and what it was told: the values behind ``measured_*``, ``setpoint_*``, ``goal_*``.

Written by the I/O thread (samples, setpoints) and by clients' threads (goals); read by anyone. Each write
replaces one reference, so that a reader always sees values that belong together.

The contents of a setpoint depend on the command that made it:

    servo_jp, servo_cp    position sent; no velocity
    servo_jv              velocity sent; no position
    servo_jf              effort sent; neither position nor velocity
    servo_cv, servo_cf    the hardware's own setpoint if it reports one; setpoint_cp is invalid;
                          servo_cv by joints: their velocity, or the integrated position with it
    move_jp, move_cp      p(t) and v(t) of the trajectory
    interpolate_jp, _jr   p(t) and v(t) of the interpolation; _cp, _cr the same by kinematics
    interpolate_jv        v(t); no position
    interpolate_cv        as servo_cv
    interpolate_jf        the effort at the time; neither position nor velocity
    none (holding)        the position held
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from crtk_drivers.commands import Space
from crtk_drivers.device import Device, Mode, Setpoint
from crtk_drivers.samples import (
    EMPTY,
    JointState,
    Matrix,
    Pose,
    Sample,
    Stamp,
    Value,
    Vector,
    empty,
    joint_state,
    vector,
)
from crtk_drivers.state import OperatingState

_POSITION_MODES = frozenset({None, Mode.JOINT_POSITION, Mode.CARTESIAN_POSITION})


@dataclass(frozen=True, slots=True, eq=False)
class _Active:
    """The setpoint in force: `mode` None means holding, or the hardware's own trajectory."""

    mode: Mode | None = None
    joints: JointState = field(default_factory=JointState)
    pose: Vector = field(default_factory=empty)
    acceleration: Vector = field(default_factory=empty)
    twist: Vector = field(default_factory=empty)


class Feedback:
    """The newest values of one device.

    Args:
        device: asked for kinematics.
        stale_after: seconds after which a sample is no longer valid.
    """

    def __init__(self, device: Device, stale_after: float) -> None:
        self._device = device
        self._capabilities = device.capabilities
        self._stale_after = stale_after
        self._sample: Sample | None = None
        self._active = _Active()
        self._cached_pose: tuple[JointState, Pose] | None = None
        self.goals: dict[str, tuple[Value, Stamp]] = {}

    # ----------------------------------------------------------------------------------- written by

    def take(self, sample: Sample) -> None:
        """A new sample arrived."""
        self._sample = sample

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

    def sent(
        self,
        setpoint: Setpoint,
        joints: JointState | None = None,
        acceleration: Vector = EMPTY,
        twist: Vector = EMPTY,
    ) -> None:
        """A setpoint went out.

        Args:
            setpoint: that went out.
            joints: what ``setpoint_js`` says of it, where that does not follow from the setpoint alone: the
                point of a trajectory of ours.
            acceleration: (n,) of the joints, for the motion that follows; empty if unknown.
            twist: (6,) of the tool, for the motion that follows; empty if unknown.
        """
        mode, values = setpoint.mode, setpoint.values
        if joints is None:
            in_joints = mode.space is Space.JOINT
            joints = joint_state(mode.kind, values) if in_joints else JointState()
        pose = values if mode is Mode.CARTESIAN_POSITION else EMPTY
        if mode is Mode.CARTESIAN_VELOCITY:
            twist = values
        self._active = _Active(mode, joints, pose, acceleration, twist)

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

    def release(self) -> None:
        """The arm is free: there is no setpoint but where it is."""
        self._active = _Active()

    def accept_goals(self, goals: Mapping[str, Value]) -> None:
        """Latch what ``goal_*`` say from now on."""
        stamp = Stamp.now()
        self.goals.update({name: (value, stamp) for name, value in goals.items()})

    # -------------------------------------------------------------------------------------- read by

    def sample_age(self, now: float) -> float:
        """Return the seconds since the newest sample was acquired; infinite without one."""
        return math.inf if self._sample is None else now - self._sample.stamp.monotonic

    def get(self, name: str, now: float, state: OperatingState) -> tuple[Value, Stamp] | None:
        """Return a value and its stamp, with `wall_ns` 0 if it is not valid now."""
        sample = self._sample
        if sample is None:
            return None
        stale = now - sample.stamp.monotonic > self._stale_after
        stamp = Stamp(0, sample.stamp.monotonic) if stale else sample.stamp
        if not name.startswith("setpoint_"):
            value = sample.values.get(name)
            if name == "jacobian":
                value = self._jacobian(sample)
            return None if value is None else (value, stamp)
        valid = state in (OperatingState.ENABLED, OperatingState.PAUSED)
        if not valid:
            stamp = Stamp(0, stamp.monotonic)
        if name == "setpoint_js":
            return self._named(self.joint_setpoint()), stamp
        if name == "setpoint_cp":
            return self._pose_setpoint(sample, stamp)
        return None

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

    def motion(self) -> tuple[Vector, Vector, Vector]:
        """Return joint position, velocity and acceleration (n,) that a new motion starts from."""
        position = self.reference_joints()
        velocity, acceleration = self.joint_setpoint().velocity, self._active.acceleration
        if not velocity.size and self._active.mode not in _POSITION_MODES:
            velocity = self._measured().velocity  # an effort or a twist is in force
        at_rest = vector(np.zeros(position.size))
        return (
            position,
            velocity if velocity.size else at_rest,
            acceleration if acceleration.size else at_rest,
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
        measured = sample.values.get("measured_cp") if sample is not None else None
        return measured if isinstance(measured, Pose) else None

    def reference_twist(self) -> Vector:
        """Return the twist (6,) of the tool, base axes, that a new motion starts from."""
        if self._active.twist.size:
            return self._active.twist
        joints, velocity, _ = self.motion()
        if not self._capabilities.has_kinematics or not velocity.any():
            return vector(np.zeros(6))
        return vector(self._device.jacobian(joints) @ velocity)

    def commanded_effort(self) -> Vector:
        """Return the joint effort (n,) that was sent last; empty unless an effort is in force."""
        is_effort = self._active.mode is Mode.JOINT_EFFORT
        return self._active.joints.effort if is_effort else EMPTY

    def before(self, mode: Mode) -> Vector:
        """Return what a new setpoint of `mode` is compared with to find a jump."""
        if mode is Mode.JOINT_POSITION:
            return self.reference_joints()
        if mode is Mode.CARTESIAN_POSITION:
            return self._active.pose if self._active.pose.size else self._measured_pose()
        return EMPTY

    def _measured_pose(self) -> Vector:
        sample = self._sample
        value = sample.values.get("measured_cp") if sample is not None else None
        if not isinstance(value, Pose):
            return EMPTY
        return vector(np.concatenate((value.position, value.orientation)))

    def _measured(self) -> JointState:
        sample = self._sample
        value = sample.values.get("measured_js") if sample is not None else None
        return value if isinstance(value, JointState) else JointState()

    def _native(self, name: str) -> JointState | None:
        sample = self._sample
        value = sample.values.get(name) if sample is not None else None
        return value if isinstance(value, JointState) else None

    def _named(self, value: JointState) -> JointState:
        return value if value.name else replace(value, name=self._capabilities.joints)

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

    def _jacobian(self, sample: Sample) -> Matrix | None:
        value = sample.values.get("measured_js")
        if not isinstance(value, JointState) or not self._capabilities.has_kinematics:
            return None
        return Matrix(self._device.jacobian(value.position))
