"""The steps of CI: what fails is judged by its output alone, a download has three tries, nobody starves."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

STEPS = Path(__file__).parents[2] / ".ci" / "steps.sh"

FAILS_TWICE = """
echo "$1"
echo run >>"$work/runs"
[ "$(wc -l <"$work/runs")" = 3 ]
"""

DOWNLOAD_ERRORS = {
    "uv": "error: Request failed after 1 retry in 1.2s\n  cause: Failed to fetch: http://127.0.0.1:9/",
    "uv, a part of a file": "hint: The structure of `numpy` was invalid:\n  Failed to read from zip file",
    "pip": "ERROR: No matching distribution found for numpy",
    "pip, a part of a file": "ERROR: Wheel 'numpy' located at /tmp/pip-unpack/numpy.whl is invalid.",
}
"""As uv 0.13 and pip 23.2 print them: no server, one that is silent or answers 503, one that breaks off."""


def run_steps(folder: Path, script: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a bash script, in a folder, that has sourced the steps."""
    return subprocess.run(
        ["bash", "-euo", "pipefail", "-c", f'source "{STEPS}"\n{script}', "run", *arguments],
        cwd=folder,
        env={**os.environ, "work": str(folder), "pause": "0"},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60,
    )


def runs(folder: Path) -> int:
    return len((folder / "runs").read_text().splitlines())


@pytest.mark.parametrize("error", DOWNLOAD_ERRORS.values(), ids=DOWNLOAD_ERRORS)
def test_a_failed_download_has_three_tries(tmp_path: Path, error: str) -> None:
    (tmp_path / "get").write_text(FAILS_TWICE)
    done = run_steps(tmp_path, 'download Get 10 sh "$work/get" "$1"', error)
    assert done.returncode == 0, done.stdout + done.stderr
    assert runs(tmp_path) == 3
    assert "=== Get: a download failed; try 3 of 3 begins in 0 s" in done.stdout


def test_another_error_has_one_try(tmp_path: Path) -> None:
    (tmp_path / "get").write_text(FAILS_TWICE)
    done = run_steps(tmp_path, 'download Get 10 sh "$work/get" "CMake Error"')
    assert done.returncode == 1
    assert runs(tmp_path) == 1
    assert "FAILED: Get: exit code 1" in done.stdout


def test_a_step_has_one_try(tmp_path: Path) -> None:
    (tmp_path / "get").write_text(FAILS_TWICE)
    done = run_steps(tmp_path, 'step Get 10 sh "$work/get" "Failed to fetch"')
    assert done.returncode == 1
    assert runs(tmp_path) == 1


TESTS = """
uv=$work/uv  # runs what follows `run --group test`
attempt Tests 10 printf '%s\\n' "2 failed, 1 error, 40 passed in 3.00s (0:00:03)"
again "$work/failures.json"
totals
"""


def look_again(folder: Path, seen: str) -> subprocess.CompletedProcess[str]:
    """Run `again` of the steps, with a stand-in for the script that it calls."""
    stub = folder / "uv"
    stub.write_text(f"#!/bin/sh\nshift 5\n{seen}\n")
    stub.chmod(0o755)
    return run_steps(folder, TESTS)


def test_unsteady_tests_are_in_the_last_lines(tmp_path: Path) -> None:
    done = look_again(tmp_path, 'printf "unsteady: a\\n    why\\nunsteady: b\\n    why\\n" >"$2"')
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.endswith(
        "40 passed, 0 failed, 2 unsteady\nunsteady: a\n    why\nunsteady: b\n    why\n"
    )


def test_a_failure_alone_ends_the_run(tmp_path: Path) -> None:
    seen = 'printf "unsteady: a\\n    why\\n" >"$2"; echo "2 of 3 fail alone"; exit 1'
    done = look_again(tmp_path, seen)
    assert done.returncode == 1
    assert done.stdout.endswith(
        "FAILED: Tests: 2 of 3 fail alone\n40 passed, 2 failed, 1 unsteady\nunsteady: a\n    why\n"
    )


ENDS_ONCE_HURRIED = """
import os, threading, time
from pathlib import Path

AUTOGROUP = Path("/proc/self/autogroup")

def slow():
    share = AUTOGROUP.read_text().split()[-1] if AUTOGROUP.exists() else "0"
    nice = os.getpriority(os.PRIO_PROCESS, 0)
    return os.sched_getscheduler(0) != os.SCHED_OTHER or nice != 0 or share != "0"

def end_once_hurried():
    while slow():
        time.sleep(0.01)

print("began idle" if os.sched_getscheduler(0) == os.SCHED_IDLE else "began as others")
thread = threading.Thread(target=end_once_hurried)
thread.start()
end_once_hurried()
thread.join()
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may raise a priority")
@pytest.mark.parametrize(
    ("begin", "said"), [("idle_beside", "began idle"), ("beside", "began as others")]
)
def test_who_is_waited_for_is_hurried(tmp_path: Path, begin: str, said: str) -> None:
    scripts = tmp_path / ".ci"
    scripts.mkdir()
    (scripts / "hurry.py").symlink_to(STEPS.with_name("hurry.py"))
    (scripts / "spin.py").write_text(ENDS_ONCE_HURRIED)
    (scripts / "job").write_text("timeout 30 python3 -u .ci/spin.py")
    wait = 'until [ -s "$work/job.log" ]; do sleep 0.01; done'  # until it has begun
    done = run_steps(tmp_path, f"{begin} job\n{wait}\nawait job")
    assert done.returncode == 0, done.stdout + done.stderr
    assert said in done.stdout
