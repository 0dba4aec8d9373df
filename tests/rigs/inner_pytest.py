"""A run of pytest inside a test: with `tests/conftest.py`, on tests that are written for it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parents[1]


def environment() -> dict[str, str]:
    """Return the environment of a run that knows nothing of the run around it."""
    inherited = {name: value for name, value in os.environ.items() if "PYTEST" not in name}
    return {**inherited, "PYTHONPATH": str(TESTS)}


def run_pytest(folder: Path, source: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Write the tests to a file in a folder, run them there, and return what pytest printed."""
    test = folder / "test_it.py"
    test.write_text(source)
    options = ["-q", "-p", "conftest", "-c", os.devnull, "-o", "timeout=60", *arguments]
    return subprocess.run(
        [sys.executable, "-m", "pytest", *options, str(test)],
        cwd=folder,
        env=environment(),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=200,
    )
