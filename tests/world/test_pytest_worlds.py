"""Tests that are marked `world`: pytest says of them what it says in real time, and sooner."""

from __future__ import annotations

import re
import time
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from rigs.inner_pytest import run_pytest

LONG_DAY = """
import time

import pytest

pytestmark = [pytest.mark.world, pytest.mark.timeout(4000)]


@pytest.fixture(scope="module")
def begun():
    return time.monotonic()


def test_it_waits_for_an_hour(begun):
    time.sleep(3600.0)


def test_it_knows_what_the_module_shares(begun):
    assert time.monotonic() - begun >= 3600.0
"""

EVERY_OUTCOME = """
import pytest

pytestmark = pytest.mark.world


@pytest.fixture
def broken():
    raise OSError("it cannot be set up")


@pytest.fixture
def breaks():
    yield
    raise OSError("it cannot be torn down")


def test_it_passes(): ...


def test_it_fails():
    print("what it printed")
    assert [1, 2] == [1, 3]


@pytest.mark.skip("not here")
def test_it_is_skipped(): ...


def test_it_skips_itself():
    pytest.skip("not now")


@pytest.mark.xfail
def test_it_fails_as_expected():
    assert False


def test_it_has_no_fixture(broken): ...


def test_its_fixture_does_not_end(breaks): ...
"""

MIXED = """
import threading

import pytest


@pytest.fixture(scope="module")
def where():
    yield "world" if "testing.world" in threading.Lock.__module__ else "here"


@pytest.mark.world
def test_one_in_the_world(where):
    assert where == "world"


def test_one_here(where):
    assert where == "here"


@pytest.mark.world
def test_another_in_the_world(where):
    assert where == "world"


def test_another_here(where):
    assert where == "here"
"""

STUCK = """
import ctypes, os, threading, time

import pytest

pytestmark = pytest.mark.world


def test_it_waits_for_ever():
    threading.Event().wait()


def test_it_takes_too_long():
    while True:
        time.sleep(1.0)


def test_it_computes_for_ever():
    def count_for_ever():
        while True:
            pass
    count_for_ever()


def test_it_crashes():
    ctypes.string_at(0)


def test_a_thread_of_it_dies():
    thread = threading.Thread(target=int, args=("no number",))
    thread.start()
    thread.join()


def test_it_asks_for_what_is_not_there():
    os.fork()


def test_the_next_one_passes(): ...
"""

PROGRAM = """
import subprocess, sys

import pytest


@pytest.mark.world
def test_it(capsys):
    print("ours")
    code = "import sys; print('theirs'); print('wrong', file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("theirs\\n", "wrong\\n")
    assert capsys.readouterr().out == "ours\\n"
"""

UNHEARD = """
import subprocess, sys

import pytest

pytestmark = pytest.mark.world


def test_it_passes():
    subprocess.run([sys.executable, "-c", "print('nobody asks')"], check=True)


def test_it_fails():
    subprocess.run([sys.executable, "-c", "print('this tells why')"], check=True)
    assert False
"""

ORDER = """
import threading, time

import pytest


@pytest.mark.world
def test_it():
    order = []
    threads = [threading.Thread(target=order.append, args=(number,)) for number in range(9)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert order == (order, time.monotonic_ns())
"""


def run(folder: Path, source: str, *arguments: str) -> CompletedProcess[str]:
    return run_pytest(folder, source, "-p", "no:randomly", *arguments)


def result(done: CompletedProcess[str]) -> str:
    """Return how many did what, without the time that it took."""
    return done.stdout.splitlines()[-1].partition(" in ")[0]


def test_an_hour_takes_seconds(tmp_path: Path) -> None:
    begun = time.monotonic()
    done = run(tmp_path, LONG_DAY)
    assert result(done) == "2 passed", done.stdout + done.stderr
    assert time.monotonic() - begun < 600.0


def test_outcomes_are_those_of_real_time(tmp_path: Path) -> None:
    world, here = (run(tmp_path, EVERY_OUTCOME, *how) for how in (("-ra",), ("-ra", "--real-time")))
    expected = "1 failed, 2 passed, 2 skipped, 1 xfailed, 2 errors"
    assert result(world) == result(here) == expected, world.stdout + world.stderr
    for text in ("assert [1, 2] == [1, 3]", "At index 1 diff: 2 != 3", "what it printed"):
        assert text in world.stdout
    summary = re.compile(r"^(?:FAILED|ERROR|SKIPPED|XFAIL) .*", re.MULTILINE)
    assert summary.findall(world.stdout) == summary.findall(here.stdout)


@pytest.mark.parametrize("workers", [(), ("-n", "2")])
def test_both_kinds_share_a_file(tmp_path: Path, workers: tuple[str, ...]) -> None:
    done = run(tmp_path, MIXED, *workers)
    assert result(done) == "4 passed", done.stdout + done.stderr


def test_what_is_stuck_says_where(tmp_path: Path) -> None:
    done = run(tmp_path, STUCK, "-o", "timeout=8")
    assert result(done) == "6 failed, 1 passed", done.stdout + done.stderr
    for text in (
        "all wait for ever",
        "test_it.py:10 test_it_waits_for_ever",
        "not done at the horizon",
        "test_it_computes_for_ever > ",
        "count_for_ever",
        "the process of a world has ended: SIGSEGV",
        "Segmentation fault",
        "a thread died",
        "invalid literal for int() with base 10: 'no number'",
        "NotSimulated: os.fork",
    ):
        assert text in done.stdout, text
    assert "INTERNALERROR" not in done.stdout


def test_what_a_program_prints_is_its_own(tmp_path: Path) -> None:
    done = run(tmp_path, PROGRAM)
    assert result(done) == "1 passed", done.stdout + done.stderr


def test_what_a_program_prints_is_shown_of_failures(tmp_path: Path) -> None:
    done = run(tmp_path, UNHEARD)
    assert result(done) == "1 failed, 1 passed", done.stdout + done.stderr
    assert "this tells why" in done.stdout
    assert "nobody asks" not in done.stdout + done.stderr
    shown = run(tmp_path, UNHEARD, "-s")
    assert "nobody asks" in shown.stdout + shown.stderr


def test_a_seed_gives_the_same_order_again(tmp_path: Path) -> None:
    runs = [run(tmp_path, ORDER, *how) for how in ((), (), ("--world-seed", "7"))]
    first, again, other = (re.findall(r"assert \[.*", each.stdout)[0] for each in runs)
    assert first == again != other


def test_only_what_is_asked_for_runs(tmp_path: Path) -> None:
    done = run(tmp_path, EVERY_OUTCOME, "-k", "passes or fails", "-x")
    assert "stopping after 1 failures" in done.stdout, done.stdout + done.stderr
    assert result(done) == "1 failed, 1 passed, 4 deselected"


def test_a_file_that_a_world_cannot_import_says_why(tmp_path: Path) -> None:
    source = "import threading\n\nimport pytest\n\n" + (
        "if 'testing.world' in threading.Lock.__module__:\n    raise ImportError('not there')\n\n\n"
        "@pytest.mark.world\ndef test_it(): ...\n\n\n@pytest.mark.world\ndef test_another(): ...\n"
    )
    done = run(tmp_path, source)
    assert result(done) == "2 failed", done.stdout + done.stderr
    assert "ImportError: not there" in done.stdout
