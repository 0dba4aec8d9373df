"""The MATLAB client, run by GNU Octave against drivers on ROS 2.

Each ``octave_*.m`` here is a program. MATLAB's own way into Python is the only part that is not run: see
docs/matlab.md.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import pytest

from crtk_drivers.client.matlab.objects import _STATE_METHODS
from crtk_drivers.commands import COMMANDS
from rigs.programs import COMMAND
from rigs.warm_start import server

HERE = Path(__file__).parent
MATLAB = HERE.parents[1] / "matlab"
OCTAVE = shutil.which("octave-cli")
PATHS = (MATLAB, MATLAB / "octave", MATLAB / "examples", HERE)

needs_octave = pytest.mark.skipif(
    OCTAVE is None, reason="octave-cli is not on PATH (Debian: apt install octave)"
)
needs_ros = pytest.mark.skipif(find_spec("rclpy") is None, reason="rclpy is not installed")

DEVICES = {
    # Where the machine does much else, the controller's time passes slowly, and its arm is behind.
    "octave_poses": (
        "ur",
        "--sim",
        "--set",
        "sample_timeout=3.0",
        "--set",
        "limits.following_error=4.0",
    ),
    "octave_state": ("loopback", "--needs-homing"),
}
"""Program: the device that it needs, if not a plain loopback."""


@contextmanager
def driver(namespace: str, *arguments: str) -> Iterator[int]:
    """Run a driver in a process of its own, and give its number."""
    with server().start_text(COMMAND, *arguments, "--ns", f"/{namespace}") as process:
        try:
            yield process.pid
        finally:
            process.terminate()
            process.wait(20.0)


def octave(program: str, namespace: str, pid: int) -> None:
    assert OCTAVE is not None
    paths = "".join(f"addpath('{path}'); " for path in PATHS)
    done = subprocess.run(
        [OCTAVE, "--quiet", "--no-init-file", "--eval", f"{paths}{program}; disp('to the end')"],
        env={
            **os.environ,
            "CRTK_PYTHON": sys.executable,
            "CRTK_NAMESPACE": namespace,
            "CRTK_DRIVER_PID": str(pid),
        },
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=180,
    )
    assert done.returncode == 0, done.stdout
    assert "to the end" in done.stdout, done.stdout
    assert "error:" not in done.stdout.replace("error: ignoring const execution_exception&", "")
    assert "Traceback" not in done.stdout, done.stdout


@pytest.mark.sweep(5)
@needs_octave
@needs_ros
@pytest.mark.parametrize("program", sorted(path.stem for path in HERE.glob("octave_*.m")))
def test_a_program(program: str) -> None:
    with driver(program, *DEVICES.get(program, ("loopback",))) as pid:
        octave(program, program, pid)


@pytest.mark.slow
@needs_octave
@needs_ros
def test_the_example() -> None:
    with driver("matlab_example", "loopback") as pid:
        octave("move_and_servo('matlab_example', 1.0)", "matlab_example", pid)


def test_there_is_an_add_for_every_command() -> None:
    """With MATLAB's own spelling, and no other."""
    source = (MATLAB / "+crtk" / "utils.m").read_text()
    found = dict(re.findall(r"function add_(\w+)\(self\), self\.add\('([\w/]+)'\); end", source))
    names = set(COMMANDS) - {"operating_state", "state_command"}
    assert found == {name.replace("/", "_"): name for name in names}
    help_text = source[
        source.index("%ADD_OPERATING_STATE") : source.index("self.add('operating_state')")
    ]
    for method in _STATE_METHODS.keys() - {"operating_state_command"}:
        assert re.search(rf"\b{method}\b", help_text), method
