"""Where the tool of a device is for a joint position, and what follows from it."""

from __future__ import annotations

from abc import ABC, abstractmethod

from crtk_drivers.samples import Array, Pose, Vector


class Kinematics(ABC):
    """Pure functions of joint positions (n,), in rad or m, and of poses of the tool in the base frame.

    They are called from any thread. What an object answers never changes: with another tool or another
    calibration a device has other kinematics. Whoever asks them takes them from the device each time.
    """

    @abstractmethod
    def forward(self, joints: Vector) -> Pose:
        """Return the tool pose in the base frame."""

    @abstractmethod
    def inverse(self, pose: Pose, reference: Vector) -> Vector:
        """Return the joint position (n,) nearest to `reference` that reaches `pose`.

        Raises:
            KinematicsError: none within the limits.
        """

    def nearby_inverse(self, pose: Pose, reference: Vector) -> Vector:
        """As `inverse`, for the poses of a stream: in a part of a cycle, also if there is none.

        To be overridden where `inverse` searches for longer. It need not find another branch.

        Raises:
            KinematicsError: none near `reference` and within the limits.
        """
        return self.inverse(pose, reference)

    @abstractmethod
    def jacobian(self, joints: Vector) -> Array:
        """Return the geometric Jacobian (6, n) at the tool point, in base axes, linear rows first."""
