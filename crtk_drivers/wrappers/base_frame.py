"""A device that stands somewhere: its own base has a pose in another frame, in which it is then used."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from typing_extensions import override

from crtk_drivers.commands import Space
from crtk_drivers.device import Capabilities, Device, Goal, Kinematics, Mode, Setpoint
from crtk_drivers.geometry.frames import product, relative, twist_from_base, twist_in_base
from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from crtk_drivers.samples import Array, Pose, Poses, Sample, Twist, Value, Vector, Wrench, vector
from crtk_drivers.wrappers.forwarding import WrappedDevice


class _PlacedKinematics(Kinematics):
    """The kinematics of a device, in the other frame."""

    def __init__(self, inner: Kinematics, base: Pose, own_frame: str) -> None:
        self.inner = inner
        self._base = base
        self._own_frame = own_frame
        self._rotation = matrix_from_quaternion(base.orientation)

    @override
    def forward(self, joints: Vector) -> Pose:
        return product(self._base, self.inner.forward(joints))

    @override
    def inverse(self, pose: Pose, reference: Vector) -> Vector:
        return self.inner.inverse(_inwards(pose, self._base, self._own_frame), reference)

    @override
    def nearby_inverse(self, pose: Pose, reference: Vector) -> Vector:
        return self.inner.nearby_inverse(_inwards(pose, self._base, self._own_frame), reference)

    @override
    def jacobian(self, joints: Vector) -> Array:
        jacobian = self.inner.jacobian(joints)
        return np.concatenate((self._rotation @ jacobian[:3], self._rotation @ jacobian[3:]))


class PlacedDevice(WrappedDevice):
    """Gives and takes everything Cartesian in another frame; what is measured is there as ``local/`` too.

    Args:
        inner: the device, in its own base.
        base: pose of that base in the frame `base.frame_id`.
    """

    def __init__(self, inner: Device, base: Pose) -> None:
        super().__init__(inner)
        own = inner.capabilities
        self._own_frame = own.base_frame
        self._base = base
        self._kinematics: _PlacedKinematics | None = None
        self._children = {
            name: PlacedDevice(child, base) if _is_seen_from(own.base_frame, child) else child
            for name, child in inner.children.items()
        }
        local = [f"local/{name}" for name in own.measured if name.startswith("measured_c")]
        self._capabilities = replace(
            own,
            base_frame=base.frame_id,
            base_pose=base,
            measured=tuple(dict.fromkeys((*own.measured, *local))),
        )

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def children(self) -> Mapping[str, Device]:
        """Those whose poses are in the device's own base, as a tracker's tools, are placed likewise."""
        return self._children

    @property
    @override
    def kinematics(self) -> Kinematics | None:
        inner, placed = self.inner.kinematics, self._kinematics
        if inner is None:
            return None
        if placed is None or placed.inner is not inner:
            self._kinematics = placed = _PlacedKinematics(inner, self._base, self._own_frame)
        return placed

    @override
    def read(self, deadline: float) -> Sample | None:
        """Put what was read into the other frame."""
        sample = self.inner.read(deadline)
        if sample is None or sample.not_finite:
            return sample  # the core drops what is not finite
        values: dict[str, Value] = {}
        for name, value in sample.values.items():
            values[name] = value
            if isinstance(value, Pose | Poses | Twist | Wrench) and "/" not in name:
                values[name] = self._outwards(value)
                if name.startswith("measured_"):
                    values[f"local/{name}"] = replace(value, frame_id="local")
        return replace(sample, values=values)

    @override
    def write(self, setpoint: Setpoint) -> None:
        """Put a setpoint of the tool into the device's own base."""
        if setpoint.mode.space is Space.CARTESIAN:
            setpoint = Setpoint(setpoint.mode, self._to_send(setpoint))
        self.inner.write(setpoint)

    @override
    def move(self, goal: Goal) -> None:
        """Put a pose into the device's own base."""
        if goal.pose is not None:
            goal = replace(goal, pose=_inwards(goal.pose, self._base, self._own_frame))
        self.inner.move(goal)

    def _outwards(self, value: Pose | Poses | Twist | Wrench) -> Value:
        """Return a value in the other frame; what is in the tool's axes stays there."""
        if value.frame_id not in ("", self._own_frame):
            return value
        if isinstance(value, Pose):
            return product(self._base, value)
        if isinstance(value, Poses):
            poses = tuple(product(self._base, pose) for pose in value.poses)
            return Poses(poses, self._base.frame_id)
        turned = twist_in_base(vector(value.vector), "local", self._base, self._base)
        return type(value)(turned[:3], turned[3:], self._base.frame_id)

    def _to_send(self, setpoint: Setpoint) -> Vector:
        values = setpoint.values
        if setpoint.mode is Mode.CARTESIAN_POSITION:
            pose = _inwards(Pose(values[:3], values[3:]), self._base, self._own_frame)
            return vector((*pose.position, *pose.orientation))
        # A wrench turns as a twist does: both are at the tool point.
        return twist_from_base(values, "local", self._base, self._base)


def _is_seen_from(frame: str, device: Device) -> bool:
    own = device.capabilities
    return own.base_frame == frame and "measured_cp" in own.measured


def _inwards(pose: Pose, base: Pose, own_frame: str) -> Pose:
    """Return a pose of the other frame in the device's own base."""
    return replace(relative(base, pose), frame_id=own_frame)
