"""How tests are run: a failure is told, whenever it comes."""

from pathlib import Path

from rigs.inner_pytest import run_pytest

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


HANGS_WHERE_NO_SIGNAL_REACHES_IT = """
import signal, threading

import conftest
import pytest

conftest.AFTER_ITS_TIME = 1.0


@pytest.mark.timeout(1)
def test_it():
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGALRM])
    threading.Event().wait()


@pytest.mark.timeout(60)
def test_another():
    pass
"""


def test_a_failure_is_told_though_the_time_of_its_test_ends_meanwhile(tmp_path: Path) -> None:
    done = run_pytest(tmp_path, FAILS_IN_ITS_LAST_SECOND)
    assert "1 failed" in done.stdout, done.stdout + done.stderr
    assert "ValueError" in done.stdout
    assert "INTERNALERROR" not in done.stdout


def test_what_hangs_inside_a_library_is_ended_and_told(tmp_path: Path) -> None:
    done = run_pytest(tmp_path, HANGS_WHERE_NO_SIGNAL_REACHES_IT, "--numprocesses=1")
    assert "1 failed, 1 passed" in done.stdout, done.stdout + done.stderr
    assert "crashed while running 'test_it.py::test_it'" in done.stdout
    assert "threading.py" in done.stderr, "where it was"
