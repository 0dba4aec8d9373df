"""Find what this machine lacks to build a message package, and say how to install it.

``python build_needs.py compiler headers`` prints one line, and ends with exit code 1, if one is missing.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import sys
import sysconfig
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Need:
    """What a build needs of the system.

    Attributes:
        called: its name in a sentence.
        is_met: whether it is there.
        packages: the package that brings it, by the system's package manager.
    """

    called: str
    is_met: Callable[[], bool]
    packages: Mapping[str, str]


OLDEST = (3, 11)
PYTHON = f"python{sys.version_info.major}.{sys.version_info.minor}"


def has_compilers() -> bool:
    """Return whether CMake finds a compiler for C and one for C++."""
    candidates = {"CC": ("cc", "gcc", "clang"), "CXX": ("c++", "g++", "clang++")}
    return all(
        any(map(shutil.which, (os.environ.get(variable) or " ".join(names)).split()))
        for variable, names in candidates.items()
    )


def has_headers() -> bool:
    """Return whether Python.h is there. In place of a Python that is too old, uv fetches one that has it."""
    return sys.version_info < OLDEST or Path(sysconfig.get_path("include"), "Python.h").is_file()


def has_venv() -> bool:
    """Return whether `python -m venv` makes environments that have pip; Debian packs the two apart."""
    return importlib.util.find_spec("ensurepip") is not None


def python_package(part: str) -> str:
    """Return the name of Debian's package: ``python3-dev``, or ``python3.13-dev`` of another Python."""
    usual = Path("/usr/bin/python3")
    own = usual.exists() and usual.resolve().name == PYTHON
    return f"{'python3' if own else PYTHON}-{part}"


NEEDS: Mapping[str, Need] = {
    "venv": Need(
        "python3 -m venv (ensurepip)", has_venv, {"apt": python_package("venv"), "dnf": "python3"}
    ),
    "headers": Need(
        f"Python.h of {PYTHON}",
        has_headers,
        {"apt": python_package("dev"), "dnf": "python3-devel"},
    ),
    "compiler": Need("a C++ compiler", has_compilers, {"apt": "g++", "dnf": "gcc-c++"}),
}


def complaint(names: Iterable[str]) -> str:
    """Return what is missing, and the command that installs it; empty if nothing is."""
    missing = [need for name, need in NEEDS.items() if name in names and not need.is_met()]
    if not missing:
        return ""
    verb = "is" if len(missing) == 1 else "are"
    what = f"{_listed([need.called for need in missing])} {verb} missing"
    manager = next(filter(shutil.which, ("apt", "dnf")), None)
    if manager is None:
        return f"{what}. Install what is missing."
    sudo = "sudo " if os.geteuid() and shutil.which("sudo") else ""
    packages = " ".join(need.packages[manager] for need in missing)
    return f"{what}. Install what is missing: {sudo}{manager} install {packages}"


def _listed(names: Sequence[str]) -> str:
    """Return names as a sentence lists them."""
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


if __name__ == "__main__":
    found = complaint(sys.argv[1:])
    if found:
        sys.exit(f"crtk-driver: {found}")
