"""Which servos move which joint: several servos on one joint, several buses, signs, offsets and gears.

A `Chain` has one place for each joint and, behind them, one for the gripper's servo angle; and one place
for each servo, joint by joint, the first servo of a joint before its shadows. Arrays are of one kind or the
other: ``(joints,)`` or ``(servos,)``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from crtk_driver_dynamixel.calibration import Calibration, turn_shift
from crtk_driver_dynamixel.config import (
    DynamixelConfig,
    GripperConfig,
    JointConfig,
    ServoConfig,
    ShadowConfig,
)
from crtk_driver_dynamixel.models import OperatingMode, model_named
from crtk_driver_dynamixel.turns import Placed, Turns, placed
from crtk_driver_dynamixel.units import Scaling, Servo
from crtk_drivers.device import JointLimits
from crtk_drivers.errors import ConfigError
from crtk_drivers.samples import Vector

Follow = Literal["goals", "secondary_id", "cable"]
_SPEED_SHARE = 0.9
"""Of the no-load speed, where no limit is given: what remains under load, and below the register's limit."""
_JERK_TIME = 0.1
"""Without a limit for the jerk, time in s in which a joint may reach its greatest acceleration."""


@dataclass(frozen=True, slots=True)
class ChainServo:
    """One servo in its chain.

    Attributes:
        joint: place of its joint.
        name: of that joint.
        bus, id: where it is.
        protocol: that it speaks.
        units: what its counts mean.
        follow: how it gets its goals; ``goals``: from the driver.
        is_first: the first servo of its joint, whose position is that of the joint.
        reverse: wanted in bit 0 of its Drive Mode.
        config: keys of its joint.
    """

    joint: int
    name: str
    bus: str
    id: int
    protocol: int
    units: Servo
    follow: Follow
    is_first: bool
    reverse: bool
    config: ServoConfig

    @property
    def place(self) -> str:
        """For messages: ``joint elbow (servo 3 on main)``."""
        return f"joint {self.name} (servo {self.id} on {self.bus})"

    @property
    def key(self) -> str:
        """For files: ``main/3``."""
        return f"{self.bus}/{self.id}"

    @property
    def has_watchdog(self) -> bool:
        """Whether it has a bus watchdog."""
        return self.protocol == 2 and self.units.model.family.has_watchdog

    @property
    def takes_velocities(self) -> bool:
        """Whether it has a mode for velocities."""
        return self.protocol == 2 and OperatingMode.VELOCITY in self.units.model.modes

    @property
    def effort_mode(self) -> OperatingMode | None:
        """Operating mode for efforts; None if it takes none."""
        units = self.units
        if OperatingMode.CURRENT in units.model.modes and not math.isnan(units.torque_constant):
            return OperatingMode.CURRENT
        return OperatingMode.PWM if self.config.pwm_effort else None

    @property
    def current_limit(self) -> int | None:
        """Greatest count of current that it is asked for; None: what its register allows."""
        limit = self.config.current_limit
        if limit is None or not self.units.model.reports_current:
            return None
        return math.floor(limit / self.units.model.current_unit + 1e-9)

    @property
    def pwm_limit(self) -> int | None:
        """Greatest count of PWM that it is asked for; None: what its register allows."""
        limit = self.config.pwm_limit
        return (
            None if limit is None else math.floor(limit * self.units.model.family.full_pwm + 1e-9)
        )


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """The servos of a configuration, and how they make up its joints.

    Attributes:
        joints: names of the arm's joints, without the gripper.
        limits: of these joints.
        servos: see the module.
        scaling: between counts and SI, (servos,).
        gripper: the configuration of the gripper; its place among the joints is the last one.
        gripper_limits: of its opening, in m or rad.
    """

    joints: tuple[str, ...]
    limits: tuple[JointLimits, ...]
    servos: tuple[ChainServo, ...]
    scaling: Scaling
    gripper: GripperConfig | None
    gripper_limits: JointLimits | None
    _joint_of: NDArray[np.int64]
    _first: NDArray[np.int64]
    _count: Vector

    @classmethod
    def of(
        cls,
        config: DynamixelConfig,
        calibration: Calibration | None = None,
        *,
        checks_ranges: bool = True,
    ) -> Chain:
        """Make the chain of a configuration.

        Args:
            config: checked by itself already.
            calibration: found by `calibrate`, or None: every servo is as its offset says.
            checks_ranges: refuse a range that a servo cannot be sent to. Not for who only reads: before it
                is calibrated, a chain may stand anywhere.

        Raises:
            ConfigError: the calibration is of other servos, or a joint's range is beyond what a servo
                can be sent.
        """
        servos = tuple(_servos(config))
        if calibration is not None:
            calibration.check([(s.name, s.bus, s.id, s.units.model.name) for s in servos])
            found = calibration.by_place
            servos = tuple(replace(s, units=found[s.bus, s.id].applied_to(s.units)) for s in servos)
        if checks_ranges and (calibration is not None or not config.calibration):
            for servo in servos:
                _check_range(servo)
        joint_of = np.array([servo.joint for servo in servos], dtype=np.int64)
        return cls(
            joints=tuple(config.joints),
            limits=tuple(map(_limits, config.joints.values())),
            servos=servos,
            scaling=Scaling.of([servo.units for servo in servos]),
            gripper=config.gripper,
            gripper_limits=None if config.gripper is None else _gripper_limits(config.gripper),
            _joint_of=joint_of,
            _first=np.flatnonzero([servo.is_first for servo in servos]),
            _count=np.bincount(joint_of).astype(np.float64),
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all joints, that of the gripper last."""
        return self.joints if self.gripper is None else (*self.joints, self.gripper.joint)

    @property
    def has_efforts(self) -> bool:
        """Whether every joint of the arm measures efforts."""
        modes = self._effort_modes
        return bool(modes) and modes == {OperatingMode.CURRENT}

    @property
    def takes_efforts(self) -> bool:
        """Whether every joint of the arm takes efforts, be it as estimates."""
        modes = self._effort_modes
        return bool(modes) and None not in modes

    @property
    def _effort_modes(self) -> set[OperatingMode | None]:
        return {servo.effort_mode for servo in self.servos if servo.joint < len(self.joints)}

    def of_joint(self, joint: int) -> tuple[int, ...]:
        """Return the places of a joint's servos, the first one first."""
        return tuple(np.flatnonzero(self._joint_of == joint).tolist())

    def positions(self, values: Vector, valid: NDArray[np.bool_] | None = None) -> Vector:
        """Return positions or velocities (joints,) from those of the servos (servos,).

        They are those of a joint's first servo, or of the first one that is `valid`; NaN if none is.
        """
        if valid is None or valid.all():
            return values[self._first]
        joints = np.full(len(self._first), np.nan)
        usable = np.flatnonzero(valid)[::-1]
        joints[self._joint_of[usable]] = values[
            usable
        ]  # the first servo of a joint is written last
        return joints

    def efforts(self, values: Vector, valid: NDArray[np.bool_] | None = None) -> Vector:
        """Return efforts (joints,): the sum of a joint's servos (servos,); NaN if one is not valid."""
        known = values if valid is None else np.where(valid, values, np.nan)
        sums: Vector = np.add.reduceat(known, self._first)
        return sums

    def to_servos(self, values: Vector) -> Vector:
        """Return positions or velocities (servos,) for the joints' (joints,)."""
        return values[self._joint_of]

    def efforts_to_servos(self, values: Vector) -> Vector:
        """Return efforts (servos,) for the joints' (joints,): the servos of a joint share its effort."""
        return (values / self._count)[self._joint_of]

    def places_of(self, joints: range) -> tuple[int, ...]:
        """Return the places of the servos of these joints."""
        return tuple(i for i, servo in enumerate(self.servos) if servo.joint in joints)

    def part(self, joints: range) -> Chain:
        """Return the chain of these joints alone: the arm, or the gripper."""
        servos = tuple(
            replace(self.servos[i], joint=self.servos[i].joint - joints.start)
            for i in self.places_of(joints)
        )
        has_gripper = self.gripper is not None and len(self.joints) in joints
        joint_of = np.array([servo.joint for servo in servos], dtype=np.int64)
        return replace(
            self,
            joints=self.joints[joints.start : joints.stop],
            limits=self.limits[joints.start : joints.stop],
            servos=servos,
            scaling=self.scaling.part(self.places_of(joints)),
            gripper=self.gripper if has_gripper else None,
            _joint_of=joint_of,
            _first=np.flatnonzero([servo.is_first for servo in servos]),
            _count=np.bincount(joint_of).astype(np.float64),
        )

    def with_shifts(self, shifts: Mapping[int, int]) -> Chain:
        """Return the same with further shifts in counts by place of a servo; before `with_registers`."""
        servos = tuple(
            replace(servo, units=replace(servo.units, shift=servo.units.shift + shifts.get(i, 0)))
            for i, servo in enumerate(self.servos)
        )
        return replace(self, servos=servos, scaling=Scaling.of([servo.units for servo in servos]))

    def turn_shifts(
        self,
        counts: Sequence[int],
        known: Turns | None = None,
        has_run_on: Callable[[int], bool] = lambda place: False,
    ) -> Mapping[int, Placed]:
        """Return where servos of more than one turn are, by their place.

        Args:
            counts: present positions (servos,) after the power may have been off.
            known: what was kept of them (of the gripper the angle of its servo).
            has_run_on: whether a servo, by its place, has had its power all along.

        Raises:
            ConfigError: which turn a servo is in cannot be told; see `calibration.turn_shift`.
        """
        found = {}
        for at, (servo, count) in enumerate(zip(self.servos, counts, strict=True)):
            if servo.units.mode is OperatingMode.POSITION:
                continue
            if known is not None and servo.name in known.positions:
                last, shift = known.positions[servo.name], known.shifts.get(servo.key)
                found[at] = placed(
                    servo.units, count, last, shift, clean=known.clean, has_run_on=has_run_on(at)
                )
                continue
            lower, upper = servo_range(servo.config)
            try:
                found[at] = Placed(turn_shift(servo.units, count, lower, upper))
            except ConfigError as error:
                raise ConfigError(error.message, where=servo.place, remedy=error.remedy) from None
        return found

    def with_registers(self, read: Sequence[Mapping[str, int]]) -> Chain:
        """Return the same, which never asks a servo for more than its registers and its configuration allow.

        Args:
            read: of each servo, by name: min_ and max_position_limit, velocity_limit, current_limit,
                pwm_limit; what is not there does not limit.
        """
        scaling = self.scaling
        least, most = scaling.position.lowest.copy(), scaling.position.highest.copy()
        for place, (servo, registers) in enumerate(zip(self.servos, read, strict=True)):
            if servo.units.mode is OperatingMode.POSITION:
                low, high = registers.get("cw_angle_limit"), registers.get("ccw_angle_limit")
                least[place] = registers.get(
                    "min_position_limit", least[place] if low is None else low
                )
                most[place] = registers.get(
                    "max_position_limit", most[place] if high is None else high
                )
        velocity, current, pwm = (
            np.array([registers.get(name, math.inf) for registers in read])
            for name in ("velocity_limit", "current_limit", "pwm_limit")
        )
        current = np.minimum(current, [_or_infinite(s.current_limit) for s in self.servos])
        pwm = np.minimum(pwm, [_or_infinite(s.pwm_limit) for s in self.servos])
        limited = replace(
            scaling,
            position=scaling.position.limited(least, most),
            velocity=scaling.velocity.limited(-velocity, velocity),
            current=scaling.current.limited(-current, current),
            effort=scaling.effort.limited(-current, current),
            pwm=scaling.pwm.limited(-pwm, pwm),
        )
        return replace(self, scaling=limited)


def _or_infinite(limit: int | None) -> float:
    return math.inf if limit is None else limit


def _servos(config: DynamixelConfig) -> list[ChainServo]:
    tables: list[tuple[str, ServoConfig]] = [*config.joints.items()]
    if config.gripper is not None:
        tables.append((config.gripper.joint, config.gripper))
    servos = []
    for joint, (name, table) in enumerate(tables):
        first = _first_servo(joint, name, table)
        servos.append(first)
        servos += [_shadow(first, table, shadow) for shadow in table.shadows]
    return servos


def _first_servo(joint: int, name: str, table: ServoConfig) -> ChainServo:
    model = table.servo_model
    constant = model.torque_constant if table.torque_constant is None else table.torque_constant
    return ChainServo(
        joint=joint,
        name=name,
        bus=table.bus,
        id=table.id,
        protocol=table.protocol or model.family.protocol,
        units=Servo(
            model=model,
            sign=table.sign,
            gear=table.gear,
            offset=table.offset,
            torque_constant=constant,
            mode=table.operating_mode,
        ),
        follow="goals",
        is_first=True,
        reverse=table.reverse,
        config=table,
    )


def _shadow(first: ChainServo, table: ServoConfig, shadow: ShadowConfig) -> ChainServo:
    model = model_named(shadow.model) if shadow.model else first.units.model
    constant = model.torque_constant if table.torque_constant is None else table.torque_constant
    return replace(
        first,
        id=shadow.id,
        units=replace(
            first.units,
            model=model,
            sign=shadow.sign,
            offset=table.offset if shadow.offset is None else shadow.offset,
            torque_constant=constant,
        ),
        follow=shadow.follow,
        is_first=False,
        reverse=shadow.reverse,
    )


def _limits(joint: JointConfig) -> JointLimits:
    model = joint.servo_model
    lower, upper = joint.range
    velocity = _SPEED_SHARE * model.no_load_speed / joint.gear
    effort = model.stall_torque * joint.gear * len(joint.ids)
    return JointLimits(
        lower=lower,
        upper=upper,
        velocity=velocity if joint.velocity is None else joint.velocity,
        acceleration=joint.acceleration,
        jerk=joint.acceleration / _JERK_TIME if joint.jerk is None else joint.jerk,
        effort=effort if joint.effort is None else joint.effort,
    )


def _gripper_limits(gripper: GripperConfig) -> JointLimits:
    acceleration = gripper.acceleration or gripper.velocity / _JERK_TIME
    return JointLimits(
        lower=gripper.closed,
        upper=gripper.open,
        velocity=gripper.velocity,
        acceleration=acceleration,
        jerk=acceleration / _JERK_TIME,
        effort=gripper.effort,
    )


def servo_range(config: ServoConfig) -> tuple[float, float]:
    """Return the range of a joint, or of the servo angle of a gripper, in rad."""
    if isinstance(config, GripperConfig):
        finger = config.finger.finger
        ends = sorted((finger.angle(config.closed), finger.angle(config.open)))
        return ends[0], ends[1]
    if isinstance(config, JointConfig):
        return config.range
    raise TypeError(f"{type(config).__name__} has no range")


def _check_range(servo: ChainServo) -> None:
    ends = servo_range(servo.config)
    counts = sorted(servo.units.count(end) for end in ends)
    least, most = servo.units.goal_range
    if least - 0.5 <= counts[0] and counts[1] <= most + 0.5:
        return
    raise ConfigError(
        f"the range of {servo.place} from {ends[0]:.4f} to {ends[1]:.4f} rad is counts {counts[0]:.0f} to "
        f"{counts[1]:.0f}, of which mode {servo.config.mode} takes {least} to {most}",
        where="gripper" if isinstance(servo.config, GripperConfig) else f"joints.{servo.name}",
        remedy="Narrow lower and upper, correct offset, calibrate, or set mode to extended_position.",
    )
