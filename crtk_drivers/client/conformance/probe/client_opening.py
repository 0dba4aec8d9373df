"""What users of the official Python client do first, in a process of its own: enable, home, read, move.

``python -m crtk_drivers.client.conformance.probe.client_opening NAMESPACE MODULE`` takes an `Opening` as JSON
from its standard input, with the client of that name, and tells each thing that worked in a line of JSON
(``{"done": "enable"}``), and the first that did not (``{"failed": "..."}``).

The calls are those of the CRTK documentation (Client Libraries: Python). The client answers with values in
releases before 1.4, with ``value, stamp`` since then.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np

from crtk_drivers.client.conformance.trial import Opening, Told

OFFICIAL: Final = "crtk"
HAS: Final = "wait_move_handle.py"
"""A file that tells the client from a package on PyPI that has its name and is something else."""
POSES: Final = "PyKDL"
"""The library of its poses, without which it cannot be imported."""

LAYER: Final = "crtk_drivers.client.compat"

START: Final = 30.0
"""Seconds in which the process has started, and met the device."""

LOOK: Final = 0.02


def open_with_client(namespace: str) -> Callable[[Opening], Told]:
    """Return what tries an opening with the official client if it is installed, else with our layer."""
    is_official = _is_installed()
    module = OFFICIAL if is_official else LAYER

    def tried(opening: Opening) -> Told:
        lasts = 2.0 * START + opening.home_time + 5.0 * opening.timeout
        try:
            found = subprocess.run(
                [sys.executable, "-m", __name__, namespace, module],
                input=json.dumps(asdict(opening)),
                capture_output=True,
                text=True,
                timeout=lasts,
                env={**os.environ, "ROS_VERSION": "2"},  # a sourced ROS 2 sets it, wheels do not
            )
        except subprocess.TimeoutExpired:
            return Told(is_official, (), f"the client did not come to its end within {lasts:g} s")
        lines = [json.loads(line) for line in found.stdout.splitlines() if line.startswith("{")]
        failed = [line["failed"] for line in lines if "failed" in line]
        if not failed and found.returncode:
            failed = [found.stderr.strip().splitlines()[-1] if found.stderr.strip() else "it died"]
        done = tuple(line["done"] for line in lines if "done" in line)
        return Told(is_official, done, "".join(failed[:1]))

    return tried


def _is_installed() -> bool:
    """Return whether the official client can be imported."""
    found = find_spec(OFFICIAL)
    places = [] if found is None else found.submodule_search_locations or []
    has_file = any(Path(place, HAS).is_file() for place in places)
    return has_file and find_spec(POSES) is not None


class _Arm:
    """As the documentation populates a class."""

    def __init__(self, crtk: Any, ral: Any) -> None:
        self.utils = crtk.utils(self, ral, 1.0)
        for name in ("operating_state", "measured_js", "move_jp"):
            getattr(self.utils, f"add_{name}")()


def _value(answer: Any) -> Any:
    return answer[0] if isinstance(answer, tuple) else answer


def _steps(arm: Any, opening: Opening) -> Iterator[tuple[str, Callable[[], object]]]:
    """Yield what is done, in words, and what does it: something false if it did not work."""
    timeout = opening.timeout

    def is_at(place: tuple[float, ...]) -> bool:
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            here = _value(arm.measured_jp())
            if len(here) == len(place) and np.allclose(here, place, rtol=0.0, atol=opening.arrival):
                return True
            time.sleep(LOOK)
        return False

    yield "enable", lambda: arm.enable(timeout)
    yield "home", lambda: arm.home(opening.home_time)
    yield "measured_jp", lambda: len(_value(arm.measured_jp())) == len(opening.begin)
    for name, place in (("there", opening.goal), ("back", opening.begin)):
        yield (
            f"move_jp(...).wait() {name}",
            lambda place=place: (  # type: ignore[misc]
                arm.move_jp(np.array(place)).wait(timeout=timeout) and is_at(place)
            ),
        )


def main() -> int:
    """Try an opening; return the exit code: 1 if something did not work."""
    namespace, module = sys.argv[1:]
    values = json.load(sys.stdin)
    opening = Opening(**{**values, "goal": tuple(values["goal"]), "begin": tuple(values["begin"])})
    name = "check_connections"
    try:
        crtk: Any = import_module(module)
        ral = crtk.ral("crtk_conform_client")
        arm = _Arm(crtk, ral.create_child(namespace))
        ral.spin()
        ral.check_connections(START)
        for name, does in _steps(arm, opening):
            if not does():
                _tell(failed=f"{name} did not succeed")
                return 1
            _tell(done=name)
        ral.shutdown()
    except Exception as error:  # whatever the client raises is what is asked for
        _tell(failed=f"{name}: {type(error).__name__}: {error}")
        return 1
    return 0


def _tell(**values: str) -> None:
    sys.stdout.write(f"\n{json.dumps(values)}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
