"""The process that runs the client for MATLAB: ``python -m crtk_drivers.client.matlab.server``.

Requests come on standard input, answers go to standard output: JSON, one a line, in turn.

    {"do": "get", "device": 2, "name": "measured_js"}    a request of `Session`
    {"value": ...}                                       its answer
    {"error": {"identifier": "crtk:Refused", "message": "..."}}
    {"pending": 7}                                       not yet: {"do": "poll", "pending": 7}, until it is

So MATLAB never waits longer than `PATIENCE` in one call, and Ctrl-C works there. What was interrupted is not
asked for again, and the next request, of a timer too, begins while it still waits: each has its own answer.
At the end of the input it leaves ROS.
"""

from __future__ import annotations

import json
import logging
import os
import signal
import sys
import threading
from typing import Any

from typing_extensions import override

from crtk_drivers.client.matlab.objects import Session, described
from crtk_drivers.errors import ConfigError, CrtkError

logger = logging.getLogger(__name__)

PATIENCE = 0.1
"""Seconds after which an answer is put off."""
KEPT = 100
"""Answers that are kept for whoever may still ask."""


class _Job(threading.Thread):
    def __init__(self, session: Session, request: dict[str, Any]) -> None:
        super().__init__(name="crtk request", daemon=True)
        self._session = session
        self._request = request
        self.answer: dict[str, Any] = {}

    @override
    def run(self) -> None:
        try:
            self.answer = {"value": self._session.perform(**self._request)}
        except Exception as error:
            if not isinstance(error, (CrtkError, AttributeError)):
                logger.exception("request %s", self._request)
            self.answer = {"error": described(error)}


class Server:
    """Answers requests, one after the other."""

    def __init__(self) -> None:
        self._session = Session()
        self._jobs: dict[int, _Job] = {}
        self._number = 0

    def answer(self, line: str) -> str:
        """Return the answer to a request."""
        request = json.loads(line)
        if request["do"] == "poll":
            number = request["pending"]
        else:
            number = self._number = self._number + 1
            self._forget()
            self._jobs[number] = _Job(self._session, request)
            self._jobs[number].start()
        job = self._jobs.get(number)
        if job is None:
            return json.dumps({"error": described(ConfigError(f"no request {number} is pending"))})
        job.join(PATIENCE)
        if job.is_alive():
            return json.dumps({"pending": number})
        del self._jobs[number]
        return json.dumps(job.answer)

    def _forget(self) -> None:
        """Forget the oldest of those that have ended, and that nobody asks about: they were interrupted."""
        over = [number for number, job in self._jobs.items() if not job.is_alive()]
        for number in over[: max(0, len(self._jobs) - KEPT + 1)]:
            del self._jobs[number]

    def close(self) -> None:
        """Leave ROS."""
        self._session.close()


def main() -> None:
    """Serve until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C interrupts MATLAB's call, not the client
    with os.fdopen(os.dup(1), "w") as answers:
        os.dup2(2, 1)  # whatever else is printed must not look like an answer
        server = Server()
        try:
            for line in sys.stdin:
                answers.write(f"{server.answer(line)}\n")
                answers.flush()
        finally:
            server.close()


if __name__ == "__main__":
    main()
