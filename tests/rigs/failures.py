"""What failed in a run of all tests, and how long programs waited for a processor meanwhile.

CI asks for it as a file (`--failures FILE`), and runs each of these tests again, alone. A person reads it in
the last lines of the run.
"""

from __future__ import annotations

import json
import os
from collections.abc import Generator
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import pytest
from xdist.workermanage import WorkerController

from crtk_drivers.labs.bench.pressure import Pressure
from rigs.scheduling import TOLD

ALONE = './crtk-driver --test -m "" -n 0 --lf'
"""Runs what failed last, one test after the other, with nothing beside it."""

WORKER_ENDED = "???"
"""What xdist reports as the phase of a test whose worker is gone."""


class How(StrEnum):
    """How a test failed."""

    FAILED = "failed"
    """As pytest reports it: in its setup, its call or its teardown."""
    OVER_TIME = "over time"
    """It hung, until its worker was ended."""
    WORKER_DIED = "worker died"
    """Its worker ended by itself: killed, or crashed in a library."""


@dataclass(frozen=True)
class Failure:
    """The first failure of one test.

    Attributes:
        test: its node id.
        how: whether it failed by itself, hung, or lost its worker.
        said: the first line of the error.
        waited: share of its time (0 to 1) in which some program waited for a processor.
        load: average number of programs that ran or wanted to, in the last minute.
    """

    test: str
    how: How
    said: str
    waited: float
    load: float


class Failures:
    """Collect the failures of a run: a plugin of the process that hands out the tests.

    Args:
        stderr: descriptor to which the stacks of a test that hung are written.
        file: where the failures are written as JSON, if anywhere.
    """

    def __init__(self, stderr: int, file: Path | None) -> None:
        self._stderr = stderr
        self._file = file
        self._run = Pressure()
        self._tests: dict[str, Pressure] = {}
        self._failures: dict[str, Failure] = {}
        self._over_time: set[WorkerController] = set()
        self._ended: dict[WorkerController, str] = {}

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Measure the pressure from the start of each test."""
        self._tests[nodeid] = Pressure()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep the first failure of each test."""
        if report.when == WORKER_ENDED:
            self._ended.pop(report.node, None)  # type: ignore[attr-defined]
        if report.failed and report.nodeid not in self._failures:
            pressure = self._tests.get(report.nodeid, self._run)
            self._failures[report.nodeid] = Failure(
                report.nodeid,
                self._how(report),
                said(report),
                waited=pressure.share,
                load=os.getloadavg()[0],
            )

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        """Forget a test that is over."""
        self._tests.pop(nodeid, None)

    def pytest_testnodedown(self, node: WorkerController, error: object | None) -> None:
        """Print the stacks that a worker left when one of its tests hung."""
        if error is None:
            return
        self._ended[node] = str(error)
        stacks = stacks_of(node.workerinput, node.gateway.id)
        if stacks.exists() and (text := stacks.read_bytes()):
            self._over_time.add(node)
            os.write(self._stderr, text)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Fail for a worker that ended outside of any test, which xdist does not; write the file."""
        for node, error in self._ended.items():
            name = f"no test of worker {node.gateway.id}"
            self._failures[name] = Failure(
                name, How.WORKER_DIED, error, waited=self._run.share, load=os.getloadavg()[0]
            )
            session.exitstatus = session.exitstatus or pytest.ExitCode.TESTS_FAILED
        if self._file is not None:
            self._file.write_text(json.dumps([asdict(one) for one in self._failures.values()]))

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_terminal_summary(
        self, terminalreporter: pytest.TerminalReporter
    ) -> Generator[None, None, None]:
        """Say, in the last lines, how busy the machine was, and how to run again what failed."""
        yield
        beside_others = terminalreporter.config.pluginmanager.has_plugin("dsession")  # xdist's
        if self._failures and beside_others:
            share = self._run.share
            waited = f"Programs waited for a processor for {share:.0%} of the time. "
            terminalreporter.write_line(
                f"{waited if share > 0.0 else ''}Run what failed again, alone: {ALONE}"
            )

    def _how(self, report: pytest.TestReport) -> How:
        if report.when != WORKER_ENDED:
            return How.FAILED
        worker: WorkerController = report.node  # type: ignore[attr-defined]
        return How.OVER_TIME if worker in self._over_time else How.WORKER_DIED


def said(report: pytest.TestReport) -> str:
    """Return the line of an error that pytest prints in its summary."""
    crash = getattr(report.longrepr, "reprcrash", None)
    lines = (crash.message if crash else report.longreprtext).strip().splitlines()
    return lines[0] if lines else ""


def stacks_of(workerinput: dict[str, Any], worker: str) -> Path:
    """Return where a worker writes its stacks when one of its tests hangs."""
    return Path(workerinput[TOLD], f"{worker}.stacks")
