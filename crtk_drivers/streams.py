"""Streams that go on between their commands, in the I/O thread: interpolate_*.

A stream takes commands as they come (`feed`) and says in each cycle what is to be sent (`step`). It begins
with the velocity and acceleration of the motion that it replaces, as far as they are known, and ends by
itself when no command came for its timeout and the motion has come to its end.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from crtk_drivers.arbiter import Order
from crtk_drivers.commands import COMMANDS, Kind
from crtk_drivers.device import Device, Mode, Setpoint
from crtk_drivers.feedback import Feedback
from crtk_drivers.interpolation import JointInterpolator
from crtk_drivers.samples import JointState, Value, Vector, empty, joint_state, joint_values

JOINT_MODES = {
    Kind.POSITION: Mode.JOINT_POSITION,
    Kind.RELATIVE: Mode.JOINT_POSITION,
    Kind.VELOCITY: Mode.JOINT_VELOCITY,
    Kind.EFFORT: Mode.JOINT_EFFORT,
}

Clamp = Callable[[str, Vector, Vector], Vector]
"""Puts joint positions into their range: (command, positions, positions that it starts from)."""


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """What goes out in one cycle.

    Attributes:
        setpoint: to be sent.
        joints: what ``setpoint_js`` says of it; None if that follows from the setpoint alone.
        acceleration: (n,) of the joints, for the motion that follows; empty if unknown.
    """

    setpoint: Setpoint
    joints: JointState | None = None
    acceleration: Vector = field(default_factory=empty)


class Stream(ABC):
    """One stream while it runs; `name` is its command."""

    def __init__(self, name: str) -> None:
        self.name = name

    @abstractmethod
    def feed(self, order: Order, now: float) -> None:
        """Take a command of this name.

        Raises:
            CommandRefused: nothing is changed.
        """

    @abstractmethod
    def step(self, now: float) -> Point:
        """Return what to send now.

        Raises:
            CommandRefused: it cannot go on.
        """

    @property
    @abstractmethod
    def is_over(self) -> bool:
        """Whether it has timed out and its motion has ended."""

    @property
    @abstractmethod
    def goals(self) -> Mapping[str, Value]:
        """What ``goal_*`` say."""


class JointStream(Stream):
    """interpolate_jp, _jr, _jv and _jf.

    Args:
        name: of the command.
        device: whose limits and rate it keeps.
        feedback: where it begins.
        clamp: for goals out of range.
        timeout: seconds without a command after which it ends.
        now: monotonic seconds.
    """

    def __init__(
        self,
        name: str,
        device: Device,
        feedback: Feedback,
        clamp: Clamp,
        timeout: float,
        now: float,
    ) -> None:
        super().__init__(name)
        self._device = device
        self._clamp = clamp
        self._kind = COMMANDS[name].kind
        self._mode = JOINT_MODES[self._kind]
        capabilities = device.capabilities
        cycle = 1.0 / capabilities.rate
        self._interpolator = JointInterpolator(capabilities.limits, cycle, timeout, self._kind)
        position, velocity, acceleration = feedback.motion()
        before = now - cycle  # when that went out
        if self._mode is Mode.JOINT_POSITION:
            self._interpolator.start(position, before, velocity, acceleration)
        elif self._mode is Mode.JOINT_VELOCITY:
            self._interpolator.start(velocity, before, acceleration)
        else:
            effort = feedback.commanded_effort()
            at_rest = np.zeros(len(capabilities.joints))
            self._interpolator.start(effort if effort.size else at_rest, before)

    def feed(self, order: Order, now: float) -> None:
        """See the base class."""
        before = self._interpolator.goal
        if order.increment.size:
            goal = before + order.increment
        else:
            assert isinstance(order.target, JointState)
            goal = joint_values(self._kind, order.target)
        if self._mode is Mode.JOINT_POSITION:
            goal = self._clamp(self.name, goal, before)
        self._interpolator.command(goal, now)

    def step(self, now: float) -> Point:
        """See the base class."""
        point = self._interpolator.point(now)
        acceleration = {
            Mode.JOINT_POSITION: self._interpolator.acceleration,
            Mode.JOINT_VELOCITY: self._interpolator.rate,
        }.get(self._mode, empty())
        values = joint_values(self._kind, point)
        return Point(Setpoint(self._mode, values), point, acceleration)

    @property
    def is_over(self) -> bool:
        """See the base class."""
        return self._interpolator.is_over

    @property
    def goals(self) -> Mapping[str, Value]:
        """See the base class."""
        capabilities = self._device.capabilities
        state = joint_state(self._kind, self._interpolator.goal)
        goals: dict[str, Value] = {"goal_js": replace(state, name=capabilities.joints)}
        if self._mode is Mode.JOINT_POSITION and capabilities.has_kinematics:
            goals["goal_cp"] = self._device.forward_kinematics(state.position)
        return goals
