"""The publishing thread: everything that this node sends, it sends from here.

A DDS writer can block for a third of a second (a stalled subscriber, Fast DDS's shared memory), so no
I/O thread and no callback publishes. The thread keeps its own absolute clock; executor timers are not
used. A job runs at its rate and whenever it is asked for.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue

from crtk_drivers.status.throttle import Throttle

logger = logging.getLogger(__name__)

FAILURE_INTERVAL = 2.0
"""Seconds between two log records of a job that keeps failing."""

FILL_IN_AFTER = 2.0
"""Periods after which a job that follows runs although it was not asked for."""

LONGEST_WAIT = 3600.0


class Job:
    """Something to be published again and again. Made by `PublishingThread.job`."""

    def __init__(self, name: str, run: Callable[[], None], wake: Callable[[], None]) -> None:
        self.name = name
        self.run = run
        self.due = math.inf
        self.wanted = False
        self.follows = False
        """It is asked for in step with the data: its own clock fills in only when nobody asks."""
        self._wake = wake
        self._period = math.inf

    def set_rate(self, rate: float) -> None:
        """Run `rate` times a second from now on; 0 means only when asked."""
        self._period = 1.0 / rate if rate > 0.0 else math.inf
        self.due = time.monotonic() + self._period
        self._wake()

    def ask(self) -> None:
        """Run it as soon as possible. Never waits; may be called from any thread."""
        if not self.wanted:
            self.wanted = True
            self._wake()

    def run_again(self, seconds: float) -> None:
        """Run it in so many seconds at the latest; the job itself says so."""
        self.due = min(self.due, time.monotonic() + seconds)

    def advance(self, now: float) -> None:
        """Set the next due time on the job's own grid; what was missed is skipped."""
        if self.follows and self.wanted:
            self.due = now + FILL_IN_AFTER * self._period
        elif self.due <= now:
            self.due += self._period * (1.0 + (now - self.due) // self._period)


class PublishingThread:
    """Runs jobs, one after the other. Not started by the constructor.

    Attributes:
        only: names of the jobs that run; those of others that are asked for wait. None: all run.
    """

    def __init__(self, name: str) -> None:
        self._jobs: list[Job] = []
        self._wakes: SimpleQueue[None] = SimpleQueue()
        self._failures = Throttle(FAILURE_INTERVAL)
        self._stopping = False
        self.only: frozenset[str] | None = None
        self._thread = threading.Thread(target=self._loop, name=name, daemon=True)

    def job(self, name: str, run: Callable[[], None], rate: float = 0.0) -> Job:
        """Add a job; before `start`."""
        job = Job(name, run, lambda: self._wakes.put(None))
        job.set_rate(rate)
        self._jobs.append(job)
        return job

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self, timeout: float) -> bool:
        """Run what was asked for, then end; return False if a writer still blocks after `timeout` seconds."""
        self._stopping = True
        self._wakes.put(None)
        if self._thread.is_alive():
            self._thread.join(timeout)
        return not self._thread.is_alive()

    def _loop(self) -> None:
        while not self._stopping:
            self._wait(min((job.due for job in self._jobs), default=math.inf))
            for job in self._jobs:
                now = time.monotonic()
                if job.wanted or job.due <= now:
                    job.advance(now)
                    if self._may_run(job):
                        job.wanted = False
                        self._run(job)
        for job in self._jobs:
            if job.wanted and self._may_run(job):
                self._run(job)

    def _may_run(self, job: Job) -> bool:
        return self.only is None or job.name in self.only

    def _wait(self, due: float) -> None:
        with suppress(Empty):
            self._wakes.get(timeout=min(max(0.0, due - time.monotonic()), LONGEST_WAIT))

    def _run(self, job: Job) -> None:
        self.attempt(job.name, job.run)

    def attempt(self, name: str, publish: Callable[[], None]) -> bool:
        """Publish something; return whether that went well, and tell now and then if not. In this thread."""
        try:
            publish()
        except Exception:
            if self._failures.passes(name, time.monotonic()):
                logger.exception("publishing %s failed; it will be tried again", name)
            return False
        return True
