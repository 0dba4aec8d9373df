"""The contract between the core and a device: what a plugin implements, on one page.

A `Device` is the hardware side only. It validates nothing, keeps no state machine and starts no
thread: a `crtk_drivers.engine.Engine` drives it from the I/O thread of its bus and gives it
setpoints that are already checked and limited. Three rules make that safe:

* Only `read` may wait, and no longer than its deadline. Everything else returns at once.
* Nothing moves because of `open`, `enable` or `resume`; only `write`, `move` and `home` move the hardware.
* The I/O thread alone calls a device, with three exceptions: `stop` comes from the watchdog's thread too,
  `abort_open` from whoever shuts down, and kinematics, which are pure functions of their arguments, from any.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from typing import Any

from crtk_drivers.commands import Kind, Level, Payload, Space, find
from crtk_drivers.errors import KinematicsError
from crtk_drivers.samples import Array, Pose, Sample, Value, Vector
from crtk_drivers.state import OperatingState

Steps = Generator[None, None, None]
"""A procedure that takes time: the runtime resumes it once a cycle until it returns or raises."""


class Mode(StrEnum):
    """A low-level mode of the hardware: what one setpoint may hold."""

    JOINT_POSITION = "joint position"
    JOINT_VELOCITY = "joint velocity"
    JOINT_EFFORT = "joint effort"
    CARTESIAN_POSITION = "Cartesian position"
    CARTESIAN_VELOCITY = "Cartesian velocity"
    CARTESIAN_EFFORT = "Cartesian effort"

    @property
    def space(self) -> Space:
        """Joint or Cartesian."""
        return _MODE_MEANING[self][0]

    @property
    def kind(self) -> Kind:
        """Position, velocity or effort."""
        return _MODE_MEANING[self][1]


_MODE_MEANING = {
    Mode.JOINT_POSITION: (Space.JOINT, Kind.POSITION),
    Mode.JOINT_VELOCITY: (Space.JOINT, Kind.VELOCITY),
    Mode.JOINT_EFFORT: (Space.JOINT, Kind.EFFORT),
    Mode.CARTESIAN_POSITION: (Space.CARTESIAN, Kind.POSITION),
    Mode.CARTESIAN_VELOCITY: (Space.CARTESIAN, Kind.VELOCITY),
    Mode.CARTESIAN_EFFORT: (Space.CARTESIAN, Kind.EFFORT),
}


@dataclass(frozen=True, slots=True)
class JointLimits:
    """Limits of one joint, in rad (m), rad/s, rad/s², rad/s³ and N·m (N).

    Raises:
        ValueError: not a number, an empty range, or a rate that is not above zero.
    """

    lower: float
    upper: float
    velocity: float
    acceleration: float
    jerk: float
    effort: float

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise ValueError(f"a joint's lower limit {self.lower} is not below upper {self.upper}")
        for name in ("velocity", "acceleration", "jerk"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"a joint's {name} limit is {getattr(self, name)}, not above 0")
        if not self.effort >= 0.0:
            raise ValueError(f"a joint's effort limit is {self.effort}, not a number from 0 up")


@dataclass(frozen=True, slots=True)
class CartesianLimits:
    """Limits of the tool, in m/s, rad/s, m/s², rad/s², N and N·m.

    Raises:
        ValueError: not a number, or a velocity or acceleration that is not above zero.
    """

    linear_velocity: float
    angular_velocity: float
    linear_acceleration: float
    angular_acceleration: float
    force: float = 0.0
    torque: float = 0.0

    def __post_init__(self) -> None:
        moving = (
            self.linear_velocity,
            self.angular_velocity,
            self.linear_acceleration,
            self.angular_acceleration,
        )
        if not all(limit > 0.0 for limit in moving):
            raise ValueError(f"Cartesian limits must be above 0, not {moving}")
        if not (self.force >= 0.0 and self.torque >= 0.0):
            raise ValueError(f"force and torque limits: {self.force}, {self.torque}")


@dataclass(frozen=True, slots=True)
class StopPolicy:
    """How the device stops when the stream of commands, the process or the link stops.

    `description` is for people and goes in the manifest; `link_timeout` is how long, in seconds, the
    hardware goes on by itself after this process died. `time` is within how many seconds after `Device.stop`
    its joints stand: past it the stop counts as not carried out.
    """

    link_timeout: float
    description: str
    time: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 < self.time < math.inf:
            raise ValueError(f"stop: time must be above zero and finite, not {self.time}")


@dataclass(frozen=True, slots=True)
class Following:
    """How closely the joints of a device follow the positions that they are sent.

    Attributes:
        error: one for each joint, in rad (m): how far a joint may be from all that was asked of it in the
            last `lag` seconds; further away it does not follow, and the device is in FAULT.
        arrival: the same for the end of a move: nearer than this the joint is there.
        lag: seconds that the hardware takes to carry a setpoint out (transport, smoothing, its own loop).

    Raises:
        ValueError: no number above zero, or not as many of one as of the other.
    """

    error: tuple[float, ...]
    arrival: tuple[float, ...]
    lag: float

    def __post_init__(self) -> None:
        if len(self.error) != len(self.arrival):
            raise ValueError(f"following: {len(self.error)} error, {len(self.arrival)} arrival")
        for name, values in (("error", self.error), ("arrival", self.arrival)):
            if not all(0.0 < value < math.inf for value in values):
                raise ValueError(f"following: {name} must be above zero and finite, not {values}")
        if not 0.0 <= self.lag < math.inf:
            raise ValueError(f"following: lag must be finite and not negative, not {self.lag}")


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What a device can do, declared once and before it is opened.

    Raises:
        ValueError: they contradict each other; said by the constructor.

    Attributes:
        joints: names, in the order of every joint vector; empty for a device without joints.
        limits: one for each joint.
        modes: the low-level modes; the core derives the CRTK commands from them.
        estimates: those of `modes` whose values the hardware reaches only roughly, by a model of itself.
        measured: CRTK names of the feedback in each sample, sub-namespaces included.
        native_moves: those of ``move_jp`` and ``move_cp`` that the hardware plans itself.
        move_limits: of the joints in ``move_jp``, if they are lower than `limits`; one for each.
        line_limits: of the tool in ``move_cp``, if they are lower than `cartesian_limits`.
        has_kinematics: `forward_kinematics`, `inverse_kinematics` and `jacobian` are implemented.
        has_free: `free` is implemented.
        has_gravity_compensation: `use_gravity_compensation` is implemented.
        needs_homing: the device says if it `is_homed`, and `home` and `unhome` change that; otherwise it
            always is.
        integrates_twists: twists are carried out as joint positions, though the joints take velocities: where
            the unit of these is too coarse for a straight way of the tool.
        stops_between_modes: the hardware comes to rest before it follows a setpoint of another mode.
        rate: of the I/O cycle, in Hz.
        paced_by_stream: `read` waits for the hardware's own clock; otherwise the runtime keeps time.
        writes_every_cycle: the hardware wants the setpoint again in each cycle (CAN, serial).
        base_frame, tool_frame: frame ids of poses and of what is attached to the tool.
        base_pose: of the device's own base in the base frame, where these are two (``local/``).
        transition_timeout: bound of enable, home, ... in seconds.
        stop: what stops it, and in what time.
        following: how closely its joints follow positions; None: that cannot be told, and is not watched.
        velocity_resolution: one for each joint, in rad/s (m/s): the smallest step of the velocities that are
            measured, below which nothing can be said to move; empty: finer than anyone asks.
    """

    joints: tuple[str, ...] = ()
    limits: tuple[JointLimits, ...] = ()
    cartesian_limits: CartesianLimits | None = None
    modes: frozenset[Mode] = frozenset()
    estimates: frozenset[Mode] = frozenset()
    measured: tuple[str, ...] = ("measured_js",)
    native_moves: frozenset[str] = frozenset()
    move_limits: tuple[JointLimits, ...] = ()
    line_limits: CartesianLimits | None = None
    has_kinematics: bool = False
    has_free: bool = False
    has_gravity_compensation: bool = False
    needs_homing: bool = False
    integrates_twists: bool = False
    stops_between_modes: bool = False
    rate: float = 100.0
    paced_by_stream: bool = False
    writes_every_cycle: bool = False
    base_frame: str = "base"
    tool_frame: str = "tool"
    base_pose: Pose | None = None
    transition_timeout: float = 30.0
    stop: StopPolicy = field(default=StopPolicy(0.0, "holds its position"))
    following: Following | None = None
    velocity_resolution: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if len(self.limits) != len(self.joints):
            raise ValueError(f"{len(self.limits)} limits for {len(self.joints)} joints")
        if len(self.move_limits) not in (0, len(self.joints)):
            raise ValueError(f"{len(self.move_limits)} move_limits for {len(self.joints)} joints")
        if self.following is not None and len(self.following.error) != len(self.joints):
            raise ValueError(
                f"following: {len(self.following.error)} for {len(self.joints)} joints"
            )
        steps = self.velocity_resolution
        if len(steps) not in (0, len(self.joints)):
            raise ValueError(f"{len(steps)} velocity_resolution for {len(self.joints)} joints")
        if not all(0.0 <= step < math.inf for step in steps):
            raise ValueError(f"velocity_resolution must be finite and not negative, not {steps}")
        if len(set(self.joints)) != len(self.joints) or not all(self.joints):
            raise ValueError(f"joints need names of their own: {', '.join(map(repr, self.joints))}")
        for name, value in (("rate", self.rate), ("transition_timeout", self.transition_timeout)):
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name} must be above zero and finite, not {value}")
        self._check_measured()
        self._check_motion()

    def _check_measured(self) -> None:
        for name in self.measured:
            try:
                level = find(name).level
            except KeyError:
                level = None
            if level is not Level.MEASURED:
                raise ValueError(f"measured: there is no feedback named {name!r}")
            if name == "measured_js" and not self.joints:
                raise ValueError("measured: measured_js without joints")

    def _check_motion(self) -> None:
        unknown = self.native_moves - {"move_jp", "move_cp"}
        if unknown:
            raise ValueError(f"native_moves: no such move: {', '.join(sorted(unknown))}")
        if not self.estimates <= self.modes:
            raise ValueError(
                f"estimates: not among the modes: {', '.join(sorted(self.estimates - self.modes))}"
            )
        in_joints = {mode for mode in self.modes if mode.space is Space.JOINT}
        if (in_joints or self.native_moves) and "measured_js" not in self.measured:
            raise ValueError("measured: motion in joint space needs measured_js")
        cartesian = self.cartesian_limits
        if Mode.CARTESIAN_VELOCITY in self.modes and cartesian is None:
            raise ValueError("cartesian_limits: needed by CARTESIAN_VELOCITY")
        if Mode.CARTESIAN_EFFORT in self.modes and not (
            cartesian is not None and cartesian.force > 0.0 and cartesian.torque > 0.0
        ):
            raise ValueError("cartesian_limits: CARTESIAN_EFFORT needs force and torque above zero")


@dataclass(frozen=True, slots=True, eq=False)
class Setpoint:
    """One low-level setpoint: `values` in the units of `mode`.

    A joint mode has one value a joint. CARTESIAN_POSITION has seven (position, quaternion), the other
    Cartesian modes six (linear before angular, in the axes of the base frame at the tool point).
    """

    mode: Mode
    values: Vector


@dataclass(frozen=True, slots=True)
class Ratios:
    """``trajectory_j/set_ratio_v`` and ``_a``: shares of the limits of velocity and acceleration.

    Raises:
        ValueError: not in (0, 1].
    """

    velocity: float = 1.0
    acceleration: float = 1.0

    def __post_init__(self) -> None:
        for name in ("velocity", "acceleration"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise ValueError(f"the {name} ratio is {getattr(self, name)}, not in (0, 1]")


FULL = Ratios()


@dataclass(frozen=True, slots=True, eq=False)
class Goal:
    """Where a move is to end: exactly one of `joints` (n,) and `pose` is set.

    A pose is reached along a straight line. `ratios` are those of the speed that moves usually have.
    """

    joints: Vector | None = None
    pose: Pose | None = None
    ratios: Ratios = FULL


Answer = Generator[None, None, str]
"""A procedure as `Steps`, which returns what is to be told."""


@dataclass(frozen=True, slots=True)
class Service:
    """Something that a device does when it is asked to, beyond CRTK: taring, clearing a fault, ...

    Attributes:
        summary: one line for people.
        run: begins it, as a procedure of the I/O thread. It may be asked for in any state; what it raises
            of `crtk_drivers.errors` is the answer, and ends nothing else.
    """

    summary: str
    run: Callable[[], Answer]


@dataclass(frozen=True, slots=True)
class Input:
    """A value that a device takes beyond CRTK: where its sensor points, an output to be set, ...

    Attributes:
        summary: one line for people.
        payload: what it is.
        take: called with each value, from any thread and in any state. It checks, keeps the value, and
            touches no bus; it raises CommandRefused.
        at_rest: it is refused while a motion is carried out: it changes what poses mean.
    """

    summary: str
    payload: Payload
    take: Callable[[Any], None]
    at_rest: bool = False


READINGS = "state"
"""Sub-namespace of a device's own readings: ``state/digital_in_3``."""


@dataclass(frozen=True, slots=True)
class Reading:
    """A value that a device tells beyond CRTK: a digital input, a mode, ...

    Attributes:
        summary: one line for people.
        payload: what it is.
        tell: returns the newest value, None while it is not known. No I/O; from any thread.
    """

    summary: str
    payload: Payload
    tell: Callable[[], Value | None]


class Severity(IntEnum):
    """How bad it is what a note says."""

    INFO = 0
    WARNING = 1
    ERROR = 2


@dataclass(frozen=True, slots=True)
class Note:
    """What people should know of a device now, in words: ``overload`` "saturated on Fz"."""

    severity: Severity
    key: str
    text: str


class MoveProgress(StrEnum):
    """Where a native move stands."""

    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Condition:
    """What the hardware says of itself: the best operating state that it allows, and why.

    ENABLED means that nothing is in the way; PAUSED that somebody else has control (pendant);
    DISABLED that power is off; FAULT that it must be attended to. `reason` says it in words.
    """

    allows: OperatingState = OperatingState.ENABLED
    reason: str = ""


class Device(ABC):
    """One piece of hardware. The constructor takes the configuration and touches nothing."""

    @property
    @abstractmethod
    def capabilities(self) -> Capabilities:
        """What it can do; constant from construction on."""

    @property
    @abstractmethod
    def address(self) -> str:
        """Where it is, for messages: ``192.168.1.10:30004``, ``/dev/ttyUSB0``, ``can0 node 3``."""

    @property
    def bus(self) -> str:
        """Devices that return the same bus share one I/O thread."""
        return self.address

    @abstractmethod
    def open(self, deadline: float) -> None:
        """Connect, before the monotonic `deadline`. Nothing moves, no torque changes.

        Raises:
            ConnectionFailed: with the address and the remedy.
        """

    def abort_open(self) -> None:  # noqa: B027 - most devices open in no time
        """End an `open` that waits, at once, and let later ones fail: everything is being shut down.

        Override it where `open` may wait for longer than a second.
        """

    @abstractmethod
    def close(self) -> None:
        """Release everything. May be called twice, and after a `ConnectionLost`.

        The core has called `stop` before and has waited for `has_stopped`. Where that could not be read back,
        what stops the hardware by itself stays armed. Hardware that can be left in more than one way is left
        as the key ``on_close`` of its configuration says (``hold`` or ``power_off``).
        """

    @abstractmethod
    def read(self, deadline: float) -> Sample | None:
        """Return the newest sample, or None if there is no new one by the monotonic `deadline`.

        Raises:
            ConnectionLost: the link is gone; the runtime closes and opens again.
        """

    @abstractmethod
    def write(self, setpoint: Setpoint) -> None:
        """Send one setpoint; its mode is one of the declared ones. Called while ENABLED only."""

    @abstractmethod
    def stop(self) -> None:
        """Stop any motion and hold, as fast as the hardware can do it smoothly.

        May be called from the watchdog's thread at any time, also while `read` waits: it must not
        take a lock that `read` holds.
        """

    @property
    def has_stopped(self) -> bool:
        """Whether what `stop` asked for last has been read back from the hardware.

        That the joints stand is judged by the core from what is measured; this is for what it cannot see: the
        goal in a register, the mode of a drive. Until it is true the core goes on calling `stop`.
        """
        return True

    @property
    def found(self) -> str:
        """In what powered or moving state `open` found it: ``torque is on``, ``brakes are released``.

        Empty if it cannot move by itself. It is told as the detail of DISABLED.
        """
        return ""

    @property
    def takes_setpoints(self) -> bool:
        """Whether a setpoint written now takes effect at once.

        False after `stop`, while the hardware comes to rest: the core begins a stream after that.
        """
        return True

    @property
    def pace(self) -> float:
        """How fast the hardware goes along a trajectory of ours, of real time: 0 (stands) to 1.

        Below 1 where somebody slows it down, as with the speed slider of a teach pendant.
        """
        return 1.0

    @property
    def has_arrived(self) -> bool:
        """Whether it rests where the last position setpoint is, as far as it can tell.

        False while hardware that smooths setpoints is still on its way: a move ends after that.
        """
        return True

    @property
    def condition(self) -> Condition:
        """What the last `read` said of the hardware."""
        return Condition()

    @property
    def is_homed(self) -> bool:
        """Whether positions can be trusted; asked only if the capabilities need homing."""
        return True

    @property
    def counters(self) -> Mapping[str, float]:
        """Numbers of its own for diagnostics (lost packages, retries, temperatures)."""
        return {}

    @property
    def notes(self) -> tuple[Note, ...]:
        """What people should know of it now, for diagnostics. No I/O; from any thread."""
        return ()

    @property
    def services(self) -> Mapping[str, Service]:
        """What it does beyond CRTK, by name (lower case, underscores); constant."""
        return {}

    @property
    def inputs(self) -> Mapping[str, Input]:
        """What it takes beyond CRTK, by name; constant."""
        return {}

    @property
    def readings(self) -> Mapping[str, Reading]:
        """What it tells beyond CRTK, by name, without `READINGS`; constant."""
        return {}

    @property
    def children(self) -> Mapping[str, Device]:
        """Devices with a state of their own behind it, by the name of their sub-namespace; constant.

        A gripper on an arm's bus, for example. They return the same `bus`, and are served after this device.
        """
        return {}

    def enable(self) -> Steps:
        """Power up and be ready for setpoints; the first one will be the measured position.

        Raises:
            TransitionFailed, DeviceFault: with what is in the way and how to remove it.
        """
        yield from ()

    def disable(self) -> Steps:
        """Power down. Like `pause` and `home`, it begins after motion was stopped by `stop`."""
        yield from ()

    def pause(self) -> Steps:
        """Keep power, stop listening to setpoints."""
        yield from ()

    def resume(self) -> Steps:
        """Back from PAUSED."""
        yield from self.enable()

    def home(self) -> Steps:
        """Find the reference positions."""
        yield from ()

    def unhome(self) -> Steps:
        """Forget the reference positions."""
        yield from ()

    def free(self) -> Steps:
        """Let go, so that the arm may be moved by hand. Ended by `stop` or the next command."""
        yield from ()

    def use_gravity_compensation(self, on: bool) -> None:
        """Add the efforts that carry the arm's own weight to those that are sent, or leave them out."""
        raise NotImplementedError

    def move(self, goal: Goal) -> None:
        """Start the hardware's own motion to `goal`, from wherever it is and moves now."""
        raise NotImplementedError

    def move_progress(self) -> MoveProgress:
        """Say where the motion started last by `move` stands."""
        raise NotImplementedError

    def forward_kinematics(self, joints: Vector) -> Pose:
        """Return the tool pose in the base frame."""
        raise NotImplementedError

    def inverse_kinematics(self, pose: Pose, reference: Vector) -> Vector:
        """Return the joint position (n,) nearest to `reference` that reaches `pose`.

        Raises:
            KinematicsError: none within the limits.
        """
        raise KinematicsError("this device has no kinematics")

    def nearby_inverse_kinematics(self, pose: Pose, reference: Vector) -> Vector:
        """As `inverse_kinematics`, for the poses of a stream: in a part of a cycle, also if there is none.

        To be overridden where `inverse_kinematics` searches for longer. It need not find another branch.

        Raises:
            KinematicsError: none near `reference` and within the limits.
        """
        return self.inverse_kinematics(pose, reference)

    def jacobian(self, joints: Vector) -> Array:
        """Return the geometric Jacobian (6, n) at the tool point, in base axes, linear rows first."""
        raise NotImplementedError
