"""Ways in which drives follow a stream of positions: what is sent on the line, and what comes of the answers.

By points (PVT) the axes follow smoothly, and stop when no more points come. By profiles each position is the
goal of the drive's own ramp, and a drive that hears no more rests at the last one.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final, Protocol

from crtk_driver_copley.axis import Axis
from crtk_driver_copley.codec import Reply, abort, get, put, update
from crtk_driver_copley.config import SHARE
from crtk_driver_copley.line import Exchange, Line, Take
from crtk_driver_copley.stream import Point, PvtStream
from crtk_driver_copley.tables import (
    CLEAR_PVT,
    PVT_PROFILE,
    TRAPEZOID,
    VELOCITY_UNIT,
    Parameter,
    Trajectory,
    error_text,
)

__all__ = ["AMPLE", "ByProfile", "ByPvt", "Tracking", "refusal"]

AMPLE: Final = 1.2
"""Speed that points and ramps may have, in those of the joints: setpoints are limited on their way here."""
LOOKS: Final = 20
"""How many times a buffer is looked at for one point before the axes go."""
RESENDS: Final = 3
TOLD: Final = 2
"""Answers in a row that tell the end of a motion, until it is believed."""
_ENDED: Final = (
    "its motion was ended, and not by this driver. Does another program talk to the drive, or an input of it "
    "stop it?"
)


def refusal(command: str, code: int) -> str:
    """Return what to say of a command that a drive does not take."""
    text, remedy = error_text(code)
    return f"{command!r} was refused: e {code} {text}. {remedy}".strip()


class Tracking(Protocol):
    """One way. It belongs to the I/O thread."""

    trouble: str
    """Why it cannot go on, in words; empty if it can."""

    def follow(self, now: float, counts: Sequence[float]) -> None:
        """Lead the axes to `counts` (n,)."""

    def forget(self) -> None:
        """The stream has ended: the axes were told to stop."""

    def take_trajectory(self, axis: int, now: float) -> None:
        """An axis has told what its profile does, asked at the time `now` or before."""

    def take_free(self, axis: int, free: int, now: float) -> None:
        """The buffer of an axis has told its free places."""

    @property
    def wants_free(self) -> bool:
        """Whether buffers are to be asked."""

    @property
    def has_arrived(self) -> bool:
        """Whether the axes should be where they were sent last."""

    @property
    def slow(self) -> str:
        """Why the line is too slow for this, in words; empty if it is not."""

    @property
    def restarts(self) -> int:
        """How many times a stream had to begin anew by itself."""


class _Asking:
    """What a way of following has on the line, which ends with its stream.

    Args:
        line: of the drives.
    """

    def __init__(self, line: Line) -> None:
        self._line = line
        self._under_way: deque[Exchange] = deque(maxlen=200)

    def ask(self, command: str, take: Take, *, once: bool = False) -> None:
        """See `Line.ask`; soon, for questions to all axes may take longer than a point lasts."""
        self._under_way.append(self._line.ask(command, take, once=once, soon=True))

    def forget(self) -> None:
        """Take back what was not sent, and heed no answers any more."""
        self._line.withdraw(self._under_way)
        self._under_way.clear()


class ByProfile:
    """0xca and ``t 1``: each position is the goal of a ramp.

    Args:
        line, axes: of the arm.
        rests: between two goals.
    """

    restarts = 0
    wants_free = False
    slow = ""

    def __init__(self, line: Line, axes: Sequence[Axis], *, rests: bool) -> None:
        self._asking = _Asking(line)
        self._axes = axes
        self._rests = rests
        self._sent: list[int | None] = [None] * len(axes)
        self._left = 0
        self._unseen: set[int] = set()
        self._going: set[int] = set()  # seen not to be aborted since its stream began
        self._aborted = [0] * len(axes)
        self.trouble = ""

    def forget(self) -> None:
        """See `Tracking`."""
        self._asking.forget()
        self._sent = [None] * len(self._axes)
        self._left = 0
        self._unseen.clear()
        self._going.clear()
        self._aborted = [0] * len(self._axes)
        self.trouble = ""

    def follow(self, now: float, counts: Sequence[float]) -> None:
        """See `Tracking`."""
        if self._left or (self._rests and self._is_under_way):
            return
        if self.trouble or any(self._aborted):  # the next goal would undo somebody else's stop
            return
        for index, (axis, goal) in enumerate(zip(self._axes, map(round, counts), strict=True)):
            if goal == self._sent[index]:
                continue
            if self._sent[index] is None:
                self._ask(put(axis.to, Parameter.PROFILE, TRAPEZOID))
            self._sent[index] = goal
            self._ask(put(axis.to, Parameter.GOAL, goal))
            self._ask(update(axis.to))
            self._unseen.add(index)

    def _ask(self, command: str) -> None:
        self._left += 1
        self._asking.ask(command, partial(self._answered, command))

    def _answered(self, command: str, reply: Reply | None) -> None:
        self._left -= 1
        if reply is not None and reply.error and not self.trouble:
            self.trouble = refusal(command, reply.error)

    def take_trajectory(self, axis: int, now: float) -> None:
        """See `Tracking`."""
        if not self._left:
            self._unseen.discard(axis)
        if self._sent[axis] is None:
            return
        if not self._axes[axis].trajectory & Trajectory.ABORTED:
            self._going.add(axis)
            self._aborted[axis] = 0
        elif axis in self._going:  # else it is of a stop before this stream
            self._aborted[axis] += 1
        if self._aborted[axis] >= TOLD and not self.trouble:
            self.trouble = f"{self._axes[axis].name}: {_ENDED}"

    def take_free(self, axis: int, free: int, now: float) -> None:
        """See `Tracking`."""

    @property
    def has_arrived(self) -> bool:
        """See `Tracking`."""
        return not self._is_under_way

    @property
    def _is_under_way(self) -> bool:
        return bool(self._unseen) or any(axis.is_running for axis in self._axes)


class ByPvt:
    """Points with velocity and time.

    Each goes out when the one before it was answered. Of one without an answer it is told from the buffer
    whether it was taken: a point too few would let the axis go twice as far in its time. Where that cannot be
    told the axes come to rest, since no more points follow.

    Args:
        line, axes: of the arm.
        period: from one point to the next, in s.
        lead: points that wait in the drives.
    """

    def __init__(self, line: Line, axes: Sequence[Axis], period: float, lead: int) -> None:
        self._asking = _Asking(line)
        self._line = line
        self._axes = axes
        fastest = [AMPLE * axis.joint.velocity * axis.joint.counts for axis in axes]
        self._stream = PvtStream(fastest, period, lead)
        self._period = period
        self._phase: Callable[[float], None] | None = None
        self._counts: dict[int, int] = {}
        self._places: dict[int, int] = {}  # told once
        self._most_start = 0.5 * lead * period
        self._most_waiting = lead // 2
        self._points: list[deque[Point]] = [deque() for _ in axes]
        self._busy = [False] * len(axes)
        self._sent = [0] * len(axes)
        self._since: dict[int, float] = {}
        self._ended = [0] * len(axes)
        self.trouble = ""
        self.restarts = 0

    def forget(self) -> None:
        """See `Tracking`."""
        self._stream.forget()
        self._leave_off()
        self.trouble = ""

    def _leave_off(self) -> None:
        self._asking.forget()
        self._phase = None
        for points in self._points:
            points.clear()
        count = len(self._axes)
        self._busy, self._sent, self._ended = [False] * count, [0] * count, [0] * count

    def follow(self, now: float, counts: Sequence[float]) -> None:
        """See `Tracking`."""
        if not self._stream.is_running and not self.trouble:
            self.trouble = self._slow(1.0)
        if self.trouble:
            return
        self._stream.add(now, counts)
        if self._phase is None:
            self._come_to_rest()
        else:
            self._phase(now)

    @property
    def slow(self) -> str:
        """See `Tracking`."""
        return self._slow(SHARE)

    def _slow(self, share: float) -> str:
        """Return what to say if points need more than a share of the line's time; empty if they do not."""
        answer, count = self._line.answer_time, len(self._axes)
        needed = count * answer / share
        if needed <= self._period:
            return ""
        return (
            f"the line is too slow: an answer takes {1000.0 * answer:.0f} ms, so that points of {count} axes "
            f"need {needed:.2g} s, and pvt_period is {self._period:g} s. Give a longer pvt_period, or look "
            "at what holds answers back: adapter, serial server, network."
        )

    def _wait(self, now: float) -> None:
        """What was asked for is not answered yet."""

    def _run(self, now: float) -> None:
        """Send what is needed by now."""
        if self._is_late(now):
            self._restart()
            return
        for row in self._stream.rows(now):
            for axis, point in enumerate(row):
                self._points[axis].append(point)
        for axis in range(len(self._axes)):
            self._feed(axis)
        if max(map(len, self._points)) > self._most_waiting:
            self.trouble = self.slow

    def _is_late(self, now: float) -> bool:
        """Whether a drive is at the end of the points that it has, and has stopped there."""
        unsent = [len(points) + busy for points, busy in zip(self._points, self._busy, strict=True)]
        return self._stream.is_late(now, unsent)

    def _restart(self) -> None:
        """The drives were sent too little, and have stopped; on a line that is too slow, for good."""
        self.restarts += 1
        self.trouble = self.slow
        self._stream.interrupt()
        self._leave_off()

    def _ask(self, axis: int, command: str, take: Callable[[int, Reply], None]) -> None:
        def answered(reply: Reply | None) -> None:
            assert reply is not None  # it is asked again, until the line counts as lost
            if reply.error:
                self.trouble = refusal(command, reply.error)
            else:
                take(axis, reply)

        self._asking.ask(command, answered)

    # Before it begins: all stand, buffers are empty, and filled with points that stand.

    def _come_to_rest(self) -> None:
        self._phase = self._wait
        for index, axis in enumerate(self._axes):
            self._ask(index, abort(axis.to), self._nothing)
        self._look_whether_all_rest()

    def _look_whether_all_rest(self, now: float = 0.0) -> None:
        self._phase = self._wait
        self._counts.clear()
        for index, axis in enumerate(self._axes):
            self._ask(index, get(axis.to, Parameter.TRAJECTORY), self._take_rest)

    def _take_rest(self, axis: int, reply: Reply) -> None:
        self._counts[axis] = reply.values[0]
        if len(self._counts) < len(self._axes):
            return
        if any(told & Trajectory.RUNNING for told in self._counts.values()):
            self._phase = self._look_whether_all_rest
        else:
            self._prepare()

    def _prepare(self) -> None:
        self._counts.clear()
        self._places.clear()
        for index, axis in enumerate(self._axes):
            self._ask(index, put(axis.to, Parameter.PVT, CLEAR_PVT), self._nothing)
            self._ask(index, put(axis.to, Parameter.PROFILE, PVT_PROFILE), self._nothing)
            self._ask(index, get(axis.to, Parameter.PVT), self._take_capacity)
            self._ask(index, get(axis.to, Parameter.COMMANDED), self._take_place)

    def _nothing(self, axis: int, reply: Reply) -> None:
        pass

    def _take_capacity(self, axis: int, reply: Reply) -> None:
        self._stream.buffers[axis].capacity = reply.values[0]

    def _take_place(self, axis: int, reply: Reply) -> None:
        """Believed when it is told twice: the first points are there, and an axis would leap to others."""
        place = reply.values[0]
        if self._places.get(axis) != place:
            self._places[axis] = place
            self._ask(axis, get(self._axes[axis].to, Parameter.COMMANDED), self._take_place)
            return
        self._counts[axis] = place
        if len(self._counts) == len(self._axes):
            here = [self._counts[index] for index in range(len(self._axes))]
            for row in self._stream.stand(here):
                for index, point in enumerate(row):
                    self._points[index].append(point)
            self._since.clear()
            for index in range(len(self._axes)):
                self._feed(index)

    def _start(self) -> None:
        for index, axis in enumerate(self._axes):
            command = update(axis.to)
            self._asking.ask(command, partial(self._started, index), once=True)

    def _started(self, axis: int, reply: Reply | None) -> None:
        if reply is None or reply.error:
            why = "it did not answer" if reply is None else refusal("t 1", reply.error)
            self.trouble = f"{self._axes[axis].name} was not started: {why}"
            return
        self._since[axis] = sent = self._line.sent.monotonic
        if time.monotonic() - sent > self._most_start:
            self._restart()  # when it began cannot be told, and so not when it needs points
            return
        if len(self._since) == len(self._axes):
            self._stream.started([self._since[index] for index in range(len(self._axes))])
            self._phase = self._run

    # Points

    def _feed(self, axis: int) -> None:
        """Send the next point of an axis; the drives start when all of the first ones were taken."""
        if self._busy[axis]:
            return
        if self._points[axis]:
            self._send(axis, self._points[axis].popleft())
        elif not self._stream.is_running and not any(self._points) and not any(self._busy):
            self._start()

    def _send(self, axis: int, point: Point, resends: int = RESENDS) -> None:
        self._busy[axis] = True
        rate = round(point.velocity / VELOCITY_UNIT)
        command = put(self._axes[axis].to, Parameter.PVT, point.time, point.position, rate)

        def answered(reply: Reply | None) -> None:
            if reply is None:
                self._look_for(axis, point, resends)
            elif not reply.error:
                self._taken(axis)
            elif resends:
                self._send(axis, point, resends - 1)
            else:
                self.trouble = f"{self._axes[axis].name}: {refusal(command, reply.error)}"

        self._asking.ask(command, answered, once=True)

    def _taken(self, axis: int) -> None:
        self._busy[axis] = False
        self._sent[axis] += 1
        self._feed(axis)

    def _look_for(
        self, axis: int, point: Point, resends: int, before: bool | None = None, looks: int = LOOKS
    ) -> None:
        """Find out whether a point was taken; believed when the buffer has told it twice."""

        def told(_: int, reply: Reply) -> None:
            found = self._has_taken(axis, reply.values[0])
            if found is not None and found is before:
                if found:
                    self._taken(axis)
                elif resends:
                    self._send(axis, point, resends - 1)
                else:
                    self._give_up(axis)
            elif looks or self._stream.is_running:  # until it is too late, and the drives stand
                self._look_for(axis, point, resends, found, looks - 1)
            else:
                self._give_up(axis)

        self._ask(axis, get(self._axes[axis].to, Parameter.PVT), told)

    def _has_taken(self, axis: int, free: int) -> bool | None:
        buffer = self._stream.buffers[axis]
        if not self._stream.is_running:
            held = buffer.capacity - free - self._sent[axis]
            return bool(held) if held in (0, 1) else None
        if not buffer.is_sure:
            return None
        return buffer.has_taken(free, len(self._points[axis]), self._line.sent.monotonic)

    def _give_up(self, axis: int) -> None:
        self.trouble = (
            f"{self._axes[axis].name}: a point was not answered, and its buffer does not tell whether it was "
            "taken. Check the line: cable, ground, and what else is on it."
        )

    # What is told meanwhile

    @property
    def wants_free(self) -> bool:
        """See `Tracking`."""
        return self._stream.is_running

    @property
    def has_arrived(self) -> bool:
        """See `Tracking`."""
        return self._stream.has_arrived(time.monotonic())

    def take_free(self, axis: int, free: int, now: float) -> None:
        """See `Tracking`."""
        if self._stream.is_running and not self._busy[axis]:
            self._stream.buffers[axis].heard(free, len(self._points[axis]), now)

    def take_trajectory(self, axis: int, now: float) -> None:
        """See `Tracking`."""
        if not self._stream.is_running or now < max(self._since.values()):
            return
        told = self._axes[axis].trajectory
        ended = bool(told & Trajectory.ABORTED) or not told & Trajectory.RUNNING
        self._ended[axis] = self._ended[axis] + 1 if ended else 0
        if self._ended[axis] < TOLD:
            return
        if self._is_late(time.monotonic()):
            self._restart()
        else:
            self.trouble = (
                f"{self._axes[axis].name}: {_ENDED} Or did points come a moment too late?"
            )
