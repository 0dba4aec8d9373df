"""Run again, alone, each test that failed: a broken promise fails alone too, a busy machine's test passes.

    python .ci/again.py FAILURES UNSTEADY

FAILURES is the file that `pytest --failures FAILURES` wrote. Each of its tests runs up to three times, in a
process of its own with nothing beside it, until it fails once. A test that passes three times is unsteady: it
gets three lines in the file UNSTEADY, of which the last says what to write into tests/UNSTEADY.md.

Exit code 0: all tests are unsteady. Exit code 1: at least one fails alone. It is 1 too, and no test runs,
where more than 20 tests failed or a worker died by itself: no second try explains that.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from datetime import date
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import ledger

AT_MOST = 20
"""Failures that are looked at one by one."""
TRIES = 3
PATIENCE = 600.0
"""Seconds for one try. pytest ends a test after its own, shorter time, unless it hangs in a library."""


def passes_alone(test: str, log: Path) -> bool:
    """Run one test, and return True if it passed. No process that it started outlives the try."""
    results = log.with_suffix(".xml")
    results.unlink(missing_ok=True)
    arguments = ["-m", "", "-n", "0", "-q", "-p", "no:cacheprovider", f"--junitxml={results}", test]
    with log.open("wb") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", "pytest", *arguments],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            code = process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            output.write(f"ended after {PATIENCE:.0f} s\n".encode())
            return False
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    return code == 0 and passed(results) > 0


def passed(results: Path) -> int:
    """Return how many tests passed, by pytest's JUnit file. A skipped test has kept no promise."""
    counts = ElementTree.parse(results).getroot()[0].attrib
    return int(counts["tests"]) - sum(int(counts[bad]) for bad in ("errors", "failures", "skipped"))


def why_not_again(failures: list[dict[str, Any]]) -> str | None:
    """Return why no second try is worth it, if so."""
    if len(failures) > AT_MOST:
        return f"{len(failures)} tests failed: more than {AT_MOST} are not run again"
    for failure in failures:
        if failure["how"] == "worker died":
            return f"{failure['test']} ended its worker: {failure['said']}"
    return None if failures else "pytest failed, but no test did"


def main() -> None:
    """Run the tests again, print each result as it comes, and exit."""
    failures = json.loads(Path(sys.argv[1]).read_text())
    unsteady = Path(sys.argv[2])
    unsteady.touch()
    if reason := why_not_again(failures):
        sys.exit(reason)
    known = ledger.read(ledger.LEDGER.read_text())
    alone: list[str] = []
    with tempfile.TemporaryDirectory() as folder, unsteady.open("a") as file:
        log = Path(folder, "try.log")
        for failure in failures:
            test, begin = failure["test"], time.monotonic()
            tries = range(1, TRIES + 1)
            failed = next((one for one in tries if not passes_alone(test, log)), None)
            seconds = time.monotonic() - begin
            if failed is not None:
                alone.append(test)
                print(f"fails alone, at try {failed} of {TRIES} ({seconds:.0f} s): {test}")
                print("".join(f"    {line}\n" for line in log.read_text().splitlines()), flush=True)
                continue
            result = f"unsteady, passes alone {TRIES} of {TRIES} times ({seconds:.0f} s)"
            print(f"{result}: {test}", flush=True)
            busy = f"programs waited for a processor for {failure['waited']:.0%} of its time"
            sighting = f"{date.today()}, load {failure['load']:.0f}, waited {failure['waited']:.0%}"
            file.write(f"unsteady: {test}\n    {failure['how']}, while {busy}: {failure['said']}\n")
            file.write(f"    {ledger.advice(test, sighting, known)}\n")
    print(f"{len(alone)} of {len(failures)} fail alone{': ' if alone else ''}{', '.join(alone)}")
    sys.exit(bool(alone))


main()
