"""What may be sent: the last gate before the wire.

`SetpointLimiter.limit` judges, in the I/O thread, the value that will really be sent, against the value sent
before it and the time since: nothing that a conversion since the command was checked
(`crtk_drivers.gates.command`) did to it, inverse kinematics or accumulation, can slip past. A refusal is a
`CommandRefused` with a reason and a remedy; it changes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from crtk_drivers.device import Capabilities, Kinematics, Mode, Setpoint
from crtk_drivers.errors import REPORT, CommandRefused, Reason
from crtk_drivers.gates.braking import NEGLIGIBLE, stoppable_speed
from crtk_drivers.gates.resolved_rate import DAMPING
from crtk_drivers.options import LimitPolicy
from crtk_drivers.samples import JointState, Pose, Vector, vector

_VELOCITY_TOLERANCE = 0.01
"""By how much a stream of positions may exceed the velocity limits for ever: clocks and rounding differ."""

_ROUNDING = 1e-9
"""Seconds of motion."""

_BRAKING_CYCLES = 2.0
"""Cycles from a sample until what follows from it takes effect."""

_START = 2.0
"""Times `LimitPolicy.max_step` in which the arm must be able to be where a stream begins."""

_OVERSPEED = 1.1
"""By how much a joint that an effort drives may exceed its speed: what is measured is noisy."""

_NOISE = 0.03
"""Share of its speed with which a joint that stands may seem to move."""


@dataclass(frozen=True, slots=True, eq=False)
class Limited:
    """A setpoint that may be sent, and what was clamped."""

    setpoint: Setpoint
    warning: str = ""


class SetpointLimiter:
    """The gate of one device.

    `judge` looks at one setpoint alone. `limit`, for the I/O thread only, also keeps the account of a
    stream's velocity: a joint position may be as far away as the velocity limits allow in the time since
    the last one, plus what was left of `LimitPolicy.max_step`.

    Args:
        capabilities: of the device.
        policy: the user's choices.
        where: the device, for messages.
        kinematics: those that count now, for twists that hardware carries out.
    """

    def __init__(
        self,
        capabilities: Capabilities,
        policy: LimitPolicy,
        where: str,
        kinematics: Callable[[], Kinematics | None] = lambda: None,
    ) -> None:
        self._joints = capabilities.joints
        self._policy = policy
        self._where = where
        self._lower = vector([limit.lower for limit in capabilities.limits])
        self._upper = vector([limit.upper for limit in capabilities.limits])
        self._velocity = vector([limit.velocity for limit in capabilities.limits])
        self._ranges = list(zip(self._lower.tolist(), self._upper.tolist(), strict=True))
        self._fastest = self._velocity.tolist()
        self._effort = vector([limit.effort for limit in capabilities.limits])
        self._cartesian = capabilities.cartesian_limits
        self._kinematics = kinematics
        lag = 0.0 if capabilities.following is None else capabilities.following.lag
        delay = lag + _BRAKING_CYCLES / capabilities.rate
        self._braking = [(limit.acceleration, delay) for limit in capabilities.limits]
        self._letting_go = [
            (min(limit.acceleration, limit.velocity / capabilities.stop.time), delay)
            for limit in capabilities.limits
        ]
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
        wrenches are scaled as a whole vector, so that their direction is kept. A velocity is then lowered to
        that from which each joint still stops before its range ends, with its own deceleration.

        Args:
            name: of the command it comes from.
            setpoint: to be sent.
            before: the position (pose) that the hardware was sent last, or has, in the same space; for
                velocities, efforts and twists the joint position (n,) that is measured. Empty if unknown.

        Raises:
            CommandRefused: not finite, further than the largest step away, or out of range where
                the policy is not to clamp.
        """
        self._check_finite(name, setpoint, before)
        return _limited(setpoint, *self._judges[setpoint.mode](name, setpoint.values, before))

    def limit(self, name: str, setpoint: Setpoint, before: Vector, now: float) -> Limited:
        """Return the setpoint to send now; see `judge`.

        Raises:
            CommandRefused: as `judge`, or a stream of positions that is faster than the velocity limits.
        """
        if setpoint.mode is not Mode.JOINT_POSITION or not before.size:
            return self.judge(name, setpoint, before)
        self._check_finite(name, setpoint, before)
        values, warning = self.into_range(name, setpoint.values, before)
        longest, index = self._time_between(values, before)
        self._check_jump(name, longest, index)
        self._credit = self._credit_after(name, longest, index, now)
        self._credited = now
        return _limited(setpoint, values, warning)

    def check_start(self, name: str, values: Vector, before: Vector, velocity: Vector) -> None:
        """Refuse the first position (n,) of a stream if the joints cannot be there soon.

        Args:
            name: of the command.
            values: to be sent.
            before: (n,) what was sent last.
            velocity: (n,) with which the joints move now.

        Raises:
            CommandRefused: further than the acceleration limits take a joint in twice `LimitPolicy.max_step`.
        """
        jump = self._jump_at_start(values, before, velocity)
        if jump is not None:
            joint, step, reach = jump
            raise self._refusal(
                name,
                Reason.STEP_TOO_LARGE,
                f"{joint} would begin with a jump of {step:.4f}; from rest it gets {reach:.4f} far",
                "Start from setpoint_js and send smaller steps, or use move_jp.",
            )

    def can_start(self, values: Vector, before: Vector, velocity: Vector) -> bool:
        """Whether `check_start` would let this pass."""
        return self._jump_at_start(values, before, velocity) is None

    def _jump_at_start(
        self, values: Vector, before: Vector, velocity: Vector
    ) -> tuple[str, float, float] | None:
        time = _START * self._policy.max_step
        steps = (values - before).tolist()
        rows = zip(self._joints, steps, velocity.tolist(), self._braking, strict=True)
        for joint, step, speed, (acceleration, _) in rows:
            reach, way = 0.5 * acceleration * time * time, speed * time
            if not min(0.0, way) - reach <= step <= max(0.0, way) + reach:
                return joint, step, reach
        return None

    def check_speed(self, name: str, values: Vector, before: Vector, now: float) -> float:
        """Refuse joint positions (n,) that are too far from those before to be sent now.

        Returns:
            seconds of motion at full speed that a stream may still ask for after them.

        Raises:
            CommandRefused: the stream is faster than the velocity limits.
        """
        return self._credit_after(name, *self._time_between(values, before), now)

    def _credit_after(self, name: str, longest: float, index: int, now: float) -> float:
        credit = self.credit(now)
        if not longest <= credit + _ROUNDING:
            raise self._refusal(
                name,
                Reason.STEP_TOO_LARGE,
                f"{self._joints[index]} would be faster than {self._fastest[index]:.4f}",
                "Start from setpoint_js and stream more slowly, or use move_jp.",
            )
        return max(0.0, credit - longest)

    def judge_tool(self, name: str, pose: Pose, before: Pose) -> None:
        """Refuse a pose of the tool that is too far from the one before.

        Raises:
            CommandRefused: further than the largest step.
        """
        self._check_step(name, pose.position, before.position)
        self._check_turn(name, pose.orientation, before.orientation)

    def credit(self, now: float) -> float:
        """Return the seconds of motion at full speed that a stream may ask for now."""
        earned = (now - self._credited) * (1.0 + _VELOCITY_TOLERANCE)
        return min(self._policy.max_step, self._credit + earned)

    def _refusal(self, name: str, reason: Reason, message: str, remedy: str) -> CommandRefused:
        return CommandRefused(name, reason, message, where=self._where, remedy=remedy)

    def _check_finite(self, name: str, setpoint: Setpoint, before: Vector) -> None:
        if not all(map(math.isfinite, setpoint.values.tolist())):
            raise self._refusal(name, Reason.NOT_FINITE, "a value to be sent is not finite", REPORT)
        if not all(map(math.isfinite, before.tolist())):
            raise self._refusal(
                name,
                Reason.NOT_FINITE,
                "it is not known where the joints are: what is measured is not finite",
                "Look at the device's encoders and at its link.",
            )

    def _position(self, name: str, values: Vector, before: Vector) -> tuple[Vector, str]:
        values, warning = self.into_range(name, values, before)
        if before.size:
            self._check_jump(name, *self._time_between(values, before))
        return values, warning

    def _check_jump(self, name: str, longest: float, index: int) -> None:
        if not longest <= self._policy.max_step:
            speed = self._fastest[index]
            raise self._refusal(
                name,
                Reason.STEP_TOO_LARGE,
                f"{self._joints[index]} would jump by {longest * speed:.4f}, "
                f"more than {self._policy.max_step * speed:.4f}",
                "Start from setpoint_js and send smaller steps, or use move_jp.",
            )

    def time_between(self, values: Vector, before: Vector) -> float:
        """Return the seconds from one joint position (n,) to another at full speed."""
        return self._time_between(values, before)[0]

    def _time_between(self, values: Vector, before: Vector) -> tuple[float, int]:
        """Return the seconds that the slowest joint takes, and which it is."""
        ways = zip(values.tolist(), before.tolist(), self._fastest, strict=True)
        times = [abs(value - old) / fastest for value, old, fastest in ways]
        longest = max(times)
        return longest, times.index(longest)

    def into_range(self, name: str, values: Vector, before: Vector) -> tuple[Vector, str]:
        """Return joint positions (n,), clamped to their range, and a warning if they were.

        Args:
            name: of the command they come from.
            values: wanted.
            before: where they are; what is out of range already may stay or come back.

        Raises:
            CommandRefused: out of range where the policy is not to clamp.
        """
        if all(
            low <= value <= high
            for value, (low, high) in zip(values.tolist(), self._ranges, strict=True)
        ):
            return values, ""
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
        values = _scaled_into(values, self._velocity)
        if not before.size:
            return values, ""
        bounds = self._stoppable(before, self._braking)
        pairs = list(zip(values.tolist(), bounds, strict=True))
        if all(low <= value <= high for value, (low, high) in pairs):
            return values, ""
        slowed = [min(max(value, low), high) for value, (low, high) in pairs]
        index = next(i for i, (value, (low, high)) in enumerate(pairs) if not low <= value <= high)
        return vector(slowed), self._slowed_text(index, before, slowed[index])

    def _stoppable(
        self, joints: Vector, brakes: Sequence[tuple[float, float]]
    ) -> list[tuple[float, float]]:
        """Return the velocities down and up (n) from which each joint still stops before its range ends.

        Args:
            joints: where they are.
            brakes: deceleration of each, and the delay before it.
        """
        rows = zip(joints.tolist(), self._ranges, brakes, strict=True)
        return [
            (-stoppable_speed(here - low, *braking), stoppable_speed(high - here, *braking))
            for here, (low, high), braking in rows
        ]

    def _slowed_text(self, index: int, joints: Vector, speed: float) -> str:
        low, high = self._ranges[index]
        return (
            f"{self._joints[index]} at {joints[index]:.4f} is near the end of [{low:.4f}, {high:.4f}]: "
            f"slowed to {speed:.4f}"
        )

    def _joint_effort(self, name: str, values: Vector, before: Vector) -> tuple[Vector, str]:
        if before.size:
            self._check_outward(name, values, before)
        return _scaled_into(values, self._effort), ""

    def _check_outward(self, name: str, values: Vector, joints: Vector) -> None:
        rows = zip(self._joints, values.tolist(), joints.tolist(), self._ranges, strict=True)
        for joint, effort, here, (low, high) in rows:
            if (here > high and effort > 0.0) or (here < low and effort < 0.0):
                raise self._refusal(
                    name,
                    Reason.OUT_OF_RANGE,
                    f"{joint} at {here:.4f} is outside [{low:.4f}, {high:.4f}], and this pushes it on",
                    "Bring it back: with move_jp, or an effort in the other direction.",
                )

    def check_driven(self, name: str, state: JointState) -> None:
        """Refuse to go on with efforts when a joint is too fast, or could not stop before its range ends.

        A joint that an effort drives is not braked but let go, before the device stops it otherwise: it is
        believed to need the whole time that the device declares for a stop from full speed.

        Args:
            name: of the command that drives it.
            state: as measured; what is not known of it is not judged.

        Raises:
            CommandRefused: with the joint, where it is and how fast.
        """
        velocity, position = state.velocity, state.position
        if velocity.size != len(self._joints):
            return
        bounds = (
            self._stoppable(position, self._letting_go)
            if position.size
            else [(-math.inf, math.inf)] * velocity.size
        )
        rows = zip(self._joints, velocity.tolist(), self._fastest, bounds, strict=True)
        for index, (joint, speed, fastest, (down, up)) in enumerate(rows):
            if not abs(speed) <= _OVERSPEED * fastest:
                raise self._refusal(
                    name,
                    Reason.OUT_OF_RANGE,
                    f"{joint} moves at {speed:.4f}, faster than {fastest:.4f}",
                    "Stopped. Send smaller efforts.",
                )
            margin = _NOISE * fastest
            if position.size and not down - margin <= speed <= up + margin:
                low, high = self._ranges[index]
                raise self._refusal(
                    name,
                    Reason.OUT_OF_RANGE,
                    f"{joint} at {position[index]:.4f} moves at {speed:.4f} towards the end of "
                    f"[{low:.4f}, {high:.4f}]",
                    "Stopped. Bring it back with move_jp, or an effort in the other direction.",
                )

    def _pose(self, name: str, values: Vector, before: Vector) -> tuple[Vector, str]:
        if before.size:
            self._check_step(name, values[:3], before[:3])
            self._check_turn(name, values[3:], before[3:])
        return values, ""

    def _check_step(self, name: str, after: Vector, before: Vector) -> None:
        step = math.dist(after, before)
        if not step <= self._policy.max_linear_step:
            raise self._refusal(
                name,
                Reason.STEP_TOO_LARGE,
                f"the tool would jump by {step:.4f} m, "
                f"more than {self._policy.max_linear_step:.4f} m",
                "Start from setpoint_cp and send smaller steps, or use move_cp.",
            )

    def _check_turn(self, name: str, after: Vector, before: Vector) -> None:
        if self._cartesian is None:
            return
        turn = 2.0 * math.acos(min(1.0, abs(float(np.dot(after, before)))))
        largest = self._cartesian.angular_velocity * self._policy.max_step
        if not turn <= largest:
            raise self._refusal(
                name,
                Reason.STEP_TOO_LARGE,
                f"the tool would turn by {turn:.4f} rad, more than {largest:.4f} rad",
                "Start from setpoint_cp and send smaller steps, or use move_cp.",
            )

    def _twist(self, name: str, values: Vector, before: Vector) -> tuple[Vector, str]:
        if self._cartesian is not None:
            limit = self._cartesian
            values = norms_into(values, limit.linear_velocity, limit.angular_velocity)
        kinematics = self._kinematics()
        if not before.size or kinematics is None or not values.any():
            return values, ""
        speeds, _ = DAMPING.rates(kinematics.jacobian(before), values)
        share, slowest = 1.0, 0
        for index, (speed, (low, high)) in enumerate(
            zip(speeds.tolist(), self._stoppable(before, self._braking), strict=True)
        ):
            bound = high if speed > 0.0 else low
            if abs(speed) <= NEGLIGIBLE * self._fastest[index]:
                continue
            if abs(speed) > abs(bound) and bound / speed < share:
                share, slowest = bound / speed, index
        if share == 1.0:
            return values, ""
        return vector(values * share), self._slowed_text(slowest, before, speeds[slowest] * share)

    def _wrench(self, name: str, values: Vector, before: Vector) -> tuple[Vector, str]:
        if self._cartesian is None:
            return values, ""
        return norms_into(values, self._cartesian.force, self._cartesian.torque), ""


def _limited(setpoint: Setpoint, values: Vector, warning: str) -> Limited:
    if values is setpoint.values:
        return Limited(setpoint, warning)
    return Limited(Setpoint(setpoint.mode, vector(values)), warning)


def _scaled_into(values: Vector, limits: Vector) -> Vector:
    """Scale a vector so that no element exceeds its limit; one whose limit is 0 becomes 0."""
    allowed = np.where(limits > 0.0, values, 0.0)
    ratios = np.divide(np.abs(values), limits, out=np.zeros_like(values), where=limits > 0.0)
    largest = float(ratios.max(initial=0.0))
    return allowed / largest if largest > 1.0 else allowed


def norms_into(values: Vector, first: float, second: float) -> Vector:
    """Scale six values so that neither half has a norm above its limit; the second limit may be 0."""
    if not second:
        values = vector((*values[:3], 0.0, 0.0, 0.0))
        ratio = math.hypot(*values[:3]) / first
    else:
        ratio = max(math.hypot(*values[:3]) / first, math.hypot(*values[3:]) / second)
    return values / ratio if ratio > 1.0 else values
