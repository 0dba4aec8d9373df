"""What may be asked: a command is judged as it arrives, in the client's thread, and no bus is touched.

Type, names, size, finite, how large, quaternion, frame, age, range. A refusal is a `CommandRefused` with a
reason and a remedy; it changes nothing. What is really sent is judged once more, see
`crtk_drivers.gates.setpoint`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from crtk_drivers.commands import Command, Kind, Level, find
from crtk_drivers.device import Capabilities
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.geometry.frames import WrenchAxes
from crtk_drivers.geometry.quaternions import QUATERNION_TOLERANCE
from crtk_drivers.options import LimitPolicy
from crtk_drivers.samples import (
    EMPTY,
    VALUE_TYPES,
    AxisMode,
    CartesianServo,
    Flag,
    JointServo,
    JointState,
    JointTrajectory,
    Number,
    Pose,
    Twist,
    Value,
    Vector,
    Wrench,
    joint_state,
    joint_values,
    vector,
)
from crtk_drivers.state import StateCommand

SETTING_GOING = frozenset({StateCommand.ENABLE, StateCommand.RESUME, StateCommand.HOME})
"""State commands whose age counts: what stops the device is never too old."""

FUTURE_TOLERANCE = 0.5
"""Seconds that a command's stamp may lie ahead of this machine's clock, if ages are checked; never more than
the age that is allowed: a clock that far ahead makes each command seem younger by as much."""

_SYNCHRONISE = (
    "If the two clocks may disagree, synchronise the machines by chrony or PTP; or send no stamp."
)

LARGEST = 1e6
"""No number of a command is larger (m, rad, m/s, N, ...): far beyond any device, and far from where
products and sums overflow."""

FARTHEST = 100.0
"""Metres that a Cartesian increment may lead away. One of a joint leads at most through its range."""

_FIELD_NAME = {
    Kind.POSITION: "position",
    Kind.RELATIVE: "position",
    Kind.VELOCITY: "velocity",
    Kind.EFFORT: "effort",
}

_ZERO = vector(np.zeros(3))
_NOTHING = (Pose(_ZERO, vector((0.0, 0.0, 0.0, 1.0))), Twist(_ZERO, _ZERO), Wrench(_ZERO, _ZERO))
"""Of a mixed setpoint, what no axis follows."""


class CommandCheck:
    """The checks of one device's commands.

    Args:
        capabilities: of the device.
        policy: of the user.
        where: the device, for messages.
        axes: of wrenches.

    Attributes:
        told_frame: gives the name of a frame as it is told to whoever sends commands.
    """

    def __init__(
        self,
        capabilities: Capabilities,
        policy: LimitPolicy,
        where: str,
        axes: WrenchAxes | None = None,
    ) -> None:
        self.told_frame: Callable[[str], str] = str
        self._axes = axes or WrenchAxes()
        self._joints = capabilities.joints
        self._index = {name: i for i, name in enumerate(capabilities.joints)}
        self._frames = {
            "": capabilities.base_frame,
            "local": "local",
            "body": capabilities.tool_frame,
            "spatial": capabilities.base_frame,
        }
        self._policy = policy
        self._where = where
        self._lower = vector([limit.lower for limit in capabilities.limits])
        self._upper = vector([limit.upper for limit in capabilities.limits])
        spans = [min(limit.upper - limit.lower, LARGEST) for limit in capabilities.limits]
        self._spans = vector(spans)
        self._velocity = vector([limit.velocity for limit in capabilities.limits])
        self._effort = vector([limit.effort for limit in capabilities.limits])
        cartesian = capabilities.cartesian_limits
        self._twist_limits: tuple[float, ...] = ()
        self._wrench_limits: tuple[float, ...] = ()
        if cartesian is not None:
            self._twist_limits = (cartesian.linear_velocity, cartesian.angular_velocity)
            self._wrench_limits = (cartesian.force, cartesian.torque)

    def check(
        self, command: Command, value: Value | None, stamp_ns: int = 0, now_ns: int = 0
    ) -> Value:
        """Return the value to execute: in declared order, its quaternion of unit length.

        Args:
            command: the row of the table.
            value: of the type that the row's payload names.
            stamp_ns: the sender's stamp, 0 if it gave none.
            now_ns: this machine's clock.

        Raises:
            CommandRefused: with the reason; nothing has been changed.
        """
        expected = VALUE_TYPES[command.payload]
        if not isinstance(value, expected):
            raise self._refusal(
                command,
                Reason.WRONG_TYPE,
                f"got {type(value).__name__}",
                f"Send a {expected.__name__}.",
            )
        self._check_age(command, stamp_ns, now_ns)
        checks: dict[type, Callable[[Command, Any], Value]] = {
            JointState: self._check_joints,
            Pose: self.check_pose,
            Twist: self._check_twist,
            Wrench: self._check_wrench,
            JointServo: self._check_joint_servo,
            CartesianServo: self._check_cartesian_servo,
            Number: self._check_ratio,
            Flag: lambda command, flag: flag,
            JointTrajectory: lambda command, way: way,  # crtk_drivers.trajectory.checks judges it
        }
        return checks[expected](command, value)

    def check_state_command(self, command: StateCommand, stamp_ns: int, now_ns: int) -> None:
        """Judge the age of a state command; stamps as for `check`.

        Raises:
            CommandRefused: it sets the device going, and its stamp is too old, or in the future.
        """
        if command in SETTING_GOING:
            self._check_age(find("state_command"), stamp_ns, now_ns)

    def check_joints(self, command: Command, joints: Vector) -> Vector:
        """Return a joint position (n,) that is given as a bare vector, as kinematics queries do.

        Raises:
            CommandRefused: empty, wrong size or not finite.
        """
        self._check_size(command, joints, "position")
        self._check_numbers(command, joints, "position")
        return joints

    def check_target(self, command: Command, joints: Vector) -> Vector:
        """Return a joint position (n,) that was computed from the value of `command`.

        Raises:
            CommandRefused: it is none, or the goal of a move or an interpolation and out of range.
        """
        self.check_joints(command, joints)
        if command.level in (Level.MOVE, Level.INTERPOLATE):
            self._check_range(command, joints)
        return joints

    def _refusal(
        self, command: Command, reason: Reason, message: str, remedy: str = ""
    ) -> CommandRefused:
        return CommandRefused(command.name, reason, message, where=self._where, remedy=remedy)

    def _check_age(self, command: Command, stamp_ns: int, now_ns: int) -> None:
        limit = self._policy.max_command_age
        if limit is None or stamp_ns == 0:
            return
        age = (now_ns - stamp_ns) / 1e9
        if age > limit:
            raise self._refusal(
                command,
                Reason.TOO_OLD,
                f"its stamp, by the sender's clock, is {age:.3f} s old by the driver's; "
                f"max_command_age is {limit:g} s",
                _SYNCHRONISE,
            )
        if -age > min(FUTURE_TOLERANCE, limit):
            raise self._refusal(
                command,
                Reason.FROM_FUTURE,
                f"its stamp, by the sender's clock, lies {-age:.3f} s ahead of the driver's",
                _SYNCHRONISE,
            )

    def _check_frame(self, command: Command, value: Pose | Twist | Wrench | CartesianServo) -> None:
        frame = self._frames[self._axes.frame_of(command)]
        if value.frame_id not in ("", frame):
            raise self._refusal(
                command,
                Reason.WRONG_FRAME,
                f"frame_id {_shown(value.frame_id)} is not known here",
                f"Give it in {self.told_frame(frame)!r}, or leave frame_id empty.",
            )

    def _check_numbers(self, command: Command, values: Vector, field: str) -> None:
        if all(abs(value) <= LARGEST for value in values.tolist()):  # NaN is not
            return
        index, finite = int(np.argmin(np.isfinite(values))), np.isfinite(values).all()
        if not finite:
            raise self._refusal(
                command,
                Reason.NOT_FINITE,
                f"{field}[{index}] is {values[index]}",
                "Send finite numbers.",
            )
        index = int(np.argmax(np.abs(values)))
        raise self._refusal(
            command,
            Reason.OUT_OF_RANGE,
            f"{field}[{index}] is {values[index]:g}",
            f"No number may exceed {LARGEST:g}.",
        )

    def _check_joints(self, command: Command, value: JointState) -> JointState:
        field = _FIELD_NAME[command.kind]
        values = joint_values(command.kind, value)
        self._check_size(command, values, field)
        values = self._in_declared_order(command, value.name, values)
        self._check_numbers(command, values, field)
        if command.is_relative:
            self._check_magnitude(command, values, self._spans)
        elif command.level is Level.MOVE:
            self._check_range(command, values)
        elif command.kind is Kind.VELOCITY:
            self._check_magnitude(command, values, self._velocity)
        elif command.kind is Kind.EFFORT:
            self._check_magnitude(command, values, self._effort)
        return joint_state(command.kind, values)

    def _check_size(self, command: Command, values: Vector, field: str) -> None:
        if values.size == 0:
            raise self._refusal(
                command, Reason.EMPTY, f"{field} is empty", f"Fill {field} ({command.units})."
            )
        if values.size != len(self._joints):
            raise self._refusal(
                command,
                Reason.WRONG_SIZE,
                f"{values.size} values in {field} for {len(self._joints)} joints",
                f"Send one value for each of {', '.join(self._joints)}.",
            )

    def _in_declared_order(
        self, command: Command, names: tuple[str, ...], values: Vector
    ) -> Vector:
        if not names or names == self._joints:
            return values
        if sorted(names) != sorted(self._joints):
            raise self._refusal(
                command,
                Reason.WRONG_NAMES,
                f"names {_shown(list(names))} are not the joints of this device",
                f"Name each of {', '.join(self._joints)} once, or send no names.",
            )
        ordered = np.empty_like(values)
        for name, number in zip(names, values, strict=True):
            ordered[self._index[name]] = number
        return vector(ordered)

    def _check_range(self, command: Command, values: Vector) -> None:
        outside = ~((values >= self._lower) & (values <= self._upper))
        if outside.any():
            index = int(np.argmax(outside))
            text = (
                f"{self._joints[index]} at {values[index]:.4f} is outside "
                f"[{self._lower[index]:.4f}, {self._upper[index]:.4f}]"
            )
            raise self._refusal(command, Reason.OUT_OF_RANGE, text, "Stay within the limits.")

    def _check_magnitude(self, command: Command, values: Vector, limits: Vector) -> None:
        excess = ~(np.abs(values) <= limits)
        if excess.any():
            index = int(np.argmax(excess))
            raise self._refusal(
                command,
                Reason.OUT_OF_RANGE,
                f"{self._joints[index]}: {values[index]:.4f} exceeds {limits[index]:.4f} "
                f"{command.units.split()[0]}",
                "Stay within the limits.",
            )

    def check_pose(self, command: Command, value: Pose) -> Pose:
        """Return the pose in the base frame with a quaternion of unit length.

        Raises:
            CommandRefused: unknown frame, not finite, or no unit quaternion.
        """
        self._check_frame(command, value)
        for size, field in ((3, value.position), (4, value.orientation)):
            if field.size != size:
                raise self._refusal(
                    command,
                    Reason.WRONG_SIZE,
                    f"{field.size} values where a pose has {size}",
                    "A pose is a position of 3 and a quaternion of 4 (x, y, z, w).",
                )
        self._check_numbers(command, value.position, "position")
        self._check_numbers(command, value.orientation, "orientation")
        norm = math.hypot(*value.orientation.tolist())
        if not abs(norm - 1.0) <= QUATERNION_TOLERANCE:
            raise self._refusal(
                command,
                Reason.BAD_QUATERNION,
                f"the quaternion has a norm of {norm:.6g}",
                "Send a unit quaternion (x, y, z, w).",
            )
        if command.is_relative:
            self.check_way(command, value.position)
        return Pose(value.position, vector(value.orientation / norm), self._frames[command.frame])

    def check_way(self, command: Command, way: Vector) -> None:
        """Judge how far (3,) an increment of the tool leads, or all that are still to be carried out.

        Raises:
            CommandRefused: further than `FARTHEST`.
        """
        far = math.hypot(*way.tolist())
        if not far <= FARTHEST:
            raise self._refusal(
                command,
                Reason.OUT_OF_RANGE,
                f"it leads {far:.4f} m away",
                f"It may lead {FARTHEST:g} m away.",
            )

    def _check_twist(self, command: Command, value: Twist) -> Twist:
        parts = (("linear velocity", value.linear), ("angular velocity", value.angular))
        self._check_parts(command, value, parts, self._twist_limits)
        return value

    def _check_wrench(self, command: Command, value: Wrench) -> Wrench:
        parts = (("force", value.force), ("torque", value.torque))
        self._check_parts(command, value, parts, self._wrench_limits)
        return value

    def _check_ratio(self, command: Command, value: Number) -> Number:
        if not 0.0 < value.value <= 1.0:
            raise self._refusal(
                command,
                Reason.OUT_OF_RANGE,
                f"{value.value} is no ratio",
                "Send a number above 0 and up to 1.",
            )
        return value

    def _check_joint_servo(self, command: Command, value: JointServo) -> JointServo:
        """Return it in declared order, with zeros where another axis' kind of value is not given."""
        self._check_size(command, vector(value.modes), "mode")
        used = self._check_modes(command, value.modes)
        order = vector(np.arange(len(self._joints)))
        order = self._in_declared_order(command, value.name, order)
        index = order.astype(int)
        modes = np.array(value.modes)[index]
        given = {
            AxisMode.POSITION: value.position,
            AxisMode.VELOCITY: value.velocity,
            AxisMode.EFFORT: value.effort,
        }
        limits = {AxisMode.VELOCITY: self._velocity, AxisMode.EFFORT: self._effort}
        ordered: dict[AxisMode, Vector] = {}
        for mode, values in given.items():
            if mode not in used:
                ordered[mode] = EMPTY
                continue
            name = mode.name.lower()
            self._check_size(command, values, name)
            counted = vector(np.where(modes == mode, values[index], 0.0))
            self._check_numbers(command, counted, name)
            if mode in limits:
                self._check_magnitude(command, counted, limits[mode])
            ordered[mode] = counted
        return JointServo(
            tuple(modes.tolist()),
            ordered[AxisMode.POSITION],
            ordered[AxisMode.VELOCITY],
            ordered[AxisMode.EFFORT],
        )

    def _check_cartesian_servo(self, command: Command, value: CartesianServo) -> CartesianServo:
        self._check_frame(command, value)
        if len(value.modes) != 6:
            raise self._refusal(
                command,
                Reason.WRONG_SIZE,
                f"{len(value.modes)} axis modes",
                "Send six: translation along x, y, z, rotation about x, y, z.",
            )
        self._check_modes(command, value.modes)
        if len(set(value.modes[3:])) > 1:
            raise self._refusal(
                command,
                Reason.UNSUPPORTED,
                "the three axes of rotation are of different modes",
                "Rotations about single axes do not add up: use one mode for all three.",
            )
        task = self.check_pose(command, value.task)
        modes = np.array(value.modes)
        goes, moves, pushes = (
            modes == mode for mode in (AxisMode.POSITION, AxisMode.VELOCITY, AxisMode.EFFORT)
        )
        pose, twist, wrench = _NOTHING
        if goes.any():
            orientation = value.pose.orientation if goes[3] else pose.orientation
            pose = Pose(_counted(value.pose.position, goes[:3]), orientation)
            pose = self.check_pose(command, pose)
        if moves.any():
            linear = _counted(value.twist.linear, moves[:3])
            twist = Twist(linear, _counted(value.twist.angular, moves[3:]))
            self._check_twist(command, twist)
        if pushes.any():
            force = _counted(value.wrench.force, pushes[:3])
            wrench = Wrench(force, _counted(value.wrench.torque, pushes[3:]))
            self._check_wrench(command, wrench)
        return CartesianServo(value.modes, pose, twist, wrench, task)

    def _check_modes(self, command: Command, modes: tuple[int, ...]) -> frozenset[int]:
        """Return the modes in use."""
        known = frozenset(AxisMode)
        strange = [mode for mode in modes if mode not in known]
        if strange:
            raise self._refusal(
                command,
                Reason.UNSUPPORTED,
                f"axis mode {strange[0]}",
                "Of a mixed setpoint, each axis follows one kind of value: "
                + ", ".join(f"{mode.name} ({int(mode)})" for mode in AxisMode)
                + ".",
            )
        return frozenset(modes) - {AxisMode.NONE}

    def _check_parts(
        self,
        command: Command,
        value: Twist | Wrench,
        parts: Iterable[tuple[str, Vector]],
        limits: tuple[float, ...],
    ) -> None:
        """Check the two halves of a twist or wrench, each against the limit of its norm."""
        self._check_frame(command, value)
        for index, (name, part) in enumerate(parts):
            if part.size != 3:
                raise self._refusal(
                    command,
                    Reason.WRONG_SIZE,
                    f"{part.size} values in {name}",
                    "Send three values for x, y and z.",
                )
            self._check_numbers(command, part, name)
            size = math.hypot(*part.tolist())
            if limits and not size <= limits[index]:
                raise self._refusal(
                    command,
                    Reason.OUT_OF_RANGE,
                    f"{name} {size:.4f} exceeds {limits[index]:.4f}",
                    "Stay within the limits.",
                )


def _shown(what: object) -> str:
    """Return what somebody sent as a message may quote it."""
    text = repr(what)
    return text if len(text) <= 200 else f"{text[:200]}..."


def _counted(values: Vector, counts: NDArray[np.bool_]) -> Vector:
    """Return values with zeros where they do not count; if of a wrong size as they are, to be refused."""
    return vector(np.where(counts, values, 0.0)) if values.size == counts.size else values
