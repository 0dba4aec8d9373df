"""Rigid-body dynamics of one arm, on pinocchio: forward, inverse, gravity, in the axes of its base."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crtk_driver_virtual.models import Arm
from crtk_drivers.kinematics.chain import JointKind
from crtk_drivers.samples import Array, Pose, Vector


class ArmDynamics:
    """The equation of motion M(q) a + h(q, v) = effort of one arm. Not for two threads at a time.

    Joint vectors are (n,), in the order of the chain; the Jacobian is (6, n), linear rows first.

    Args:
        arm: links and joints.
        gravity: acceleration of free fall (3,) in base axes, in m/s².
        extra_inertia: (n,) added to the diagonal of M, in kg·m² (kg).
        tool: of the tool point in the tip of the chain.
    """

    def __init__(
        self, arm: Arm, gravity: Sequence[float], extra_inertia: Vector, tool: Pose | None = None
    ) -> None:
        import pinocchio as pin

        self._pin = pin
        model = pin.Model()
        model.gravity.linear = np.array(gravity, dtype=np.float64)
        kinds = {
            JointKind.REVOLUTE: pin.JointModelRevoluteUnaligned,
            JointKind.PRISMATIC: pin.JointModelPrismaticUnaligned,
        }
        parent = 0
        for joint, inertia in zip(arm.chain.joints, arm.inertias, strict=True):
            placement = pin.SE3(joint.placement[:3, :3], joint.placement[:3, 3])
            parent = model.addJoint(parent, kinds[joint.kind](joint.axis), placement, joint.name)
            model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
        model.armature = np.array(extra_inertia)
        tip = pin.SE3(arm.chain.tip[:3, :3], arm.chain.tip[:3, 3])
        if tool is not None:
            tip *= pin.XYZQUATToSE3(np.concatenate((tool.position, tool.orientation)))
        frame = pin.Frame("tool", parent, 0, tip, pin.FrameType.OP_FRAME)
        self._frame = model.addFrame(frame)
        self._model = model
        self._data = model.createData()

    def tool(self, q: Vector) -> tuple[Vector, Array]:
        """Return the tool point (3,) in m and the Jacobian there, in base axes."""
        pin, data = self._pin, self._data
        jacobian: Array = pin.computeFrameJacobian(
            self._model, data, q, self._frame, pin.LOCAL_WORLD_ALIGNED
        )
        return data.oMf[self._frame].translation.copy(), jacobian

    def acceleration(self, q: Vector, v: Vector, effort: Vector) -> Vector:
        """Return the acceleration under joint efforts (forward dynamics)."""
        found: Vector = self._pin.aba(self._model, self._data, q, v, effort)
        return found

    def effort(self, q: Vector, v: Vector, a: Vector) -> Vector:
        """Return the joint efforts that lead to an acceleration (inverse dynamics)."""
        found: Vector = self._pin.rnea(self._model, self._data, q, v, a)
        return found

    def weight(self, q: Vector) -> Vector:
        """Return the joint efforts that carry the arm's weight at rest."""
        found: Vector = self._pin.computeGeneralizedGravity(self._model, self._data, q)
        return found

    def mobility(self, q: Vector) -> Array:
        """Return the inverse of the mass matrix, (n, n)."""
        found: Array = self._pin.computeMinverse(self._model, self._data, q)
        return found

    def energy(self, q: Vector, v: Vector) -> float:
        """Return kinetic plus potential energy, in J."""
        pin, model, data = self._pin, self._model, self._data
        mass_matrix = pin.crba(model, data, q)
        return float(0.5 * v @ mass_matrix @ v + pin.computePotentialEnergy(model, data, q))
