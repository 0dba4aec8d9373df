"""Runs worlds, each in a child of one process that has imported what they need, patched, once.

``python -m crtk_drivers.testing.world.world_host FILE [MODULE ...]``: FILE has scenarios at its top level.
The MODULEs are imported before it.
Each line of standard input is a request, and each line of standard output its answer, both in JSON. The child
reads its request after the fork, so that every child begins with the same memory.
"""

from __future__ import annotations

import ctypes
import faulthandler
import gc
import importlib
import importlib.util
import inspect
import json
import os
import select
import shutil
import signal
import sys
import tempfile
import traceback
from pathlib import Path
from typing import Any, Final

from crtk_drivers.testing.world import patches

AGAIN: Final = "--addresses-fixed"
NAME: Final = "crtk_world_scenarios"
HANG_SIGNAL: Final = signal.SIGUSR2
"""At it, a world writes where each of its threads is."""
HANG_FILE: Final = "where_it_hangs.txt"
"""What it writes then, beside the folder in which it runs."""
_ADDR_NO_RANDOMIZE: Final = 0x0040000
_HERE: Final = "/proc/self/cwd"

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


class RefusedError(Exception):
    """A request cannot be carried out; the text says why."""


def main() -> None:
    """Answer requests until the end of the input."""
    if AGAIN not in sys.argv:
        _fix_addresses()
    arguments = [each for each in sys.argv[1:] if each != AGAIN]
    requests, answers = os.dup(0), os.dup(1)
    signal.signal(
        HANG_SIGNAL, signal.SIG_IGN
    )  # it is for the child, and comes to the whole session
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)  # input() of a scenario ends at once, and takes no request
    os.close(nothing)
    os.dup2(2, 1)
    patches.install()
    for name in arguments[1:]:
        importlib.import_module(name)
    scenarios = _load(Path(arguments[0]))
    poll = _poll()
    poll.register(requests, select.POLLIN)
    while True:
        if not poll.poll()[0][1] & select.POLLIN:
            return
        folder = tempfile.mkdtemp(prefix=folder_prefix(os.getpid()))
        # Every child begins with the same counts, and never looks through what is imported here.
        gc.collect()
        gc.freeze()
        life, held = _pipe()
        child = _fork()
        if child == 0:
            _be_child(scenarios, requests, answers, folder)  # the end `held` closes when it ends
        _close(held)
        status = _await(child, life, requests)
        _close(life)
        shutil.rmtree(folder, ignore_errors=True)
        if status is None:
            return
        if status:
            code = os.waitstatus_to_exitcode(status)
            how = f"exit code {code}" if code >= 0 else signal.Signals(-code).name
            _answer(answers, {"error": f"the process of a world has ended: {how}"})


def folder_prefix(pid: int) -> str:
    """Return how the names of the folders begin in which the worlds of a host run."""
    return f"crtk-world-{pid}-"


def _await(child: int, life: int, requests: int) -> int | None:
    """Return the status of a world that has ended; None if whoever asked for it has gone.

    Such a world is killed: it may compute for ever.

    Args:
        child: its process.
        life: a pipe that only this process holds open.
        requests: the pipe of whoever asks.
    """
    poll = _poll()
    poll.register(life, 0)  # tells a hang-up only
    poll.register(requests, 0)
    is_alone = requests in [descriptor for descriptor, _ in poll.poll()]
    if is_alone:
        _kill(child, signal.SIGKILL)
    _, status = _waitpid(child, 0)
    return None if is_alone else status


def _fix_addresses() -> None:
    """Start anew without random addresses, so that sets of objects have the same order in each run."""
    if sys.platform == "linux":
        ctypes.CDLL(None).personality(_ADDR_NO_RANDOMIZE)  # where it is forbidden, they stay random
    os.execv(sys.executable, [sys.executable, "-m", __spec__.name, *sys.argv[1:], AGAIN])


def _load(file: Path) -> Any:
    sys.path.insert(0, str(file.parent))
    spec = importlib.util.spec_from_file_location(NAME, file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file} is no file of Python: its name has to end with .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[NAME] = module
    spec.loader.exec_module(module)
    return module


def _be_child(scenarios: Any, requests: int, answers: int, folder: str) -> None:
    try:
        line = _read_line(requests)
        dump = Path(folder, HANG_FILE).open("w")  # noqa: SIM115 - for its life
        faulthandler.register(HANG_SIGNAL, dump)
        (inside := Path(folder, "world")).mkdir()
        os.chdir(inside)
        if Path(_HERE).exists():  # the same name in each child, for a folder of its own
            tempfile.tempdir = _HERE
        _answer(answers, _run(scenarios, json.loads(line)))
    except RefusedError as error:
        _answer(answers, {"error": str(error)})
    except BaseException:
        _answer(answers, {"error": traceback.format_exc()})
    _exit(0)


def _read_line(requests: int) -> bytes:
    data = bytearray()
    while not data.endswith(b"\n"):
        piece = _read(requests, 1)  # no more of the next request
        if not piece:
            break
        data += piece
    return bytes(data)


def _run(scenarios: Any, request: dict[str, Any]) -> dict[str, Any]:
    from crtk_drivers.testing.world.world import World

    options = list(inspect.signature(World).parameters)[1:]
    if wrong := ", ".join(request["options"].keys() - options):
        raise RefusedError(f"a world has no option {wrong}; it has {', '.join(options)}")
    world = World(request["seed"], **request["options"])
    if log := request.get("log"):
        world.kernel.log = []
    scenario: Any = scenarios
    for part in request["scenario"].split("."):
        scenario = getattr(scenario, part, None)
    if not callable(scenario):
        name, file = request["scenario"], scenarios.__file__
        raise RefusedError(f"{file} has no function {name!r} at its top level")
    if before := request.get("before"):
        module, _, name = before.rpartition(":")
        getattr(importlib.import_module(module) if module else scenarios, name)()
    outcome = world.run(lambda given: scenario(given, *request["arguments"]))
    try:
        json.dumps(outcome.result)
    except (TypeError, ValueError) as error:
        kind = type(outcome.result).__name__
        text = f"{request['scenario']} returned a {kind}: return what JSON can hold, or nothing"
        raise RefusedError(text) from error
    if log and world.kernel.log is not None:
        Path(log).write_text("\n".join(world.kernel.log) + "\n")
    return outcome.to_json()


def _answer(answers: int, found: dict[str, Any]) -> None:
    data = json.dumps(found).encode() + b"\n"
    while data:
        data = data[_write(answers, data) :]


if __name__ == "__main__":
    main()
