"""Programs that watch a running simulator from a process of their own, over its control socket."""

from __future__ import annotations

import select
import time
from collections.abc import Callable, Iterator
from typing import Any, Final

from crtk_sim_backends.control import ControlClient, ControlError, ControlRefused

ANSWER_TIMEOUT: Final = 1.0
"""Seconds after which a simulator that does not answer is told to hang."""

NICENESS: Final = 5
"""Of such programs: the simulator comes first."""

_POLL: Final = 0.1  # s after which a signal is noticed

Found = dict[str, Any]


def address(text: str) -> tuple[str, int]:
    """Return host and port of ``host:port``.

    Raises:
        ValueError: it is none.
    """
    host, colon, port = text.rpartition(":")
    if not (host and colon):
        raise ValueError(f"expected HOST:PORT, not {text!r}")
    return host, int(port)


def pictures(
    control: tuple[str, int],
    requests: tuple[str, str],
    period: float,
    wait: Callable[[float], bool],
) -> Iterator[tuple[Found, Found | None]]:
    """Yield what does not change, and what does: None while the simulator does not answer.

    Args:
        control: host and port of the control socket.
        requests: that are answered with what does not change, and with what does.
        period: s from one picture to the next.
        wait: waits for a time, s; True when that was the last one.

    Raises:
        ControlError: there is no simulator any more, or it refuses a request.
    """
    once, each_time = requests
    fixed: Found | None = None
    while True:
        with ControlClient(*control, timeout=ANSWER_TIMEOUT) as client:
            try:
                fixed = client.call(once)
                while True:
                    yield fixed, client.call(each_time)
                    if wait(period):
                        return
            except ControlRefused:
                raise
            except ControlError:  # it hangs, or has ended: the next connection tells which
                if fixed is not None:
                    yield fixed, None
        if wait(period):
            return


class Life:
    """When such a program has to end: asked by a signal, or as the process that started it has died."""

    def __init__(self, parent_fd: int | None) -> None:
        self._fds = [] if parent_fd is None else [parent_fd]
        self.over = False

    def end(self) -> None:
        """Ask it to end; from any thread or signal handler."""
        self.over = True

    def wait(self, seconds: float) -> bool:
        """Wait for a time, s; True as soon as the program has to end."""
        end = time.monotonic() + seconds
        while not self.over:
            left = max(0.0, end - time.monotonic())
            if select.select(self._fds, (), (), min(left, _POLL))[0]:
                self.over = True
            if left <= _POLL:
                break
        return self.over
