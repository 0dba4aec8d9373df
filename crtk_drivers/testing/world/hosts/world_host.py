"""Runs worlds whose scenarios are in a file.

``python -m crtk_drivers.testing.world.hosts.world_host FILE [MODULE ...]``: FILE has scenarios at its top
level. The MODULEs are imported before it. Each request names a scenario, its seed and its options.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import json
import os
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any, Final

from crtk_drivers.testing.world.hosts import forking
from crtk_drivers.testing.world.hosts.forking import RefusedError, Requests

NAME: Final = "crtk_world_scenarios"
_HERE: Final = "/proc/self/cwd"


def main() -> None:
    """Answer requests until whoever asks has gone."""
    requests, (file, *modules) = forking.begin()
    for name in modules:
        importlib.import_module(name)
    scenarios = _load(Path(file))
    forking.serve(requests, partial(_be_world, requests, scenarios))


def _load(file: Path) -> Any:
    sys.path.insert(0, str(file.parent))
    spec = importlib.util.spec_from_file_location(NAME, file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file} is no file of Python: its name has to end with .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[NAME] = module
    spec.loader.exec_module(module)
    return module


def _be_world(requests: Requests, scenarios: Any, folder: Path) -> None:
    request = requests.read()
    if request is None:
        return
    (inside := Path(folder, "world")).mkdir()
    os.chdir(inside)
    if Path(_HERE).exists():  # the same name in each child, for a folder of its own
        tempfile.tempdir = _HERE
    requests.answer(_run(scenarios, request))


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


if __name__ == "__main__":
    main()
