"""Frames while a tracker tracks: asked for when one is due, told once, and stamped with when it was taken."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from crtk_driver_ndi.codec import Reply
from crtk_driver_ndi.frames import PARSERS, Frame, Parsers
from crtk_drivers.kit.clock_fit import ClockFit, WallClock
from crtk_drivers.samples import Stamp

__all__ = ["FrameStream"]

EARLY: Final = 0.05
"""Share of the period by which the next frame is asked for before it is due, by the stamp of this one."""
PROBE: Final = 0.5
PROBED: Final = 8
"""The same for every so many-th: when a frame is there at the earliest shows only who asks before."""
STEP: Final = 0.02
"""Share of the period from one question to the next while it is not there."""

SLOW: Final = 0.25
"""Share of the period by which a reply may take longer than the fastest one: else its question may have."""

SET: Final = 1.0
"""Seconds by which the tracker's own clock and ours differ from frame to frame only when one is set."""

SHORTEST: Final = 1e-3
LONGEST: Final = 0.2
"""Seconds from one frame to the next that are believed."""

APART: Final = 1e-4
"""Seconds between the stamps of two frames at least: a line that moves back would give them one."""


class FrameStream:
    """The frames of one tracker, from one start of tracking on.

    Args:
        rate: of the tracker, in Hz, as far as it is known.
        kind: how frames are asked for, see `crtk_driver_ndi.frames.PARSERS`.
        parsers: these, or those that ask for stray markers too.
        step: by how much frame numbers rise from frame to frame; 0: by the least that was seen.

    Attributes:
        kind: as given.
        newest: the newest frame; None before the first.
        stamp: when it was taken.
        frames, repeated, lost: frames told, replies without a new one, and frames that were never seen.
        reply_time: seconds from the last question to its reply.
    """

    def __init__(self, rate: float, kind: str, parsers: Parsers = PARSERS, step: int = 0) -> None:
        self.kind = kind
        self.question, self._parse = parsers[kind]
        self.newest: Frame | None = None
        self.stamp = Stamp(0, 0.0)
        self.frames = self.repeated = self.lost = 0
        self.reply_time = 0.0
        self._step = step
        self._period = max(1, step) / rate
        self._clock = ClockFit()
        self._wall = WallClock()
        self._due = 0.0
        self._least = math.inf
        self._asked = 0.0

    @property
    def due(self) -> float:
        """Monotonic seconds at which to ask next."""
        return self._due

    def take(self, reply: Reply, asked: float, arrival: float) -> bool:
        """Take a reply; return whether it has a new frame.

        Its time is found by when it was asked for, not by when the reply came: a link may hold replies back,
        all by the same time too. The tracker answers with its newest frame after it was asked, and those that
        are asked for as soon as they are there show when that is.

        Args:
            reply: the reply.
            asked: monotonic seconds at which its question was sent.
            arrival: monotonic seconds at which the reply came.

        Raises:
            ValueError: it is no frame.
        """
        frame = self._parse(reply)
        self.reply_time = arrival - asked
        if self._least == math.inf and self.reply_time > self._period:
            # Nobody knows when a first frame was taken that took so long. The next one is compared with it.
            self._least, self._due = self.reply_time, arrival
            return False
        before = self.newest.number if self.newest is not None else -1
        if frame.number < 0 or frame.number == before:
            self.repeated += 1
            self._due = arrival + STEP * self._period
            return False
        # Another client has started tracking anew, or somebody has set the tracker's clock.
        if frame.number < before or self._was_set(frame, asked):
            self._clock.reset()
        elif self.newest is not None:
            risen = frame.number - before
            self._step = min(self._step or risen, risen)
            self.lost += risen // self._step - 1
            self._learn_period(self.newest, frame)
        self._asked = asked
        taken = self._taken(frame, asked, arrival)
        stamp = max(taken, self.stamp.monotonic + APART)
        self.stamp = Stamp(round(stamp * 1e9) + self._wall.offset(), stamp)
        self.newest = frame
        self.frames += 1
        early = EARLY if self.frames % PROBED else PROBE
        self._due = taken + (1.0 - early) * self._period
        return True

    def _taken(self, frame: Frame, asked: float, arrival: float) -> float:
        """Return when a frame was taken; where its question may have been held back, by those before."""
        ticks = frame.nanoseconds or frame.number
        least = self._least = min(self._least, self.reply_time)
        if self.reply_time > least + SLOW * self._period:
            known = self._clock.time_of(ticks)
            return min(self._after_the_last(frame, asked) if known is None else known, arrival)
        (taken,) = self._clock.stamp(np.array([ticks]), np.array([asked])).tolist()
        return float(taken)

    def _after_the_last(self, frame: Frame, asked: float) -> float:
        """Return when a frame was taken by the one before, while the tracker's clock is not known yet."""
        before = self.newest
        if before is None or frame.number < before.number:
            return asked
        passed = 1e-9 * (frame.nanoseconds - before.nanoseconds)
        if not frame.nanoseconds:
            passed = (frame.number - before.number) / max(1, self._step) * self._period
        return max(asked, self.stamp.monotonic + passed)

    def _was_set(self, frame: Frame, asked: float) -> bool:
        """Whether somebody has set the tracker's own clock since the frame before."""
        before = self.newest
        if before is None or not before.nanoseconds:
            return False
        passed = 1e-9 * (frame.nanoseconds - before.nanoseconds)
        return abs(passed - (asked - self._asked)) > SET

    def _learn_period(self, before: Frame, frame: Frame) -> None:
        """The tracker may be slower than its family: by its settings, or its exposure."""
        passed = frame.nanoseconds - before.nanoseconds
        if before.nanoseconds and passed > 0:
            period = passed * 1e-9 * self._step / (frame.number - before.number)
            self._period = min(max(period, SHORTEST), LONGEST)
        elif self._clock.tick_rate and not frame.nanoseconds:
            self._period = min(max(self._step / self._clock.tick_rate, SHORTEST), LONGEST)

    @property
    def counters(self) -> Mapping[str, float]:
        """For diagnostics."""
        p50, p99, most = self._clock.jitter
        return {
            "frames": float(self.frames),
            "repeated": float(self.repeated),
            "lost": float(self.lost),
            "frame_rate": 1.0 / self._period if self._clock.locked else 0.0,
            "clock_locked": float(self._clock.locked),
            "reply_time": self.reply_time,
            "jitter_p50": p50,
            "jitter_p99": p99,
            "jitter_max": most,
        }
