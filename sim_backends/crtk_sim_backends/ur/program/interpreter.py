"""Interpreter mode: statements of a client join the running program, while it is in `interpreter_mode()`.

Sources: script manual 5.x, chapter "Interpreter Mode" (functions, commands, replies, numbers, scope);
UR's article "Interpreter mode" (port, first software); for the reasons of a discard, of which the
manual names none, clients that look for UR's words, and the manual of Elite's CS controller, whose
interpreter mode is the same but for "task" in place of "program".
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from crtk_sim_backends.ur.program.compilation import LONG_SCRIPT, Compilation
from crtk_sim_backends.ur.urscript import (
    Builtin,
    CompileError,
    Enclosing,
    ScriptRuntimeError,
    Statement,
    Statements,
)

if TYPE_CHECKING:
    from crtk_sim_backends.ur.clock import Clock
    from crtk_sim_backends.ur.program.player import ProgramPlayer
    from crtk_sim_backends.ur.program.running import ProgramRuntime

NOT_RUNNING: Final = "Program is in an invalid state"
SYNTAX_ERROR: Final = "Syntax error"
COMPILE_ERROR: Final = "Compile error"
TOO_MANY: Final = "Too many interpreted messages"
CLEANED_UP: Final = "Cleaned up before interpretation"

STATEMENT_LIMIT: Final = 8500
"""Lines that may be interpreted between two clearings, and that may wait: that of Elite's controller.
The manual of UR says only that there is one."""

SIZE_LIMIT: Final = 1 << 22  # characters that may be interpreted between two clearings, and wait

LINES_PER_PERIOD: Final = 4  # that are compiled in one control period
STATEMENTS_PER_PERIOD: Final = 100  # that are executed in one control period

_HOLDING: Final = frozenset({"clear_interpreter", "end_interpreter"})
"""A line that calls these is executed before the next is interpreted."""

Reply = Callable[[str], None]


@dataclass(frozen=True)
class _Line:
    """A line that is not interpreted yet."""

    text: str
    reply: Reply

    def discard(self, reason: str) -> None:
        self.reply(f"discard: {reason}: {self.text}")


@dataclass(frozen=True)
class _Accepted:
    """A line that is interpreted."""

    number: int
    statement: Statement

    @property
    def holds(self) -> bool:
        """Whether what follows must wait for its execution."""
        return bool(self.statement.calls & _HOLDING)


@dataclass
class _Mode:
    """One call of `interpreter_mode`."""

    clear_on_end: bool
    ended: bool = False


class _Execution:
    """The interpreter of one execution of a program."""

    def __init__(self, runtime: ProgramRuntime) -> None:
        self.runtime = runtime
        self.threads: set[int] = set()
        namespace = runtime.namespace()
        self._run, self._kill = namespace["run"], namespace["kill"]
        self.statements = Statements(runtime.program, {**namespace, "run": self._run_thread})
        self.mode: _Mode | None = None
        self.lines: deque[_Line] = deque()
        self.waiting_size = 0  # characters of these
        self.accepted: deque[_Accepted] = deque()
        self.executing: _Accepted | None = None
        self.count = 0  # lines interpreted since the last clearing
        self.size = 0  # characters of these
        self.last_interpreted = 0
        self.last_executed = 0
        self.last_cleared = 0
        self._compilation: Compilation | None = None
        self._compiled: tuple[_Line, object] | None = None  # what that compiles, and in which scope

    @property
    def held(self) -> bool:
        """Whether nothing may be interpreted before the last line is executed."""
        last = self.accepted[-1] if self.accepted else self.executing
        return last is not None and last.holds

    @property
    def full(self) -> bool:
        """Whether it must be cleared before more can be interpreted."""
        return self.count >= STATEMENT_LIMIT or self.size >= SIZE_LIMIT

    @property
    def unexecuted(self) -> int:
        """Lines that `skipbuffer` would skip."""
        return len(self.lines) + len(self.accepted)

    def put(self, line: _Line) -> None:
        """Take a line that is to be interpreted."""
        if len(self.lines) >= STATEMENT_LIMIT or self.waiting_size >= SIZE_LIMIT:
            line.discard(TOO_MANY)
            return
        self.lines.append(line)
        self.waiting_size += len(line.text)

    def take(self) -> _Line:
        """The line that has waited for longest."""
        line = self.lines.popleft()
        self.waiting_size -= len(line.text)
        return line

    def discard_lines(self, reason: str) -> None:
        """Discard all lines that wait."""
        while self.lines:
            self.take().discard(reason)

    def compiled(self, line: _Line) -> Statement | CompileError | None:
        """What a line compiles to; None while that is not known yet."""
        wanted = line, self.statements.scope
        if self._compilation is not None:
            if self._compilation.is_alive():  # also when its line was skipped: one text at a time
                return None
            compilation, self._compilation = self._compilation, None
            if compilation.error is not None:
                raise compilation.error
            if self._compiled == wanted:  # neither skipped nor in a scope that has gone
                result: Statement | CompileError = compilation.result
                return result
        if len(line.text) <= LONG_SCRIPT:
            return self._compile(line.text)
        self._compiled = wanted
        self._compilation = Compilation(partial(self._compile, line.text))
        self._compilation.start()
        return None

    def _compile(self, text: str) -> Statement | CompileError:
        try:
            return self.statements.compile(text)
        except CompileError as error:
            return error

    def clear(self) -> None:
        """Forget what was interpreted, and end the threads that it started."""
        for handle in self.threads:
            self._kill(handle)
        self.threads.clear()
        self.statements.clear()
        self.count = self.size = 0
        self.last_cleared = self.last_interpreted

    def _run_thread(self, thread: Generator[None]) -> int:
        handle: int = self._run(thread)
        self.threads.add(handle)
        return handle


class Interpreter:
    """Takes lines, replies to them, and executes them where the program waits for them.

    Args:
        player: runs the program.
        clock: of the controller.
        note: enters a text in the log.
        abort: stops the running `movej` or `movel`.
    """

    def __init__(
        self,
        player: ProgramPlayer,
        clock: Clock,
        note: Callable[[str], None],
        abort: Callable[[], None],
    ) -> None:
        self._player = player
        self._clock = clock
        self._note = note
        self._abort = abort
        self._latest: _Execution | None = None
        self._tick = -1
        self._left = 0  # lines that may be compiled in that period
        player.ended.append(self._program_ended)
        self._commands: dict[str, Callable[[], str]] = {
            "abort": self._do_abort,
            "skipbuffer": self._skip,
            "statelastexecuted": lambda: self._state("last_executed"),
            "statelastinterpreted": lambda: self._state("last_interpreted"),
            "statelastcleared": lambda: self._state("last_cleared"),
            "stateunexecuted": lambda: self._state("unexecuted"),
        }

    def builtins(self) -> Iterator[Builtin]:
        """The functions for programs."""
        yield Builtin("interpreter_mode", self.interpreter_mode, blocking=True)
        yield Builtin("end_interpreter", self.end_interpreter)
        yield Builtin("clear_interpreter", self.clear_interpreter)

    # What a client sends.

    def receive(self, text: str, reply: Reply) -> None:
        """Take one line; `reply` gets the answer, now or once the line is interpreted."""
        command = self._commands.get(text)
        if command is not None:
            reply(f"{command()}: {text}")
            return
        line = _Line(text, reply)
        execution = self._execution()
        if execution is None:
            line.discard(NOT_RUNNING)
            return
        execution.put(line)
        self.interpret()

    def interpret(self) -> None:
        """Compile lines that wait, as many as this control period permits."""
        execution = self._latest
        if execution is None or execution.mode is None or execution.mode.ended:
            return
        if self._tick != self._clock.ticks:
            self._tick, self._left = self._clock.ticks, LINES_PER_PERIOD
        while execution.lines and not execution.held and self._left > 0:
            self._left -= 1
            if execution.full and not any(name in execution.lines[0].text for name in _HOLDING):
                execution.take().discard(TOO_MANY)
                continue
            outcome = execution.compiled(execution.lines[0])
            if outcome is None:
                return
            line = execution.take()
            if isinstance(outcome, CompileError):
                self._note(f"interpreter: {outcome.text}")
                line.discard(SYNTAX_ERROR if outcome.is_syntax else COMPILE_ERROR)
            else:
                self._accept(execution, line, outcome)

    def _accept(self, execution: _Execution, line: _Line, statement: Statement) -> None:
        execution.count += 1
        execution.size += len(line.text)
        execution.last_interpreted += 1
        accepted = _Accepted(execution.last_interpreted, statement)
        execution.accepted.append(accepted)
        line.reply(f"ack: {accepted.number}: {line.text}")

    # Commands: done at once, and never interpreted.

    def _do_abort(self) -> str:
        self._abort()
        return "ack: 0"

    def _skip(self) -> str:
        execution = self._execution()
        if execution is not None:
            execution.accepted.clear()
            execution.discard_lines(CLEANED_UP)
        return "ack: 0"

    def _state(self, name: str) -> str:
        execution = self._execution()
        return f"state: {0 if execution is None else getattr(execution, name)}"

    # Built-ins, with the names and defaults of the URScript manual.

    def interpreter_mode(
        self,
        clearQueueOnEnter: Any = True,  # noqa: N803
        clearOnEnd: Any = True,  # noqa: N803
        *,
        enclosing: Enclosing,
    ) -> Generator[None]:
        """Execute what clients send until `end_interpreter`, in the scope of the call."""
        execution = self._of_caller("interpreter_mode")
        if not execution.runtime.in_main_thread:
            raise ScriptRuntimeError("interpreter_mode can only be called in the main thread")
        if execution.mode is not None:
            raise ScriptRuntimeError("Nested interpreter modes are not supported")
        if clearQueueOnEnter:
            execution.discard_lines(CLEANED_UP)
        execution.statements.enter(enclosing)
        mode = execution.mode = _Mode(bool(clearOnEnd))
        done, tick = 0, self._clock.ticks
        while not mode.ended:
            if tick != self._clock.ticks:
                done, tick = 0, self._clock.ticks
            self.interpret()
            if not execution.accepted or done >= STATEMENTS_PER_PERIOD:
                yield
                continue
            done += 1
            execution.executing = execution.accepted.popleft()
            execution.last_executed = execution.executing.number
            yield from execution.executing.statement.start()
            execution.executing = None
        execution.accepted.clear()
        execution.mode = None
        if mode.clear_on_end:
            execution.clear()

    def end_interpreter(self) -> None:
        """End interpreter mode once the statement that is executed is done; else without effect."""
        execution = self._of_caller("end_interpreter")
        if execution.mode is not None:
            execution.mode.ended = True

    def clear_interpreter(self) -> None:
        """Forget the variables, functions and threads that statements have made."""
        execution = self._of_caller("clear_interpreter")
        if execution.executing is None or not execution.runtime.in_main_thread:
            raise ScriptRuntimeError("clear_interpreter can only be called from interpreter mode")
        execution.clear()

    def _of_caller(self, name: str) -> _Execution:
        """The interpreter of the program that calls."""
        runtime, _ = self._player.caller()
        if runtime.program.kind == "sec":
            raise ScriptRuntimeError(f"{name} cannot be called in a secondary program")
        return self._execution() or _Execution(runtime)  # it runs on to where it blocks, once ended

    def _execution(self) -> _Execution | None:
        """That of the program that plays or is paused."""
        runtime = self._player.running
        if runtime is None:
            return None
        if self._latest is None or self._latest.runtime is not runtime:
            self._latest = _Execution(runtime)
        return self._latest

    def _program_ended(self) -> None:
        execution, self._latest = self._latest, None
        if execution is not None:
            execution.accepted.clear()  # the statement that ended it may be running still
            execution.discard_lines(NOT_RUNNING)
