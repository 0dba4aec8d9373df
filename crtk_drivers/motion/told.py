"""What the fronts tell of a device: the values behind ``measured_*``, ``setpoint_*``, ``goal_*``.

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
anyone can see which commands took effect, and when; of two that went out between two samples, the second.
Otherwise it is the stamp of the newest sample.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace

from crtk_drivers.commands import Kind
from crtk_drivers.geometry.frames import (
    jacobian_from_base,
    relative,
    twist_from_base,
    twist_in_base,
    wrench_from_base,
    wrench_in_base,
)
from crtk_drivers.motion.feedback import POSITION_MODES, Feedback
from crtk_drivers.samples import JointState, Matrix, Pose, Sample, Stamp, Twist, Value, Wrench
from crtk_drivers.state import OperatingState


class Told:
    """The newest values of one device, each with its stamp. From any thread.

    Args:
        feedback: of the device.
    """

    def __init__(self, feedback: Feedback) -> None:
        self._device = feedback.device
        self._capabilities = feedback.device.capabilities
        self._feedback = feedback
        self._cached_pose: tuple[object, object, Pose] | None = None  # of a position, by kinematics
        self._latched: dict[str, tuple[Value, Stamp]] = {}
        self._setpoints: Mapping[str, Callable[[Sample, Stamp], tuple[Value, Stamp] | None]] = {
            "setpoint_js": self._joint_setpoint,
            "setpoint_cp": self._pose_setpoint,
            "setpoint_cv": self._twist_setpoint,
            "setpoint_cf": self._wrench_setpoint,
        }

    def latch(self, values: Mapping[str, Value], stamp_ns: int = 0) -> None:
        """Keep what ``goal_*`` or the settings say from now on, with the stamp of the command, if any."""
        stamp = Stamp(stamp_ns or time.time_ns(), time.monotonic())
        self._latched.update({name: (self._named(value), stamp) for name, value in values.items()})

    def latched(self, name: str) -> tuple[Value, Stamp] | None:
        """Return what `latch` kept; None if there never was a value."""
        return self._latched.get(name)

    def get(self, name: str, now: float, state: OperatingState) -> tuple[Value, Stamp] | None:
        """Return a value and its stamp, with `wall_ns` 0 if it is not valid now."""
        sample = self._feedback.sample
        if sample is None:
            return None
        frame, _, base_name = name.rpartition("/")
        if frame in ("body", "spatial") and name not in sample.values:
            return self._in_frame(base_name, frame, now, state)
        if frame == "local" and name not in sample.values:
            return self._in_own_base(base_name, now, state)
        stale = now - sample.stamp.monotonic > self._feedback.stale_after
        stamp = Stamp(0, sample.stamp.monotonic) if stale else sample.stamp
        if not name.startswith("setpoint_"):
            value = sample.values.get(name)
            if name == "jacobian":
                value = self._jacobian(sample)
            return None if value is None else (value, stamp)
        if state not in (OperatingState.ENABLED, OperatingState.PAUSED):
            stamp = Stamp(0, stamp.monotonic)
        elif self._feedback.active.stamp_ns and stamp.wall_ns:
            stamp = Stamp(self._feedback.active.stamp_ns, stamp.monotonic)
        return self._setpoints[name](sample, stamp)

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
        pose = self._feedback.reference_pose() if is_setpoint else self._feedback.measured_pose()
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
            if frame == "body" and self._feedback.axes.absolute:
                frame, told_in = "", base
            wrench = wrench_from_base(wrench, frame, pose)
            return Wrench(wrench[:3], wrench[3:], told_in), stamp
        assert isinstance(value, Matrix)
        return Matrix(jacobian_from_base(value.values, frame, pose)), stamp

    def _named(self, value: Value) -> Value:
        """Return a value as it is told: joints have their names."""
        if not isinstance(value, JointState) or value.name:
            return value
        return replace(value, name=self._capabilities.joints)

    def _joint_setpoint(self, sample: Sample, stamp: Stamp) -> tuple[Value, Stamp]:
        return self._named(self._feedback.joint_setpoint()), stamp

    def _pose_setpoint(self, sample: Sample, stamp: Stamp) -> tuple[Value, Stamp] | None:
        active = self._feedback.active
        if active.mode not in POSITION_MODES:
            stamp = Stamp(0, stamp.monotonic)
        if active.pose.size:
            pose = Pose(active.pose[:3], active.pose[3:], self._capabilities.base_frame)
            return pose, stamp
        native = sample.values.get("setpoint_cp")
        if native is not None and not active.joints.position.size:
            return native, stamp
        joints = self._feedback.joint_setpoint()
        if not joints.position.size:
            joints = self._feedback.measured
            stamp = Stamp(0, stamp.monotonic)
        position, kinematics = joints.position, self._device.kinematics
        if not position.size or kinematics is None:
            return None
        cached = self._cached_pose
        if cached is None or cached[0] is not position or cached[1] is not kinematics:
            self._cached_pose = cached = position, kinematics, kinematics.forward(position)
        return cached[2], stamp

    def _twist_setpoint(self, sample: Sample, stamp: Stamp) -> tuple[Value, Stamp]:
        is_effort = (
            self._feedback.active.mode is not None
            and self._feedback.active.mode.kind is Kind.EFFORT
        )
        known = self._feedback.active.twist.size or self._feedback.joint_setpoint().velocity.size
        twist = self._feedback.reference_twist(stamp.monotonic)
        if is_effort or not known:
            stamp = Stamp(0, stamp.monotonic)
        return Twist(twist[:3], twist[3:], self._capabilities.base_frame), stamp

    def _wrench_setpoint(self, sample: Sample, stamp: Stamp) -> tuple[Value, Stamp]:
        wrench = self._feedback.commanded_wrench()
        if not self._feedback.active.wrench.size:
            stamp = Stamp(0, stamp.monotonic)
        return Wrench(wrench[:3], wrench[3:], self._capabilities.base_frame), stamp

    def _jacobian(self, sample: Sample) -> Matrix | None:
        value, kinematics = sample.values.get("measured_js"), self._device.kinematics
        if not isinstance(value, JointState) or kinematics is None:
            return None
        return Matrix(kinematics.jacobian(value.position))
