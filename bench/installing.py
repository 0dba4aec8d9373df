"""The README's first command on a fresh machine: a clone without environment, and empty caches.

Beside it, what any program with rclpy installs: the wheels of ROS 2, and no build. Both load from the package
index that uv is configured with, and install nothing outside a temporary folder. Needs git and uv.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench import processes
from bench.report import options, ratio, show

FIRST = ("uv", "run", "crtk-driver", "ur", "--ns", processes.NAMESPACE, "--sim")
"""As in the README, but for the namespace, in which the client listens."""

WHEELS = (
    "diagnostic-msgs",
    "geometry-msgs",
    "rclpy",
    "rmw-fastrtps-cpp",
    "sensor-msgs",
    "std-srvs",
)
"""Of ROS 2: what the extra `ros` asks for, but what is built."""

_MEGABYTE = 1e6


class Installed(NamedTuple):
    """What an installation took."""

    seconds: float
    megabytes: float
    packages: int
    processor: float


OURS = frozenset(
    {"AMENT_PREFIX_PATH", "LD_LIBRARY_PATH", "PYTHONPATH", "UV_PROJECT_ENVIRONMENT", "VIRTUAL_ENV"}
)
"""Variables of this process's own environment: with them its libraries would be found instead."""


def fresh(folder: Path) -> Mapping[str, str]:
    """Return the variables of a shell, without caches."""
    kept = {
        name: value
        for name, value in os.environ.items()
        if name not in OURS and not name.startswith("_ROS_WHEELS")
    }
    return {**kept, "UV_CACHE_DIR": str(folder / "cache"), "UV_NO_PROGRESS": "1"}


def measured(environment: Path, began: float, ended: float, processor: float) -> Installed:
    """Return the size of a virtual environment, and what it took."""
    files = [path for path in environment.rglob("*") if path.is_file() and not path.is_symlink()]
    blocks = sum(path.stat().st_blocks for path in files)
    packages = sum(1 for _ in environment.glob("lib/python*/site-packages/*.dist-info"))
    return Installed(ended - began, 512 * blocks / _MEGABYTE, packages, processor)


def processor_time() -> float:
    """Return the processor time (s) of the children that have ended, and of theirs."""
    times = os.times()
    return times.children_user + times.children_system


def first_command(folder: Path) -> Installed:
    """Clone, and run the first command until a client hears the arm."""
    clone = folder / "clone"
    subprocess.run(["git", "clone", "--quiet", str(processes.ROOT), str(clone)], check=True)
    with processes.client(folder, "--topics", "measured_js", "--patience", "600") as client:
        processes.wait_up(client)
        before, began = processor_time(), time.monotonic()
        with subprocess.Popen(FIRST, cwd=clone, env=fresh(folder)) as command:
            try:
                ended = processes.wait_ready(client)
            finally:
                command.terminate()
                command.wait()
        used = processor_time() - before
    return measured(clone / ".venv", began, ended, used)


def ros_wheels(folder: Path) -> Installed:
    """Install what any program with rclpy needs."""
    environment, venv = fresh(folder), folder / "venv"
    names = [f"ros-jazzy-{name}" for name in WHEELS]
    before, began = processor_time(), time.monotonic()
    subprocess.run(["uv", "venv", "--quiet", "--python", sys.executable, str(venv)], check=True)
    install = ["uv", "pip", "install", "--quiet", "--python", str(venv / "bin" / "python"), *names]
    subprocess.run(install, check=True, env=environment)
    subprocess.run([venv / "bin" / "python", "-c", "import rclpy"], check=True, env=environment)
    return measured(venv, began, time.monotonic(), processor_time() - before)


def main() -> None:
    """Measure and print."""
    given = options(__doc__ or "", runs=(3, "of each"))
    cases = {"ROS 2 wheels alone": ros_wheels, "README's first command": first_command}
    found: dict[str, list[Installed]] = {name: [] for name in cases}
    for _ in range(given.runs):
        for name, install in cases.items():
            with tempfile.TemporaryDirectory() as folder:
                found[name].append(install(Path(folder)))
    peer = np.median(found["ROS 2 wheels alone"], axis=0)
    rows = []
    for name, values in found.items():
        median = np.median(values, axis=0)
        figures = [f"{value:.0f}" for value in (median[0], max(v.seconds for v in values))]
        figures += [f"{value:.0f}" for value in (median[3], median[1], median[2])]
        rows.append([name, *figures, ratio(median[0], peer[0])])
    show(
        f"Installing, {given.runs} runs",
        ("what", "median s", "max s", "CPU s", "MB", "packages", "time over the peer"),
        rows,
        [
            "Until the arm was heard on ROS; the peer until rclpy was imported. MB: the environment on disk."
        ],
    )


if __name__ == "__main__":
    main()
