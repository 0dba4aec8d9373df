"""What goes out in one cycle, and what is known of the motion that it belongs to."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from crtk_drivers.device import Mode, Setpoint
from crtk_drivers.samples import JointState, Vector, empty, vector


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
        """Return the point as it is sent when its trajectory runs at `pace`, a share of real time.

        Velocities are slower by that, accelerations by its square.
        """
        if pace == 1.0:
            return self
        joints = self.joints
        if joints is not None:
            joints = replace(joints, velocity=vector(joints.velocity * pace))
        acceleration, twist = vector(self.acceleration * pace * pace), vector(self.twist * pace)
        return replace(self, joints=joints, acceleration=acceleration, twist=twist)

    def limited_to(self, setpoint: Setpoint) -> Point:
        """Return the point with what the limits left of its setpoint; joints and wrench change with it."""
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
