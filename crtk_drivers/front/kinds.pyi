"""What each kind of device offers."""

# Written by `python -m crtk_drivers.cli.type_stubs`, from the command table.

from typing import Literal, Protocol, overload

from numpy.typing import ArrayLike

from crtk_drivers.front.base import Operated
from crtk_drivers.front.payloads import JointsLike, PoseLike, TwistLike, WrenchLike
from crtk_drivers.motion.move import Move
from crtk_drivers.samples import (
    CartesianServo,
    JointServo,
    JointState,
    Matrix,
    Pose,
    Poses,
    Twist,
    Vector,
    Wrench,
)

__all__ = [
    "AnyDevice",
    "Arm",
    "CartesianMotion",
    "ForceSensor",
    "Gripper",
    "HapticDevice",
    "InputDevice",
    "JointMotion",
    "Moving",
    "SomeDevice",
    "Tracker",
]

class SomeDevice(Operated, Protocol):
    """What devices of all kinds have."""

    def child(self, name: str) -> AnyDevice:
        """Return a device behind this one, by the name of its sub-namespace."""

class InputDevice(SomeDevice, Protocol):
    """Pedals, a joystick or a six-axis mouse."""

class Tracker(SomeDevice, Protocol):
    """A camera or a field generator that sees markers; each tool that it tracks is a `child`."""

    @overload
    def measured_cp_array(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Poses:
        """Where all is that is seen: tools, then markers of none.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Poses: for each, position (3,) in m, orientation (4,) a unit quaternion x, y, z, w.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def measured_cp_array(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Poses, float]: ...

class ForceSensorRaw(Protocol):
    """As the sensor measures, without bias and filters."""

    @overload
    def measured_cf(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Wrench:
        """Return the measured force and torque at the tool.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Wrench: force (3,) in N, torque (3,) in N·m. As the sensor measures, without bias and
                filters.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def measured_cf(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Wrench, float]: ...

class ForceSensor(SomeDevice, Protocol):
    """A sensor of force and torque."""

    @property
    def raw(self) -> ForceSensorRaw:
        """As the sensor measures, without bias and filters."""

    @overload
    def measured_cf(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Wrench:
        """Return the measured force and torque at the tool.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Wrench: force (3,) in N, torque (3,) in N·m. `frame_id` says in which frame: of an arm
                the base frame, at the tool point.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def measured_cf(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Wrench, float]: ...

class Moving(SomeDevice, Protocol):
    """A device that moves."""

    def hold(self) -> None:
        """Stop, and stay at the present position.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def free(self) -> None:
        """Let go: the arm may be moved by hand.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def use_gravity_compensation(self, value: bool, /) -> None:
        """Whether efforts are added that carry the arm's own weight.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

class JointMotionTrajectoryJ(Protocol):
    """Which share of the limits of joints moves use."""

    def set_ratio(self, value: float, /) -> None:
        """Share of the velocity and acceleration limits that moves use, above 0 and up to 1.

        Args:
            value: a number.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def set_ratio_v(self, value: float, /) -> None:
        """Share of the velocity limits that moves use, above 0 and up to 1.

        Args:
            value: a number.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def set_ratio_a(self, value: float, /) -> None:
        """Share of the acceleration limits that moves use, above 0 and up to 1.

        Args:
            value: a number.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    @overload
    def ratio(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> float:
        """The lesser of the two shares in force.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            float: a number.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def ratio(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[float, float]: ...
    @overload
    def ratio_v(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> float:
        """Share of the velocity limits in force.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            float: a number.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def ratio_v(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[float, float]: ...
    @overload
    def ratio_a(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> float:
        """Share of the acceleration limits in force.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            float: a number.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def ratio_a(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[float, float]: ...

class JointMotion(Moving, Protocol):
    """A device that moves its joints."""

    @property
    def trajectory_j(self) -> JointMotionTrajectoryJ:
        """Which share of the limits of joints moves use."""

    @overload
    def measured_js(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> JointState:
        """Return the measured joint state.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            JointState: position (n,) in rad (m), velocity (n,) in rad/s (m/s), effort (n,) in N·m
                (N).

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def measured_js(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[JointState, float]: ...
    @overload
    def measured_jp(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Vector:
        """Return the measured joint positions.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Vector: (n,) in rad (m), one for each joint.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def measured_jp(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Vector, float]: ...
    @overload
    def measured_jv(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Vector:
        """Return the measured joint velocities.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Vector: (n,) in rad/s (m/s), one for each joint.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def measured_jv(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Vector, float]: ...
    @overload
    def measured_jf(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Vector:
        """Return the measured joint efforts.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Vector: (n,) in N·m (N), one for each joint.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def measured_jf(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Vector, float]: ...
    @overload
    def setpoint_js(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> JointState:
        """Return what was last sent to the low-level control: joint state.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            JointState: position (n,) in rad (m), velocity (n,) in rad/s (m/s), effort (n,) in N·m
                (N).

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def setpoint_js(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[JointState, float]: ...
    @overload
    def setpoint_jp(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Vector:
        """Return what was last sent to the low-level control: joint positions.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Vector: (n,) in rad (m), one for each joint.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def setpoint_jp(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Vector, float]: ...
    @overload
    def setpoint_jv(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Vector:
        """Return what was last sent to the low-level control: joint velocities.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Vector: (n,) in rad/s (m/s), one for each joint.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def setpoint_jv(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Vector, float]: ...
    @overload
    def setpoint_jf(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Vector:
        """Return what was last sent to the low-level control: joint efforts.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Vector: (n,) in N·m (N), one for each joint.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def setpoint_jf(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Vector, float]: ...
    @overload
    def goal_js(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> JointState:
        """Return the goal last accepted by interpolate or move: joint state.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            JointState: position (n,) in rad (m), velocity (n,) in rad/s (m/s), effort (n,) in N·m
                (N).

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def goal_js(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[JointState, float]: ...
    @overload
    def goal_jp(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Vector:
        """Return the goal last accepted by interpolate or move: joint positions.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Vector: (n,) in rad (m), one for each joint.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def goal_jp(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Vector, float]: ...
    @overload
    def goal_jv(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Vector:
        """Return the goal last accepted by interpolate or move: joint velocities.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Vector: (n,) in rad/s (m/s), one for each joint.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def goal_jv(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Vector, float]: ...
    @overload
    def goal_jf(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Vector:
        """Return the goal last accepted by interpolate or move: joint efforts.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Vector: (n,) in N·m (N), one for each joint.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def goal_jf(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Vector, float]: ...
    def servo_jp(self, value: JointsLike, /) -> None:
        """Stream in real time, the newest wins: joint positions.

        Args:
            value: (n,) in rad (m), one for each joint; or a JointState.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def servo_jr(self, value: JointsLike, /) -> None:
        """Stream in real time, the newest wins: increments of the joint positions.

        Args:
            value: (n,) in rad (m), one for each joint; or a JointState.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def servo_jv(self, value: JointsLike, /) -> None:
        """Stream in real time, the newest wins: joint velocities.

        Args:
            value: (n,) in rad/s (m/s), one for each joint; or a JointState.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def servo_jf(self, value: JointsLike, /) -> None:
        """Stream in real time, the newest wins: joint efforts.

        Args:
            value: (n,) in N·m (N), one for each joint; or a JointState.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def servo_js(self, value: JointServo, /) -> None:
        """Stream in real time, the newest wins: joint setpoints of a kind for each joint.

        Args:
            value: for each joint a position in rad (m), a velocity in rad/s (m/s) or an effort in
                N·m (N); as a JointServo.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def interpolate_jp(self, value: JointsLike, /) -> None:
        """Stream at a low rate, smoothed by the device: joint positions.

        Args:
            value: (n,) in rad (m), one for each joint; or a JointState.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def interpolate_jr(self, value: JointsLike, /) -> None:
        """Stream at a low rate, smoothed by the device: increments of the joint positions.

        Args:
            value: (n,) in rad (m), one for each joint; or a JointState.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def interpolate_jv(self, value: JointsLike, /) -> None:
        """Stream at a low rate, smoothed by the device: joint velocities.

        Args:
            value: (n,) in rad/s (m/s), one for each joint; or a JointState.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def interpolate_jf(self, value: JointsLike, /) -> None:
        """Stream at a low rate, smoothed by the device: joint efforts.

        Args:
            value: (n,) in N·m (N), one for each joint; or a JointState.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def move_jp(self, goal: JointsLike, /) -> Move:
        """Plan a trajectory to a goal and stop there: joint positions.

        Args:
            goal: (n,) in rad (m), one for each joint; or a JointState.

        Returns:
            Move: `wait()` waits until it has ended. It raises MotionAborted where that is not at
                the goal, and over ROS ConnectionLost once the device is not heard any more.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def move_jr(self, goal: JointsLike, /) -> Move:
        """Plan a trajectory to a goal and stop there: increments of the joint positions.

        Args:
            goal: (n,) in rad (m), one for each joint; or a JointState.

        Returns:
            Move: `wait()` waits until it has ended. It raises MotionAborted where that is not at
                the goal, and over ROS ConnectionLost once the device is not heard any more.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

class CartesianMotionLocal(Protocol):
    """In the frame of the device's own base."""

    @overload
    def measured_cp(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Pose:
        """Return the measured pose of the tool.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Pose: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w. In the frame of
                the device's own base.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def measured_cp(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Pose, float]: ...
    @overload
    def setpoint_cp(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Pose:
        """Return what was last sent to the low-level control: pose of the tool.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Pose: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w. In the frame of
                the device's own base.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def setpoint_cp(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Pose, float]: ...
    def servo_cp(self, value: PoseLike, /) -> None:
        """Stream in real time, the newest wins: pose of the tool.

        Args:
            value: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w; as a Pose,
                these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3. In the frame of
                the device's own base.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def servo_cr(self, value: PoseLike, /) -> None:
        """Stream in real time, the newest wins: increments of the tool's pose.

        Args:
            value: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w; as a Pose,
                these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3. Along the axes
                of the device's own base, at the tool point.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def servo_cv(self, value: TwistLike, /) -> None:
        """Stream in real time, the newest wins: velocity of the tool.

        Args:
            value: linear (3,) in m/s, angular (3,) in rad/s; as a Twist or these 6 numbers. Along
                the axes of the device's own base, at the tool point.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def servo_cf(self, value: WrenchLike, /) -> None:
        """Stream in real time, the newest wins: force and torque at the tool.

        Args:
            value: force (3,) in N, torque (3,) in N·m; as a Wrench or these 6 numbers. Along the
                axes of the device's own base, at the tool point.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def servo_cs(self, value: CartesianServo, /) -> None:
        """Stream in real time, the newest wins: setpoints of the tool of a kind for each axis.

        Args:
            value: for each axis of a task frame a pose in m (rad), a velocity in m/s (rad/s) or a
                force in N (N·m); as a CartesianServo.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def interpolate_cp(self, value: PoseLike, /) -> None:
        """Stream at a low rate, smoothed by the device: pose of the tool.

        Args:
            value: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w; as a Pose,
                these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3. In the frame of
                the device's own base.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def interpolate_cr(self, value: PoseLike, /) -> None:
        """Stream at a low rate, smoothed by the device: increments of the tool's pose.

        Args:
            value: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w; as a Pose,
                these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3. Along the axes
                of the device's own base, at the tool point.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def interpolate_cv(self, value: TwistLike, /) -> None:
        """Stream at a low rate, smoothed by the device: velocity of the tool.

        Args:
            value: linear (3,) in m/s, angular (3,) in rad/s; as a Twist or these 6 numbers. Along
                the axes of the device's own base, at the tool point.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def interpolate_cf(self, value: WrenchLike, /) -> None:
        """Stream at a low rate, smoothed by the device: force and torque at the tool.

        Args:
            value: force (3,) in N, torque (3,) in N·m; as a Wrench or these 6 numbers. Along the
                axes of the device's own base, at the tool point.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def move_cp(self, goal: PoseLike, /) -> Move:
        """Plan a trajectory to a goal and stop there: pose of the tool.

        Args:
            goal: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w; as a Pose,
                these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3. In the frame of
                the device's own base.

        Returns:
            Move: `wait()` waits until it has ended. It raises MotionAborted where that is not at
                the goal, and over ROS ConnectionLost once the device is not heard any more.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def move_cr(self, goal: PoseLike, /) -> Move:
        """Plan a trajectory to a goal and stop there: increments of the tool's pose.

        Args:
            goal: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w; as a Pose,
                these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3. Along the axes
                of the device's own base, at the tool point.

        Returns:
            Move: `wait()` waits until it has ended. It raises MotionAborted where that is not at
                the goal, and over ROS ConnectionLost once the device is not heard any more.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def forward_kinematics(self, joints: ArrayLike, timeout: float = 5.0) -> Pose:
        """Pose of a joint position.

        Args:
            joints: (n,) in rad (m), one for each joint.
            timeout: how long to wait for the answer, in s.

        Returns:
            Pose: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w. In the frame of
                the device's own base.

        Raises:
            CommandRefused: what was given cannot be used; a wrong size or a value that is not
                finite is a KinematicsError over ROS.
            ConnectionFailed, DataTimeout: over ROS, nobody serves it, or there was no answer in
                `timeout` s; CrtkError inside a callback.
        """

class CartesianMotionBody(Protocol):
    """Along the axes of the tool, at the tool point."""

    @overload
    def measured_cv(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Twist:
        """Return the measured velocity of the tool.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Twist: linear (3,) in m/s, angular (3,) in rad/s. Along the axes of the tool, at the
                tool point.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def measured_cv(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Twist, float]: ...
    @overload
    def measured_cf(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Wrench:
        """Return the measured force and torque at the tool.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Wrench: force (3,) in N, torque (3,) in N·m. Along the axes of the tool, at the tool
                point.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def measured_cf(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Wrench, float]: ...
    @overload
    def setpoint_cv(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Twist:
        """Return what was last sent to the low-level control: velocity of the tool.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Twist: linear (3,) in m/s, angular (3,) in rad/s. Along the axes of the tool, at the
                tool point.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def setpoint_cv(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Twist, float]: ...
    @overload
    def setpoint_cf(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Wrench:
        """Return what was last sent to the low-level control: force and torque at the tool.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Wrench: force (3,) in N, torque (3,) in N·m. Along the axes of the tool, at the tool
                point.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def setpoint_cf(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Wrench, float]: ...
    def servo_cr(self, value: PoseLike, /) -> None:
        """Stream in real time, the newest wins: increments of the tool's pose.

        Args:
            value: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w; as a Pose,
                these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3. Along the axes
                of the tool, at the tool point.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def servo_cv(self, value: TwistLike, /) -> None:
        """Stream in real time, the newest wins: velocity of the tool.

        Args:
            value: linear (3,) in m/s, angular (3,) in rad/s; as a Twist or these 6 numbers. Along
                the axes of the tool, at the tool point.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def servo_cf(self, value: WrenchLike, /) -> None:
        """Stream in real time, the newest wins: force and torque at the tool.

        Args:
            value: force (3,) in N, torque (3,) in N·m; as a Wrench or these 6 numbers. Along the
                axes of the tool, at the tool point.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def interpolate_cr(self, value: PoseLike, /) -> None:
        """Stream at a low rate, smoothed by the device: increments of the tool's pose.

        Args:
            value: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w; as a Pose,
                these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3. Along the axes
                of the tool, at the tool point.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def interpolate_cv(self, value: TwistLike, /) -> None:
        """Stream at a low rate, smoothed by the device: velocity of the tool.

        Args:
            value: linear (3,) in m/s, angular (3,) in rad/s; as a Twist or these 6 numbers. Along
                the axes of the tool, at the tool point.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def interpolate_cf(self, value: WrenchLike, /) -> None:
        """Stream at a low rate, smoothed by the device: force and torque at the tool.

        Args:
            value: force (3,) in N, torque (3,) in N·m; as a Wrench or these 6 numbers. Along the
                axes of the tool, at the tool point.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def move_cr(self, goal: PoseLike, /) -> Move:
        """Plan a trajectory to a goal and stop there: increments of the tool's pose.

        Args:
            goal: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w; as a Pose,
                these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3. Along the axes
                of the tool, at the tool point.

        Returns:
            Move: `wait()` waits until it has ended. It raises MotionAborted where that is not at
                the goal, and over ROS ConnectionLost once the device is not heard any more.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    @overload
    def jacobian(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Matrix:
        """6 x n geometric Jacobian of the tool, linear rows first.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Matrix: (6, n) in m/rad and 1. Along the axes of the tool, at the tool point.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def jacobian(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Matrix, float]: ...
    def set_cf_orientation_absolute(self, value: bool, /) -> None:
        """Whether wrenches of body/ are along the axes of the base frame instead of the tool's.

        Args:
            value: True or False.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

class CartesianMotionSpatial(Protocol):
    """Along the axes of the base frame, at its origin."""

    @overload
    def measured_cv(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Twist:
        """Return the measured velocity of the tool.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Twist: linear (3,) in m/s, angular (3,) in rad/s. Along the axes of the base frame, at
                its origin.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def measured_cv(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Twist, float]: ...
    @overload
    def measured_cf(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Wrench:
        """Return the measured force and torque at the tool.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Wrench: force (3,) in N, torque (3,) in N·m. Along the axes of the base frame, at its
                origin.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def measured_cf(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Wrench, float]: ...
    @overload
    def setpoint_cv(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Twist:
        """Return what was last sent to the low-level control: velocity of the tool.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Twist: linear (3,) in m/s, angular (3,) in rad/s. Along the axes of the base frame, at
                its origin.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def setpoint_cv(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Twist, float]: ...
    @overload
    def setpoint_cf(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Wrench:
        """Return what was last sent to the low-level control: force and torque at the tool.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Wrench: force (3,) in N, torque (3,) in N·m. Along the axes of the base frame, at its
                origin.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def setpoint_cf(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Wrench, float]: ...
    def servo_cr(self, value: PoseLike, /) -> None:
        """Stream in real time, the newest wins: increments of the tool's pose.

        Args:
            value: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w; as a Pose,
                these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3. Along the axes
                of the base frame, at its origin.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def servo_cv(self, value: TwistLike, /) -> None:
        """Stream in real time, the newest wins: velocity of the tool.

        Args:
            value: linear (3,) in m/s, angular (3,) in rad/s; as a Twist or these 6 numbers. Along
                the axes of the base frame, at its origin.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def servo_cf(self, value: WrenchLike, /) -> None:
        """Stream in real time, the newest wins: force and torque at the tool.

        Args:
            value: force (3,) in N, torque (3,) in N·m; as a Wrench or these 6 numbers. Along the
                axes of the base frame, at its origin.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def interpolate_cr(self, value: PoseLike, /) -> None:
        """Stream at a low rate, smoothed by the device: increments of the tool's pose.

        Args:
            value: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w; as a Pose,
                these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3. Along the axes
                of the base frame, at its origin.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def interpolate_cv(self, value: TwistLike, /) -> None:
        """Stream at a low rate, smoothed by the device: velocity of the tool.

        Args:
            value: linear (3,) in m/s, angular (3,) in rad/s; as a Twist or these 6 numbers. Along
                the axes of the base frame, at its origin.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def interpolate_cf(self, value: WrenchLike, /) -> None:
        """Stream at a low rate, smoothed by the device: force and torque at the tool.

        Args:
            value: force (3,) in N, torque (3,) in N·m; as a Wrench or these 6 numbers. Along the
                axes of the base frame, at its origin.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def move_cr(self, goal: PoseLike, /) -> Move:
        """Plan a trajectory to a goal and stop there: increments of the tool's pose.

        Args:
            goal: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w; as a Pose,
                these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3. Along the axes
                of the base frame, at its origin.

        Returns:
            Move: `wait()` waits until it has ended. It raises MotionAborted where that is not at
                the goal, and over ROS ConnectionLost once the device is not heard any more.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    @overload
    def jacobian(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Matrix:
        """6 x n geometric Jacobian of the tool, linear rows first.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Matrix: (6, n) in m/rad and 1. Along the axes of the base frame, at its origin.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def jacobian(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Matrix, float]: ...

class CartesianMotion(Moving, Protocol):
    """A device that moves a tool in space."""

    @property
    def local(self) -> CartesianMotionLocal:
        """In the frame of the device's own base."""

    @property
    def body(self) -> CartesianMotionBody:
        """Along the axes of the tool, at the tool point."""

    @property
    def spatial(self) -> CartesianMotionSpatial:
        """Along the axes of the base frame, at its origin."""

    @overload
    def measured_cp(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Pose:
        """Return the measured pose of the tool.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Pose: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w. `frame_id` says
                in which frame: of an arm the base frame, at the tool point.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def measured_cp(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Pose, float]: ...
    @overload
    def measured_cv(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Twist:
        """Return the measured velocity of the tool.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Twist: linear (3,) in m/s, angular (3,) in rad/s. `frame_id` says in which frame: of an
                arm the base frame, at the tool point.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def measured_cv(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Twist, float]: ...
    @overload
    def measured_cf(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Wrench:
        """Return the measured force and torque at the tool.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Wrench: force (3,) in N, torque (3,) in N·m. `frame_id` says in which frame: of an arm
                the base frame, at the tool point.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def measured_cf(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Wrench, float]: ...
    @overload
    def setpoint_cp(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Pose:
        """Return what was last sent to the low-level control: pose of the tool.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Pose: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w. In the base
                frame.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def setpoint_cp(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Pose, float]: ...
    @overload
    def setpoint_cv(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Twist:
        """Return what was last sent to the low-level control: velocity of the tool.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Twist: linear (3,) in m/s, angular (3,) in rad/s. Along the axes of the base frame, at
                the tool point.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def setpoint_cv(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Twist, float]: ...
    @overload
    def setpoint_cf(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Wrench:
        """Return what was last sent to the low-level control: force and torque at the tool.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Wrench: force (3,) in N, torque (3,) in N·m. Along the axes of the base frame, at the
                tool point.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def setpoint_cf(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Wrench, float]: ...
    @overload
    def goal_cp(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Pose:
        """Return the goal last accepted by interpolate or move: pose of the tool.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Pose: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w. In the base
                frame.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def goal_cp(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Pose, float]: ...
    @overload
    def goal_cv(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Twist:
        """Return the goal last accepted by interpolate or move: velocity of the tool.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Twist: linear (3,) in m/s, angular (3,) in rad/s. Along the axes of the base frame, at
                the tool point.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def goal_cv(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Twist, float]: ...
    def servo_cp(self, value: PoseLike, /) -> None:
        """Stream in real time, the newest wins: pose of the tool.

        Args:
            value: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w; as a Pose,
                these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3. In the base
                frame.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def servo_cr(self, value: PoseLike, /) -> None:
        """Stream in real time, the newest wins: increments of the tool's pose.

        Args:
            value: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w; as a Pose,
                these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3. Along the axes
                of the base frame, at the tool point.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def servo_cv(self, value: TwistLike, /) -> None:
        """Stream in real time, the newest wins: velocity of the tool.

        Args:
            value: linear (3,) in m/s, angular (3,) in rad/s; as a Twist or these 6 numbers. Along
                the axes of the base frame, at the tool point.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def servo_cf(self, value: WrenchLike, /) -> None:
        """Stream in real time, the newest wins: force and torque at the tool.

        Args:
            value: force (3,) in N, torque (3,) in N·m; as a Wrench or these 6 numbers. Along the
                axes of the base frame, at the tool point.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def servo_cs(self, value: CartesianServo, /) -> None:
        """Stream in real time, the newest wins: setpoints of the tool of a kind for each axis.

        Args:
            value: for each axis of a task frame a pose in m (rad), a velocity in m/s (rad/s) or a
                force in N (N·m); as a CartesianServo.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def interpolate_cp(self, value: PoseLike, /) -> None:
        """Stream at a low rate, smoothed by the device: pose of the tool.

        Args:
            value: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w; as a Pose,
                these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3. In the base
                frame.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def interpolate_cr(self, value: PoseLike, /) -> None:
        """Stream at a low rate, smoothed by the device: increments of the tool's pose.

        Args:
            value: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w; as a Pose,
                these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3. Along the axes
                of the base frame, at the tool point.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def interpolate_cv(self, value: TwistLike, /) -> None:
        """Stream at a low rate, smoothed by the device: velocity of the tool.

        Args:
            value: linear (3,) in m/s, angular (3,) in rad/s; as a Twist or these 6 numbers. Along
                the axes of the base frame, at the tool point.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def interpolate_cf(self, value: WrenchLike, /) -> None:
        """Stream at a low rate, smoothed by the device: force and torque at the tool.

        Args:
            value: force (3,) in N, torque (3,) in N·m; as a Wrench or these 6 numbers. Along the
                axes of the base frame, at the tool point.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do. Over
                ROS the next call raises it.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def move_cp(self, goal: PoseLike, /) -> Move:
        """Plan a trajectory to a goal and stop there: pose of the tool.

        Args:
            goal: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w; as a Pose,
                these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3. In the base
                frame.

        Returns:
            Move: `wait()` waits until it has ended. It raises MotionAborted where that is not at
                the goal, and over ROS ConnectionLost once the device is not heard any more.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    def move_cr(self, goal: PoseLike, /) -> Move:
        """Plan a trajectory to a goal and stop there: increments of the tool's pose.

        Args:
            goal: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w; as a Pose,
                these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3. Along the axes
                of the base frame, at the tool point.

        Returns:
            Move: `wait()` waits until it has ended. It raises MotionAborted where that is not at
                the goal, and over ROS ConnectionLost once the device is not heard any more.

        Raises:
            CommandRefused: the device does not accept it; the error says why, and what to do.
            ConnectionLost: over ROS, nobody listens to it any more.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found in
                time; CrtkError inside a callback.
        """

    @overload
    def jacobian(
        self,
        age: float | None = None,
        wait: float | None = None,
        extra: Literal[False] = False,
    ) -> Matrix:
        """6 x n geometric Jacobian of the tool, linear rows first.

        Args:
            age: how old the value may be, in s; 0 takes any. None: 0.1 s.
            wait: how long to wait for one that is new enough, in s. None: 1 s.
            extra: also return the stamp, in s since the epoch; 0 marks a value that is not valid.

        Returns:
            Matrix: (6, n) in m/rad and 1. Along the axes of the base frame, at the tool point.

        Raises:
            DataTimeout: there is no value that is new enough.
            ConnectionFailed: over ROS at the first use, the other end was not found in time;
                CrtkError inside a callback.
        """
    @overload
    def jacobian(
        self,
        age: float | None = None,
        wait: float | None = None,
        *,
        extra: Literal[True],
    ) -> tuple[Matrix, float]: ...
    def forward_kinematics(self, joints: ArrayLike, timeout: float = 5.0) -> Pose:
        """Pose of a joint position.

        Args:
            joints: (n,) in rad (m), one for each joint.
            timeout: how long to wait for the answer, in s.

        Returns:
            Pose: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w. In the base
                frame.

        Raises:
            CommandRefused: what was given cannot be used; a wrong size or a value that is not
                finite is a KinematicsError over ROS.
            ConnectionFailed, DataTimeout: over ROS, nobody serves it, or there was no answer in
                `timeout` s; CrtkError inside a callback.
        """

    def inverse_kinematics(
        self,
        pose: PoseLike,
        reference: ArrayLike = (),
        timeout: float = 5.0,
    ) -> Vector:
        """Joint position of a pose, nearest to a reference.

        Args:
            pose: position (3,) in m, orientation (4,) a unit quaternion x, y, z, w; as a Pose,
                these 7 numbers, a (4, 4) matrix, a PyKDL.Frame or a pinocchio.SE3. In the base
                frame.
            reference: (n,) in rad (m), one for each joint: the solution nearest to it is returned;
                empty: to the arm.
            timeout: how long to wait for the answer, in s.

        Returns:
            Vector: (n,) in rad (m), one for each joint.

        Raises:
            CommandRefused: what was given cannot be used; a wrong size or a value that is not
                finite is a KinematicsError over ROS.
            KinematicsError: no joint position within the limits reaches the pose.
            ConnectionFailed, DataTimeout: over ROS, nobody serves it, or there was no answer in
                `timeout` s; CrtkError inside a callback.
        """

class Gripper(JointMotion, Protocol):
    """Fingers, jaws or a vacuum gripper."""

class HapticDevice(CartesianMotion, Protocol):
    """A device that a hand holds, and that pushes back."""

    @property
    def gripper(self) -> Gripper:
        """The device in `gripper/`."""

class Arm(JointMotion, CartesianMotion, Protocol):
    """An arm, or axes that are driven as one."""

    @property
    def jaw(self) -> Gripper:
        """The device in `jaw/`."""

    @property
    def gripper(self) -> Gripper:
        """The device in `gripper/`."""

    @property
    def actuators(self) -> JointMotion:
        """The device in `actuators/`."""

class AnyDevice(Arm, Tracker, ForceSensor, Protocol):
    """A device of a kind that is not known: a type checker lets every command pass."""
