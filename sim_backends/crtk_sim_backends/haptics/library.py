"""Builds a library that stands for a vendor's."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import Final

from crtk_sim_backends.process import SimStartError

HEADERS: Final = Path(__file__).parent


def compiler() -> str | None:
    """Return the C compiler of this machine: $CC, cc, gcc or clang; None if there is none."""
    return next(filter(None, map(shutil.which, (os.environ.get("CC", "cc"), "gcc", "clang"))), None)


def build(source: Path, target: Path) -> Path:
    """Build a shared library of one C file, and return its path.

    Raises:
        SimStartError: there is no compiler, or it fails.
    """
    program = compiler()
    if program is None:
        raise SimStartError(
            "there is no C compiler, which builds the library that stands for the vendor's: "
            "install one (`sudo apt install gcc`), or name it in CC"
        )
    command = [program, "-O2", "-shared", "-fPIC", f"-I{HEADERS}", "-o", str(target), str(source)]
    done = subprocess.run(
        [*command, "-lpthread", "-lm", "-ldl"],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60.0,
        check=False,
    )
    if done.returncode:
        raise SimStartError(f"{program} could not build {source.name}: {done.stderr[-2000:]}")
    return target
