"""How tests are run: a failure is told, whenever it comes."""

import os
import subprocess
import sys
from pathlib import Path

FAILS_IN_ITS_LAST_SECOND = """
import signal, sys, time, types

import pytest


class LongToLookUp(types.ModuleType):
    @property
    def __file__(self):  # asked for when the frames of a failure are looked up
        while signal.getitimer(signal.ITIMER_REAL)[0] > 0.0:
            time.sleep(0.01)
        raise AttributeError


@pytest.mark.timeout(5)
def test_it():
    sys.modules["long_to_look_up"] = LongToLookUp("long_to_look_up")
    raise ValueError
"""


def test_a_failure_is_told_though_the_time_of_its_test_ends_meanwhile(tmp_path: Path) -> None:
    test = tmp_path / "test_late.py"
    test.write_text(FAILS_IN_ITS_LAST_SECOND)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "conftest", "-c", os.devnull, str(test)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parent)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=50,
    )
    assert "1 failed" in done.stdout, done.stdout + done.stderr
    assert "ValueError" in done.stdout
    assert "INTERNALERROR" not in done.stdout
