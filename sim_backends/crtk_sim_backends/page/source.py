"""Where the server of a page has it from: a simulator's control socket, or a pipe to another process.

Over the pipe goes a number and ``scene`` or ``live`` as a request, and JSON as the answer: that number, and
what was asked for under ``shown``, or why there is none under ``error``.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from typing import Any, Final, Protocol

from crtk_sim_backends.control import ControlClient, ControlError, ControlRefused, token
from crtk_sim_backends.watching import ANSWER_TIMEOUT, Found, pictures

SCENE: Final = "scene"
"""Request for what does not change."""
LIVE: Final = "live"
"""Request for what does."""


class Source(Protocol):
    """What a page shows. Used by a thread for each browser."""

    @property
    def secret(self) -> str | None:
        """The token without which nothing is changed; None where nothing can be."""

    def scene(self) -> Found:
        """What does not change.

        Raises:
            ControlError: there is no answer.
        """

    def pictures(self, period: float, wait: Callable[[float], bool]) -> Iterator[Found | None]:
        """Yield what changes, every `period` s until `wait` says so; None while there is no answer.

        Raises:
            ControlError: there is nobody any more, or the request is refused.
        """

    def change(self, request: str, arguments: dict[str, Any]) -> None:
        """Let a fault begin, or end.

        Raises:
            ControlError: it is refused, or there is no answer.
        """


class SimulatorSource:
    """A simulator, by host and port of its control socket."""

    def __init__(self, control: tuple[str, int]) -> None:
        self._control = control
        self.secret: str | None = token()

    def scene(self) -> Found:
        """See `Source`."""
        with ControlClient(*self._control) as control:
            found: Found = control.call(SCENE)
        return found | {"detail": f"simulated, {found['detail']}"}

    def pictures(self, period: float, wait: Callable[[float], bool]) -> Iterator[Found | None]:
        """See `Source`."""
        for _, live in pictures(self._control, (SCENE, LIVE), period, wait):
            yield live

    def change(self, request: str, arguments: dict[str, Any]) -> None:
        """See `Source`."""
        with ControlClient(*self._control) as control:
            control.call(request, **arguments)


class PipeSource:
    """What another process shows; however many browsers look, it is asked once in a period.

    Args:
        pipe: to the process, which ends with it.
    """

    secret = None

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._lock = threading.Lock()
        self._number = 0
        self._taken = -1e9  # monotonic s
        self._latest: Found | None = None

    def scene(self) -> Found:
        """See `Source`."""
        with self._lock:
            found = self._ask(SCENE)
        if found is None:
            raise ControlError(f"no answer in {ANSWER_TIMEOUT:g} s: the process hangs")
        return found

    def pictures(self, period: float, wait: Callable[[float], bool]) -> Iterator[Found | None]:
        """See `Source`."""
        while True:
            with self._lock:
                if time.monotonic() - self._taken >= period:
                    self._taken = time.monotonic()
                    self._latest = self._ask(LIVE)
                picture = self._latest
            yield picture
            if wait(period):
                return

    def change(self, request: str, arguments: dict[str, Any]) -> None:
        """See `Source`."""
        raise ControlRefused("this page only looks")

    def _ask(self, what: str) -> Found | None:
        """Return the answer, None if there is none in time; one that comes too late is left out."""
        self._number += 1
        deadline = time.monotonic() + ANSWER_TIMEOUT
        try:
            self._pipe.send_bytes(f"{self._number} {what}".encode())
            while self._pipe.poll(max(0.0, deadline - time.monotonic())):
                answer = json.loads(self._pipe.recv_bytes())
                if answer["number"] == self._number:
                    break
            else:
                return None
        except (EOFError, OSError) as error:
            raise ControlError("the process that is shown has ended") from error
        if "error" in answer:
            raise ControlRefused(answer["error"])
        found: Found = answer["shown"]
        return found
