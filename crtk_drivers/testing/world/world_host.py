"""Runs worlds, each in a child of one process that has imported what they need, patched, once.

``python -m crtk_drivers.testing.world.world_host FILE [MODULE ...]``: FILE has scenarios at its top level.
The MODULEs are imported before it.
Each line of standard input is a request, and each line of standard output its answer, both in JSON. The child
reads its request after the fork, so that every child begins with the same memory.
"""

from __future__ import annotations

import ctypes
import gc
import importlib
import importlib.util
import json
import os
import select
import shutil
import sys
import tempfile
import traceback
from pathlib import Path
from typing import Any, Final

from crtk_drivers.testing.world import patches

AGAIN: Final = "--addresses-fixed"
NAME: Final = "crtk_world_scenarios"
_ADDR_NO_RANDOMIZE: Final = 0x0040000
_END_OF_INPUT: Final = 3
_HERE: Final = "/proc/self/cwd"

# Before they are patched.
_poll, _read, _write, _fork, _waitpid, _exit = (
    select.poll,
    os.read,
    os.write,
    os.fork,
    os.waitpid,
    os._exit,
)


def main() -> None:
    """Answer requests until the end of the input."""
    if AGAIN not in sys.argv:
        _fix_addresses()
    arguments = [each for each in sys.argv[1:] if each != AGAIN]
    answers = os.dup(1)
    os.dup2(2, 1)
    patches.install()
    for name in arguments[1:]:
        importlib.import_module(name)
    scenarios = _load(Path(arguments[0]))
    poll = _poll()
    poll.register(0, select.POLLIN)
    while True:
        poll.poll()
        folder = tempfile.mkdtemp(prefix="crtk-world-")
        # Every child begins with the same counts, and never looks through what is imported here.
        gc.collect()
        gc.freeze()
        child = _fork()
        if child == 0:
            _be_child(scenarios, answers, folder)
        _, status = _waitpid(child, 0)
        shutil.rmtree(folder, ignore_errors=True)
        if os.WIFEXITED(status) and os.WEXITSTATUS(status) == _END_OF_INPUT:
            return
        if status:
            _answer(answers, {"error": f"the process of a world ended with status {status}"})


def _fix_addresses() -> None:
    """Start anew without random addresses, so that sets of objects have the same order in each run."""
    if sys.platform == "linux":
        ctypes.CDLL(None).personality(_ADDR_NO_RANDOMIZE)  # where it is forbidden, they stay random
    os.execv(sys.executable, [sys.executable, "-m", __spec__.name, *sys.argv[1:], AGAIN])


def _load(file: Path) -> Any:
    sys.path.insert(0, str(file.parent))
    spec = importlib.util.spec_from_file_location(NAME, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[NAME] = module
    spec.loader.exec_module(module)
    return module


def _be_child(scenarios: Any, answers: int, folder: str) -> None:
    try:
        line = _read_line()
        if not line:
            _exit(_END_OF_INPUT)
        os.chdir(folder)
        if Path(_HERE).exists():  # the same name in each child, for a folder of its own
            tempfile.tempdir = _HERE
        _answer(answers, _run(scenarios, json.loads(line)))
    except BaseException:
        _answer(answers, {"error": traceback.format_exc()})
    _exit(0)


def _read_line() -> bytes:
    data = bytearray()
    while not data.endswith(b"\n"):
        piece = _read(0, 1)  # no more of the next request
        if not piece:
            break
        data += piece
    return bytes(data)


def _run(scenarios: Any, request: dict[str, Any]) -> dict[str, Any]:
    from crtk_drivers.testing.world.world import World

    world = World(request["seed"], **request["options"])
    if log := request.get("log"):
        world.kernel.log = []
    scenario: Any = scenarios
    for part in request["scenario"].split("."):
        scenario = getattr(scenario, part)
    if before := request.get("before"):
        module, _, name = before.rpartition(":")
        getattr(importlib.import_module(module) if module else scenarios, name)()
    outcome = world.run(lambda given: scenario(given, *request["arguments"]))
    if log and world.kernel.log is not None:
        Path(log).write_text("\n".join(world.kernel.log) + "\n")
    return outcome.to_json()


def _answer(answers: int, found: dict[str, Any]) -> None:
    data = json.dumps(found).encode() + b"\n"
    while data:
        data = data[_write(answers, data) :]


if __name__ == "__main__":
    main()
