"""From poses of the tool to what the hardware takes: poses themselves, or joint positions by kinematics."""

from __future__ import annotations

import numpy as np

from crtk_drivers.commands import Command
from crtk_drivers.device import CartesianLimits, Device, Kinematics, Mode, Ratios, Setpoint
from crtk_drivers.errors import CommandRefused, CrtkError, KinematicsError, MotionAborted, Reason
from crtk_drivers.gates.command import CommandCheck
from crtk_drivers.geometry.frames import moved
from crtk_drivers.motion.feedback import Feedback
from crtk_drivers.samples import Pose, Vector, vector
from crtk_drivers.trajectory.profiles import LineProfile, check_line


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

    @property
    def kinematics(self) -> Kinematics:
        """Those of the device that count now.

        Raises:
            KinematicsError: it has none.
        """
        found = self._device.kinematics
        if found is None:
            raise KinematicsError("this device has no kinematics", where=self._where)
        return found

    def frame_of(self, command: Command) -> str:
        """Return the frame in which a command's values are given; of wrenches the user may change it."""
        return self._feedback.axes.frame_of(command)

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
        """Return the joint position (n,) of a pose, nearest to the setpoint.

        Args:
            command: that the pose comes from.
            pose: in the base frame.
            near: where to look instead, and nowhere else: for streams.

        Raises:
            CommandRefused: there is none.
        """
        try:
            if near is None:
                joints = vector(self.kinematics.inverse(pose, self.reference(command)))
            else:
                joints = vector(self.kinematics.nearby_inverse(pose, near))
        except KinematicsError as error:
            raise self._unreachable(command, error) from error
        return self._check.check_target(command, joints)

    def setpoint(self, command: Command, pose: Pose) -> Setpoint:
        """Return the setpoint of a stream that brings the tool to a pose near by.

        Raises:
            CommandRefused: out of reach.
        """
        if self._takes_poses:
            numbers = np.concatenate((pose.position, pose.orientation))
            return Setpoint(Mode.CARTESIAN_POSITION, vector(numbers))
        return Setpoint(Mode.JOINT_POSITION, self.joints(command, pose, self.reference(command)))

    def moved(self, command: Command, displacement: Pose, native: bool = False) -> Pose:
        """Return the pose that the setpoint has after an increment.

        Args:
            command: whose increment it is.
            displacement: in the frame of the command, see `crtk_drivers.geometry.frames`.
            native: in the hardware's own kinematics, if it reports a pose of its own.

        Raises:
            CommandRefused: the device has not said where it is.
        """
        base = self._device.capabilities.base_pose
        return moved(self.pose(command, native), displacement, command.frame, base)

    def check_way(self, command: Command, goal: Pose) -> None:
        """Judge a goal that increments have added up to, for hardware that takes poses as they are.

        Raises:
            CommandRefused: further from the setpoint than one increment may lead.
        """
        self._check.check_way(command, vector(goal.position - self.pose(command).position))

    def line(
        self,
        command: Command,
        pose: Pose,
        limits: CartesianLimits,
        ratios: Ratios,
        now: float | None = None,
    ) -> Vector:
        """Return the joint position (n,) at the end of a straight line from the setpoint to a pose.

        Args:
            command, pose, limits, ratios: what is to be done.
            now: monotonic seconds; the line goes on from the motion that it replaces. None: from rest.

        Raises:
            CommandRefused: the line leaves the reach or the range of the joints, or makes one too fast.
        """
        start, feedback = self.reference(command), self._feedback
        twist = change = None
        is_moving = now is not None and feedback.goes_on
        if now is not None and is_moving:
            twist, change = feedback.reference_twist(now), feedback.reference_twist_change(now)
            is_moving = bool(twist.any())
        kinematics = self.kinematics
        begin = kinematics.forward(start)
        try:
            line = LineProfile(begin, pose, limits, ratios, twist, change)
            capabilities = self._device.capabilities
            return check_line(
                line, kinematics.inverse, start, capabilities.joints, capabilities.limits
            )
        except (KinematicsError, MotionAborted) as error:
            raise self._unreachable(command, error, is_moving) from error

    def pose(self, command: Command, native: bool = False) -> Pose:
        """Return the pose (base frame) of the setpoint in force; `native` as for `moved`.

        Raises:
            CommandRefused: the device has not said where it is.
        """
        pose = self._feedback.reference_pose(native)
        if pose is None:
            raise self._not_known(command, "pose", "measured_cp")
        return pose

    def _unreachable(
        self, command: Command, error: CrtkError, is_moving: bool = False
    ) -> CommandRefused:
        remedy = error.remedy or "Choose a pose within reach, away from singularities."
        if is_moving:
            remedy += " It moves now: from rest there may be a way."
        return CommandRefused(
            command.name, Reason.UNREACHABLE, error.message, where=self._where, remedy=remedy
        )

    def _not_known(self, command: Command, what: str, name: str) -> CommandRefused:
        return CommandRefused(
            command.name,
            Reason.NOT_CONNECTED,
            f"the device has not reported its {what}",
            where=self._where,
            remedy=f"Wait for a valid {name}.",
        )
