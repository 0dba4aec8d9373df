"""`crtk-driver up` as a process, and what it logs."""

from __future__ import annotations

import re
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rigs.programs import COMMAND, Program, Start
from rigs.waiting import LONG


class Up:
    """A running `crtk-driver up`, and what it has logged."""

    def __init__(self, process: Program) -> None:
        self.process = process
        self.lines: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stderr is not None
        self.lines += iter(self.process.stderr.readline, "")

    def until(self, text: str, count: int = 1) -> int:
        """Wait until a line that matches was logged so often; return the number in its last group."""
        deadline = time.monotonic() + LONG
        while True:
            found = self.matching(text)
            if len(found) >= count:
                return int(found[-1][1]) if found[-1].groups() else 0
            assert self.process.poll() is None, f"it has ended: {self.lines}"
            assert time.monotonic() < deadline, f"never: {text}: {self.lines}"
            time.sleep(0.02)

    def matching(self, text: str) -> list[re.Match[str]]:
        """Return what has matched in the lines so far."""
        return [match for line in list(self.lines) if (match := re.search(text, line))]

    def end(self) -> int:
        """Send SIGINT, and return the exit code."""
        self.process.send_signal(signal.SIGINT)
        code = self.process.wait(LONG)
        self._reader.join(LONG)
        return code


@contextmanager
def up(start: Start, folder: Path, text: str, *options: str) -> Iterator[Up]:
    path = folder / "lab.toml"
    path.write_text(text)
    words = ("up", str(path), "--logs", str(folder), *options)
    process = start(COMMAND, *words, stderr=subprocess.PIPE)
    with process:
        try:
            yield Up(process)
        finally:
            process.kill()
