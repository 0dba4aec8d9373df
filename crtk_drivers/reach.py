"""From poses of the tool to what the hardware takes: poses themselves, or joint positions by kinematics."""

from __future__ import annotations

import numpy as np

from crtk_drivers.commands import Command
from crtk_drivers.device import Device, Mode, Setpoint
from crtk_drivers.errors import CommandRefused, KinematicsError, Reason
from crtk_drivers.feedback import Feedback
from crtk_drivers.limits import CommandCheck
from crtk_drivers.resolved_rate import increment_in_base
from crtk_drivers.samples import Pose, Vector, vector


class Reach:
    """What one device can reach. Touches no bus; from any thread.

    Args:
        device: asked for kinematics.
        where: the device, for messages.
        check: of the joint positions that are found.
        feedback: where the device is.
    """

    def __init__(self, device: Device, where: str, check: CommandCheck, feedback: Feedback) -> None:
        self._device = device
        self._where = where
        self._check = check
        self._feedback = feedback
        self._takes_poses = Mode.CARTESIAN_POSITION in device.capabilities.modes

    def reference(self, command: Command) -> Vector:
        """Return the joint position (n,) that increments and kinematics start from.

        Raises:
            CommandRefused: the device has not said where it is.
        """
        joints = self._feedback.reference_joints()
        if joints.size != len(self._device.capabilities.joints):
            raise self._not_known(command, "joint positions", "measured_js")
        return joints

    def joints(self, command: Command, pose: Pose, near: Vector | None = None) -> Vector:
        """Return the joint position (n,) of a pose, nearest to `near` or else to the setpoint.

        Raises:
            CommandRefused: there is none.
        """
        try:
            reference = self.reference(command) if near is None else near
            joints = vector(self._device.inverse_kinematics(pose, reference))
        except KinematicsError as error:
            raise CommandRefused(
                command.name,
                Reason.UNREACHABLE,
                error.message,
                where=self._where,
                remedy=error.remedy or "Choose a pose within reach, away from singularities.",
            ) from error
        return self._check.check_target(command, joints)

    def setpoint(self, command: Command, pose: Pose) -> Setpoint:
        """Return the setpoint that brings the tool to a pose.

        Raises:
            CommandRefused: out of reach.
        """
        if self._takes_poses:
            numbers = np.concatenate((pose.position, pose.orientation))
            return Setpoint(Mode.CARTESIAN_POSITION, vector(numbers))
        return Setpoint(Mode.JOINT_POSITION, self.joints(command, pose))

    def moved(self, command: Command, displacement: Pose, native: bool = False) -> Pose:
        """Return the pose that the setpoint has after an increment, see `crtk_drivers.resolved_rate`.

        Args:
            command: for messages.
            displacement: along and about the axes of the base frame.
            native: in the hardware's own kinematics, if it reports a pose of its own.

        Raises:
            CommandRefused: the device has not said where it is.
        """
        return increment_in_base(self.pose(command, native), displacement)

    def pose(self, command: Command, native: bool = False) -> Pose:
        """Return the pose that is set now; see `moved`."""
        pose = self._feedback.reference_pose(native)
        if pose is None:
            raise self._not_known(command, "pose", "measured_cp")
        return pose

    def _not_known(self, command: Command, what: str, name: str) -> CommandRefused:
        return CommandRefused(
            command.name,
            Reason.NOT_CONNECTED,
            f"the device has not reported its {what}",
            where=self._where,
            remedy=f"Wait for a valid {name}.",
        )
