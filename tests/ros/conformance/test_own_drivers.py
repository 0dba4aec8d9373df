"""Our own drivers conform, each as a user starts it, at its simulator."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from crtk_drivers.client.conformance.clause_rows import Needs
from crtk_drivers.client.conformance.clauses import CLAUSES
from crtk_drivers.client.conformance.expectations import Expectations
from crtk_drivers.client.conformance.findings import Verdict
from crtk_drivers.client.conformance.probe.examining import examine
from crtk_drivers.client.conformance.trials import chosen_steps
from rigs.waiting import LONG

MAIN = "import sys; from crtk_drivers.cli import main; sys.exit(main())"
LISTEN = 1.5
QUICK = Expectations(wait=0.15)
TIMED = {"RAT-1", "STA-3", "QOS-3", "CLI-2"}
"""Clauses about time, which a busy machine breaks for the device."""

PATIENT = ("--set", "sample_timeout=3.0")
"""A busy machine is no fault."""
DRIVERS = {
    "loopback": PATIENT,
    "virtual": (*PATIENT, "--set", "rate=100"),
    "ur": ("--sim", *PATIENT, "--set", "watchdog_frequency=2.0", "--set", "frequency=125"),
    "dynamixel": ("--sim", *PATIENT, "--set", "rate=100"),
    "canopen": ("--sim", *PATIENT),
    "robotiq": ("--sim", *PATIENT),
    "onrobot": ("--sim", *PATIENT),
    "ros2-control": ("--sim", *PATIENT),
    "schunk": ("--sim", *PATIENT),
    "weiss-wsg": ("--sim", *PATIENT),
    "schunk-fts": ("--sim", "--sim-set=tcp_port=0", *PATIENT),
    "optoforce": ("--sim", *PATIENT),
    "raven": ("--sim", "--sim-set=port=0", *PATIENT),
    "ati-netft": ("--sim", *PATIENT),
    "ndi": ("--sim", *PATIENT),
    "haply": ("--sim", *PATIENT, "--set", "rate=100"),
    "force-dimension": ("--sim", "--model", "delta.3", *PATIENT, "--set", "rate=100"),
    "openhaptics": ("--sim", *PATIENT, "--set", "rate=100"),
    "inputs": ("--sim", "--link", "spacenavd", *PATIENT),
}
MOVED = ("loopback",)
"""Those that are moved too: simulators of hardware fall behind on a busy machine."""
NOT_MOVED = (
    "ati-netft",
    "force-dimension",
    "haply",
    "inputs",
    "ndi",
    "openhaptics",
    "optoforce",
    "raven",
    "schunk-fts",
)
"""Those that nothing moves: trials of states end where they would look at joints."""
LEAST = {"ndi": 16, "raven": 16}
"""Clauses that have something to look at: what a tracker sees its tools tell, and of Raven its arms."""
MOTION = ("MOV-4", "MOV-12", "MOV-16", "MOV-18", "MOV-22", "STA-13", "BSY-3")
"""Clauses of the trials with joints, which decide others as well."""
STATES = ("STA-5", "MOV-2", "SPT-9")
"""Of the trials of states those that take no command of motion."""
PASSIVE = [each for each in CLAUSES if CLAUSES[each].needs is Needs.PASSIVE]


@contextmanager
def running(name: str, *arguments: str) -> Iterator[str]:
    """Run a driver from the command line; give its namespace."""
    namespace = f"/{name.replace('-', '_')}_{os.getpid()}"
    with subprocess.Popen(
        [sys.executable, "-c", MAIN, name, "--ns", namespace, *arguments],
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    ) as process:
        try:
            assert process.stderr is not None
            told, end = "", time.monotonic() + LONG
            while "connected" not in told:
                line = process.stderr.readline()
                assert line, told
                assert time.monotonic() < end, told
                told += line
            yield namespace
            process.terminate()
            _, rest = process.communicate(timeout=LONG)
            assert "Traceback" not in told + rest
        finally:
            process.kill()


@pytest.mark.ros
@pytest.mark.slow  # the trials of a sound device in test_trials.py are their quick brother
@pytest.mark.timeout(180)
@pytest.mark.parametrize("name", DRIVERS)
def test_it_conforms(name: str) -> None:
    moved = [each for step in chosen_steps(MOTION) for each in step.clauses]
    ids = [*PASSIVE, *STATES, *(moved if name in MOVED else ())]
    with running(name, *DRIVERS[name]) as namespace:
        outcome = examine(namespace, ids, LISTEN, LONG, may_move=True, expected=QUICK)
    found = [e for e in outcome.of(Verdict.DIVERGES) if e.clause.id not in TIMED]
    assert found == []
    assert outcome.ended == "" or name in NOT_MOVED, outcome.ended
    assert len(outcome.of(Verdict.CONFORMS)) >= LEAST.get(name, 20)
