"""The operating state as it is announced, and those who want to be told.

Everything that observers hear comes from here, under one lock, so that they hear it in one order.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Final

from crtk_drivers.errors import CommandRefused, with_remedy, without_name
from crtk_drivers.samples import Stamp
from crtk_drivers.state import OperatingState, Status
from crtk_drivers.status.health import HealthRecorder
from crtk_drivers.status.throttle import Throttle, kind_of

logger = logging.getLogger(__name__)

WARNING_INTERVAL: Final = 2.0
"""Seconds in which one warning of a kind is told: a stream at a limit warns in each cycle."""


class Observer:
    """What a front wants to be told. Called from any thread, in order; must return at once.

    It is called under the lock of the board, and must not command the engine; what it logs, it logs
    afterwards (`BoardLock.afterwards`).
    """

    def status_changed(self, status: Status, stamp: Stamp) -> None:
        """The operating state was announced; stamps increase strictly."""

    def command_refused(self, refusal: CommandRefused) -> None:
        """A command was refused; it has been counted."""

    def latched(self, name: str) -> None:
        """What is told once, ``goal_*`` or ``trajectory_j/ratio``, has a new value."""

    def warned(self, text: str) -> None:
        """Something was corrected or is about to go wrong. One of a kind in `WARNING_INTERVAL`."""


class BoardLock:
    """A lock that its thread may take again, and what is to be done once it is released for good."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._depth = 0
        self._afterwards: list[Callable[[], object]] = []

    def acquire(self, timeout: float = -1.0) -> bool:
        """Take it; return whether that was so within `timeout` seconds, -1: for ever."""
        is_taken = self._lock.acquire(timeout=timeout)
        if is_taken:  # whoever has it not must not write
            self._depth += 1
        return is_taken

    def release(self) -> None:
        """Leave it; for good, do what was put off."""
        due: list[Callable[[], object]] = []
        self._depth -= 1
        if not self._depth:
            due, self._afterwards = self._afterwards, due
        self._lock.release()
        for call in due:
            call()

    def afterwards(self, call: Callable[[], object]) -> None:
        """Do what may take its time, as a log does, once nobody waits for it; at once if it is free."""
        with self:
            self._afterwards.append(call)

    def __enter__(self) -> None:
        self.acquire()

    def __exit__(self, *error: object) -> None:
        self.release()


class StatusBoard:
    """Holds the status of one device and tells its observers. Thread-safe.

    Nothing of the device is ever called under `lock`, nor is anything logged: whoever waits for it, waits for
    microseconds.

    Args:
        status: before anything happened.
        where: the device, for messages.
        health: counts refusals, and warnings that are not told.
        clock: monotonic seconds.

    Attributes:
        status: as announced last.
        lock: under which it changes.
        move_waits: a move waits to begin; the device is busy until it has ended.
    """

    def __init__(
        self, status: Status, where: str, health: HealthRecorder, clock: Callable[[], float]
    ) -> None:
        self.status = status
        self.lock = BoardLock()
        self.move_waits = False
        self._is_busy = status.is_busy
        self._lent = False
        self._where = where
        self._health = health
        self._observers: list[Observer] = []
        self._last_stamp_ns = 0
        self._clock = clock
        self._warnings = Throttle(WARNING_INTERVAL)

    def add(self, observer: Observer) -> None:
        """Tell `observer` from now on."""
        with self.lock:
            self._observers.append(observer)

    def remove(self, observer: Observer) -> None:
        """Tell `observer` no more."""
        with self.lock:
            self._observers.remove(observer)

    def update(
        self,
        state: OperatingState | None = None,
        detail: str | None = None,
        *,
        remedy: str = "",
        homed: bool | None = None,
        busy: bool | None = None,
    ) -> None:
        """Change what is given, and announce it if that is a change. A new state drops the old detail.

        `remedy` is what to do about `detail`, which is told together with it. The first state that is given
        ends `Status.connecting`.
        """
        with self.lock:
            old = self.status
            if state not in (None, old.state) and detail is None:
                detail = ""
            if detail is not None:
                detail = with_remedy(without_name(detail, self._where), remedy)
            if detail in (None, old.detail):
                detail, remedy = old.detail, old.remedy
            self._is_busy = self._is_busy if busy is None else busy
            new = replace(
                old,
                state=old.state if state is None else state,
                detail=detail,
                remedy=remedy,
                is_homed=old.is_homed if homed is None else homed,
                is_busy=self._is_busy or self._lent or self.move_waits,
                connecting=old.connecting and state is None,
            )
            if new == old:
                return
            if new.state is OperatingState.FAULT and new.detail != old.detail:
                self._log(logging.ERROR, "%s: FAULT: %s", self._where, new.detail)
            self.status = new
            self.announce()

    def lend(self, busy: bool) -> None:
        """Be busy as well while something is that has no operating state of its own."""
        with self.lock:
            self._lent = busy
            self.update()

    def announce(self) -> None:
        """Tell the status as it is, also if it did not change: every state command has an answer."""
        with self.lock:
            now = Stamp.now()
            self._last_stamp_ns = max(now.wall_ns, self._last_stamp_ns + 1)
            stamp = Stamp(self._last_stamp_ns, now.monotonic)
            status = self.status
            self._tell(lambda observer: observer.status_changed(status, stamp))

    def refused(self, refusal: CommandRefused) -> None:
        """Count and tell a refusal.

        Busy rises and falls also for a move that is refused: clients wait for both.
        """
        self._health.refused(refusal)
        with self.lock:
            self._tell(lambda observer: observer.command_refused(refusal))
            is_move = refusal.command.rpartition("/")[2].startswith("move_")
            if is_move and not self.status.is_busy:
                self.update(busy=True)
                self.update(busy=False)

    def latched(self, name: str) -> None:
        """Tell that ``goal_*`` or a setting has a new value."""
        with self.lock:
            self._tell(lambda observer: observer.latched(name))

    def warned(self, text: str) -> None:
        """Tell a warning, unless one of its kind was told of late: then it is counted."""
        text = without_name(text, self._where)
        kind = kind_of(text)
        with self.lock:
            if not self._warnings.passes(kind, self._clock()):
                self._health.warnings_left_out += 1
                return
            left_out = self._warnings.left_out(kind)
            told = f"{text} ({left_out} more of these were not told)" if left_out else text
            self._log(logging.DEBUG, "%s: %s", self._where, told)
            self._tell(lambda observer: observer.warned(told))

    def _tell(self, call: Callable[[Observer], None]) -> None:
        for observer in tuple(self._observers):
            try:
                call(observer)
            except Exception as error:
                told = "%s: an observer failed"
                self._log(logging.ERROR, told, self._where, exc_info=error)

    def _log(self, level: int, *told: object, exc_info: Exception | None = None) -> None:
        self.lock.afterwards(partial(logger.log, level, *told, exc_info=exc_info))
