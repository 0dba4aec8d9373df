"""A process that runs worlds, seen by whoever asks it to."""

from __future__ import annotations

import json
import os
import re
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Self

from crtk_drivers.testing.world.hosts.forking import HANG_FILE, HANG_SIGNAL, folder_prefix

PATIENCE: Final = 180.0
"""s of real time within which a world must have ended."""
_DUMP_TAKES: Final = 5.0
"""s in which a world that hangs has written where."""
_FRAME: Final = re.compile(r'  File "(.*/)?(?P<file>.*)", line (?P<line>\d+) in (?P<name>.*)')
"""A line of what `faulthandler` writes: a thread after the other, the innermost call first."""
_END_OF_DUMP: Final = "_run_module_as_main\n"
"""The outermost call of the oldest thread, which comes last."""
_HIDDEN: Final = (
    *("kernel.py", "world.py", "world_host.py", "forking.py", "pytest_inside.py"),
    *("threading.py", "<frozen runpy>"),
)
_SHOWN: Final = 6
"""Calls of a thread that hangs, the innermost ones."""


class WorldError(RuntimeError):
    """A world could not be run: its file cannot be imported, or its process hangs or has died."""


class HostProcess:
    """A process that forks a child for each world, one after the other.

    Args:
        name: of what runs in its worlds, for errors.
        module: that is run.
        arguments: of it.
        environment: what it has besides this process's.
    """

    def __init__(
        self,
        name: str,
        module: str,
        arguments: Sequence[str],
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._name = name
        path = os.pathsep.join(each for each in sys.path if each)
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # it ends with its worlds, and Ctrl-C is for whoever asked for them
            env={**os.environ, "PYTHONHASHSEED": "0", "PYTHONPATH": path, **(environment or {})},
        )
        self._read = bytearray()

    def fileno(self) -> int:
        """Return what becomes readable when there is an answer."""
        assert self._process.stdout is not None
        return self._process.stdout.fileno()

    def send(self, request: dict[str, Any]) -> None:
        """Ask for something.

        Raises:
            WorldError: the process has ended.
        """
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            self._process.stdin.flush()
        except BrokenPipeError as error:
            raise WorldError(f"the process for {self._name} has ended") from error

    def receive(self, patience: float = PATIENCE) -> dict[str, Any]:
        """Return the answer to what was asked first.

        Args:
            patience: s of real time for which it is waited for.

        Raises:
            WorldError: it cannot be done, or is not done in time.
        """
        deadline = time.monotonic() + patience
        while b"\n" not in self._read:
            left = deadline - time.monotonic()
            if left <= 0.0 or not select.select([self], [], [], left)[0]:
                where = self.where_it_hangs()
                self.close()
                raise WorldError(
                    f"a world of {self._name} is not done in {patience:g} s of real time: it computes for "
                    f"ever, or it waits for the real system, past what is patched{where}"
                )
            piece = os.read(self.fileno(), 1 << 20)
            if not piece:
                raise WorldError(
                    f"the process for {self._name} has ended: most likely it cannot import a file; "
                    "standard error says why"
                )
            self._read += piece
        line, _, rest = bytes(self._read).partition(b"\n")
        self._read = bytearray(rest)
        found: dict[str, Any] = json.loads(line)
        if "error" in found:
            raise WorldError(found["error"])
        return found

    def where_it_hangs(self) -> str:
        """Return in which functions the thread of the world is that runs, for the end of a message."""
        os.killpg(self._process.pid, HANG_SIGNAL)
        deadline = time.monotonic() + _DUMP_TAKES
        dump = ""
        while not dump.endswith(_END_OF_DUMP) and time.monotonic() < deadline:
            dump = "".join(file.read_text() for file in self._folders(HANG_FILE))
            time.sleep(0.02)
        return "".join(f"; it is at {place}" for place in running_places(dump))

    def _folders(self, inside: str = "") -> list[Path]:
        """Return the folders of its worlds, or the files in them with a name."""
        return list(
            Path(tempfile.gettempdir()).glob(f"{folder_prefix(self._process.pid)}*/{inside}")
        )

    def kill(self) -> None:
        """End the process and its world, from any thread; whoever waits for an answer gets a WorldError."""
        if self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGKILL)  # a world that hangs is a child of it

    def close(self) -> None:
        """End the process; safe to repeat."""
        self.kill()
        self._process.wait()
        for folder in self._folders():
            shutil.rmtree(folder, ignore_errors=True)  # it had no time to do so
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None and not pipe.closed:
                try:
                    pipe.close()
                except BrokenPipeError:
                    continue

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def running_places(dump: str) -> list[str]:
    """Return where each thread is that does not wait for its turn, the outermost call first.

    Args:
        dump: what `faulthandler` has written of all threads of a world.
    """
    found = []
    for thread in dump.split("\n\n"):
        calls = list(_FRAME.finditer(thread))
        if not calls or calls[0]["file"] == "kernel.py":
            continue
        shown = [call for call in calls if call["file"] not in _HIDDEN][:_SHOWN]
        if shown:
            places = [f"{call['file']}:{call['line']} {call['name']}" for call in reversed(shown)]
            found.append(" > ".join(places))
    return found
