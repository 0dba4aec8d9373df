"""Moves while they run, in the I/O thread: by the hardware, or along a trajectory of ours."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Final

from typing_extensions import override

from crtk_drivers.device import Goal, Mode, MoveProgress, Setpoint
from crtk_drivers.errors import MotionAborted
from crtk_drivers.motion.context import MotionContext
from crtk_drivers.motion.feedback import Point
from crtk_drivers.motion.tool import PoseOutput
from crtk_drivers.move import Move
from crtk_drivers.samples import JointState
from crtk_drivers.trajectory.profiles import JointProfile, LineProfile

ARRIVAL_TIMEOUT: Final = 10.0
"""Seconds, at full pace, in which hardware that smooths setpoints must be where a trajectory of ours ends."""

SETTLING_TIME: Final = 2.0
"""Seconds in which the joints must be measured at the goal of a move that the hardware says it has ended."""

Missing = Callable[[float], str | None]
"""Says which joint is not at the goal, empty if none is; None without a sample since that monotonic time."""

PACE_TIME: Final = 0.2
"""Seconds in which a trajectory goes from rest to full pace, or back, where the hardware's own pace jumps."""


class MoveExecution(ABC):
    """A move while it runs, in the I/O thread."""

    def __init__(self, move: Move) -> None:
        self.move = move

    @abstractmethod
    def step(self, now: float) -> bool:
        """Do this cycle's part; return True when the goal is reached.

        Raises:
            MotionAborted: it cannot be reached.
        """


class NativeMove(MoveExecution):
    """The hardware plans and executes; this one watches."""

    def __init__(self, move: Move, context: MotionContext, goal: Goal, missing: Missing) -> None:
        super().__init__(move)
        self._device = context.device
        self._missing = missing
        self._ended: float | None = None
        context.device.move(goal)

    @override
    def step(self, now: float) -> bool:
        """Ask the hardware how far it is, and look whether it is there when it says so."""
        progress = self._device.move_progress()
        if progress is MoveProgress.FAILED:
            raise MotionAborted(f"the hardware ended {self.move.name} before its goal")
        if progress is not MoveProgress.DONE:
            return False
        if self._ended is None:
            self._ended = now
        missing = self._missing(self._ended)
        if missing and now - self._ended > SETTLING_TIME:
            raise MotionAborted(
                f"the hardware says that {self.move.name} has ended, but {missing}",
                remedy="Look at what holds it.",
            )
        return missing == ""


class StreamedMove(MoveExecution):
    """A trajectory of our own, sent point by point.

    After a late cycle the profile goes on from where it was, at most two periods further: no burst and
    no jump, the motion just takes longer. So it does where the hardware is slowed down.

    Args:
        move: the handle.
        context: of the device.
        send: takes the name of the command, a point, and monotonic seconds.
        missing: which joint is not at the goal.
        now: monotonic seconds.
        pace: of the trajectory at its beginning, of real time.

    Attributes:
        pace: of the trajectory now; that of the hardware, not faster than `PACE_TIME`.
    """

    def __init__(
        self,
        move: Move,
        context: MotionContext,
        send: Callable[[str, Point, float], object],
        missing: Missing,
        now: float,
        pace: float,
    ) -> None:
        super().__init__(move)
        period = context.cycle
        self._device = context.device
        self._send = send
        self._missing = missing
        self._ended: float | None = None
        self._last = now - period  # when the setpoint went out from which it starts
        self._longest = 2.0 * period
        self._time = 0.0
        self.pace = pace

    @override
    def step(self, now: float) -> bool:
        """Send the next point; at the end the last one, until the hardware is there."""
        passed = min(now - self._last, self._longest)
        self._last = now
        change = passed / PACE_TIME
        self.pace = min(max(self._device.pace, self.pace - change), self.pace + change)
        step = self.pace * passed
        self._time += step
        self._send(self.move.name, self._point(self._time, step).at_pace(self.pace), now)
        late = self._time - self._duration
        if late < 0.0:
            return False
        if self._ended is None:
            self._ended = now
        missing = self._missing(self._ended)
        if late > ARRIVAL_TIMEOUT:
            raise MotionAborted(
                f"the hardware has not come to rest where {self.move.name} ends in {ARRIVAL_TIMEOUT:g} s"
                + (f": {missing}" if missing else ""),
                remedy="Look at what holds it.",
            )
        return self._device.has_arrived and missing == ""

    @property
    @abstractmethod
    def _duration(self) -> float:
        """Seconds from start to rest."""

    @abstractmethod
    def _point(self, time: float, step: float) -> Point:
        """Return what to send `time` seconds of the trajectory after its start, and `step` after the last."""


class ProfileMove(StreamedMove):
    """A profile of the joints."""

    def __init__(
        self,
        move: Move,
        context: MotionContext,
        profile: JointProfile,
        send: Callable[[str, Point, float], object],
        missing: Missing,
        now: float,
        pace: float,
    ) -> None:
        super().__init__(move, context, send, missing, now, pace)
        self._profile = profile

    @property
    @override
    def _duration(self) -> float:
        return self._profile.duration

    @override
    def _point(self, time: float, step: float) -> Point:
        position, velocity, acceleration = self._profile.state(time)
        state = JointState(position=position, velocity=velocity)
        return Point(Setpoint(Mode.JOINT_POSITION, position), state, acceleration)


class LineMove(StreamedMove):
    """A straight line of the tool."""

    def __init__(
        self,
        move: Move,
        context: MotionContext,
        profile: LineProfile,
        output: PoseOutput,
        send: Callable[[str, Point, float], object],
        missing: Missing,
        now: float,
        pace: float,
    ) -> None:
        super().__init__(move, context, send, missing, now, pace)
        self._profile = profile
        self._output = output

    @property
    @override
    def _duration(self) -> float:
        return self._profile.duration

    @override
    def _point(self, time: float, step: float) -> Point:
        return self._output.point(*self._profile.at(time), step)
