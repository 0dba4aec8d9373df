"""An installed ROS 2 that a setup script makes known: the libraries of the wheels, found by variables alone.

A virtual environment has all that is installed here but ROS 2. `PYTHONPATH` and `LD_LIBRARY_PATH` lead to
that, as in a shell in which ``/opt/ros/jazzy/setup.bash`` is sourced.
"""

from __future__ import annotations

import subprocess
import sys
import sysconfig
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import distributions
from pathlib import Path
from typing import Final

from rigs.waiting import LONG

SITE: Final = Path(sysconfig.get_path("purelib"))
MESSAGES: Final = (
    "crtk-msgs",
    "crtk-tf2-msgs",
    "crtk-control-msgs",
    "crtk-controller-manager-msgs",
)


@dataclass(frozen=True)
class InstalledRos:
    """Attributes:
    python: of the environment without ROS 2.
    shell: the variables that a setup script sets.
    """

    python: Path
    shell: Mapping[str, str]


def installed_ros(folder: Path) -> InstalledRos:
    """Make one in a folder."""
    of_ros = {
        str(file).partition("/")[0]
        for found in distributions(path=[str(SITE)])
        if found.metadata["Name"].startswith("ros-") or found.metadata["Name"] in MESSAGES
        for file in found.files or ()
        if not str(file).startswith("..")
    }
    for name in ("ros", "others"):
        (folder / name).mkdir(parents=True)
    for entry in SITE.iterdir():
        if entry.suffix == ".pth":
            continue
        if entry.name not in of_ros:
            (folder / "others" / entry.name).symlink_to(entry)
        elif not entry.name.endswith("-info"):
            (folder / "ros" / entry.name).symlink_to(entry)
    venv = folder / "venv"
    making = (sys.executable, "-m", "venv", "--without-pip", str(venv))
    subprocess.run(making, check=True, timeout=LONG)
    (site,) = venv.glob("lib/python3*/site-packages")
    beside = [path for path in sys.path if path and Path(path) != SITE and Path(path).is_dir()]
    (site / "beside.pth").write_text("\n".join([str(folder / "others"), *beside]))
    libraries = [str(path) for path in sorted((folder / "ros").glob("*.libs"))]
    libraries.append(str(Path(sys.prefix) / "lib"))  # what the wheels hold for programs of C++
    return InstalledRos(
        venv / "bin" / "python",
        {"PYTHONPATH": str(folder / "ros"), "LD_LIBRARY_PATH": ":".join(libraries)},
    )
