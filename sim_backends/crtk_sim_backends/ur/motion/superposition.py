"""What is added to the motion of a program: a conveyor that is tracked, or an offset of the path.

A move goes along its path as ever (the *plan* of `arm`); the pose that belongs to it is moved, and what
that asks of the joints is added. Source: URScript manual 5.x, chapter "motion", `track_conveyor_...` and
`path_offset_...`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from enum import IntEnum
from math import copysign, cos, pi, sin, sqrt
from typing import Final, Protocol

from typing_extensions import override

from crtk_sim_backends.ur.motion.arm import SUDDEN_CHANGE, Arm, LimitViolation, approach
from crtk_sim_backends.ur.motion.kinematics import (
    IDENTITY,
    Floats,
    Kinematics,
    Transform,
    compose,
    cross,
    invert,
    multiply,
    norm,
    rotate,
    to_transform,
)
from crtk_sim_backends.ur.motion.limits import JOINT_SPEED, SINGULARITY, VIOLATION

LARGEST_SHIFT: Final = 0.1  # m along an axis
LARGEST_TURN: Final = 0.52  # rad about an axis
"""Of a path offset, unless `path_offset_set_max_offset` says otherwise."""

_CATCHING_UP: Final = 4.0  # periods, in which most of a small delay is made up for
_AT_ONCE: Final = 1e-5  # rad, that are made up for in one
_STILL: Final = 1e-9  # rad/s
_SLOW: Final = 1e-4  # m/s: the direction of a slower motion counts for nothing
_TOLERANCE: Final = 1.001


class Source(Protocol):
    """What moves the pose that belongs to the plan."""

    def advance(self, pace: float) -> None:
        """Go on by one control period; `pace` is 0 while the program is paused."""

    def moved(self, pose: Transform, motion: Callable[[], Transform]) -> Transform:
        """Pose of the tool where the plan has it at `pose`; `motion` is the frame of its path."""


class Encoder(Protocol):
    """What tells how far a belt has gone.

    Attributes:
        ticks: since whenever.
    """

    ticks: float


class Conveyor(ABC):
    """A belt with an encoder. What it moves while the program is paused is lost.

    Args:
        encoder: tells how far it has gone.
        ticks: of the encoder for 1 m, or for a turn.
    """

    def __init__(self, encoder: Encoder, ticks: float) -> None:
        self._encoder = encoder
        self._ticks = ticks
        self._before = encoder.ticks
        self._travelled = 0.0

    @property
    def way(self) -> float:
        """How far the belt has gone since it is tracked, m or turns."""
        return self._travelled / self._ticks

    def advance(self, pace: float) -> None:
        """Go on by one control period."""
        now = self._encoder.ticks
        self._travelled += pace * (now - self._before)
        self._before = now

    @abstractmethod
    def moved(self, pose: Transform, motion: Callable[[], Transform]) -> Transform:
        """Pose further along the belt."""


class LinearConveyor(Conveyor):
    """A straight belt; `direction` is a unit vector in base."""

    def __init__(self, encoder: Encoder, ticks: float, direction: Floats) -> None:
        super().__init__(encoder, ticks)
        self._direction = direction

    @override
    def moved(self, pose: Transform, motion: Callable[[], Transform]) -> Transform:
        """Pose further along the belt."""
        return _shifted(pose, [self.way * x for x in self._direction])


class CircularConveyor(Conveyor):
    """A turntable about the z axis of `centre`; the tool turns with it or keeps its orientation."""

    def __init__(self, encoder: Encoder, ticks: float, centre: Transform, turns: bool) -> None:
        super().__init__(encoder, ticks)
        self._centre = centre
        self._inverse = invert(centre)
        self._turns = turns

    @override
    def moved(self, pose: Transform, motion: Callable[[], Transform]) -> Transform:
        """Pose further about the centre."""
        c, s = cos(2.0 * pi * self.way), sin(2.0 * pi * self.way)
        turn = (c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
        turned = compose(self._centre, compose(turn, compose(self._inverse, pose)))
        return turned if self._turns else (*pose[:9], *turned[9:])


class OffsetFrame(IntEnum):
    """The argument `type` of `path_offset_set`."""

    BASE = 1
    TCP = 2
    MOTION = 3
    WORLD = 4


class PathOffset:
    """An offset of the path, which programs set in each cycle; its settings outlive it.

    Attributes:
        wanted: m and rotation vector in `frame`.
        frame: in which it is meant.
        alpha: share of what is wanted in what is applied, period by period; 1: no filter.
        limits: of the offset along, and of the rotation about an axis, m and rad.
    """

    def __init__(self) -> None:
        self.wanted: Floats = (0.0,) * 6
        self.frame = OffsetFrame.BASE
        self.alpha = 1.0
        self.limits = (LARGEST_SHIFT, LARGEST_TURN)
        self._applied = [0.0] * 6

    def begin(self) -> None:
        """Begin with no offset."""
        self.wanted = (0.0,) * 6
        self._applied = [0.0] * 6

    def advance(self, pace: float) -> None:
        """Bring what is applied towards what is wanted, for one control period."""
        share = self.alpha * pace
        for i, wanted in enumerate(self.wanted):
            limit = self.limits[i // 3]
            within = max(-limit, min(limit, wanted))
            self._applied[i] = share * within + (1.0 - share) * self._applied[i]

    def moved(self, pose: Transform, motion: Callable[[], Transform]) -> Transform:
        """Pose with the offset that is applied now."""
        offset = to_transform(self._applied)
        match self.frame:
            case OffsetFrame.BASE:
                return _in_frame(IDENTITY, offset, pose)
            case OffsetFrame.TCP:
                return compose(pose, offset)
            case OffsetFrame.MOTION:
                return _in_frame(motion(), offset, pose)
        return compose(invert(offset), pose)

    def between(
        self, pose: Transform, moved: Transform, frame: OffsetFrame, motion: Callable[[], Transform]
    ) -> Transform:
        """Offset that brings `pose` to `moved`, as it would be given in `frame`."""
        match frame:
            case OffsetFrame.TCP:
                return compose(invert(pose), moved)
            case OffsetFrame.WORLD:
                return compose(pose, invert(moved))
        turn = compose((*moved[:9], 0.0, 0.0, 0.0), invert((*pose[:9], 0.0, 0.0, 0.0)))
        offset = _shifted(turn, [a - b for a, b in zip(moved[9:], pose[9:], strict=True)])
        axes = motion() if frame is OffsetFrame.MOTION else IDENTITY
        return compose(invert(axes), compose(offset, axes))


class Superposition:
    """Adds one source to the plan of an arm.

    Args:
        arm: that moves.
        kinematics: its own.

    Attributes:
        path_offset: the one that programs set.
    """

    def __init__(self, arm: Arm, kinematics: Kinematics) -> None:
        self._arm = arm
        self._kinematics = kinematics
        self._source: Source | None = None
        self._added = [0.0] * 6  # joint positions that the source asks to add
        self._qd = [0.0] * 6
        self._deceleration = 0.0
        self.path_offset = PathOffset()

    @property
    def source(self) -> Source | None:
        """What is added, None for nothing."""
        return self._source

    @property
    def coasts(self) -> bool:
        """Whether the arm still moves with a source that has been left."""
        return self._source is None and any(self._qd)

    def start(self, source: Source) -> None:
        """Add a source from now on, in place of another one: the path begins where the arm is."""
        self._arm.rebase()
        self._source = source
        self._added = [0.0] * 6

    def end(self, deceleration: float) -> None:
        """Add the source no more; its motion slows down with `deceleration`, rad/s^2."""
        if self._source is not None:
            self._source = None
            self._deceleration = deceleration
            if not self.coasts:
                self._arm.rebase()

    def step(self, tool: Transform, pace: float) -> LimitViolation | None:
        """Set what is added in this period; `pace` is 0 while the program is paused.

        What it violates has not been added: the arm goes on as it did.
        """
        arm = self._arm
        if not arm.enabled:
            self._qd = [0.0] * 6
        elif self._source is None:
            self._qd = approach(self._qd, (0.0,) * 6, self._deceleration * arm.dt)
        else:
            self._source.advance(pace)
            violation = self._follow(self._source, tool)
            if violation is not None:
                return violation
        arm.drift(self._qd)
        return None

    def poses(self, tool: Transform) -> tuple[Transform, Transform]:
        """Pose of the tool on the path, and where it is instead."""
        flange = self._kinematics.flange
        return compose(flange(self._arm.plan_q), tool), compose(flange(self._arm.target_q), tool)

    def motion_frame(self, tool: Transform) -> Transform:
        """Axes along the path, across it and the tool's z axis, and across both; without a position.

        Those of the base while nothing moves along a path.
        """
        arm = self._arm
        twist = multiply(self._kinematics.jacobian(arm.plan_q, tool), arm.commanded_qd)
        speed = norm(twist[:3])
        if speed < _SLOW:
            return IDENTITY
        x = [v / speed for v in twist[:3]]
        across = cross(x, rotate(compose(self._kinematics.flange(arm.plan_q), tool), (0, 0, 1)))
        size = norm(across)
        if size < _SLOW:
            return IDENTITY
        y = [v / size for v in across]
        z = cross(x, y)
        return (x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2], 0.0, 0.0, 0.0)

    def _follow(self, source: Source, tool: Transform) -> LimitViolation | None:
        arm, dt = self._arm, self._arm.dt
        plan = arm.commanded_q
        pose = compose(self._kinematics.flange(plan), tool)
        goal = source.moved(pose, lambda: self.motion_frame(tool))
        q = self._kinematics.follow(goal, arm.target_q, tool)
        if q is None:
            return LimitViolation(SINGULARITY, 0)
        model = arm.model
        added = [x - p for x, p in zip(q, plan, strict=True)]
        qd = []
        for i, velocity in enumerate(self._qd):
            lead = (added[i] - self._added[i]) / dt
            if abs(lead) > model.velocity[i]:
                return SUDDEN_CHANGE
            behind = self._added[i] - (arm.target_q[i] - arm.plan_q[i])
            wanted = lead + _making_up(behind, model.acceleration, dt)
            step = model.acceleration * dt
            wanted = velocity + max(-step, min(step, wanted - velocity))
            qd.append(wanted if abs(wanted) > _STILL else 0.0)
            planned = arm.commanded_qd[i] * arm.scale
            if abs(planned + wanted) > _TOLERANCE * model.velocity[i]:
                return LimitViolation(VIOLATION, JOINT_SPEED + i)
        self._added, self._qd = added, qd
        return None


def _making_up(behind: float, acceleration: float, dt: float) -> float:
    """Speed with which a joint catches up, and from which it can slow down in time, rad/s."""
    size = abs(behind)
    if size < _AT_ONCE:
        return behind / dt
    return copysign(min(size / (_CATCHING_UP * dt), sqrt(acceleration * size)), behind)


def _shifted(pose: Transform, way: Floats) -> Transform:
    x, y, z = (a + b for a, b in zip(pose[9:], way, strict=True))
    return (*pose[:9], x, y, z)


def _in_frame(axes: Transform, offset: Transform, pose: Transform) -> Transform:
    """`pose` moved by `offset` along `axes`, and turned about itself."""
    inner = compose(axes, compose(offset, invert(axes)))
    turned = compose((*inner[:9], 0.0, 0.0, 0.0), (*pose[:9], 0.0, 0.0, 0.0))
    return _shifted((*turned[:9], *pose[9:]), inner[9:])
