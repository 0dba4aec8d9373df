"""A process that forks a child for each world, so that all worlds begin with the same memory.

It has imported what they need, patched, once. Whoever started it asks by lines of JSON on standard input, and
is answered by lines of JSON on standard output. A child reads its request after the fork, by itself.
"""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import gc
import json
import os
import select
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NoReturn

from crtk_drivers.testing.world import middleware
from crtk_drivers.testing.world.machine import patches

AGAIN: Final = "--addresses-fixed"
"""Last argument of a process that starts no more anew: addresses are fixed, or need not be."""
HANG_SIGNAL: Final = signal.SIGUSR2
"""At it, a world writes where each of its threads is."""
HANG_FILE: Final = "where_it_hangs.txt"
"""What it writes then, in the folder of its world."""
PRINTED: Final = "printed.txt"
"""What the processes of a world have printed, if it is kept, in the folder of the world."""
_ADDR_NO_RANDOMIZE: Final = 0x0040000
_SAID: Final = 4000
"""Characters of what a process printed before it died that the error has."""

# Before they are patched.
_poll, _read, _write, _pipe, _close, _fork, _waitpid, _kill, _exit = (
    select.poll,
    os.read,
    os.write,
    os.pipe,
    os.close,
    os.fork,
    os.waitpid,
    os.kill,
    os._exit,
)
# Only Linux has it.
_sched_setaffinity: Final[Any] = getattr(os, "sched_setaffinity", None)
real_clock: Final = time.perf_counter
"""s of this machine's clock."""


class RefusedError(Exception):
    """A request cannot be carried out; the text says why."""


class Requests:
    """What whoever has started this process asks for, and the way of the answers."""

    def __init__(self) -> None:
        self._requests, self._answers = os.dup(0), os.dup(1)
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)  # input() in a world ends at once, and takes no request
        os.close(nothing)
        os.dup2(2, 1)

    def read(self) -> dict[str, Any] | None:
        """Wait for the next request, in real time, and return it; None if there will be none."""
        data = bytearray()
        while not data.endswith(b"\n"):
            piece = _read(self._requests, 1)  # what follows the line may be for another child
            if not piece:
                return None
            data += piece
        found: dict[str, Any] = json.loads(data)
        return found

    def answer(self, found: dict[str, Any]) -> None:
        """Answer the request that was read last."""
        data = json.dumps(found).encode() + b"\n"
        while data:
            data = data[_write(self._answers, data) :]

    def await_next(self) -> bool:
        """Wait until there is a request to read, in real time; False if there will be none."""
        poll = _poll()
        poll.register(self._requests, select.POLLIN)
        return bool(poll.poll()[0][1] & select.POLLIN)

    def await_child(self, life: int) -> bool:
        """Wait until a child has ended; False if whoever asks has gone before.

        Args:
            life: a pipe that only the child holds open.
        """
        poll = _poll()
        poll.register(life, 0)  # tells a hang-up only
        poll.register(self._requests, 0)
        return self._requests not in [descriptor for descriptor, _ in poll.poll()]


def begin() -> tuple[Requests, list[str]]:
    """Make this process one that forks worlds: fix its addresses, and patch the standard library,
    and rclpy once it is imported.

    Returns:
        The requests, and the arguments of the process.
    """
    if AGAIN not in sys.argv:
        _fix_addresses()
    # The whole session gets the signal, which is for the child.
    signal.signal(HANG_SIGNAL, signal.SIG_IGN)
    requests = Requests()
    patches.install()
    middleware.install()
    return requests, [each for each in sys.argv[1:] if each != AGAIN]


def serve(requests: Requests, be_world: Callable[[Path], None]) -> None:
    """Fork a child for each request, one after the other, until whoever asks has gone.

    Args:
        requests: from whoever asks.
        be_world: reads the request and answers it, in the child, which ends with it; given a new folder.
    """
    while requests.await_next():
        folder = Path(tempfile.mkdtemp(prefix=folder_prefix(os.getpid())))
        # Every child begins with the same counts, and never looks through what is imported here.
        gc.collect()
        gc.freeze()
        life, held = _pipe()
        child = _fork()
        if child == 0:
            _be_child(requests, be_world, folder)  # the end `held` closes when it ends
        _close(held)
        goes_on = requests.await_child(life)
        if not goes_on:
            _kill(child, signal.SIGKILL)  # it may compute for ever
        _, status = _waitpid(child, 0)
        _close(life)
        printed = Path(folder, PRINTED)
        said = printed.read_text(errors="replace")[-_SAID:] if status and printed.exists() else ""
        shutil.rmtree(folder, ignore_errors=True)
        if not goes_on:
            return
        if status:
            code = os.waitstatus_to_exitcode(status)
            how = f"exit code {code}" if code >= 0 else signal.Signals(-code).name
            requests.answer({"error": f"the process of a world has ended: {how}\n{said}".rstrip()})


def folder_prefix(pid: int) -> str:
    """Return how the names of the folders begin in which the worlds of a process run."""
    return f"crtk-world-{pid}-"


def _fix_addresses() -> None:
    """Start anew without random addresses, so that sets of objects have the same order in each run."""
    if sys.platform == "linux":
        ctypes.CDLL(None).personality(_ADDR_NO_RANDOMIZE)  # where it is forbidden, they stay random
    module = sys.modules["__main__"].__spec__
    assert module is not None
    os.execv(sys.executable, [sys.executable, "-m", module.name, *sys.argv[1:], AGAIN])


def _stay_on_this_core() -> None:
    """Let all threads of this process run on one core: of them one runs at a time.

    Otherwise each switch wakes another core, which takes six times as long.
    """
    if sys.platform == "linux":
        here = ctypes.CDLL(None).sched_getcpu()
        with contextlib.suppress(OSError):  # where it is forbidden, it only takes longer
            _sched_setaffinity(0, {here})


def leave() -> NoReturn:
    """End the process of a world, whatever still runs in it."""
    _exit(0)
    raise AssertionError


def _be_child(requests: Requests, be_world: Callable[[Path], None], folder: Path) -> None:
    try:
        _stay_on_this_core()
        dump = Path(folder, HANG_FILE).open("w")  # noqa: SIM115 - for its life
        faulthandler.register(HANG_SIGNAL, dump)
        be_world(folder)
    except RefusedError as error:
        requests.answer({"error": str(error)})
    except BaseException:
        requests.answer({"error": traceback.format_exc()})
    leave()
