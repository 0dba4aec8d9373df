"""The handle of a move on the far side of ROS.

CRTK gives a move no identity: there are ``is_busy``, ``refusals``, with the stamp of what they refuse, and
the setpoint to tell its fate from. Busy must have been seen, and be over; the state must still be ENABLED;
and where the goal is known, or the device tells that of a relative move, and the device tells its setpoint,
that must have arrived at the goal. Each comes on a topic of its own: the end of busy may be heard before the
setpoint, or the goal, that tells of a stop on the way.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

from typing_extensions import override

from crtk_drivers.client.goals import SETTLE_TIME
from crtk_drivers.errors import CommandRefused, ConnectionLost, MotionAborted
from crtk_drivers.motion.move import Move, Outcome
from crtk_drivers.state import OperatingState, Status

ACCEPT_TIMEOUT = 1.0
"""Seconds to wait for a sign that a move has begun, before the handle is returned without one."""
ACCEPT_TIME = 0.03
"""Seconds that busy must last, or be on already, without a refusal, to count as accepted."""
REPEATED_ACCEPT_TIME = 0.7
"""The same after a refusal: a driver may thin busy pulses out, and end one with its next heartbeat."""
PULSE_TIME = 0.1
"""Seconds in which busy rises and falls for a move that is refused; not to be taken for the next one's."""
REFUSAL_TIME = 0.3
"""Seconds after a busy pulse in which the refusal that may be its cause arrives."""
REPEATED_REFUSAL_TIME = 3.0
"""The same if a refusal of the same command was told a moment ago: the next one is held back for 2 s."""
UNTOLD = 5.0
"""Seconds after busy after which it is judged by what was told before that: no setpoint is told any more."""
START_TIMEOUT = 10.0
"""Seconds after which a move that never showed as busy is given up, unless `wait` has a timeout."""
LOOK_PERIOD = 0.05


class RemoteMove(Move):
    """A move that was sent. Thread-safe.

    Args:
        name: the CRTK command.
        stamp_ns: that it was sent with, by which its refusal is known; 0 if it had none.
        was_busy: the device was moving already when it was sent.
        refused_before: the same command was refused within the last seconds.
        at_goal: whether the setpoint is at the goal; None: that is not known.
        told_at: when (monotonic, s) that setpoint arrived: one that is still to come may tell otherwise.
            Infinity where none will ever tell.
        lost: why nothing more will be heard of it; empty if all is well.
    """

    def __init__(
        self,
        name: str,
        *,
        stamp_ns: int,
        was_busy: bool,
        refused_before: bool,
        at_goal: Callable[[], bool | None],
        lost: Callable[[], str],
        told_at: Callable[[], float] = lambda: math.inf,
    ) -> None:
        super().__init__(name)
        self.stamp_ns = stamp_ns
        self._changed = threading.Condition()
        self._at_goal = at_goal
        self._told_at = told_at
        self._lost = lost
        self._sent = time.monotonic()
        self._was_busy = was_busy
        self._busy_since = self._sent if was_busy else None
        self._idle_since: float | None = None
        self._state: OperatingState | None = None
        self._refusal_time = REPEATED_REFUSAL_TIME if refused_before else REFUSAL_TIME
        self._accept_time = ACCEPT_TIME
        if refused_before:
            self._accept_time = REPEATED_REFUSAL_TIME if was_busy else REPEATED_ACCEPT_TIME
        self.accepted = False
        self.refusal: CommandRefused | None = None

    # ------------------------------------------------------------------ told by the spinning thread

    def status_changed(self, status: Status) -> None:
        """A status arrived."""
        with self._changed:
            now = time.monotonic()
            if status.is_busy:
                self._busy_since = self._busy_since or now
                self._idle_since = None
            elif self._busy_since is not None:
                self._idle_since = self._idle_since or now
            self._state = status.state
            self._changed.notify_all()

    def refused(self, refusal: CommandRefused) -> None:
        """It was not accepted."""
        with self._changed:
            self.refusal = refusal
            self._changed.notify_all()
        self.finish(Outcome.ABORTED, str(refusal))  # which tells others, who may look at it

    def replaced(self, name: str) -> None:
        """Another command of this client took its place."""
        with self._changed:
            self.finish(Outcome.PREEMPTED, f"by {name}")
            self._changed.notify_all()

    # ------------------------------------------------------------------------------ for the client

    @property
    def has_ended(self) -> bool:
        """Whether its fate is known."""
        return self._ended.is_set()

    def confirm(self) -> None:
        """Wait until it is accepted, or until there is no sign of it for `ACCEPT_TIMEOUT`.

        Raises:
            CommandRefused: it was refused.
        """
        with self._changed:
            while self.refusal is None:
                left = self._unconfirmed(time.monotonic())
                if left <= 0.0:
                    break
                self._changed.wait(left)
            self.accepted = True
            if self.refusal is not None:
                if not self._was_busy:
                    self._changed.wait_for(lambda: self._idle_since is not None, PULSE_TIME)
                raise self.refusal

    def _unconfirmed(self, now: float) -> float:
        """Return the seconds for which it is still open whether it was accepted."""
        if self._busy_since is None:
            return self._sent + ACCEPT_TIMEOUT - now
        if self._idle_since is None:
            repeated = (
                self._refusal_time == REPEATED_REFUSAL_TIME and self._busy_since == self._sent
            )
            enough = self._refusal_time if repeated else self._accept_time
            return self._busy_since + enough - now
        if self._at_goal():
            return 0.0
        return self._idle_since + self._refusal_time - now

    def _judge(self) -> None:
        if self._ended.is_set() or self.refusal is not None:
            return
        now = time.monotonic()
        idle = 0.0 if self._idle_since is None else now - self._idle_since
        if self._state not in (None, OperatingState.ENABLED):
            if self._busy_since is not None and self._idle_since is None:
                return  # it waits for the state command that is carried out
            told = self.accepted and now - self._sent > ACCEPT_TIME
            if told or idle > self._refusal_time:
                self.finish(Outcome.ABORTED, f"the device is {self._state}")
            return
        if self._idle_since is None:
            return
        told_at = self._told_at()  # first: what comes between the two is judged by the next look
        arrived = self._at_goal()
        is_told = told_at - self._idle_since > SETTLE_TIME or idle > UNTOLD
        if arrived is False and idle > SETTLE_TIME and is_told:
            self.finish(Outcome.ABORTED, "it stopped away from its goal")
        elif arrived or (
            arrived is None and is_told and (self._was_long or idle > self._refusal_time)
        ):
            self.finish(Outcome.REACHED)

    @property
    def _was_long(self) -> bool:
        """Whether busy lasted too long to be the pulse of a refused move."""
        if self._busy_since is None or self._idle_since is None:
            return False
        return self._idle_since - self._busy_since > self._accept_time

    @override
    def is_busy(self) -> bool:
        """Whether it has not ended yet."""
        with self._changed:
            self._judge()
            return not self._ended.is_set()

    @override
    def wait(self, timeout: float | None = None, is_busy: bool = False) -> bool:
        """Wait until the move has ended, or with `is_busy` until it has started.

        Args:
            timeout: in seconds; None waits as long as the device moves and is heard.
            is_busy: wait for the start instead.

        Returns:
            True when the goal is reached (or the move has started), False when the time is over.

        Raises:
            CommandRefused: it was refused after all.
            MotionAborted: it was stopped, pre-empted by another command, or failed.
            ConnectionLost: nothing is heard of the device any more.
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        with self._changed:
            while not self._over(is_busy):
                now = time.monotonic()
                if deadline is not None and now >= deadline:
                    return False
                lost = self._lost()
                if lost:
                    raise ConnectionLost(
                        f"{self.name}: {lost}",
                        remedy="The device may still be moving: see what it does.",
                    )
                if deadline is None and self._busy_since is None:
                    self._give_up_unstarted(now)
                self._changed.wait(
                    LOOK_PERIOD if deadline is None else min(LOOK_PERIOD, deadline - now)
                )
        if self.refusal is not None:
            raise self.refusal
        return super().wait(0.0, is_busy)

    def _over(self, is_busy: bool) -> bool:
        if is_busy and self.refusal is None and self._busy_since is not None:
            return True
        self._judge()
        return self._ended.is_set()

    def _give_up_unstarted(self, now: float) -> None:
        if now - self._sent > START_TIMEOUT:
            raise MotionAborted(
                f"{self.name} was sent {START_TIMEOUT:g} s ago, and the device was never busy",
                remedy="Is it ENABLED, and does it accept this command?",
            )
