"""What MATLAB calls: one function, text in and text out. The MATLAB side is ``matlab/+crtk``.

    MATLAB  --py.-->  call()  --pipe-->  crtk_drivers.client.matlab.server  --ROS 2-->  device

The client runs in a process of its own, because MATLAB loads its own C++ library, which may be older than the
one that ROS 2 was built with, and because nothing says that Python threads, in which ROS 2 spins, run on
while MATLAB is not in a call.

A request and its answer are one line of JSON each; `server` has the list of requests.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import selectors
import subprocess
import threading
import time

ANSWER_TIMEOUT = 30.0
"""Seconds in which the process must answer; it does so in a fraction of one, once it runs."""
END_TIMEOUT = 10.0
"""Seconds in which the process must end when it is told to."""

SERVER = "crtk_drivers.client.matlab.server"

_LIBRARY_PATHS = ("LD_LIBRARY_PATH", "LD_PRELOAD")
_MATLABS_OWN = "/glnxa64"
"""Part of every folder with libraries of MATLAB for Linux."""


class Client:
    """The process that runs the client.

    Args:
        python: the interpreter that runs it.
    """

    def __init__(self, python: str) -> None:
        self._process = subprocess.Popen(
            [python, "-P", "-m", SERVER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment(),
            start_new_session=True,  # Ctrl-C in MATLAB's terminal is not for it
        )
        self._rest = b""

    @property
    def runs(self) -> bool:
        """Whether the process has not ended."""
        return self._process.poll() is None

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid

    def ask(self, request: str) -> str:
        """Return the answer to a request.

        Raises:
            OSError: the process has ended.
            TimeoutError: it does not answer.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(request.encode() + b"\n")
        self._process.stdin.flush()
        deadline = time.monotonic() + ANSWER_TIMEOUT
        with selectors.DefaultSelector() as selector:
            selector.register(self._process.stdout, selectors.EVENT_READ)
            while b"\n" not in self._rest:
                if not selector.select(max(0.0, deadline - time.monotonic())):
                    raise TimeoutError(f"it gave no answer within {ANSWER_TIMEOUT:g} s")
                piece = os.read(self._process.stdout.fileno(), 1 << 16)
                if not piece:
                    raise BrokenPipeError("it has ended")
                self._rest += piece
        answer, _, self._rest = self._rest.partition(b"\n")
        return answer.decode()

    def close(self) -> None:
        """Let the process leave ROS and end. May be called twice."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):  # it has ended before it had read everything
            self._process.stdin.close()
        try:
            self._process.wait(END_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()


def environment() -> dict[str, str]:
    """Return this process's environment without the libraries that MATLAB brings for itself."""
    variables = dict(os.environ)
    for name in _LIBRARY_PATHS:
        paths = variables.pop(name, "").split(":")
        kept = [path for path in paths if path and _MATLABS_OWN not in path]
        if kept:
            variables[name] = ":".join(kept)
    return variables


_lock = threading.Lock()
_client: Client | None = None


def call(request: str, python: str) -> str:
    """Pass a request on to the client, and return its answer. Never raises.

    Args:
        request: JSON, one line.
        python: the interpreter that runs the client, when it does not run yet.
    """
    global _client
    with _lock:
        try:
            if _client is None or not _client.runs:
                close()
                _client = Client(python)
            return _client.ask(request)
        except (OSError, ValueError) as error:
            close()
            return json.dumps(
                {
                    "error": {
                        "identifier": "crtk:ConnectionLost",
                        "message": f"the process that runs the client ({python} -m {SERVER}): "
                        f"{error}. What it printed is on the terminal. Make crtk.ral and crtk.utils "
                        "anew; everything made before is gone.",
                    }
                }
            )


def close() -> None:
    """End the process, if it runs."""
    global _client
    if _client is not None:
        _client.close()
        _client = None


atexit.register(close)
