"""Which connection moves which device: to the device all of them are one client.

It is as between clients of a device (`crtk_drivers.motion.arbiter`): a stream has an owner until it has been
silent, a move until it has ended; who goes on sending after somebody else's `hold` is refused until it has
been silent; and what a connection has begun ends with it.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any, Final

from crtk_drivers.commands import Command
from crtk_drivers.errors import CommandRefused, Reason

SILENCE: Final = 0.5
"""Seconds after which a stream has ended; the device itself ends it sooner."""


class Ownership:
    """Who moves one device. Thread-safe.

    Args:
        where: the device, for messages.
        clock: monotonic seconds.
    """

    def __init__(self, where: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._where = where
        self._clock = clock
        self._lock = threading.Lock()
        self._owner: object | None = None
        self._until = -math.inf
        self._move: Any = None
        self._held = self._has_begun = False
        self._before: tuple[Any, ...] = self._state

    @property
    def _state(self) -> tuple[Any, ...]:
        return self._owner, self._until, self._move, self._held, self._has_begun

    def claim(self, owner: object, command: Command) -> None:
        """Let an owner begin or go on.

        Raises:
            CommandRefused: another one moves the device, or somebody has stopped it.
        """
        with self._lock:
            now = self._clock()
            if self._is_live(now):
                if owner is not self._owner:
                    raise CommandRefused(
                        command.name,
                        Reason.STREAM_OWNED,
                        "another connection moves it",
                        where=self._where,
                        remedy="Wait until that has ended, or send hold.",
                    )
                if self._held:
                    self._until = now + SILENCE
                    raise CommandRefused(
                        command.name,
                        Reason.STREAM_ENDED,
                        "another connection has sent hold",
                        where=self._where,
                        remedy=f"Be silent for {SILENCE:g} s, and begin again.",
                    )
            self._before = self._state
            if owner is not self._owner:
                self._has_begun = False
            self._owner, self._held, self._move = owner, False, None
            # What does not end by itself, free drive, goes on until something else is asked for.
            self._until = now + SILENCE if command.is_motion else math.inf

    def began(self, owner: object, move: Any) -> None:
        """What an owner has asked for was accepted; `move` is the handle of a move, None of all else."""
        with self._lock:
            if self._owner is owner:
                self._move, self._has_begun = move, True

    def refused(self, owner: object, move: Any = None) -> None:
        """It was not accepted: what it had begun before goes on, or else what somebody else has.

        Args:
            owner: who asked for it.
            move: its handle, if it was refused later; another one may have taken its place.
        """
        with self._lock:
            if self._owner is not owner or self._held:  # somebody has stopped it meanwhile
                return
            if move is not None and self._move is not move:
                return
            if self._before[0] is owner:
                self._owner, self._until, self._move, self._held, self._has_begun = self._before
            else:
                self._forget()

    def hold(self, by: object) -> None:
        """Somebody has stopped the device."""
        with self._lock:
            self._move = None
            if by is self._owner or not self._is_live(self._clock()):
                self._forget()
            else:
                self._held, self._until = True, self._clock() + SILENCE

    def leave(self, owner: object) -> bool:
        """An owner is gone; return whether it has left the device in motion."""
        with self._lock:
            if owner is not self._owner:
                return False
            was_live = self._has_begun and not self._held and self._is_live(self._clock())
            self._forget()
            return was_live

    def _is_live(self, now: float) -> bool:
        return self._owner is not None and (
            now < self._until or (self._move is not None and self._move.is_busy())
        )

    def _forget(self) -> None:
        self._owner, self._until, self._move = None, -math.inf, None
        self._held = self._has_begun = False
