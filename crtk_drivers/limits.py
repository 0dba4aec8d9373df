"""What may be commanded: the checks between a client and the hardware.

Two stages. `CommandCheck.check` judges a command as it arrives, in the client's thread, and touches no
bus: type, names, size, finite, quaternion, frame, age, range, reach. `SetpointLimiter.limit` judges the
value that will really be sent, in the I/O thread, against the value sent before it and the time since:
nothing that a conversion in between did (inverse kinematics, accumulation) can slip past.

A refusal is a `CommandRefused` with a reason and a remedy; it changes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from crtk_drivers.commands import Command, Kind, Level, Payload
from crtk_drivers.device import Capabilities, Mode, Setpoint
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.samples import (
    JointState,
    Pose,
    Twist,
    Value,
    Vector,
    Wrench,
    joint_state,
    joint_values,
    vector,
)

QUATERNION_TOLERANCE = 1e-3
"""A norm further than this from one is refused; within it the quaternion is normalised."""

_VELOCITY_TOLERANCE = 0.01
"""By how much a stream of positions may exceed the velocity limits for ever: clocks and rounding differ."""

FUTURE_TOLERANCE = 0.5
"""Seconds that a command's stamp may lie ahead of this machine's clock, if ages are checked."""

_FIELD_NAME = {
    Kind.POSITION: "position",
    Kind.RELATIVE: "position",
    Kind.VELOCITY: "velocity",
    Kind.EFFORT: "effort",
}
_VALUE_TYPE: dict[Payload, type] = {
    Payload.JOINT_STATE: JointState,
    Payload.POSE: Pose,
    Payload.TWIST: Twist,
    Payload.WRENCH: Wrench,
}


@dataclass(frozen=True, slots=True)
class LimitPolicy:
    """The choices a user has.

    Attributes:
        clamp_servo: a servo position out of range is clamped with a warning; otherwise refused.
        max_step: largest distance in rad (m) between two servo positions of one joint, as a time: a
            joint may be asked to go as far as its velocity limit takes it in this many seconds. It is
            also how far a stream may run ahead of its velocity limit before it is refused.
        max_linear_step: the same for the tool, in m, for hardware that takes poses; it may turn as far
            as its angular velocity limit takes it in `max_step`.
        max_command_age: in seconds; a command whose stamp is older is refused. None: not checked.
    """

    clamp_servo: bool = True
    max_step: float = 0.1
    max_linear_step: float = 0.05
    max_command_age: float | None = None


class CommandCheck:
    """The first stage, for one device."""

    def __init__(self, capabilities: Capabilities, policy: LimitPolicy, where: str) -> None:
        self._joints = capabilities.joints
        self._index = {name: i for i, name in enumerate(capabilities.joints)}
        self._frames = frozenset({"", capabilities.base_frame})
        self._base_frame = capabilities.base_frame
        self._policy = policy
        self._where = where
        self._lower = vector([limit.lower for limit in capabilities.limits])
        self._upper = vector([limit.upper for limit in capabilities.limits])
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
        expected = _VALUE_TYPE[command.payload]
        if not isinstance(value, expected):
            raise self._refusal(
                command,
                Reason.WRONG_TYPE,
                f"got {type(value).__name__}",
                f"Send a {expected.__name__}.",
            )
        self._check_age(command, stamp_ns, now_ns)
        if isinstance(value, JointState):
            return self._check_joints(command, value)
        if isinstance(value, Pose):
            return self.check_pose(command, value)
        if isinstance(value, Twist):
            parts = (("linear velocity", value.linear), ("angular velocity", value.angular))
            return self._check_parts(command, value, parts, self._twist_limits)
        assert isinstance(value, Wrench)
        parts = (("force", value.force), ("torque", value.torque))
        return self._check_parts(command, value, parts, self._wrench_limits)

    def check_joints(self, command: Command, joints: Vector) -> Vector:
        """Return a joint position (n,) that is given as a bare vector, as kinematics queries do.

        Raises:
            CommandRefused: empty, wrong size or not finite.
        """
        self._check_size(command, joints, "position")
        self._check_finite(command, joints, "position")
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
                command, Reason.TOO_OLD, f"its stamp is {age:.3f} s old", f"At most {limit} s."
            )
        if age < -FUTURE_TOLERANCE:
            raise self._refusal(
                command,
                Reason.FROM_FUTURE,
                f"its stamp lies {-age:.3f} s ahead",
                "Synchronise the clocks of the two machines.",
            )

    def _check_frame(self, command: Command, value: Pose | Twist | Wrench) -> None:
        if value.frame_id not in self._frames:
            raise self._refusal(
                command,
                Reason.WRONG_FRAME,
                f"frame_id {value.frame_id!r} is not known here",
                f"Give it in {self._base_frame!r}, or leave frame_id empty.",
            )

    def _check_finite(self, command: Command, values: Vector, field: str) -> None:
        finite = np.isfinite(values)
        if not finite.all():
            index = int(np.argmin(finite))
            raise self._refusal(
                command,
                Reason.NOT_FINITE,
                f"{field}[{index}] is {values[index]}",
                "Send finite numbers.",
            )

    def _check_joints(self, command: Command, value: JointState) -> JointState:
        field = _FIELD_NAME[command.kind]
        values = joint_values(command.kind, value)
        self._check_size(command, values, field)
        values = self._in_declared_order(command, value.name, values)
        self._check_finite(command, values, field)
        if command.level is Level.MOVE and command.kind is Kind.POSITION:
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
                f"names {list(names)} are not the joints of this device",
                f"Name each of {', '.join(self._joints)} once, or send no names.",
            )
        ordered = np.empty_like(values)
        for name, number in zip(names, values, strict=True):
            ordered[self._index[name]] = number
        return vector(ordered)

    def _check_range(self, command: Command, values: Vector) -> None:
        outside = (values < self._lower) | (values > self._upper)
        if outside.any():
            index = int(np.argmax(outside))
            text = (
                f"{self._joints[index]} at {values[index]:.4f} is outside "
                f"[{self._lower[index]:.4f}, {self._upper[index]:.4f}]"
            )
            raise self._refusal(command, Reason.OUT_OF_RANGE, text, "Stay within the limits.")

    def _check_magnitude(self, command: Command, values: Vector, limits: Vector) -> None:
        excess = np.abs(values) > limits
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
        self._check_finite(command, value.position, "position")
        self._check_finite(command, value.orientation, "orientation")
        norm = float(np.linalg.norm(value.orientation))
        if abs(norm - 1.0) > QUATERNION_TOLERANCE:
            raise self._refusal(
                command,
                Reason.BAD_QUATERNION,
                f"the quaternion has a norm of {norm:.6g}",
                "Send a unit quaternion (x, y, z, w).",
            )
        return Pose(value.position, vector(value.orientation / norm), self._base_frame)

    def _check_parts(
        self,
        command: Command,
        value: Twist | Wrench,
        parts: Iterable[tuple[str, Vector]],
        limits: tuple[float, ...],
    ) -> Twist | Wrench:
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
            self._check_finite(command, part, name)
            size = float(np.linalg.norm(part))
            if limits and size > limits[index]:
                raise self._refusal(
                    command,
                    Reason.OUT_OF_RANGE,
                    f"{name} {size:.4f} exceeds {limits[index]:.4f}",
                    "Stay within the limits.",
                )
        return value


@dataclass(frozen=True, slots=True, eq=False)
class Limited:
    """A setpoint that may be sent, and what was clamped."""

    setpoint: Setpoint
    warning: str = ""


class SetpointLimiter:
    """The second stage, for one device: the last gate before the wire.

    `judge` looks at one setpoint alone. `limit`, for the I/O thread only, also keeps the account of a
    stream's velocity: a joint position may be as far away as the velocity limits allow in the time since
    the last one, plus what was left of `LimitPolicy.max_step`.
    """

    def __init__(self, capabilities: Capabilities, policy: LimitPolicy, where: str) -> None:
        self._joints = capabilities.joints
        self._policy = policy
        self._where = where
        self._lower = vector([limit.lower for limit in capabilities.limits])
        self._upper = vector([limit.upper for limit in capabilities.limits])
        self._velocity = vector([limit.velocity for limit in capabilities.limits])
        self._effort = vector([limit.effort for limit in capabilities.limits])
        self._cartesian = capabilities.cartesian_limits
        self._credit = policy.max_step
        self._credited = -math.inf
        self._judges: dict[Mode, Callable[[str, Vector, Vector], tuple[Vector, str]]] = {
            Mode.JOINT_POSITION: self._position,
            Mode.JOINT_VELOCITY: self._joint_velocity,
            Mode.JOINT_EFFORT: self._joint_effort,
            Mode.CARTESIAN_POSITION: self._pose,
            Mode.CARTESIAN_VELOCITY: self._twist,
            Mode.CARTESIAN_EFFORT: self._wrench,
        }

    def judge(self, name: str, setpoint: Setpoint, before: Vector) -> Limited:
        """Return the setpoint that may be sent.

        Positions are clamped to their range and refused when they jump; velocities, efforts and
        wrenches are scaled as a whole vector, so that their direction is kept.

        Args:
            name: of the command it comes from.
            setpoint: to be sent.
            before: the position (pose) that the hardware was sent last, or has, in the same space;
                empty if unknown. Not used for velocities and efforts.

        Raises:
            CommandRefused: not finite, further than the largest step away, or out of range where
                the policy is not to clamp.
        """
        if not np.isfinite(setpoint.values).all():
            raise self._refusal(
                name, Reason.NOT_FINITE, "a value to be sent is not finite", "Please report this."
            )
        values, warning = self._judges[setpoint.mode](name, setpoint.values, before)
        return Limited(Setpoint(setpoint.mode, vector(values)), warning)

    def limit(self, name: str, setpoint: Setpoint, before: Vector, now: float) -> Limited:
        """Return the setpoint to send now; see `judge`.

        Raises:
            CommandRefused: as `judge`, or a stream of positions that is faster than the velocity limits.
        """
        limited = self.judge(name, setpoint, before)
        if setpoint.mode is Mode.JOINT_POSITION and before.size:
            self._spend(name, np.abs(limited.setpoint.values - before) / self._velocity, now)
        return limited

    def _spend(self, name: str, times: Vector, now: float) -> None:
        """Take the time that the slowest joint needs from what has passed."""
        earned = (now - self._credited) * (1.0 + _VELOCITY_TOLERANCE)
        credit = min(self._policy.max_step, self._credit + earned)
        index = int(np.argmax(times))
        if times[index] > credit:
            raise self._refusal(
                name,
                Reason.STEP_TOO_LARGE,
                f"{self._joints[index]} would be faster than {self._velocity[index]:.4f}",
                "Start from setpoint_js and stream more slowly, or use move_jp.",
            )
        self._credit, self._credited = credit - float(times[index]), now

    def _refusal(self, name: str, reason: Reason, message: str, remedy: str) -> CommandRefused:
        return CommandRefused(name, reason, message, where=self._where, remedy=remedy)

    def _position(self, name: str, values: Vector, before: Vector) -> tuple[Vector, str]:
        values, warning = self.into_range(name, values, before)
        if before.size:
            step = np.abs(values - before)
            largest = self._velocity * self._policy.max_step
            excess = step > largest
            if excess.any():
                index = int(np.argmax(excess))
                raise self._refusal(
                    name,
                    Reason.STEP_TOO_LARGE,
                    f"{self._joints[index]} would jump by {step[index]:.4f}, "
                    f"more than {largest[index]:.4f}",
                    "Start from setpoint_js and send smaller steps, or use move_jp.",
                )
        return values, warning

    def into_range(self, name: str, values: Vector, before: Vector) -> tuple[Vector, str]:
        """Return joint positions (n,), clamped to their range, and a warning if they were.

        Args:
            name: of the command they come from.
            values: wanted.
            before: where they are; what is out of range already may stay or come back.

        Raises:
            CommandRefused: out of range where the policy is not to clamp.
        """
        lower, upper = self._lower, self._upper
        if before.size:
            lower, upper = np.minimum(lower, before), np.maximum(upper, before)
        outside = (values < lower) | (values > upper)
        if not outside.any():
            return values, ""
        index = int(np.argmax(outside))
        text = (
            f"{self._joints[index]} at {values[index]:.4f} is outside "
            f"[{self._lower[index]:.4f}, {self._upper[index]:.4f}]"
        )
        if not self._policy.clamp_servo:
            raise self._refusal(name, Reason.OUT_OF_RANGE, text, "Stay within the limits.")
        return np.clip(values, lower, upper), f"{text}: clamped"

    def _joint_velocity(self, name: str, values: Vector, before: Vector) -> tuple[Vector, str]:
        return _scaled_into(values, self._velocity), ""

    def _joint_effort(self, name: str, values: Vector, before: Vector) -> tuple[Vector, str]:
        return _scaled_into(values, self._effort), ""

    def _pose(self, name: str, values: Vector, before: Vector) -> tuple[Vector, str]:
        if before.size:
            step = float(np.linalg.norm(values[:3] - before[:3]))
            if step > self._policy.max_linear_step:
                raise self._refusal(
                    name,
                    Reason.STEP_TOO_LARGE,
                    f"the tool would jump by {step:.4f} m, "
                    f"more than {self._policy.max_linear_step:.4f} m",
                    "Start from setpoint_cp and send smaller steps, or use move_cp.",
                )
            self._check_turn(name, values[3:], before[3:])
        return values, ""

    def _check_turn(self, name: str, after: Vector, before: Vector) -> None:
        if self._cartesian is None:
            return
        turn = 2.0 * math.acos(min(1.0, abs(float(np.dot(after, before)))))
        largest = self._cartesian.angular_velocity * self._policy.max_step
        if turn > largest:
            raise self._refusal(
                name,
                Reason.STEP_TOO_LARGE,
                f"the tool would turn by {turn:.4f} rad, more than {largest:.4f} rad",
                "Start from setpoint_cp and send smaller steps, or use move_cp.",
            )

    def _twist(self, name: str, values: Vector, before: Vector) -> tuple[Vector, str]:
        if self._cartesian is None:
            return values, ""
        limit = self._cartesian
        return _norms_into(values, limit.linear_velocity, limit.angular_velocity), ""

    def _wrench(self, name: str, values: Vector, before: Vector) -> tuple[Vector, str]:
        if self._cartesian is None:
            return values, ""
        return _norms_into(values, self._cartesian.force, self._cartesian.torque), ""


def _scaled_into(values: Vector, limits: Vector) -> Vector:
    """Scale a vector so that no element exceeds its limit; one whose limit is 0 becomes 0."""
    allowed = np.where(limits > 0.0, values, 0.0)
    ratios = np.divide(np.abs(values), limits, out=np.zeros_like(values), where=limits > 0.0)
    largest = float(ratios.max(initial=0.0))
    return allowed / largest if largest > 1.0 else allowed


def _norms_into(values: Vector, first: float, second: float) -> Vector:
    """Scale six values so that neither half has a norm above its limit."""
    ratio = max(math.hypot(*values[:3]) / first, math.hypot(*values[3:]) / second)
    return values / ratio if ratio > 1.0 else values
