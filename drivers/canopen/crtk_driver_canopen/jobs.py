"""What takes longer than a cycle: transfers with nodes, each node in a thread of its own."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable, Mapping

from crtk_drivers.device import Steps
from crtk_drivers.errors import CrtkError, DeviceError

logger = logging.getLogger(__name__)


class NodeJobs:
    """Runs a function for each of some nodes, beside the cycle. Belongs to the I/O thread.

    The functions use SDO, whose every wait has a time limit: so have they.

    Attributes:
        errors: of the jobs that were started last.
    """

    def __init__(self) -> None:
        self.errors: list[CrtkError] = []
        self._threads: list[threading.Thread] = []

    @property
    def running(self) -> bool:
        """Whether one of them has not ended."""
        return any(thread.is_alive() for thread in self._threads)

    def start(self, jobs: Mapping[int, Callable[[], object]]) -> None:
        """Run these, by node; none may be running."""
        errors: list[CrtkError] = []
        self.errors = errors

        def run(job: Callable[[], object]) -> None:
            try:
                job()
            except CrtkError as error:
                errors.append(error)
            except Exception as error:  # it must not pass for having been done
                logger.exception("unexpected error in a job of a node")
                errors.append(DeviceError(f"unexpected {type(error).__name__}: {error}"))

        self._threads = [
            threading.Thread(target=run, args=(job,), name=f"node {node}", daemon=True)
            for node, job in jobs.items()
        ]
        for thread in self._threads:
            thread.start()

    def until_over(self) -> Steps:
        """Wait for those that run, as a procedure."""
        while self.running:
            yield

    def join(self, deadline: float) -> None:
        """Wait for those that run, until a monotonic deadline."""
        for thread in self._threads:
            thread.join(max(0.0, deadline - time.monotonic()))


def one_by_one(writes: Iterable[Callable[[], object]]) -> None:
    """Do one after the other: the job of a node with several axes."""
    for write in writes:
        write()
