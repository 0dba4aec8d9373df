"""What the tool is to do in one cycle, as a setpoint: of the hardware's own kind, or of its joints.

Each output belongs to one stream or move, in the I/O thread, and is asked once a cycle.
"""

from __future__ import annotations

from crtk_drivers.commands import Command
from crtk_drivers.device import Mode, Setpoint
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.gates.resolved_rate import ResolvedRate
from crtk_drivers.gates.setpoint import norms_into
from crtk_drivers.motion.context import MotionContext
from crtk_drivers.motion.point import Point
from crtk_drivers.samples import JointState, Pose, Vector, empty, frozen, vector

_STILL = 1e-6
"""rad/s (m/s) of a joint that stands: what rounding leaves over."""

_INSTANT = 1e-5
"""Seconds of motion below which nothing can be said of velocities."""

_TOLERANCE = 0.01
"""By how much a joint may exceed its velocity limit between two poses: rounding, and clocks that differ."""


class PoseOutput:
    """Poses that follow each other smoothly: as they are if the hardware takes them, else by kinematics.

    Args:
        command: that they come from.
        context: of the device.
        now: monotonic seconds.
        share: of real time in the motion's own time, at its beginning; 0: begin at rest.
    """

    def __init__(
        self, command: Command, context: MotionContext, now: float, share: float = 1.0
    ) -> None:
        capabilities = context.capabilities
        self._command = command
        self._context = context
        self._inverse = context.inverse
        self._takes_poses = Mode.CARTESIAN_POSITION in capabilities.modes
        self._joints, velocity, self._acceleration = context.feedback.motion(now)
        self._velocity = frozen(velocity * share)
        self._step = context.cycle
        self._fastest = [limit.velocity for limit in capabilities.limits]

    def point(self, pose: Pose, twist: Vector, step: float) -> Point:
        """Return what to send for a pose of the tool that moves with a twist (6,), base axes.

        Args:
            pose, twist: of this cycle.
            step: seconds of the motion's own time since the pose before.

        Raises:
            CommandRefused: out of reach, or a joint would be too fast.
        """
        if self._takes_poses:
            return Point(self._inverse.setpoint(self._command, pose), twist=twist)
        # Where the joints would go on to: inverse kinematics has the least to do from there.
        expected = frozen(self._joints + self._velocity * step)
        joints = self._inverse.joints(self._command, pose, expected)
        if step > _INSTANT:
            velocity = frozen((joints - self._joints) / step)
            self._check_speed(velocity)
            # Each is the mean of its step: they are as far apart as the middles of these.
            apart = 0.5 * (step + self._step)
            self._acceleration = frozen((velocity - self._velocity) / apart)
            self._joints, self._velocity, self._step = joints, velocity, step
        return Point(
            Setpoint(Mode.JOINT_POSITION, joints),
            JointState(position=joints, velocity=self._velocity),
            self._acceleration,
            twist,
        )

    def _check_speed(self, velocity: Vector) -> None:
        speeds = zip(velocity.tolist(), self._fastest, strict=True)
        excess = [abs(speed) / fastest for speed, fastest in speeds]
        largest = max(excess)
        if largest > 1.0 + _TOLERANCE:
            name = self._context.capabilities.joints[excess.index(largest)]
            raise CommandRefused(
                self._command.name,
                Reason.STEP_TOO_LARGE,
                f"{name} would be too fast on the way",
                where=self._context.where,
                remedy="Stay away from singularities, or command joints.",
            )


class TwistOutput:
    """Twists: as they are if the hardware takes them, else through the Jacobian.

    Joints take velocities if they can, else the positions to which these lead in each cycle. They keep
    the limits of position, velocity and acceleration, see `crtk_drivers.gates.resolved_rate`.

    Args:
        context: of the device.
        now: monotonic seconds.

    Attributes:
        share: in [0, 1], of the last twist, that limits of the joints left.
    """

    share = 1.0

    def __init__(self, context: MotionContext, now: float) -> None:
        capabilities = context.capabilities
        self._inverse = context.inverse
        self._feedback = context.feedback
        self._cycle = context.cycle
        self._takes_twists = Mode.CARTESIAN_VELOCITY in capabilities.modes
        takes_velocities = Mode.JOINT_VELOCITY in capabilities.modes
        self._takes_velocities = takes_velocities and not capabilities.integrates_twists
        limits = capabilities.cartesian_limits
        self._rates = ResolvedRate(capabilities.limits, limits, self._cycle)
        _, self._velocity, _ = context.feedback.motion(now)

    def point(self, twist: Vector) -> Point:
        """Return what to send for a twist (6,), base axes, in this cycle."""
        if self._takes_twists:
            return Point(Setpoint(Mode.CARTESIAN_VELOCITY, twist))
        joints = self._feedback.reference_joints()
        jacobian = self._inverse.kinematics.jacobian(joints)
        before = self._velocity
        rate = self._rates.follow_twist(joints, jacobian, twist, before)
        self._velocity = velocity = rate.velocity
        self.share = rate.scale
        acceleration = frozen((velocity - before) / self._cycle)
        done = frozen(jacobian @ velocity)  # within the limits, and without what is damped
        if self._takes_velocities:
            setpoint = Setpoint(Mode.JOINT_VELOCITY, velocity)
            return Point(setpoint, None, acceleration, done)
        position = frozen(joints + velocity * self._cycle)
        state = JointState(position=position, velocity=velocity)
        return Point(Setpoint(Mode.JOINT_POSITION, position), state, acceleration, done)

    @property
    def is_at_rest(self) -> bool:
        """Whether the joints, if it moves these, have been told to stand."""
        return self._takes_twists or all(abs(speed) <= _STILL for speed in self._velocity.tolist())


class WrenchOutput:
    """Wrenches: as they are if the hardware takes them, else as joint efforts, by the Jacobian's transpose.

    Both within the limits of the tool's force and torque.

    Args:
        context: of the device.
    """

    def __init__(self, context: MotionContext) -> None:
        self._inverse = context.inverse
        self._feedback = context.feedback
        self._takes_wrenches = Mode.CARTESIAN_EFFORT in context.capabilities.modes
        limits = context.capabilities.cartesian_limits
        assert limits is not None
        self._limits = limits.force, limits.torque

    def point(self, wrench: Vector) -> Point:
        """Return what to send for a wrench (6,), base axes, that the tool is to exert in this cycle."""
        if self._takes_wrenches:
            return Point(Setpoint(Mode.CARTESIAN_EFFORT, wrench))
        wrench = norms_into(wrench, *self._limits)
        joints, _ = self._feedback.measured_state()
        jacobian = self._inverse.kinematics.jacobian(joints.position)
        effort = vector(jacobian.T @ wrench)
        return Point(Setpoint(Mode.JOINT_EFFORT, effort), wrench=wrench)

    is_at_rest = True
    """An effort has no way to come to rest: it is over at once."""


class Pursuit:
    """A tool that goes to a pose as directly as the limits of its joints allow.

    The joint position that reaches the pose is sent at once if the joints may be that fast. Otherwise, and
    near a singularity, where a short way of the tool is a long one of the joints, the tool approaches
    through the damped Jacobian, the joint velocities scaled as a whole (see
    `crtk_drivers.gates.resolved_rate`). From then on no joint is faster than its limit in any one cycle,
    until the pose is reached.

    Args:
        context: of the device.

    Attributes:
        behind: how far (n,) the last step is from the joint position that reaches the pose.
    """

    def __init__(self, context: MotionContext) -> None:
        capabilities = context.capabilities
        self.behind = empty()
        self._inverse = context.inverse
        self._cycle = context.cycle
        self._rates = ResolvedRate(capabilities.limits, capabilities.cartesian_limits, self._cycle)
        self._limiter = context.limiter
        self._approaches = False

    def point(
        self, joints: Vector, goal: Pose, there: Vector, now: float, may_jump: bool = False
    ) -> Point:
        """Return the next step from a joint position towards a pose of the tool.

        Args:
            joints: (n,) where it is.
            goal: of the tool, in the base frame.
            there: (n,) the joint position that reaches it.
            now: monotonic seconds.
            may_jump: whether it may be further away than a cycle takes it, as in a stream of joint positions.
        """
        needs = self._limiter.time_between(joints, there)
        credit = self._limiter.credit(now)
        at_once = Point(Setpoint(Mode.JOINT_POSITION, there))
        self.behind = empty()
        if needs <= min(credit, self._cycle * (1.0 + _TOLERANCE)):
            self._approaches = False
            return at_once
        kinematics = self._inverse.kinematics
        pose, jacobian = kinematics.forward(joints), kinematics.jacobian(joints)
        rate = self._rates.follow_pose(joints, pose, jacobian, goal, self._cycle)
        may_jump = may_jump and not self._approaches and not rate.is_damped
        if may_jump and needs <= credit:
            return at_once
        self._approaches = True
        step = rate.velocity * min(self._cycle, credit)
        self.behind = vector(there - joints - step)
        return Point(Setpoint(Mode.JOINT_POSITION, vector(joints + step)))
