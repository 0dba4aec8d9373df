"""Tests in worlds: pytest runs each test that is marked ``world`` on a simulated machine, in virtual time.

This is an entry point (``pytest11``), which every pytest of the environment imports: it imports little.
Tests of a file that follow each other share a world, and so the fixtures of their module. Another process
runs them (`pytest_host`) and sends back its reports.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any, Final
from zlib import crc32

import pytest

from crtk_drivers.testing import world

if TYPE_CHECKING:
    from crtk_drivers.testing.world.hosts.host_process import HostProcess

MARKER: Final = "world"
LIMIT: Final = 120.0
"""s of the world that a test may take, unless the marker or the setting `timeout` says otherwise."""
_EXPECTED: Final = ("pytest.PytestAssertRewriteWarning", "RuntimeWarning:runpy")
"""Warnings to ignore in worlds: modules are imported before pytest, and before a child process runs them."""
_NEVER: Final = ("crtk_drivers.testing.world",)
"""Modules that are not imported before worlds are forked: rclpy cannot be in one."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("crtk-world", "tests on a simulated machine (crtk-drivers)")
    group.addoption(
        "--real-time",
        action="store_true",
        help="Run tests that are marked `world` on this machine. So do --pdb, and all systems but Linux.",
    )
    group.addoption(
        "--world-seed",
        metavar="N",
        type=int,
        help="Another order in which threads of marked tests take turns. Default: the same each time.",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Register the marker, and what runs marked tests in worlds."""
    config.addinivalue_line(
        "markers", f"{MARKER}: runs on a simulated machine, in virtual time (crtk_drivers.testing)"
    )
    in_real_time = config.option.real_time or config.option.usepdb or sys.platform != "linux"
    if not (world.is_here() or in_real_time):
        config.pluginmanager.register(_Worlds(config))


class _Worlds:
    """Has marked tests run in worlds, by one process that is started for the first of them."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._host: HostProcess | None = None
        self._expected = ""
        """Node id of the test that the world waits for which is there; empty if there is none."""

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(
        self, item: pytest.Item, nextitem: pytest.Item | None
    ) -> bool | None:
        """Run a marked test in a world, and report it here."""
        if not _is_marked(item):
            return None
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        for report in (*self._run(item, nextitem), *_torn_down(item, nextitem)):
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def pytest_unconfigure(self) -> None:
        """End the process that runs worlds."""
        self._close()

    def _run(self, item: pytest.Item, following: pytest.Item | None) -> Iterator[pytest.TestReport]:
        from crtk_drivers.testing.world.hosts.host_process import WorldError

        begun = time.perf_counter()
        if following is not None and not (_is_marked(following) and following.path == item.path):
            following = None
        try:
            answer = self._ask(item, following)
        except WorldError as error:
            self._close()
            yield _failure(item, "call", str(error), begun)
            return
        except pytest.fail.Exception as error:  # its time is over, says pytest-timeout
            where = "" if self._host is None else self._host.where_it_hangs()
            self._close()
            yield _failure(item, "call", f"{error.msg}{where}", begun)
            return
        except BaseException:
            self._close()
            raise
        self._expected = "" if following is None or "found" in answer else following.nodeid
        for data in answer["reports"]:
            if isinstance(data["longrepr"], list):  # of a test that was skipped
                data["longrepr"] = tuple(data["longrepr"])
            yield self._config.hook.pytest_report_from_serializable(config=self._config, data=data)
        if "found" in answer:
            yield _failure(item, answer["phase"], answer["found"], begun)

    def _ask(self, item: pytest.Item, following: pytest.Item | None) -> dict[str, Any]:
        if self._host is None:
            self._host = self._started()
        if self._expected not in ("", item.nodeid):
            self._host.send({"test": None})  # the world that is there ends
        file = item.nodeid.partition("::")[0]
        chosen = self._config.option.world_seed
        self._host.send(
            {
                "file": str(item.path),
                "seed": crc32(file.encode()) if chosen is None else chosen,
                "test": item.nodeid,
                "next": None if following is None else following.nodeid,
                "limit": _limit(item),
            }
        )
        return self._host.receive()

    def _started(self) -> HostProcess:
        from crtk_drivers.testing.world.hosts.host_process import HostProcess

        option = self._config.option
        arguments = [
            *("--rootdir", str(self._config.rootpath)),
            *(("-c", str(self._config.inipath)) if self._config.inipath else ()),
            *("-o", "addopts=", "--import-mode", option.importmode, "-m", option.markexpr),
            *("--tb", option.tbstyle, "--capture", "no" if option.capture == "no" else "sys"),
            *(word for name in option.plugins for word in ("-p", name)),
            *("-p", "no:cacheprovider", "-p", "no:faulthandler"),
            *(word for warning in _EXPECTED for word in ("-W", f"ignore::{warning}")),
            *(("-" + "v" * option.verbose,) if option.verbose > 0 else ()),
            *dict.fromkeys(each.partition("::")[0] for each in self._config.args),
        ]
        return HostProcess(
            "tests",
            "crtk_drivers.testing.world.hosts.pytest_host",
            [json.dumps({"arguments": arguments, "preload": _modules()})],
            {"PYTEST_ADDOPTS": ""},
        )

    def _close(self) -> None:
        if self._host is not None:
            self._host.close()
            self._host = None
        self._expected = ""


def _is_marked(item: pytest.Item) -> bool:
    return item.get_closest_marker(MARKER) is not None


def _limit(item: pytest.Item) -> float:
    """Return the s of the world that a test may take; pytest-timeout has the same of real time."""
    marker = item.get_closest_marker("timeout")
    if marker is not None and marker.args:
        return float(marker.args[0])
    try:
        return float(item.config.getini("timeout") or LIMIT)
    except (KeyError, ValueError):  # pytest-timeout is not installed
        return LIMIT


def _modules() -> list[str]:
    """Return the modules of drivers and simulators that the tests of this process have imported."""
    packages = {"crtk_drivers", "crtk_sim_backends"}
    packages |= {
        each.value.partition(":")[0].partition(".")[0]
        for each in entry_points(group="crtk_drivers.devices")
    }
    return sorted(
        name
        for name in sys.modules
        if name.partition(".")[0] in packages and not name.startswith(_NEVER)
    )


def _torn_down(item: pytest.Item, following: pytest.Item | None) -> Iterator[pytest.TestReport]:
    """End the fixtures here that the following test does not share; report what fails."""
    call = pytest.CallInfo.from_call(
        lambda: item.session._setupstate.teardown_exact(following),  # noqa: SLF001 - as pytest's runner does
        "teardown",
        reraise=(pytest.exit.Exception, KeyboardInterrupt),
    )
    if call.excinfo is not None:
        yield pytest.TestReport.from_item_and_call(item, call)


def _failure(item: pytest.Item, phase: Any, text: str, begun: float) -> pytest.TestReport:
    """Return the report of a failure that the pytest in the world could not report itself."""
    return pytest.TestReport(
        nodeid=item.nodeid,
        location=item.location,
        keywords={item.name: 1},
        outcome="failed",
        longrepr=text,
        when=phase,
        duration=time.perf_counter() - begun,
    )
