"""What a device can do: its joints and their limits, its modes, how it stops and follows."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum

from crtk_drivers.commands import Kind, Level, Space, find
from crtk_drivers.samples import Pose


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
_MODE_OF = {meaning: mode for mode, meaning in _MODE_MEANING.items()}


def mode_of(space: Space, kind: Kind) -> Mode:
    """Return the mode whose setpoints carry out values of `kind`; increments lead to positions."""
    return _MODE_OF[space, kind if kind in (Kind.VELOCITY, Kind.EFFORT) else Kind.POSITION]


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
            last `lag` seconds; further away it does not follow, and the device is in FAULT. inf: it may
            take its time, or stop at what is in its way.
        arrival: the same for the end of a move: nearer than this the joint is there.
        lag: seconds that the hardware takes to carry a setpoint out (transport, smoothing, its own loop).

    Raises:
        ValueError: not above zero, an arrival that is not finite, or not as many of one as of the other.
    """

    error: tuple[float, ...]
    arrival: tuple[float, ...]
    lag: float

    def __post_init__(self) -> None:
        if len(self.error) != len(self.arrival):
            raise ValueError(f"following: {len(self.error)} error, {len(self.arrival)} arrival")
        if not all(value > 0.0 for value in self.error):
            raise ValueError(f"following: error must be above zero, not {self.error}")
        if not all(0.0 < value < math.inf for value in self.arrival):
            raise ValueError(
                f"following: arrival must be above zero and finite, not {self.arrival}"
            )
        if not 0.0 <= self.lag < math.inf:
            raise ValueError(f"following: lag must be finite and not negative, not {self.lag}")


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What a device can do, declared once and before it is opened.

    Raises:
        ValueError: they contradict each other; said by the constructor.

    Attributes:
        type: what it is, for programs that choose by it: ``tracker``; empty: what its commands say.
        model: what its maker calls it, as ``UR5e``; empty: the driver does not know before it is opened.
        joints: names, in the order of every joint vector; empty for a device without joints.
        limits: one for each joint.
        modes: the low-level modes; the core derives the CRTK commands from them.
        estimates: those of `modes` whose values the hardware reaches only roughly, by a model of itself.
        measured: CRTK names of the feedback in each sample, sub-namespaces included.
        native_moves: those of ``move_jp`` and ``move_cp`` that the hardware plans itself.
        move_limits: of the joints in ``move_jp``, if they are lower than `limits`; one for each.
        line_limits: of the tool in ``move_cp``, if they are lower than `cartesian_limits`.
        has_free: `free` is implemented.
        has_gravity_compensation: `use_gravity_compensation` is implemented.
        needs_homing: the device says if it `is_homed`, and `home` and `unhome` change that; otherwise it
            always is.
        enable_moves: `enable` or `resume` may set the hardware in motion: any stop ends them, and the
            hardware is stopped then; so it is where they fail on their way.
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
        joint_units: of the position of each joint: ``rad``, ``m``, ``Pa``, or empty where it is not known;
            without any, what the kinematics say.
    """

    type: str = ""
    model: str = ""
    joints: tuple[str, ...] = ()
    limits: tuple[JointLimits, ...] = ()
    cartesian_limits: CartesianLimits | None = None
    modes: frozenset[Mode] = frozenset()
    estimates: frozenset[Mode] = frozenset()
    measured: tuple[str, ...] = ("measured_js",)
    native_moves: frozenset[str] = frozenset()
    move_limits: tuple[JointLimits, ...] = ()
    line_limits: CartesianLimits | None = None
    has_free: bool = False
    has_gravity_compensation: bool = False
    needs_homing: bool = False
    enable_moves: bool = False
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
    joint_units: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if len(self.limits) != len(self.joints):
            raise ValueError(f"{len(self.limits)} limits for {len(self.joints)} joints")
        if len(self.joint_units) not in (0, len(self.joints)):
            raise ValueError(f"{len(self.joint_units)} joint_units for {len(self.joints)} joints")
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
            cartesian is not None and cartesian.force > 0.0
        ):
            raise ValueError("cartesian_limits: CARTESIAN_EFFORT needs a force above zero")
