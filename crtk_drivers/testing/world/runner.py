"""Runs scenarios from a test or a search: hosts, seeds, and the fewest troubles that a failure needs."""

from __future__ import annotations

import atexit
import inspect
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
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, Self

from crtk_drivers.testing.world.world_host import AGAIN, HANG_FILE, HANG_SIGNAL, folder_prefix
from crtk_drivers.testing.world.world_outcome import Outcome

PATIENCE: Final = 180.0
"""s of real time within which a world must have ended."""
_DUMP_TAKES: Final = 5.0
"""s in which a world that hangs has written where."""
_FRAME: Final = re.compile(r'  File "(.*/)?(?P<file>.*)", line (?P<line>\d+) in (?P<name>.*)')
"""A line of what `faulthandler` writes: a thread after the other, the innermost call first."""
_END_OF_DUMP: Final = "_run_module_as_main\n"
"""The outermost call of the oldest thread, which comes last."""
_HIDDEN: Final = ("kernel.py", "world.py", "world_host.py", "threading.py", "<frozen runpy>")
_SHOWN: Final = 6
"""Calls of a thread that hangs, the innermost ones."""


class WorldError(RuntimeError):
    """A world could not be run: its file cannot be imported, or its process hangs or has died."""


class Host:
    """A process that runs worlds, one after the other.

    Args:
        file: that has the scenarios at its top level.
        preload: modules that it imports first.
        fixed: whether addresses are the same in each process; sets of objects are in their order.
    """

    def __init__(self, file: Path, preload: Sequence[str] = (), *, fixed: bool = True) -> None:
        self.file = file
        command = [
            sys.executable,
            "-m",
            "crtk_drivers.testing.world.world_host",
            str(file),
            *preload,
        ]
        if not fixed:
            command.append(AGAIN)
        path = os.pathsep.join(each for each in sys.path if each)
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # it ends with its worlds, and Ctrl-C is for whoever asked for them
            env={**os.environ, "PYTHONHASHSEED": "0", "PYTHONPATH": path},
        )
        self._read = bytearray()

    def fileno(self) -> int:
        """Return what becomes readable when there is an answer."""
        assert self._process.stdout is not None
        return self._process.stdout.fileno()

    def ask(
        self,
        scenario: str,
        seed: int,
        *,
        arguments: Sequence[Any] = (),
        before: str = "",
        log: str = "",
        **options: Any,
    ) -> None:
        """Begin to run a seed.

        Args:
            scenario: its function's name.
            seed: of all that happens.
            arguments: of the scenario, after the world.
            before: name of a function that is called first; with ``module:`` before it, of another module.
            log: file for every line of the trace.
            options: of `World`.
        """
        request = {
            "scenario": scenario,
            "seed": seed,
            "arguments": list(arguments),
            "options": options,
            "before": before,
            "log": log,
        }
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            self._process.stdin.flush()
        except BrokenPipeError as error:
            raise WorldError(f"the process for the scenarios of {self.file} has ended") from error

    def answer(self, patience: float = PATIENCE) -> Outcome:
        """Return what came of the seed that was asked for.

        Raises:
            WorldError: it cannot be run, or is not done in time.
        """
        deadline = time.monotonic() + patience
        while b"\n" not in self._read:
            left = deadline - time.monotonic()
            if left <= 0.0 or not select.select([self], [], [], left)[0]:
                where = self._where_it_hangs()
                self.close()
                raise WorldError(
                    f"a world of {self.file} is not done in {patience:g} s of real time: it computes for "
                    f"ever, or it waits for the real system, past what is patched{where}"
                )
            piece = os.read(self.fileno(), 1 << 20)
            if not piece:
                raise WorldError(
                    f"the process for the scenarios of {self.file} has ended: most likely it cannot import "
                    "the file; standard error says why"
                )
            self._read += piece
        line, _, rest = bytes(self._read).partition(b"\n")
        self._read = bytearray(rest)
        found = json.loads(line)
        if "error" in found:
            raise WorldError(found["error"])
        return Outcome.of_json(found)

    def _where_it_hangs(self) -> str:
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

    def run(
        self, scenario: str, seed: int, *, patience: float = PATIENCE, **options: Any
    ) -> Outcome:
        """Run a seed; see `ask` for the options."""
        self.ask(scenario, seed, **options)
        return self.answer(patience)

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


_hosts: dict[Path, Host] = {}


def _host_of(scenario: Callable[..., object]) -> tuple[Host, str]:
    """Return the host of a scenario's file, started at the first use, and the scenario's name in it."""
    if not inspect.isfunction(scenario) or scenario.__qualname__ != scenario.__name__:
        raise ValueError(f"{scenario!r}: a scenario is a function at the top level of its file")
    if inspect.iscoroutinefunction(scenario) or scenario.__name__ == "<lambda>":
        raise ValueError(f"{scenario!r}: a scenario is a plain function, made by `def`")
    file, name = Path(inspect.getfile(scenario)).resolve(), scenario.__name__
    if file not in _hosts:
        if not _hosts:
            atexit.register(_close_hosts)
        _hosts[file] = Host(file)
    return _hosts[file], name


def _close_hosts() -> None:
    while _hosts:
        _hosts.popitem()[1].close()


def run(scenario: Callable[..., object], seed: int, **options: Any) -> Outcome:
    """Run a scenario with a seed in a world of its own.

    Args:
        scenario: a function at the top level of a file, which is imported anew where the world runs.
        seed: of all that happens.
        options: of `Host.ask`.

    Raises:
        WorldError: it cannot be run.
    """
    host, name = _host_of(scenario)
    try:
        return host.run(name, seed, **options)
    except WorldError:
        _hosts.pop(host.file, host).close()
        raise


def search(
    file: Path,
    scenario: str,
    seeds: Iterable[int],
    *,
    workers: int = 1,
    preload: Sequence[str] = (),
    **options: Any,
) -> Iterator[Outcome]:
    """Run a scenario of a file with many seeds, several at a time; yield the outcomes as they come.

    Args:
        file, scenario: where it is, and what it is called.
        seeds: each in a world of its own.
        workers: how many at a time.
        preload: modules that are imported before the file.
        options: of `Host.ask`.
    """
    waiting = deque(seeds)
    hosts = [Host(file, preload) for _ in range(min(workers, len(waiting)))]
    busy = []
    try:
        for host in hosts:
            host.ask(scenario, waiting.popleft(), **options)
            busy.append(host)
        while busy:
            ready, _, _ = select.select(busy, [], [], PATIENCE)
            for host in ready or busy[:1]:
                outcome = host.answer(PATIENCE if ready else 0.0)
                if waiting:
                    host.ask(scenario, waiting.popleft(), **options)
                else:
                    busy.remove(host)
                yield outcome
    finally:
        for host in hosts:
            host.close()


def shrink(rerun: Callable[[Sequence[int]], Outcome], found: Outcome) -> Outcome:
    """Return a run with the same finding and as few troubles as can be found.

    Args:
        rerun: runs the same seed without some troubles.
        found: a run with a finding.
    """
    best = found
    # What is left out changes what the script does, and then it may meet troubles that it has not met before.
    left_out = set(found.without)
    size = max(1, len(found.kept))
    while kept := best.kept:
        size = min(size, len(kept))
        for start in range(0, len(kept), size):
            more = left_out.union(kept[start : start + size])
            tried = rerun(sorted(more))
            if tried.kinds & found.kinds:
                best, left_out = tried, more
                break
        else:
            if size == 1:
                break
            size //= 2
    return best
