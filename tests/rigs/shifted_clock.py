"""The environment of a process whose clock is off, and of all that it starts."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from pathlib import Path

HOOK = Path(__file__).parent / "shifted"


def shifted(seconds: float, environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Return an environment in which the wall clock of Python is so many seconds ahead, as in F18."""
    path = os.pathsep.join(filter(None, (str(HOOK), *sys.path)))
    return {**environment, "PYTHONPATH": path, "CRTK_TESTS_SHIFT": str(seconds)}
