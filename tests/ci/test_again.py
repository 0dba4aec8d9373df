"""CI runs each test that failed again, alone, and is green only if it then passes three times."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from rigs.inner_pytest import environment, run_pytest

CI = Path(__file__).parents[2] / ".ci"

FAILS_IN_SOME_RUNS = """
from pathlib import Path

def test_it():
    runs = Path("runs")
    run = int(runs.read_text()) if runs.exists() else 1
    runs.write_text(str(run + 1))
    assert run not in FAILING, f"run {run}"
"""

FAILS_AND_THEN_SKIPS = """
from pathlib import Path

import pytest

def test_it():
    if Path("ran").exists():
        pytest.skip("a skipped test keeps no promise")
    Path("ran").touch()
    assert False
"""

FAILS_IN_CALL_AND_TEARDOWN = """
from pathlib import Path

import pytest

@pytest.fixture
def once():
    first = not Path("ran").exists()
    Path("ran").touch()
    yield first
    assert not first, "in the teardown"

def test_it(once):
    assert not once, "in the call"
"""

FAILS_21_TIMES = """
import pytest

@pytest.mark.parametrize("case", range(21))
def test_it(case):
    assert False
"""

COMPUTES = """
import time

def test_it():
    end = time.process_time() + 1.6
    while time.process_time() < end:
        pass
"""

KILLS_ITS_WORKER = """
import os
import signal

def test_it():
    os.kill(os.getpid(), signal.SIGKILL)
"""

ENDS_ITS_WORKER_AFTER_ALL_TESTS = """
import os
import signal

class Ending:
    def pytest_sessionfinish(self):
        os.kill(os.getpid(), signal.SIGKILL)

def test_it(request):
    request.config.pluginmanager.register(Ending())
"""

HANGS_WITH_OTHERS = """
import os
import signal
import threading

import conftest
import pytest

conftest.AFTER_ITS_TIME = 1.0

@pytest.mark.timeout(1)
def test_it():
    if "PYTEST_XDIST_WORKER" in os.environ:
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGALRM])
        threading.Event().wait()
"""


@dataclass(frozen=True)
class Outcome:
    """What `.ci/again.py` came to: its exit code, what it printed, and the unsteady tests."""

    code: int
    printed: str
    unsteady: str


def run_again(folder: Path, source: str) -> Outcome:
    """Run tests of which some fail, with one worker; then run again what failed."""
    done = run_pytest(folder, source, "--numprocesses=1", "--failures=failures.json")
    assert done.returncode == 1, done.stdout + done.stderr
    again = subprocess.run(
        [sys.executable, CI / "again.py", "failures.json", "unsteady"],
        cwd=folder,
        env={**environment(), "PYTEST_ADDOPTS": f"-p conftest -c {os.devnull} --rootdir={folder}"},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=200,
    )
    printed = again.stdout + again.stderr
    return Outcome(again.returncode, printed, (folder / "unsteady").read_text())


def in_runs(*failing: int) -> str:
    return FAILS_IN_SOME_RUNS.replace("FAILING", repr(failing))


def test_three_passes_alone_are_unsteady(tmp_path: Path) -> None:
    outcome = run_again(tmp_path, in_runs(1))
    assert outcome.code == 0, outcome.printed
    assert "passes alone 3 of 3 times" in outcome.printed
    first, second, third = outcome.unsteady.splitlines()
    assert first == "unsteady: test_it.py::test_it"
    assert second.strip().startswith("failed, while programs waited for a processor for ")
    assert second.endswith(": AssertionError: run 1")
    assert re.fullmatch(
        r" +add to tests/UNSTEADY.md: \| `test_it.py::test_it` "
        r"\| 20\d\d-\d\d-\d\d, load \d+, waited \d+% \| open \| \|",
        third,
    )
    assert (tmp_path / "runs").read_text() == "5", "one run with others, three alone"


def test_one_failure_alone_fails(tmp_path: Path) -> None:
    outcome = run_again(tmp_path, in_runs(1, 4))
    assert outcome.code == 1
    assert "fails alone, at try 3 of 3" in outcome.printed
    assert "AssertionError: run 4" in outcome.printed, "what it said alone"
    assert outcome.printed.splitlines()[-1] == "1 of 1 fail alone: test_it.py::test_it"
    assert not outcome.unsteady


def test_a_skip_alone_fails(tmp_path: Path) -> None:
    assert run_again(tmp_path, FAILS_AND_THEN_SKIPS).code == 1


def test_two_failures_of_one_test_count_once(tmp_path: Path) -> None:
    outcome = run_again(tmp_path, FAILS_IN_CALL_AND_TEARDOWN)
    assert outcome.code == 0, outcome.printed
    assert outcome.printed.splitlines()[-1] == "0 of 1 fail alone"
    assert "in the call" in outcome.unsteady, "the first error is kept"


def test_more_than_twenty_failures_fail(tmp_path: Path) -> None:
    outcome = run_again(tmp_path, FAILS_21_TIMES)
    assert outcome.code == 1
    assert outcome.printed.strip() == "21 tests failed: more than 20 are not run again"


def test_a_dead_worker_fails(tmp_path: Path) -> None:
    outcome = run_again(tmp_path, KILLS_ITS_WORKER)
    assert outcome.code == 1
    assert outcome.printed.startswith("test_it.py::test_it ended its worker: ")


def test_a_worker_that_dies_outside_of_tests_fails(tmp_path: Path) -> None:
    outcome = run_again(tmp_path, ENDS_ITS_WORKER_AFTER_ALL_TESTS)
    assert outcome.code == 1
    assert outcome.printed.startswith("no test of worker gw0 ended its worker: ")


def test_a_hang_that_ended_its_worker_runs_again(tmp_path: Path) -> None:
    outcome = run_again(tmp_path, HANGS_WITH_OTHERS)
    assert outcome.code == 0, outcome.printed
    assert "over time, while programs waited" in outcome.unsteady


# ------------------------------------------------------------------------------------ for a person


def test_the_last_lines_say_how_to_run_again(tmp_path: Path) -> None:
    done = run_pytest(tmp_path, in_runs(1), "--numprocesses=1")
    *_, hint, summary = done.stdout.splitlines()
    busy = r"(Programs waited for a processor for \d+% of the time\. )?"
    again = re.escape('./crtk-driver --test -m "" -n 0 --lf')
    assert re.fullmatch(f"{busy}Run what failed again, alone: {again}", hint), done.stdout
    assert summary.startswith("1 failed in ")


def test_the_failures_are_in_the_file(tmp_path: Path) -> None:
    run_pytest(tmp_path, in_runs(1), "--numprocesses=0", "--failures=failures.json")
    (failure,) = json.loads((tmp_path / "failures.json").read_text())
    assert failure.pop("waited") >= 0.0
    assert failure.pop("load") >= 0.0
    assert failure == {
        "test": "test_it.py::test_it",
        "how": "failed",
        "said": "AssertionError: run 1",
    }


def test_what_computes_is_in_the_table(tmp_path: Path) -> None:
    done = run_pytest(tmp_path, COMPUTES, "--numprocesses=1", "--failures=failures.json")
    (row,) = re.findall(r"^ +(\d+) s +(\d+) s of CPU +1 tests  in all$", done.stdout, re.M)
    assert min(map(int, row)) >= 1, done.stdout
