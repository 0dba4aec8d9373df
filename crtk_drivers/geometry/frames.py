"""The frames in which a Cartesian value may be given: the sub-namespaces ``local/``, ``body/``, ``spatial/``.

The core computes in the base frame: poses in it, twists and wrenches in its axes at the tool point.

    none       the base frame. An increment moves the tool point along its axes and turns the tool about these
               axes, through the tool point: p + dp, dR · R.
    local/     the same in the device's own base, which may have a pose in the base frame. Commands exist
               there where that pose is configured; else the two are one, and only poses are told.
    body/      axes of the tool, at the tool point; an increment is p + R · dp, R · dR.
    spatial/   axes of the base frame, at its origin: the twist of the point of the tool, extended, that is
               there, and the wrench with the moment about it. An increment moves the tool as a rigid motion
               of the whole base frame: T' = dT · T.

Wrenches of ``body/`` are along base axes, at the tool point, where a client asks for that (`WrenchAxes`).

A `frame` is one of `crtk_drivers.commands.FRAMES`, or empty.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crtk_drivers.commands import Command, Kind
from crtk_drivers.geometry.quaternions import quaternion_product, rotated, unit
from crtk_drivers.geometry.rates import cross, inverse
from crtk_drivers.samples import Array, Pose, Vector, vector


@dataclass(slots=True)
class WrenchAxes:
    """Along which axes the wrenches of ``body/`` are. Set by clients' threads, read in each cycle.

    Attributes:
        absolute: those of the base frame instead of the tool's, see ``body/set_cf_orientation_absolute``.
    """

    absolute: bool = False

    def frame_of(self, command: Command) -> str:
        """Return the frame in which the values of a command are."""
        if self.absolute and command.frame == "body" and command.kind is Kind.EFFORT:
            return ""
        return command.frame


def twist_in_base(twist: Vector, frame: str, pose: Pose, base: Pose | None = None) -> Vector:
    """Return a twist (6,) that is given in `frame`, linear before angular, in base axes at the tool point.

    Args:
        twist: in m/s and rad/s.
        frame: see the module.
        pose: of the tool, in the base frame.
        base: pose of the device's own base in the base frame, for ``local``.
    """
    if frame == "spatial":
        return _shifted(twist, 3, pose.position, -1.0)
    return _turned(twist, _axes(frame, pose, base))


def twist_from_base(twist: Vector, frame: str, pose: Pose, base: Pose | None = None) -> Vector:
    """Return a twist (6,) in base axes at the tool point as it is in `frame`; see `twist_in_base`."""
    if frame == "spatial":
        return _shifted(twist, 3, pose.position, 1.0)
    return _turned(twist, _axes(frame, pose, base), back=True)


def wrench_in_base(wrench: Vector, frame: str, pose: Pose, base: Pose | None = None) -> Vector:
    """As `twist_in_base` for a wrench (6,) in N and N·m, force before torque."""
    if frame == "spatial":
        return _shifted(wrench, 0, pose.position, -1.0)
    return _turned(wrench, _axes(frame, pose, base))


def wrench_from_base(wrench: Vector, frame: str, pose: Pose, base: Pose | None = None) -> Vector:
    """As `twist_from_base` for a wrench (6,)."""
    if frame == "spatial":
        return _shifted(wrench, 0, pose.position, 1.0)
    return _turned(wrench, _axes(frame, pose, base), back=True)


def jacobian_from_base(jacobian: Array, frame: str, pose: Pose, base: Pose | None = None) -> Array:
    """Return a Jacobian (6, n), whose columns are twists in base axes, with those as they are in `frame`."""
    columns = [twist_from_base(vector(column), frame, pose, base) for column in jacobian.T]
    return np.stack(columns, axis=1)


def pose_in_base(pose: Pose, frame: str, base: Pose | None = None) -> Pose:
    """Return a pose that is given in the device's own base (frame ``local``) in the base frame."""
    return product(base, pose) if frame == "local" and base is not None else pose


def product(first: Pose, second: Pose) -> Pose:
    """Return `second`, given in the frame that `first` is the pose of, in the frame of `first`."""
    x, y, z = rotated(first.orientation, *second.position.tolist())
    a, b, c = first.position.tolist()
    orientation = unit(quaternion_product(first.orientation, second.orientation))
    return Pose(vector((a + x, b + y, c + z)), orientation, first.frame_id)


def relative(first: Pose, second: Pose) -> Pose:
    """Return `second` as it is seen from `first`, both given in one frame: `product` undone."""
    back = inverse(first.orientation)
    (a, b, c), (x, y, z) = first.position.tolist(), second.position.tolist()
    position = vector(rotated(back, x - a, y - b, z - c))
    return Pose(position, unit(quaternion_product(back, second.orientation)))


def inverse_pose(pose: Pose) -> Pose:
    """Return the pose of the frame that `pose` is given in, as seen from `pose`."""
    orientation = inverse(pose.orientation)
    x, y, z = rotated(orientation, *pose.position.tolist())
    return Pose(vector((-x, -y, -z)), orientation)


def moved(pose: Pose, increment: Pose, frame: str = "", base: Pose | None = None) -> Pose:
    """Return the pose (in the base frame) after an increment that is given in `frame`.

    Args:
        pose: before it, in the base frame.
        increment: translation in m and unit quaternion.
        frame, base: as for `twist_in_base`.
    """
    if frame == "body":
        step = product(pose, increment)
        return Pose(step.position, step.orientation, pose.frame_id)
    position, change = pose.position.tolist(), increment.orientation
    step_by = increment.position.tolist()
    if frame == "spatial":
        position = rotated(change, *position)
    axes = _axes(frame, pose, base)
    if axes is not None:
        step_by = rotated(axes, *step_by)
        change = quaternion_product(quaternion_product(axes, change), inverse(axes))
    orientation = unit(quaternion_product(change, pose.orientation))
    stepped = vector([here + way for here, way in zip(position, step_by, strict=True)])
    return Pose(stepped, orientation, pose.frame_id)


def both(first: Pose, second: Pose, frame: str = "") -> Pose:
    """Return the increment in `frame` that is `second` after `first`."""
    if frame == "body":
        return product(first, second)
    if frame == "spatial":
        return product(second, first)
    orientation = unit(quaternion_product(second.orientation, first.orientation))
    return Pose(vector(first.position + second.position), orientation)


def _axes(frame: str, pose: Pose, base: Pose | None) -> Vector | None:
    """Return the quaternion of the axes of `frame`; None for those of the base frame."""
    if frame == "body":
        return pose.orientation
    return base.orientation if frame == "local" and base is not None else None


def _turned(values: Vector, axes: Vector | None, back: bool = False) -> Vector:
    if axes is None:
        return values
    x, y, z, rx, ry, rz = values.tolist()
    by = inverse(axes) if back else axes
    return vector((*rotated(by, x, y, z), *rotated(by, rx, ry, rz)))


def _shifted(values: Vector, free: int, point: Vector, sign: float) -> Vector:
    """Return a twist or wrench at the origin instead of at `point`, or with `sign` -1 the other way.

    `free` is where the half begins that is the same everywhere: the angular velocity, the force.
    """
    carried = cross(point.tolist(), values[free : free + 3].tolist())
    shifted = values.copy()
    shifted[3 - free : 6 - free] += sign * np.array(carried)
    return vector(shifted)
