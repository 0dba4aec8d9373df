"""Moves: the handle that a client waits on, and the two ways in which a move is executed."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from enum import StrEnum

from crtk_drivers.device import Device, Goal, MoveProgress
from crtk_drivers.errors import MotionAborted
from crtk_drivers.profiles import JointProfile
from crtk_drivers.samples import JointState, Vector


class Outcome(StrEnum):
    """How a move ended, or that it has not."""

    RUNNING = "running"
    REACHED = "reached"
    PREEMPTED = "pre-empted"
    ABORTED = "aborted"


class Move:
    """An accepted move. Thread-safe.

    Attributes:
        name: the CRTK command, for example ``move_jp``.
        outcome: where it stands.
        reason: why it did not reach its goal, in words.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.outcome = Outcome.RUNNING
        self.reason = ""
        self._lock = threading.Lock()
        self._ended = threading.Event()

    def finish(self, outcome: Outcome, reason: str = "") -> None:
        """Record the end; the first one counts."""
        with self._lock:
            if not self._ended.is_set():
                self.outcome, self.reason = outcome, reason
                self._ended.set()

    def wait(self, timeout: float | None = None, is_busy: bool = False) -> bool:
        """Wait until the move has ended, or with `is_busy` until it has started.

        Args:
            timeout: in seconds; None waits as long as the move takes.
            is_busy: wait for the start instead, which an accepted move already has.

        Returns:
            True when the goal is reached, False when the time is over.

        Raises:
            MotionAborted: it was stopped, pre-empted by another command, or failed.
        """
        if is_busy:
            return True
        if not self._ended.wait(timeout):
            return False
        if self.outcome is not Outcome.REACHED:
            raise MotionAborted(
                f"{self.name} was {self.outcome}" + (f": {self.reason}" if self.reason else "")
            )
        return True


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

    def __init__(self, move: Move, device: Device, goal: Goal) -> None:
        super().__init__(move)
        self._device = device
        device.move(goal)

    def step(self, now: float) -> bool:
        """Ask the hardware how far it is."""
        progress = self._device.move_progress()
        if progress is MoveProgress.FAILED:
            raise MotionAborted(f"the hardware ended {self.move.name} before its goal")
        return progress is MoveProgress.DONE


class ProfileMove(MoveExecution):
    """A profile of our own, streamed as joint positions.

    After a late cycle the profile goes on from where it was, at most two periods further: no burst and
    no jump, the motion just takes longer.
    """

    def __init__(
        self,
        move: Move,
        profile: JointProfile,
        send: Callable[[str, JointState, Vector, float], None],
        now: float,
        period: float,
    ) -> None:
        super().__init__(move)
        self._profile = profile
        self._send = send
        self._last = now - period  # when the setpoint went out from which it starts
        self._longest = 2.0 * period
        self._time = 0.0

    def step(self, now: float) -> bool:
        """Send the next point."""
        self._time += min(now - self._last, self._longest)
        self._last = now
        position, velocity, acceleration = self._profile.state(self._time)
        point = JointState(position=position, velocity=velocity)
        self._send(self.move.name, point, acceleration, now)
        return self._time >= self._profile.duration
