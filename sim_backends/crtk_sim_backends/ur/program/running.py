"""One running program: its threads, each resumed once per control period."""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable, Generator
from typing import Any

from crtk_sim_backends.ur.urscript import Halt, Program, ScriptRuntimeError
from crtk_sim_backends.ur.urscript.values import arguments_taken

STEPS_PER_SECOND = 50_000_000
"""How many calls and turns of loops a program may make, per second of control period, before it
counts as an infinite loop: 100,000 in 2 ms, which a legitimate computation stays far below and a
simulator gets over in some hundredths of a second."""

SECONDS_PER_TICK = 0.1
"""Processor time, s, that a program may use in one control period, however few its steps are."""

INFINITE_LOOP = (
    "Runtime error: The program used too much time without instructing the robot what to do. "
    "Consider using a Wait or sync() to split long program sequences that do not move the robot."
)
"""What the controller reports, as users quote it (ur_modern_driver issue 150)."""

_STEPS_BETWEEN_CHECKS = 25

THREAD_LIMIT = 100
"""How many threads a program may run at a time."""

_log = logging.getLogger(__name__)

_ERROR_TEXTS: tuple[tuple[type[Exception], str], ...] = (
    (ZeroDivisionError, "Division by zero"),
    (IndexError, "Index out of range"),
    (RecursionError, "Too many nested function calls"),
    (NameError, "Variable used before it has a value"),
    (AttributeError, "Type error: no such member"),
    (TypeError, "Type error: wrong type of operand or argument"),
    (ValueError, "Value out of range"),
    (OverflowError, "Value out of range"),
)
_WRONG_CALL = re.compile(r"(?:.*\.)?(\w+)\(\) ((?:takes|missing|got) .*)")
_VARIABLE = re.compile(r"'v\d+_(\w+)'")


class _ThreadKilled(Exception):
    """Unwinds a thread that kills itself."""


class ProgramRuntime:
    """Runs a program as cooperating threads.

    :meth:`step` resumes every thread once, in the order in which they were started; a thread that
    is started takes its first step in the same period. The program ends with its main thread.
    Critical sections need no support: a thread is never interrupted between two blocking calls.
    """

    def __init__(self, program: Program, tick_seconds: float) -> None:
        self.program = program
        self.finished = False
        self.current_thread: int | None = None
        """Handle of the thread that is running now; None outside :meth:`step`."""
        self.on_thread_end: Callable[[int], None] | None = None
        """Called with the handle of each thread that ended, was killed or was stopped."""
        self._steps_per_tick = round(STEPS_PER_SECOND * tick_seconds)
        self._steps_left = 0
        self._deadline = 0.0
        self._budget = [0]
        self._threads: dict[int, Generator[None]] = {}
        self._order: list[int] = []
        self._last_handle = 0
        self._main = 0

    def start(self) -> None:
        """Create the main thread; it runs at the next :meth:`step`."""
        if self._last_handle:
            raise RuntimeError(f"program {self.program.name!r} was already started")
        self._main = self._run(self.program.start(self.namespace()))

    def namespace(self) -> dict[str, Any]:
        """Return what code of this execution finds by name, for code that joins it while it runs."""
        return self.program.namespace(
            self._run, self._kill, self._join, self._budget, self._check_use
        )

    @property
    def in_main_thread(self) -> bool:
        """Whether the main thread runs now."""
        return self.current_thread == self._main and self._main != 0

    def step(self) -> None:
        """Let every thread run until it blocks.

        :raises ScriptRuntimeError: with line and column; the program is stopped then.
        """
        self._steps_left = self._steps_per_tick
        self._deadline = time.thread_time() + SECONDS_PER_TICK
        self._budget[0] = _STEPS_BETWEEN_CHECKS
        try:
            for handle in self._order:  # grows while threads start others
                if handle in self._threads:
                    self.current_thread = handle
                    self._resume(handle)
        except Halt:
            self.finished = True
        except Exception as error:
            self.finished = True
            raise self._runtime_error(error) from error
        finally:
            self.current_thread = None
            if self.finished:
                self.stop()
            elif len(self._order) != len(self._threads):
                self._order = list(self._threads)

    def stop(self) -> None:
        """End all threads. Called by a built-in, the calling thread ends when it blocks next."""
        self.finished = True
        for handle in list(self._threads):
            if handle != self.current_thread:
                self._end(handle)

    def _resume(self, handle: int) -> None:
        try:
            next(self._threads[handle])
        except (StopIteration, _ThreadKilled):
            self._end(handle)
            if handle == self._main:
                self.stop()

    def _end(self, handle: int) -> None:
        thread = self._threads.pop(handle, None)
        if thread is None:
            return
        thread.close()
        if self.on_thread_end:
            self.on_thread_end(handle)

    def _run(self, thread: Generator[None]) -> int:
        if len(self._threads) >= THREAD_LIMIT:
            thread.close()
            raise ScriptRuntimeError(f"Too many threads: more than {THREAD_LIMIT}")
        self._last_handle += 1
        self._threads[self._last_handle] = thread
        self._order.append(self._last_handle)
        return self._last_handle

    def _kill(self, handle: Any) -> None:
        """End a thread; a handle of none, such as 0, does no harm."""
        if handle == self.current_thread:
            raise _ThreadKilled
        if handle in self._threads:
            self._end(handle)
            if handle == self._main:
                self.stop()

    def _join(self, handle: Any) -> Generator[None]:
        """Wait for the end of a thread: a period at least, in which the others have their turn."""
        yield
        while handle in self._threads:
            yield

    def _check_use(self) -> None:
        """Let the program make some more steps, or end it as an infinite loop."""
        self._steps_left -= _STEPS_BETWEEN_CHECKS
        if self._steps_left < 0 or time.thread_time() > self._deadline:
            raise ScriptRuntimeError(INFINITE_LOOP)
        self._budget[0] = _STEPS_BETWEEN_CHECKS

    def _runtime_error(self, error: Exception) -> ScriptRuntimeError:
        """Put whatever a thread raised into the controller's words, with the script's position."""
        line, column = self.program.position(error.__traceback__)
        if isinstance(error, ScriptRuntimeError):
            return ScriptRuntimeError(error.text, line, column)
        _log.debug("program %r failed", self.program.name, exc_info=error)
        for kind, text in _ERROR_TEXTS:
            if isinstance(error, kind):
                text = self._call_error(error) or text + _detail(error)
                return ScriptRuntimeError(text, line, column)
        _log.error("built-in of program %r failed", self.program.name, exc_info=error)
        return ScriptRuntimeError("Internal error of a built-in function", line, column)

    def _call_error(self, error: Exception) -> str | None:
        """Say how a built-in is called that got too few or too many arguments."""
        call = _WRONG_CALL.match(str(error)) if isinstance(error, TypeError) else None
        if call is None:
            return None
        for builtin in self.program.builtins.values():
            if builtin.call.__name__ == call[1]:
                return f"Type error: {builtin.name} {arguments_taken(builtin.call)}"
        return None


def _detail(error: Exception) -> str:
    """Return what a Python error says that a script author can use."""
    if isinstance(error, AttributeError) and error.name:
        return f" ({error.name.removeprefix('m_')})"
    if isinstance(error, NameError) and (variable := _VARIABLE.search(str(error))):
        return f" ({variable[1]})"
    return ""
