"""What pytest does in a process that runs tests in worlds."""

from __future__ import annotations

import faulthandler
import importlib.util
import os
import tempfile
from collections.abc import Generator
from functools import partial
from pathlib import Path
from typing import IO, Any, Final, NoReturn

import pytest
from _pytest.assertion.rewrite import AssertionRewritingHook
from _pytest.runner import runtestprotocol

from crtk_drivers.testing.world.hosts import forking
from crtk_drivers.testing.world.hosts.forking import Requests
from crtk_drivers.testing.world.world import World

_MOST: Final = 1 << 20
"""Bytes of what processes printed that a report has."""
_OUTSIDE: Final = ("terminalreporter", "timeout")
"""Plugins that work in the process that asks for the tests: they print, and they measure real time."""


def _code(_: AssertionRewritingHook, name: str) -> Any:
    """Return what `runpy` runs of a module whose assertions pytest has rewritten."""
    spec = importlib.util.find_spec(name)
    assert spec is not None
    assert spec.origin is not None
    return compile(Path(spec.origin).read_bytes(), spec.origin, "exec")


AssertionRewritingHook.get_code = _code  # type: ignore[attr-defined]


class Inside:
    """A plugin: forks at each request, and in the child runs tests as they are asked for.

    Args:
        requests: from whoever asks.
    """

    def __init__(self, requests: Requests) -> None:
        self._requests = requests
        self._request: dict[str, Any] | None = None
        self._items: dict[str, pytest.Item] = {}
        self._reports: list[dict[str, Any]] = []
        self._refused: list[str] = []
        self._phase_began = 0.0
        self._printed: IO[bytes] | None = None
        self._read = 0

    @pytest.hookimpl(tryfirst=True)
    def pytest_cmdline_main(self, config: pytest.Config) -> int:
        """Fork children until whoever asks has gone."""
        forking.serve(self._requests, partial(self._be_world, config))
        return 0

    def _be_world(self, config: pytest.Config, folder: Path) -> None:
        """Let pytest start in the child as it does elsewhere, with the file of the request."""
        self._request = self._requests.read()
        if self._request is None or self._request["test"] is None:
            return
        if config.option.capture != "no":
            self._printed = (folder / forking.PRINTED).open("w+b")
            for standard in (1, 2):  # the files of child processes too, unless they have others
                os.dup2(self._printed.fileno(), standard)
        faulthandler.enable(all_threads=False)
        config.args[:] = [self._request["file"]]
        config.option.basetemp = str(folder / "tests")
        (files := folder / "files").mkdir()
        tempfile.tempdir = str(files)
        others = config.pluginmanager.subset_hook_caller("pytest_cmdline_main", [self])
        code = others(config=config)
        self._requests.answer({"error": f"pytest has ended before the test began, with {code}"})

    @pytest.hookimpl(trylast=True)
    def pytest_configure(self, config: pytest.Config) -> None:
        """Take out the plugins that work in the process that asks."""
        for name in _OUTSIDE:
            if (plugin := config.pluginmanager.getplugin(name)) is not None:
                config.pluginmanager.unregister(plugin)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Keep why a file cannot be collected."""
        if report.failed:
            self._refused.append(report.longreprtext)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> NoReturn:
        """Begin a world, and run in it what is asked for."""
        assert self._request is not None
        if self._refused:
            self._requests.answer({"error": "\n".join(self._refused)})
            forking.leave()
        self._items = {item.nodeid: item for item in session.items}
        world = World(self._request["seed"])
        outcome = world.run(self._serve)
        if outcome.findings:
            phase = ("setup", "call", "teardown")[min(len(self._reports), 2)]
            text = f"{outcome.told()}\n{self._what_was_printed()}".rstrip()
            found = {"reports": self._reports, "found": text, "phase": phase}
            self._requests.answer(found)
        forking.leave()  # nobody looks at a clock any more: the world is over

    def _serve(self, world: World) -> None:
        while self._request is not None and (name := self._request["test"]) is not None:
            item = self._items.get(name)
            if item is None:
                self._requests.answer(
                    {"error": f"{name} is not there when its file is collected anew"}
                )
                return
            following = self._items.get(self._request["next"])
            self._reports = []
            world.kernel.draw_anew(name)
            world.kernel.allow(self._request["limit"])
            self._phase_began = forking.real_clock()
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            self._requests.answer({"reports": self._reports})
            self._request = None if following is None else self._requests.read()

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> bool:
        """Run a test; its reports are for whoever asks."""
        runtestprotocol(item, log=False, nextitem=nextitem)
        return True

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item
    ) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        """Keep a report, with the real time that its phase took."""
        report = yield
        now = forking.real_clock()
        report.duration, self._phase_began = now - self._phase_began, now
        printed = self._what_was_printed()
        if report.failed and printed:
            report.sections.append(("Captured output of processes", printed))
        hook = item.config.hook
        self._reports.append(hook.pytest_report_to_serializable(config=item.config, report=report))
        return report

    def _what_was_printed(self) -> str:
        """Return what the processes of the world have printed since the last call."""
        if self._printed is None:
            return ""
        text = os.pread(self._printed.fileno(), _MOST, self._read).decode(errors="replace")
        self._read = os.fstat(self._printed.fileno()).st_size
        return text
