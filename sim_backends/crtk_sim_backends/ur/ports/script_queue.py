"""Scripts between a port and the controller: run in the order of their arrival, once compiled."""

from __future__ import annotations

import logging
from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from crtk_sim_backends.ur.messages import ErrorMessage, ReportLevel
from crtk_sim_backends.ur.program.compilation import LONG_SCRIPT, Compilation

if TYPE_CHECKING:
    from crtk_sim_backends.ur.controller import Controller

WAITING_LIMIT: Final = 100  # scripts; more are refused
READ_ONLY_PORT: Final = 210  # error code: script on a port that is read-only

_REMEMBERED: Final = 20

log = logging.getLogger(__name__)


class ScriptQueue:
    """Hands scripts to a controller; a long one is compiled in another thread before.

    Attributes:
        last: time, length and first line of the last scripts.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._waiting: deque[str] = deque()
        self._compilation: Compilation | None = None
        self.last: deque[dict[str, Any]] = deque(maxlen=_REMEMBERED)

    @property
    def waiting(self) -> bool:
        """Whether one is not run yet."""
        return bool(self._waiting)

    def put(self, script: str) -> None:
        """Take one program or line, and run it at once when it is short and none waits."""
        first_line = script.partition("\n")[0]
        self.last.append(
            {"time": self._controller.time, "length": len(script), "text": first_line[:200]}
        )
        if len(self._waiting) >= WAITING_LIMIT:
            self._refuse(0, f"{WAITING_LIMIT} others wait to be compiled")
        else:
            self._waiting.append(script)
            self.run_compiled()

    def refuse(self, script: str) -> None:
        """Take one from a port that is read-only."""
        self._refuse(READ_ONLY_PORT, "this port is read-only")

    def run_compiled(self) -> None:
        """Run what is ready, and have the next long script compiled."""
        while self._waiting:
            if self._compilation is None and len(self._waiting[0]) > LONG_SCRIPT:
                # `run_script` finds in a cache what this leaves there.
                work = partial(self._controller.prepare_script, self._waiting[0])
                self._compilation = Compilation(work)
                self._compilation.start()
            error = None
            if self._compilation is not None:
                if self._compilation.is_alive():
                    return
                error = self._compilation.error
                self._compilation = None
            script = self._waiting.popleft()
            if error is None:
                self._controller.run_script(script)
            else:
                log.error("a defect of the simulator: a script cannot be compiled", exc_info=error)

    def _refuse(self, code: int, reason: str) -> None:
        text = f"Script refused: {reason}"
        self._controller.post(ErrorMessage(code, 0, ReportLevel.WARNING, text))
