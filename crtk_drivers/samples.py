"""Frozen values in SI units: what travels between a device, the core and its fronts.

Every array is a read-only float64 array; a constructor copies what is not, so that nobody can change a
value that has been checked. Quaternions are ``x, y, z, w`` and of unit length. A value never carries a
stamp of its own: the `Sample` (or setpoint) that holds it has one, so everything that was read together is
stamped together.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from itertools import accumulate
from types import MappingProxyType
from typing import Final, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import override

from crtk_drivers.commands import Kind, Payload

Array = NDArray[np.float64]
"""Any shape."""

Vector = NDArray[np.float64]
"""One dimension."""

EMPTY: Vector = np.empty(0)
EMPTY.setflags(write=False)


def empty() -> Vector:
    """Return the vector without values: what is not known."""
    return EMPTY


def vector(values: ArrayLike) -> Vector:
    """Return `values` as a read-only float64 array of one dimension.

    Raises:
        TypeError, ValueError: not numbers, or not one-dimensional.
    """
    array = np.array(values, dtype=np.float64)
    if array.ndim != 1:
        raise ValueError(f"expected a list of numbers, got an array of shape {array.shape}")
    array.setflags(write=False)
    return array


def frozen(array: Array) -> Vector:
    """Return an array of one dimension, which nobody else has, made read-only: `vector` without a copy."""
    array.setflags(write=False)
    return array


def parts(numbers: Sequence[float], *sizes: int) -> list[Vector]:
    """Return `numbers` cut into vectors of `sizes`: what is read together costs one conversion."""
    whole = vector(numbers)
    ends = accumulate(sizes)
    return [whole[end - size : end] for size, end in zip(sizes, ends, strict=True)]


def _freeze(value: object, *fields: str) -> None:
    """Replace each of `fields` that is not a read-only vector by a copy that is one."""
    for name in fields:
        array = getattr(value, name)
        if array is EMPTY:
            continue
        if (
            type(array) is not np.ndarray
            or array.flags.writeable
            or array.ndim != 1
            or array.dtype != np.float64
        ):
            object.__setattr__(value, name, vector(array))


def _numbers(values: Iterable[float], unit: str = "") -> str:
    """Return numbers in one line, rounded as people read them: ``[0.1, -1.5708] rad``."""
    shown = ", ".join(f"{round(value, 6) + 0.0:.6g}" for value in values)
    return f"[{shown}] {unit}".rstrip()


def _shown(what: str, /, **parts: str) -> str:
    """Return what a value looks like at a prompt; parts that are empty are left out."""
    return f"{what}({', '.join(f'{part}={text}' for part, text in parts.items() if text)})"


def _known(values: Vector, unit: str) -> str:
    return _numbers(values.tolist(), unit) if values.size else ""


def _quoted(text: str) -> str:
    return repr(text) if text else ""


CLOCKS_AGREE: Final = 0.005
"""Seconds by which the clocks of two machines may differ while stamps of both are compared."""


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """The clock of another machine minus ours, and by how much that can be wrong at most, both in s."""

    value: float
    uncertainty: float

    @property
    def is_apart(self) -> bool:
        """Whether the clocks surely differ by more than `CLOCKS_AGREE`."""
        return abs(self.value) - self.uncertainty > CLOCKS_AGREE


_READINGS: Final = 5
"""Times that two clocks are read at most, to read them at the same time."""
_QUICK: Final = 1e-4
"""s in which both are read, unless somebody else has the processor meanwhile."""


@dataclass(frozen=True, slots=True)
class Stamp:
    """When something was acquired, on two clocks.

    `wall_ns` is nanoseconds since the epoch, for messages; 0 is CRTK's mark of invalid data.
    `monotonic` is seconds on the monotonic clock, for ages and deadlines.
    """

    wall_ns: int
    monotonic: float

    @classmethod
    def now(cls) -> Stamp:
        """Return the present on both clocks.

        They cannot be read at once. Where this thread had to wait between the two, they are read again.
        """
        for _ in range(_READINGS):
            begin, wall_ns, end = time.monotonic(), time.time_ns(), time.monotonic()
            if end - begin < _QUICK:
                break
        return cls(wall_ns, end)

    @classmethod
    def at(cls, monotonic: float) -> Stamp:
        """Return a moment on the monotonic clock (s) on both."""
        now = cls.now()
        return cls(now.wall_ns - round(1e9 * (now.monotonic - monotonic)), monotonic)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class JointState:
    """Position, velocity and effort of joints; what is not known is empty, never zeros.

    `position` rad or m, `velocity` rad/s or m/s, `effort` N·m or N; non-empty vectors have one size.

    Raises:
        TypeError, ValueError: not numbers, or vectors (or names) of different sizes.
    """

    position: Vector = field(default_factory=empty)
    velocity: Vector = field(default_factory=empty)
    effort: Vector = field(default_factory=empty)
    name: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        _freeze(self, "position", "velocity", "effort")
        sizes = {self.position.size, self.velocity.size, self.effort.size, len(self.name)} - {0}
        if len(sizes) > 1:
            raise ValueError(f"joint state with vectors of different sizes: {sorted(sizes)}")

    @override
    def __repr__(self) -> str:
        return _shown(
            "JointState",
            position=_known(self.position, "rad|m"),
            velocity=_known(self.velocity, "rad/s|m/s"),
            effort=_known(self.effort, "N·m|N"),
            name=str(list(self.name)) if self.name else "",
        )


def joint_state(kind: Kind, values: Vector) -> JointState:
    """Return a joint state that holds `values` in the field that a command of `kind` fills."""
    if kind is Kind.VELOCITY:
        return JointState(velocity=values)
    if kind is Kind.EFFORT:
        return JointState(effort=values)
    return JointState(position=values)


def joint_values(kind: Kind, state: JointState) -> Vector:
    """Return the field of a joint state that a command of `kind` fills."""
    if kind is Kind.VELOCITY:
        return state.velocity
    if kind is Kind.EFFORT:
        return state.effort
    return state.position


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Pose:
    """Position (3,) in m and orientation as a unit quaternion (4,) x, y, z, w, in `frame_id`."""

    position: Vector
    orientation: Vector
    frame_id: str = ""

    def __post_init__(self) -> None:
        _freeze(self, "position", "orientation")

    @override
    def __repr__(self) -> str:
        return _shown(
            "Pose",
            position=_known(self.position, "m"),
            orientation=_known(self.orientation, "xyzw"),
            frame_id=_quoted(self.frame_id),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Where several things are, seen together, in `frame_id`. A place without orientation has 0, 0, 0, 1."""

    poses: tuple[Pose, ...] = ()
    frame_id: str = ""

    @property
    def vector(self) -> Vector:
        """All numbers, seven for each: position, then quaternion."""
        parts = [part for pose in self.poses for part in (pose.position, pose.orientation)]
        return np.concatenate(parts) if parts else EMPTY


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Twist:
    """Linear (3,) in m/s and angular velocity (3,) in rad/s, in the axes of `frame_id`."""

    linear: Vector
    angular: Vector
    frame_id: str = ""

    def __post_init__(self) -> None:
        _freeze(self, "linear", "angular")

    @property
    def vector(self) -> Vector:
        """All six, linear first."""
        return np.concatenate((self.linear, self.angular))

    @override
    def __repr__(self) -> str:
        return _shown(
            "Twist",
            linear=_known(self.linear, "m/s"),
            angular=_known(self.angular, "rad/s"),
            frame_id=_quoted(self.frame_id),
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Wrench:
    """Force (3,) in N and torque (3,) in N·m, in the axes of `frame_id`."""

    force: Vector
    torque: Vector
    frame_id: str = ""

    def __post_init__(self) -> None:
        _freeze(self, "force", "torque")

    @property
    def vector(self) -> Vector:
        """All six, force first."""
        return np.concatenate((self.force, self.torque))

    @override
    def __repr__(self) -> str:
        return _shown(
            "Wrench",
            force=_known(self.force, "N"),
            torque=_known(self.torque, "N·m"),
            frame_id=_quoted(self.frame_id),
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Matrix:
    """A matrix (rows, columns), for example a Jacobian."""

    values: Array

    @override
    def __repr__(self) -> str:
        rows = ", ".join(_numbers(row) for row in self.values.tolist())
        return _shown("Matrix", values=f"[{rows}]")


@dataclass(frozen=True, slots=True)
class Number:
    """A number that is told or set by itself."""

    value: float


@dataclass(frozen=True, slots=True)
class Flag:
    """Something that is on or off."""

    value: bool


@dataclass(frozen=True, slots=True)
class Numbers:
    """Numbers that are told or set together."""

    values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Joy:
    """Axes of a joystick, -1 to 1, and buttons or pedals: 1 is pressed, 0 is not.

    Where `is_valid` is false nothing is known: its message has the stamp 0.
    """

    axes: tuple[float, ...] = ()
    buttons: tuple[int, ...] = ()
    is_valid: bool = True


@dataclass(frozen=True, slots=True)
class Text:
    """Words that are told or set."""

    value: str


class AxisMode(IntEnum):
    """What of a mixed setpoint an axis follows (crtk_msgs/SetpointMode, without the combined ones)."""

    NONE = 0
    POSITION = 1
    VELOCITY = 2
    EFFORT = 4


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class JointServo:
    """A setpoint that may be of another kind for each joint.

    `modes` has one entry a joint; the vectors are as in a `JointState`, and of a joint only the value that
    its mode names counts. `modes` is as it came: numbers that are no `AxisMode` are possible until checked.

    Raises:
        TypeError, ValueError: not numbers, or vectors (names, modes) of different sizes.
    """

    modes: tuple[int, ...]
    position: Vector = field(default_factory=empty)
    velocity: Vector = field(default_factory=empty)
    effort: Vector = field(default_factory=empty)
    name: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        JointState(self.position, self.velocity, self.effort, self.name)
        _freeze(self, "position", "velocity", "effort")
        sizes = {v.size for v in (self.position, self.velocity, self.effort) if v.size}
        if sizes - {len(self.modes)}:
            raise ValueError(f"{len(self.modes)} modes for vectors of {max(sizes)}")

    @override
    def __repr__(self) -> str:
        return _shown(
            "JointServo",
            modes=f"[{', '.join(map(str, self.modes))}]",
            position=_known(self.position, "rad|m"),
            velocity=_known(self.velocity, "rad/s|m/s"),
            effort=_known(self.effort, "N·m|N"),
            name=str(list(self.name)) if self.name else "",
        )


@dataclass(frozen=True, slots=True, eq=False)
class CartesianServo:
    """A setpoint of the tool that may be of another kind for each axis of a task frame.

    `modes` has six entries: translation along x, y, z and rotation about x, y, z of `task`, a pose in
    `frame_id`. `pose` is in the task frame; `twist` and `wrench` are in its axes, at the tool point.
    """

    modes: tuple[int, ...]
    pose: Pose
    twist: Twist
    wrench: Wrench
    task: Pose
    frame_id: str = ""


MOST_POINTS: Final = 50_000
"""Points of one trajectory: eight minutes at 100 Hz."""


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How far one joint may be from a trajectory, in rad, rad/s (m, m/s).

    What 0 and -1 mean says `crtk_drivers.trajectory.tolerances`.
    """

    name: str
    position: float = 0.0
    velocity: float = 0.0


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class JointTrajectory:
    """Points that joints go through, as a goal of FollowJointTrajectory gives them.

    Attributes:
        name: of the joints, in the order of the columns.
        times: (m,) s from the start, as they came.
        positions: (m, n) rad (m).
        velocities: (m, n) rad/s (m/s); a row of NaN where a point has none.
        accelerations: (m, n) rad/s² (m/s²); the same.
        start_ns: when it starts, since the epoch; 0: at once.
        path: tolerances on the way.
        goal: tolerances at the end.
        goal_time: seconds that it may take longer; 0: as long as it takes.
    """

    name: tuple[str, ...]
    times: Vector
    positions: Array
    velocities: Array
    accelerations: Array
    start_ns: int = 0
    path: tuple[Tolerance, ...] = ()
    goal: tuple[Tolerance, ...] = ()
    goal_time: float = 0.0

    @override
    def __repr__(self) -> str:
        seconds = self.times[-1] if len(self.times) else 0.0
        return (
            f"JointTrajectory({len(self.times)} points in {seconds:g} s of {', '.join(self.name)})"
        )


Value = (
    JointState
    | Pose
    | Poses
    | Twist
    | Wrench
    | Matrix
    | Number
    | Numbers
    | Flag
    | Text
    | Joy
    | JointServo
    | CartesianServo
    | JointTrajectory
)


VALUE_TYPES: Mapping[Payload, type[Value]] = MappingProxyType(
    {
        Payload.JOINT_STATE: JointState,
        Payload.POSE: Pose,
        Payload.POSES: Poses,
        Payload.TWIST: Twist,
        Payload.WRENCH: Wrench,
        Payload.MATRIX: Matrix,
        Payload.JOINT_SERVO: JointServo,
        Payload.CARTESIAN_SERVO: CartesianServo,
        Payload.TRAJECTORY: JointTrajectory,
        Payload.NUMBER: Number,
        Payload.NUMBERS: Numbers,
        Payload.FLAG: Flag,
        Payload.TEXT: Text,
        Payload.JOY: Joy,
    }
)
"""What each payload is in Python."""


Source = TypeVar("Source")


class OnDemand(Mapping[str, Value], Generic[Source]):
    """Values of a sample of which each is made when it is first asked for: what nobody reads costs nothing.

    Args:
        makers: make each value from `source`; in whatever thread asks, in two perhaps.
        source: what was read, not changed any more; its numbers have been found to be finite.
    """

    __slots__ = ("_made", "_makers", "_source")

    def __init__(self, makers: Mapping[str, Callable[[Source], Value]], source: Source) -> None:
        self._makers = makers
        self._source = source
        self._made: dict[str, Value] = {}

    @override
    def __getitem__(self, name: str) -> Value:
        made = self._made.get(name)
        if made is None:
            made = self._made[name] = self._makers[name](self._source)
        return made

    @override
    def __contains__(self, name: object) -> bool:
        return name in self._makers

    @override
    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)

    @override
    def __len__(self) -> int:
        return len(self._makers)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Sample:
    """One reading of a device: everything in it was acquired at the same instant.

    `values` is keyed by CRTK name, with a sub-namespace where there is one: ``measured_js``,
    ``measured_cp``, ``local/measured_cp``; a dict, or `OnDemand`. A device that makes its own trajectories
    adds the ``setpoint_js`` that it is following.
    """

    stamp: Stamp
    values: Mapping[str, Value] = field(default_factory=dict)

    @property
    def not_finite(self) -> str:
        """Name the first number that is none, as ``measured_js position[2] is nan``; empty if all are."""
        if isinstance(self.values, OnDemand):
            return ""
        for name, value in self.values.items():
            for part in _MEASURED_PARTS.get(type(value), ()):
                numbers = getattr(value, part).tolist()
                if not math.isfinite(sum(numbers)):
                    index = next((i for i, n in enumerate(numbers) if not math.isfinite(n)), 0)
                    return f"{name} {part}[{index}] is {numbers[index]:g}"
        return ""

    @override
    def __repr__(self) -> str:
        if self.stamp.wall_ns == 0:
            return f"Sample(not valid: {', '.join(self.values)})"
        age = time.monotonic() - self.stamp.monotonic
        return f"Sample({age:.3f} s old: {', '.join(self.values)})"


_MEASURED_PARTS: Mapping[type, tuple[str, ...]] = {
    JointState: ("position", "velocity", "effort"),
    Pose: ("position", "orientation"),
    Poses: ("vector",),
    Twist: ("linear", "angular"),
    Wrench: ("force", "torque"),
}
