"""Programs that tests start, as `python -m` does; most are forked, see `rigs.warm_start`."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Protocol, TypeAlias

from rigs.warm_start import Process

Program: TypeAlias = "subprocess.Popen[str] | Process"

COMMAND = "crtk_drivers.cli"
"""The module of `crtk-driver`."""


class Start(Protocol):
    """How to start a program; what it writes is text."""

    def __call__(
        self, module: str, *arguments: str, stdout: int | None = None, stderr: int | None = None
    ) -> Program: ...


def start(
    module: str, *arguments: str, stdout: int | None = None, stderr: int | None = None
) -> subprocess.Popen[str]:
    """Start it as users do."""
    return subprocess.Popen(
        [sys.executable, "-m", module, *arguments],
        stdin=subprocess.PIPE,
        stdout=stdout,
        stderr=stderr,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
