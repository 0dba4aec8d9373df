"""Where the server of a page has it from: a simulator's control socket, or a pipe to another process.

Over the pipe goes a number, what is asked for (``scene``, ``live``) and its arguments as JSON, and JSON as
the answer: that number, and what was asked for under ``shown``, or why there is none under ``error``.
"""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from multiprocessing.connection import Connection
from typing import Any, Final, Protocol

from crtk_sim_backends.control import ControlClient, ControlError, ControlRefused, token
from crtk_sim_backends.watching import ANSWER_TIMEOUT, Found, pictures

PERIOD: Final = 1 / 30
"""Seconds from one picture to the next."""
HANGS: Final = 5.0
"""Seconds after which a process hangs that does not do what it is asked to: its machine may be busy. Pictures
are waited for less long, and told to be missing."""
SCENE: Final = "scene"
"""Request for what does not change."""
LIVE: Final = "live"
"""Request for what does."""
SECRET: Final = "secret"
"""Request for the token without which nothing is commanded; null where nothing can be."""
COMMAND: Final = "command"
"""Request to do something, with the number of the browser, and an answer in words; empty: it is done."""
WATCH: Final = "watch"
"""Request to show a value of a device from now on; whether it is."""

Answer = Callable[..., Any]
"""What answers a request, with its arguments; its result is plain data."""


def json_of(value: Any) -> bytes:
    """Return JSON that every browser reads: what is not finite, as a fault may have it, is null."""
    try:
        return json.dumps(value, allow_nan=False).encode()
    except ValueError:
        return json.dumps(_finite(value)).encode()


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {name: _finite(each) for name, each in value.items()}
    return [_finite(each) for each in value] if isinstance(value, list) else value


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
        is_commanded: whether it may be asked for its token, and commanded.
    """

    def __init__(self, pipe: Connection, is_commanded: bool = False) -> None:
        self._pipe = pipe
        self._is_commanded = is_commanded
        self._lock = threading.Lock()
        self._number = 0
        self._taken = -1e9  # monotonic s
        self._latest: Found | None = None

    @property
    def secret(self) -> str | None:
        """See `Source`."""
        return self._answered(SECRET) if self._is_commanded else None

    def scene(self) -> Found:
        """See `Source`."""
        found: Found = self._answered(SCENE)
        return found

    def picture(self, period: float) -> Found | None:
        """Return what changes, at most `period` s old; None if there is no answer."""
        with self._lock:
            if time.monotonic() - self._taken >= period:
                self._taken = time.monotonic()
                self._latest = self._ask(LIVE)
            return self._latest

    def pictures(self, period: float, wait: Callable[[float], bool]) -> Iterator[Found | None]:
        """See `Source`."""
        while True:
            yield self.picture(period)
            if wait(period):
                return

    def change(self, request: str, arguments: dict[str, Any]) -> None:
        """See `Source`."""
        raise ControlRefused("this page only looks")

    def command(self, browser: int, arguments: Mapping[str, Any]) -> str:
        """Have something done for a browser; return why it is not, empty if it is.

        Raises:
            ControlError: there is no answer.
        """
        return str(self._answered(COMMAND, browser=browser, arguments=arguments))

    def watch(self, device: str, value: str) -> None:
        """Have a value of a device shown from now on, if there is such a one."""
        self._answered(WATCH, namespace=device, name=value)

    def _answered(self, what: str, **arguments: Any) -> Any:
        with self._lock:
            found = self._ask(what, HANGS, **arguments)
        if found is None and what != SECRET:
            raise ControlError(f"no answer in {HANGS:g} s: the process hangs")
        return found

    def _ask(self, what: str, timeout: float = ANSWER_TIMEOUT, **arguments: Any) -> Any:
        """Return the answer, None if there is none in time; one that comes too late is left out."""
        self._number += 1
        deadline = time.monotonic() + timeout
        try:
            self._pipe.send_bytes(f"{self._number} {what} {json.dumps(arguments)}".encode())
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
        return answer["shown"]
