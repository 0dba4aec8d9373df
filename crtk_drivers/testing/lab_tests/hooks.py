"""The hooks of a session with a lab; see `crtk_drivers.testing.lab_tests`."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import pytest

from crtk_drivers.errors import ConfigError, CrtkError
from crtk_drivers.labs import load_lab
from crtk_drivers.labs.bench import report
from crtk_drivers.labs.bench.bounds import check_bounds
from crtk_drivers.labs.bench.catalogue import QUANTITIES
from crtk_drivers.labs.bench.folder import default_folder
from crtk_drivers.labs.lab_commands import require_commands
from crtk_drivers.labs.lab_file import require_devices
from crtk_drivers.labs.verdicts.judging import Findings, Verdict
from crtk_drivers.ros import environment
from crtk_drivers.testing.lab_tests import FILE
from crtk_drivers.testing.lab_tests.lab_fixtures import SESSION, UNDER_WAY
from crtk_drivers.testing.lab_tests.session import LabSession, verdict_of

__all__ = ["begun"]

_REFUSED: Final = (
    ("numprocesses", (None, 0), "two tests at once (pytest-xdist): give -n 0"),
    ("workers", (None, 1, "1"), "two tests at once (pytest-parallel): leave --workers out"),
    ("parallel_threads", (None, 0, 1), "two tests at once: leave --parallel-threads out"),
    ("reruns", (None, 0), "a test again (pytest-rerunfailures): leave --reruns out"),
    ("count", (None, 1), "a test again (pytest-repeat): leave --count out"),
)
"""Options of other plugins, what of them is no matter, and what they would do."""

_REFUSED_MARKS: Final = ("flaky", "repeat")

_MACHINE: Final = "--lab-machine"

_FIXTURES: Final = ("lab", "measure")

_VERDICT: Final = "crtk_verdict"
"""Attribute of a report."""


def begun(config: pytest.Config) -> LabHooks:
    """Return the hooks of a session.

    Raises:
        UsageError: the lab file cannot be used, or another plugin would repeat tests or run them at once.
    """
    for option, harmless, does in _REFUSED:
        if config.getoption(option, None) not in harmless:
            raise pytest.UsageError(
                f"the devices of a lab may move, and something would run {does}"
            )
    if hasattr(config, "workerinput"):
        raise pytest.UsageError("the devices of a lab are not tested in a worker of pytest-xdist")
    try:
        lab = load_lab(
            config.getoption(FILE),
            sim=config.getoption("--lab-sim"),
            machine=config.getoption(_MACHINE),
        )
        require_devices(lab)
        require_commands(lab, programs=False)
        check_bounds(lab, QUANTITIES)
        environment.adopt(lab.environment)  # for drivers, simulators and clients
    except CrtkError as error:
        said = str(error).replace("--machine", _MACHINE)
        raise pytest.UsageError(said) from error
    out = config.getoption("--lab-out")
    folder = Path(out) if out else default_folder(lab)
    session = LabSession(lab, folder, config.getoption("--may-move"))
    config.stash[SESSION] = session
    return LabHooks(session, lab.left_out)


class LabHooks:
    """The plugin that is there when a lab is.

    Args:
        session: of it.
        left_out: devices of other machines, in words.
    """

    def __init__(self, session: LabSession, left_out: str) -> None:
        self._session = session
        self._left_out = left_out
        self._verdicts: list[tuple[str, Findings]] = []
        self._seen: set[str] = set()

    def pytest_report_header(self) -> list[str]:
        """Name the devices of the lab that are not tested."""
        return [f"left out of the lab: {self._left_out}"] if self._left_out else []

    # ----------------------------------------------------------------------------------- order

    @pytest.hookimpl(hookwrapper=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> Generator[None]:
        """Refuse what would repeat a test, or run them in another order than they were written in."""
        written = {item.nodeid: index for index, item in enumerate(items)}
        yield
        for item in items:
            for mark in _REFUSED_MARKS:
                if _is_of_lab(item) and item.get_closest_marker(mark):
                    raise pytest.UsageError(
                        f"{item.nodeid}: the mark {mark} repeats a test, whose devices may move"
                    )
        order = [item for item in items if _is_of_lab(item)]
        for before, item in pairwise(order):
            if written[before.nodeid] > written[item.nodeid]:
                raise pytest.UsageError(
                    f"{item.nodeid} would run after {before.nodeid}, which comes later in the files: "
                    "the tests of a lab keep their order. Leave the plugin or option out that changes it"
                )

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None]:
        """Hold and leave what a test commanded, however it ended, and keep what it found."""
        if not _is_of_lab(item):
            yield
            return
        test = self._session.test(item.nodeid, _title(item))
        item.stash[UNDER_WAY] = test
        yield
        self._session.ended(test)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        """Skip what needs something that is not there; carry nothing out twice."""
        if not _is_of_lab(item):
            return
        if item.nodeid in self._seen:
            pytest.fail("it would run again, and the devices of a lab may move", pytrace=False)
        self._seen.add(item.nodeid)
        names = [str(name) for mark in item.iter_markers("needs") for name in mark.args]
        missing = [name for name in names if not self._session.has(name)]
        if missing:
            pytest.skip(f"the lab has no {', no '.join(missing)}")

    # ---------------------------------------------------------------------------------- verdicts

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item, call: pytest.CallInfo[None]
    ) -> Generator[None, Any]:
        """Let what was measured decide, where nothing else has."""
        outcome = yield
        if not _is_of_lab(item):
            return
        found = outcome.get_result()
        test = item.stash[UNDER_WAY]
        error = None if call.excinfo is None else call.excinfo.value
        if call.when == "teardown":
            test.left = error
            return
        if error is None and call.when == "setup":
            return
        findings = test.judged(error)
        verdict = Verdict.SKIPPED if found.skipped else verdict_of(findings)
        setattr(found, _VERDICT, verdict)
        if found.skipped:
            test.skipped = str(found.longrepr[2]).removeprefix("Skipped: ")
        elif error is None and verdict is Verdict.FAIL:
            found.outcome, found.longrepr = "failed", findings.reason
        elif verdict is Verdict.INCONCLUSIVE and (error is None or _is_of_device(error)):
            path, line, _ = item.location
            found.outcome, found.longrepr = "skipped", (path, line or 0, findings.reason)
        if verdict is Verdict.INCONCLUSIVE:
            self._verdicts.append((item.nodeid, findings))

    def pytest_report_teststatus(
        self, report: pytest.CollectReport | pytest.TestReport
    ) -> tuple[str, str, tuple[str, Mapping[str, bool]]] | None:
        """Tell what is not decided by its name."""
        is_open = getattr(report, _VERDICT, None) is Verdict.INCONCLUSIVE
        if not is_open or report.outcome == "failed":
            return None
        return "inconclusive", "I", ("INCONCLUSIVE", {"yellow": True})

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(
        self, session: pytest.Session, exitstatus: int | pytest.ExitCode
    ) -> None:
        """Leave the devices and keep the run; end with 1 where nothing is decided, or cannot be kept.

        Fixtures that an interrupt left as they were end after this: they move nothing any more.
        """
        self._session.leave()
        interrupted = exitstatus == pytest.ExitCode.INTERRUPTED
        self._session.finish("stopped by the operator" if interrupted else "")
        inconclusive_ok = session.config.getoption("--inconclusive-ok")
        code = self._session.exit_code(inconclusive_ok=inconclusive_ok)
        if code and exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Print what is not decided, what became worse, and where everything is."""
        run = self._session.run
        if run is None:
            return
        terminalreporter.section(f"lab {run.lab}")
        for nodeid, findings in self._verdicts:
            terminalreporter.write_line(f"INCONCLUSIVE {nodeid}: {findings.reason}", yellow=True)
        for device, test in run.tests:
            for found in test.measurements:
                if found.regressed:
                    told = f"{device.name} {found.id}: worse than it was: {found.regressed}"
                    terminalreporter.write_line(told, yellow=True)
        terminalreporter.write_line(f"{run.verdict}: {report.summary(run)}")
        if self._session.trouble:
            terminalreporter.write_line(self._session.trouble, red=True)
        else:
            terminalreporter.write_line(f"Report: {self._session.folder / 'report.html'}")


def _is_of_lab(item: pytest.Item) -> bool:
    """Whether a test has to do with the lab, by a fixture of its own or of what it uses."""
    names: Sequence[str] = getattr(item, "fixturenames", ())
    return any(name in names for name in _FIXTURES)


def _is_of_device(error: BaseException) -> bool:
    """Whether an error is of a device, and none of the test."""
    return isinstance(error, CrtkError) and not isinstance(error, ConfigError)


def _title(item: pytest.Item) -> str:
    """Return what a test is called: the first line of its docstring, or its name."""
    text = (getattr(getattr(item, "obj", None), "__doc__", None) or "").strip()
    return text.partition("\n")[0].rstrip(".") or item.name
