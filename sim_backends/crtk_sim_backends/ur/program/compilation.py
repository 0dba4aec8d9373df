"""Work that takes longer than a control period, beside the loop."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Final

from typing_extensions import override

LONG_SCRIPT: Final = 1000  # characters; a shorter one is compiled within a period


class Compilation(threading.Thread):
    """Runs `work` once. A daemon: it must not hold up the end of the process.

    Attributes:
        result: what `work` returned; None before its end.
        error: what it raised.
    """

    def __init__(self, work: Callable[[], Any]) -> None:
        super().__init__(name="script compiler", daemon=True)
        self._work = work
        self.result: Any = None
        self.error: Exception | None = None

    @override
    def run(self) -> None:
        """Work."""
        try:
            self.result = self._work()
        except Exception as error:
            self.error = error
