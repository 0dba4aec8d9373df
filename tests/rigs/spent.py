"""What a run of all tests spends its time on, by folder: seconds of workers, and of the processor.

CI prints it, so that whoever wants it shorter sees where to begin.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Final

import pytest

CPU: Final = "cpu"
"""Of the properties of a test's report: seconds of the processor."""
SHOWN: Final = 25
"""Folders that are printed, those that take longest."""


def cpu() -> float:
    """Return the seconds that this process and the children that it waited for have computed.

    Simulators and commands that are forked are children of another process, and do not count.
    """
    return sum(os.times()[:4])


@dataclass
class _Folder:
    tests: int = 0
    seconds: float = 0.0
    cpu: float = 0.0


class Spent:
    """Adds up what tests took: a plugin of the process that hands them out."""

    def __init__(self) -> None:
        self._folders: dict[str, _Folder] = defaultdict(_Folder)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add a setup, a call or a teardown."""
        folder = self._folders[folder_of(report.nodeid)]
        folder.seconds += report.duration
        if report.when == "teardown":
            folder.tests += 1
            folder.cpu += sum(
                value
                for name, value in report.user_properties
                if name == CPU and isinstance(value, float)
            )

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Print the table."""
        terminalreporter.section("what the time went to")
        terminalreporter.write_line("\n".join(self.table()))

    def table(self) -> Iterator[str]:
        """Return a line for each folder, what takes longest first, and one for all of them."""
        whole = _Folder()
        for folder in self._folders.values():
            whole.tests += folder.tests
            whole.seconds += folder.seconds
            whole.cpu += folder.cpu
        longest = sorted(self._folders.items(), key=lambda each: -each[1].seconds)[:SHOWN]
        for name, folder in [*longest, ("in all", whole)]:
            yield (
                f"{folder.seconds:7.0f} s {folder.cpu:7.0f} s of CPU {folder.tests:6} tests  {name}"
            )


def folder_of(test: str) -> str:
    """Return the folder of a test, or its file where that is for all devices."""
    parts = PurePosixPath(test.partition("::")[0]).parts
    whole = parts if "all_devices" in parts else parts[:-1]
    return "/".join(whole) or "."
