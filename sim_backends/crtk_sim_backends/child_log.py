"""What a process writes to standard error becomes log records of the process that started it.

Written straight to a terminal it would land in the middle of a status line that is rewritten there, and
between the objects of a log in JSON.
"""

from __future__ import annotations

import logging
import os
import re
import threading
from typing import Final

FORMAT: Final = "%(levelname)s %(name)s: %(message)s"
"""How a process writes its records, so that they are records again here."""

_RECORD: Final = re.compile(r"(DEBUG|INFO|WARNING|ERROR|CRITICAL) ([\w.]+): (.*)")
_JOINED_WITHIN: Final = 1.0
_LONGEST: Final = 16384
"""Characters of a line; of a longer one each part is a record."""


class ChildLog:
    """Logs each line that comes from a pipe, by a thread of its own, until the other end is closed.

    Args:
        called: what stands before each line, as it is another process.
        errors: descriptor of our end of the pipe, which is closed at the end.

    Attributes:
        last: line that was read.
    """

    def __init__(self, called: str, errors: int) -> None:
        self._called = called
        self.last = "none"
        self._thread = threading.Thread(
            target=self._run, args=(errors,), name=f"log of {called}", daemon=True
        )
        self._thread.start()

    def join(self) -> None:
        """Wait until all is logged that was written by a process that has ended."""
        if threading.current_thread() is not self._thread:
            self._thread.join(_JOINED_WITHIN)

    def _run(self, errors: int) -> None:
        with os.fdopen(errors, encoding="utf-8", errors="replace") as lines:
            for line in iter(lambda: lines.readline(_LONGEST), ""):
                if line := line.rstrip():
                    self.last = line.strip()
                    self._log(line)

    def _log(self, line: str) -> None:
        found = _RECORD.fullmatch(line)
        level, name, text = found.groups() if found else ("WARNING", __name__, line)
        logger = logging.getLogger(name)
        logger.log(logging.getLevelNamesMapping()[level], "%s: %s", self._called, text)
