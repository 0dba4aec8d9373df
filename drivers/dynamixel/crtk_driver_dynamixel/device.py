"""A chain of DYNAMIXEL servos as CRTK devices: the arm, and the gripper behind it."""

from __future__ import annotations

import logging
import math
import threading
from abc import abstractmethod
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from crtk_driver_dynamixel.calibration import configured_calibration
from crtk_driver_dynamixel.chain_link import ChainLink, lost
from crtk_driver_dynamixel.config import DynamixelConfig, GripperConfig
from crtk_driver_dynamixel.joints import Chain
from crtk_driver_dynamixel.models import OperatingMode
from crtk_driver_dynamixel.motors import Motors
from crtk_driver_dynamixel.own_profile import move_limits, takes_its_time
from crtk_driver_dynamixel.part import Part
from crtk_driver_dynamixel.readings import Frame
from crtk_driver_dynamixel.units import Counts
from crtk_drivers.commands import Kind
from crtk_drivers.device import (
    Capabilities,
    Condition,
    Device,
    Following,
    JointLimits,
    Mode,
    Note,
    Setpoint,
    Severity,
    Steps,
    StopPolicy,
)
from crtk_drivers.errors import ConnectionLost, CrtkError
from crtk_drivers.samples import JointState, Sample, Stamp, Value, Vector, vector
from crtk_drivers.state import OperatingState

logger = logging.getLogger(__name__)

LAG: Final = 0.2
"""Seconds in which a servo without a profile carries a goal out: transport, and its own loop."""
HOT: Final = 5.0
"""Degrees below its limit at which a servo's temperature is told."""


def make_device(config: DynamixelConfig) -> Device:
    """Return the device of a configuration: the arm with its gripper behind it, or the gripper alone.

    Raises:
        ConfigError: the calibration is not of this chain, or a range is out of reach.
    """
    calibration = configured_calibration(config.calibration)
    link = ChainLink(config, Chain.of(config, calibration), calibration)
    arm = range(len(config.joints))
    gripper = None
    if config.gripper is not None:
        place = range(len(config.joints), len(config.joints) + 1)
        gripper = GripperDevice(link, Part(link, place, config), config, config.gripper)
    if not config.joints and gripper is not None:
        return gripper
    return ArmDevice(link, Part(link, arm, config), config, gripper)


class _ChainDevice(Device):
    """What arm and gripper have in common.

    Args:
        link: to the chain, shared.
        part: its servos.
        config: of the chain.
    """

    def __init__(self, link: ChainLink, part: Part, config: DynamixelConfig) -> None:
        self.link = link
        self.part = part
        self._config = config
        self._seen_cycle = -1
        self._stamp = -math.inf
        self._last: dict[str, Value] = {}
        self._is_open = False
        self._thread = 0
        self._condition = Condition()
        servos = part.chain.servos
        by_pwm = [servo.effort_mode is OperatingMode.PWM for servo in servos]
        self._by_pwm, self._by_current = np.flatnonzero(by_pwm), np.flatnonzero(np.invert(by_pwm))
        self._motors = Motors.of(
            [servo.units for servo in servos if servo.effort_mode is OperatingMode.PWM]
        )

    @property
    @override
    def address(self) -> str:
        return self.link.address

    # ----------------------------------------------------------------------------------- life cycle

    @override
    def open(self, deadline: float) -> None:
        """It finds the servos, and changes nothing in them."""
        self.link.open(deadline)
        self._thread = threading.get_ident()
        self._is_open = True
        self._seen_cycle = -1
        self._stamp, self._last = -math.inf, {}
        self.part.take_over()
        self._condition = Condition()

    @property
    @override
    def found(self) -> str:
        return self.part.found

    @override
    def close(self) -> None:
        """A servo that is not known to have stopped keeps its watchdog armed.

        Raises:
            StopUnconfirmed: there is such a servo, and its adapter is there.
        """
        if not self._is_open:
            return
        self._is_open = False
        try:
            self.part.leave()
        except ConnectionLost as error:
            told = error if self.part.has_stopped else self.part.unconfirmed
            logger.warning("%s: %s", self.address, told)
        finally:
            self.link.close()

    @override
    def read(self, deadline: float) -> Sample | None:
        """Arm and gripper share what a cycle reads.

        A joint vector has the stamp of the oldest value in it, and there is none as long as that does not get
        newer. After `silent_timeout` a fault names the servo, and the last vector goes on as invalid.
        """
        link = self.link
        if self._seen_cycle == link.cycles:
            link.exchange()
        self._seen_cycle = link.cycles
        frame = link.frame
        assert frame is not None
        self._silent()
        self.part.step()
        silent = self._silent()  # a stop may have waited long for answers
        self._judge()
        stamp, usable, is_whole = self._acquired(frame)
        if stamp.monotonic > self._stamp:
            self._stamp = stamp.monotonic
            self._last = {"measured_js": self._state(frame, usable, is_whole=is_whole)}
            goals = self.part.goals
            if goals is not None:
                self._last |= {"setpoint_js": JointState(position=self._positions(goals))}
            return Sample(stamp, self._last)
        # The link is there, and the fault tells who is missing.
        return Sample(Stamp(0, frame.stamp.monotonic), self._last) if silent else None

    def _silent(self) -> list[int]:
        """Return the places of the servos that have not answered for `silent_timeout`.

        Raises:
            ConnectionLost: none of the chain has.
        """
        silent = self.part.silent()
        if len(silent) == len(self.part.places) and not self.part.has_company():
            raise lost(self.address)
        return silent

    def _acquired(self, frame: Frame) -> tuple[Stamp, NDArray[np.bool_], bool]:
        """Return when the oldest value of the joint vector was acquired, from which servos its positions are
        taken, and whether none of the others is older.
        """
        usable = self.part.own(frame.valid)
        if usable.all():
            return frame.stamp, usable, True
        chain, seen = self.part.chain, self.part.own(frame.seen)
        for joint in range(len(self.capabilities.joints)):
            servos = list(chain.of_joint(joint))
            usable[servos] |= not usable[servos].any()
        oldest = float(chain.positions(seen, usable).min())
        age = frame.stamp.monotonic - oldest
        stamp = Stamp(frame.stamp.wall_ns - round(age * 1e9), oldest)
        return stamp, usable, bool(seen.min() >= oldest)

    def _judge(self) -> None:
        trouble = self.part.trouble()
        if not trouble:
            self._condition = Condition()
        elif trouble != self._condition.reason:
            if not self._condition.reason and self._config.on_servo_fault == "torque_off":
                self.part.let_go()
            self._condition = Condition(OperatingState.FAULT, trouble)

    @abstractmethod
    def _state(self, frame: Frame, usable: NDArray[np.bool_], *, is_whole: bool) -> JointState:
        """Return what the joints do.

        Args:
            usable: (servos,) those whose positions are taken.
            is_whole: the others are as good, so that efforts are known.
        """

    @abstractmethod
    def _positions(self, counts: Counts, usable: NDArray[np.bool_] | None = None) -> Vector:
        """Return the positions of the joints (n,) for those of the servos of this part.

        Args:
            usable: (servos,) those whose positions are taken; None: all.
        """

    # -------------------------------------------------------------------------------------- setpoints

    @override
    def write(self, setpoint: Setpoint) -> None:
        """A setpoint of another kind begins with a change of mode."""
        self.part.send(setpoint.mode.kind, self._counts(setpoint.mode.kind, setpoint.values))

    @abstractmethod
    def _counts(self, kind: Kind, values: Vector) -> Counts:
        """Return the goals of the servos of this part."""

    def _effort_counts(self, efforts: Vector) -> Counts:
        """Return currents, or voltages by what is known of the motors, for efforts of the joints (n,)."""
        part, scaling = self.part, self.part.chain.scaling
        torques = part.chain.efforts_to_servos(efforts)
        if not self._by_pwm.size:
            return scaling.effort.to_counts(torques)
        by_pwm, by_current = self._by_pwm, self._by_current
        frame = self.link.frame
        assert frame is not None
        velocities = scaling.velocity.to_si(part.own(frame.velocity))
        voltages = np.array([self.link.health[part.places[i]].voltage for i in by_pwm])
        duties = self._motors.duty(torques[by_pwm], velocities[by_pwm], voltages)
        counts = np.zeros(len(torques), dtype=np.int64)
        counts[by_pwm] = scaling.pwm.part(by_pwm.tolist()).to_counts(duties)
        counts[by_current] = scaling.effort.part(by_current.tolist()).to_counts(torques[by_current])
        return counts

    @override
    def stop(self) -> None:
        """Velocities and efforts end at once, positions in the next cycle."""
        self.part.ask_to_stop()
        if threading.get_ident() == self._thread:
            self.part.stop_at_once()
        else:
            self.part.stop_from_outside()

    @property
    @override
    def has_stopped(self) -> bool:
        """The goal was read back, and in velocity mode that nothing turns."""
        return self.part.has_stopped

    @property
    @override
    def has_arrived(self) -> bool:
        return self.part.has_arrived

    @property
    @override
    def takes_setpoints(self) -> bool:
        return self.part.takes_setpoints

    # ------------------------------------------------------------------------------------ transitions

    @property
    @override
    def condition(self) -> Condition:
        return self._condition

    @property
    @override
    def obstacles(self) -> tuple[CrtkError, ...]:
        return tuple(self.part.obstacles())

    @override
    def enable(self) -> Steps:
        """Restart servos with errors, set all up, and hold where they are."""
        yield from self.part.enable()
        self._condition = Condition()

    @override
    def resume(self) -> Steps:
        """The servos have held all along."""
        yield from ()

    @override
    def disable(self) -> Steps:
        """Take the torque away, or hold, as configured."""
        yield from self.part.disable()

    @override
    def free(self) -> Steps:
        """Take the torque away, so that the joints can be moved by hand."""
        yield from self.part.free()

    @property
    @override
    def is_homed(self) -> bool:
        """It is known in which turn every servo is."""
        return not self.part.doubts

    @override
    def home(self) -> Steps:
        """Take the joints to be where `measured_js` says: somebody has looked. Nothing moves."""
        yield from ()
        self.part.trust()

    @override
    def unhome(self) -> Steps:
        """Take the turns as not known."""
        yield from ()
        self.part.distrust()

    # ------------------------------------------------------------------------------------------- told

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        return self.link.counters

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        return tuple(self._notes())

    def _notes(self) -> list[Note]:
        notes = [Note(Severity.WARNING, "latency timer", text) for text in self.link.remedies]
        notes += [Note(Severity.WARNING, "not homed", text) for text in self.part.doubts]
        for place in self.part.places:
            health, servo = self.link.health[place], self.link.chain.servos[place]
            if health.error_text:
                notes.append(Note(Severity.ERROR, servo.place, health.error_text))
            elif health.temperature > health.hottest - HOT:
                text = f"{health.temperature:.0f} °C, it stops at {health.hottest:.0f}"
                notes.append(Note(Severity.WARNING, servo.place, text))
        return notes

    def _capabilities_of(
        self,
        joints: tuple[str, ...],
        limits: tuple[JointLimits, ...],
        *,
        takes_efforts: bool,
        unit: str = "rad",
    ) -> Capabilities:
        modes = {Mode.JOINT_POSITION}
        servos = self.part.chain.servos
        if all(servo.takes_velocities for servo in servos):
            modes.add(Mode.JOINT_VELOCITY)
        estimates: frozenset[Mode] = frozenset()
        if takes_efforts:
            modes.add(Mode.JOINT_EFFORT)
            estimates = frozenset({Mode.JOINT_EFFORT} if self._by_pwm.size else ())
        has_watchdog = all(servo.has_watchdog for servo in servos)
        timeout = self._config.watchdog if has_watchdog else 0.0
        what = "stops by itself" if timeout else "goes on to its last goal"
        return Capabilities(
            joints=joints,
            joint_units=(unit,) * len(joints),
            limits=limits,
            move_limits=self._move_limits(limits),
            modes=frozenset(modes),
            estimates=estimates,
            needs_homing=self.part.turning,
            has_free=True,
            integrates_twists=True,
            stops_between_modes=True,
            # A voltage makes the same effort only as long as the speed is the same.
            writes_every_cycle=bool(estimates),
            rate=self._config.rate,
            stop=StopPolicy(
                timeout, f"each servo {what} when it hears nothing", self.part.stop_time
            ),
            following=self._following(),
            velocity_resolution=tuple(self._velocity_steps()),
        )

    def _move_limits(self, limits: tuple[JointLimits, ...]) -> tuple[JointLimits, ...]:
        """Return the limits of moves, where profiles of the servos' own are slower; else none."""
        servos = self.part.chain.servos
        configs = [servo.config for servo in servos if servo.is_first]
        slower = tuple(map(move_limits, configs, limits))
        return () if slower == limits else slower

    def _velocity_steps(self) -> list[float]:
        """Return what one count of the present velocity is, for each joint, in rad/s (m/s)."""
        chain = self.part.chain
        ones = np.ones(len(chain.servos))
        return [abs(step) for step in chain.positions(chain.scaling.velocity.to_si(ones)).tolist()]

    def _following(self) -> Following | None:
        """Return how closely joints follow; those that take their time are looked at when a move ends.

        None for a gripper: its move ends at its goal, or at what it grips.
        """
        if isinstance(self, GripperDevice):
            return None
        own = list(self._config.joints.values())
        errors = tuple(math.inf if takes_its_time(each) else each.following_error for each in own)
        return Following(errors, tuple(joint.arrival for joint in own), LAG)


class ArmDevice(_ChainDevice):
    """The joints of a chain.

    Args:
        link, part, config: see the base class.
        gripper: on the same chain, None if it has none.
    """

    def __init__(
        self,
        link: ChainLink,
        part: Part,
        config: DynamixelConfig,
        gripper: GripperDevice | None = None,
    ) -> None:
        super().__init__(link, part, config)
        self._gripper = gripper
        self._has_efforts = self.part.chain.has_efforts
        self._capabilities = self._capabilities_of(
            self.part.chain.joints,
            self.part.chain.limits,
            takes_efforts=self.part.chain.takes_efforts,
        )

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def children(self) -> Mapping[str, Device]:
        return {} if self._gripper is None else {self._gripper.name: self._gripper}

    @property
    @override
    def followers(self) -> frozenset[str]:
        if self._gripper is None or self._gripper.has_own_state:
            return frozenset()
        return frozenset(self.children)

    @override
    def _state(self, frame: Frame, usable: NDArray[np.bool_], *, is_whole: bool) -> JointState:
        chain, scaling = self.part.chain, self.part.chain.scaling
        position = self._positions(self.part.own(frame.position), usable)
        velocity = chain.positions(scaling.velocity.to_si(self.part.own(frame.velocity)), usable)
        effort: Vector | tuple[()] = ()
        if self._has_efforts and is_whole:
            effort = chain.efforts(scaling.effort.to_si(self.part.own(frame.effort)))
        return JointState(position, vector(velocity), vector(effort))

    @override
    def _positions(self, counts: Counts, usable: NDArray[np.bool_] | None = None) -> Vector:
        chain = self.part.chain
        return vector(chain.positions(chain.scaling.position.to_si(counts), usable))

    @override
    def _counts(self, kind: Kind, values: Vector) -> Counts:
        chain, scaling = self.part.chain, self.part.chain.scaling
        if kind is Kind.EFFORT:
            return self._effort_counts(values)
        scale = scaling.velocity if kind is Kind.VELOCITY else scaling.position
        return scale.to_counts(chain.to_servos(values))


class GripperDevice(_ChainDevice):
    """The gripper: one joint, whose position is the opening of its fingers.

    Args:
        link, part, config: see the base class.
        gripper: its configuration.

    Attributes:
        name: its sub-namespace.
        has_own_state: it does not follow the operating state of the arm.
    """

    def __init__(
        self, link: ChainLink, part: Part, config: DynamixelConfig, gripper: GripperConfig
    ) -> None:
        super().__init__(link, part, config)
        self.name, self.has_own_state = gripper.name, gripper.own_state
        self._finger = gripper.finger.finger
        limits = self.part.chain.gripper_limits
        assert limits is not None
        self._measures_effort = not any(
            math.isnan(servo.units.torque_constant) for servo in self.part.chain.servos
        )
        takes_efforts = gripper.effort > 0.0 and all(
            servo.effort_mode is not None for servo in self.part.chain.servos
        )
        self._angle = 0.0
        self._capabilities = self._capabilities_of(
            (gripper.joint,),
            (limits,),
            takes_efforts=takes_efforts,
            unit="rad" if gripper.finger.kind == "jaw" else "m",
        )

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @override
    def _state(self, frame: Frame, usable: NDArray[np.bool_], *, is_whole: bool) -> JointState:
        chain, scaling, finger = self.part.chain, self.part.chain.scaling, self._finger
        speeds = chain.positions(scaling.velocity.to_si(self.part.own(frame.velocity)), usable)
        self._angle = angle = self._angle_at(self.part.own(frame.position), usable)
        effort: tuple[float, ...] = ()
        if self._measures_effort and is_whole:
            torques = chain.efforts(scaling.effort.to_si(self.part.own(frame.effort)))
            effort = (finger.effort(float(torques[0]), angle),)
        return JointState(
            vector((finger.opening(angle),)),
            vector((finger.rate(angle) * float(speeds[0]),)),
            vector(effort if all(map(math.isfinite, effort)) else ()),
        )

    @override
    def _velocity_steps(self) -> list[float]:
        (step,), limits = super()._velocity_steps(), self.part.chain.gripper_limits
        assert limits is not None
        openings = limits.lower, 0.5 * (limits.lower + limits.upper), limits.upper
        rates = [abs(self._finger.rate(self._finger.angle(opening))) for opening in openings]
        return [step * max(rates)]

    def _angle_at(self, counts: Counts, usable: NDArray[np.bool_] | None) -> float:
        chain = self.part.chain
        return float(chain.positions(chain.scaling.position.to_si(counts), usable)[0])

    @override
    def _positions(self, counts: Counts, usable: NDArray[np.bool_] | None = None) -> Vector:
        return vector((self._finger.opening(self._angle_at(counts, usable)),))

    @override
    def _counts(self, kind: Kind, values: Vector) -> Counts:
        chain, scaling, finger, (value,) = (
            self.part.chain,
            self.part.chain.scaling,
            self._finger,
            values.tolist(),
        )
        if kind is Kind.EFFORT:
            return self._effort_counts(vector((finger.torque(value, self._angle),)))
        if kind is Kind.VELOCITY:
            rate = finger.rate(self._angle)
            speed = vector((value / rate if rate else 0.0,))
            return scaling.velocity.to_counts(chain.to_servos(speed))
        return scaling.position.to_counts(chain.to_servos(vector((finger.angle(value),))))
