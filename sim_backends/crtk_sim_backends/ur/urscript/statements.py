"""Statements that join a running program, one text after the other, in a scope that it has reached.

Each text becomes a generator function whose free variables are the program's own closure cells: it
reads and assigns the program's variables and calls its functions. What statements make themselves,
variables and functions, lasts until :meth:`Statements.clear`.

The manual, "Interpreter Mode": the scope is inherited from the one in which interpreter mode was
called, new global variables are not supported, and of several statements in a line all are accepted
or none. A variable that a statement makes is therefore local: later statements reach it, functions
do not.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from types import CellType, CodeType, FunctionType
from typing import Any, Final

from typing_extensions import override

from crtk_sim_backends.ur.urscript import syntax
from crtk_sim_backends.ur.urscript.compiler import Emitter, Program
from crtk_sim_backends.ur.urscript.errors import CompileError
from crtk_sim_backends.ur.urscript.manual import ENCLOSED
from crtk_sim_backends.ur.urscript.parser import parse
from crtk_sim_backends.ur.urscript.scopes import Scope, analyse_more

Enclosing = tuple[int, Callable[[], Any]]
"""Number of a scope, and a function whose closure has the cells of all that is in reach there."""

NESTED: Final = "Nested interpreter modes are not supported"
NEW_GLOBAL: Final = "New global variables are not supported in interpreter mode"

_FILE: Final = "<statements>"
_BODY: Final = "statements"
_HEAD: Final = ("if False: yield", "budget[0] -= 1", "if budget[0] < 0: overrun()")
_DEPTH: Final = 1000  # of the variables that statements make; no function of a program is so deep


@dataclass(frozen=True)
class Statement:
    """One text, ready to run. `calls` are the functions that it calls, without those that they call."""

    start: Callable[[], Generator[None]]
    calls: frozenset[str]


class _StatementScope(Scope):
    """The scope of the statements, within the scope of the program that they have joined."""

    def __init__(self, enclosing: Scope, variables: set[str], functions: dict[str, Scope]) -> None:
        function = syntax.Function("def", "", (), (), 1, 1)
        super().__init__(function, enclosing, _DEPTH, 0, True, variables, functions=functions)
        self.enclosing = enclosing
        self.globals = replace(enclosing.program, variables=set(enclosing.program.variables))

    @override
    def owner(self, variable: str) -> Scope | None:
        return self if variable in self.variables else self.enclosing.owner(variable)

    @property
    @override
    def program(self) -> Scope:
        return self.globals

    @property
    def new_globals(self) -> set[str]:
        """Global variables that the program does not have."""
        return self.globals.variables - self.enclosing.program.variables


class Statements:
    """What has joined one execution of a program, and what can join it.

    Args:
        program: that is executed.
        namespace: what code of this execution finds by name.

    Attributes:
        scope: in which texts are compiled; another one after `enter` and `clear`.
    """

    scope: _StatementScope

    def __init__(self, program: Program, namespace: dict[str, Any]) -> None:
        self._program = program
        self._namespace = namespace
        self._names = frozenset(program.builtins)
        self._blocking = frozenset(name for name in self._names if program.builtins[name].blocking)
        self._reached: dict[str, CellType] = {}
        self._enclosing = program.scopes[0]
        self.clear()

    def enter(self, enclosing: Enclosing) -> None:
        """Have the next statements join the scope from which a program has called."""
        number, reach = enclosing
        self._reached = dict(zip(reach.__code__.co_freevars, reach.__closure__ or (), strict=True))
        self._enclosing = self._program.scopes[number]
        made = set(self.scope.variables), dict(self.scope.functions)
        self.scope = _StatementScope(self._enclosing, *made)

    def clear(self) -> None:
        """Forget what statements have made; those that run already keep it."""
        self._own: dict[str, CellType] = {}
        self._scopes = list(self._program.scopes)
        self.scope = _StatementScope(self._enclosing, set(), {})

    def compile(self, text: str) -> Statement:
        """Compile one text. May be called in any thread, for one text at a time.

        Raises:
            CompileError: nothing of the text has joined the program.
        """
        scope, scopes = self.scope, self._scopes
        variables, functions, count = set(scope.variables), dict(scope.functions), len(scopes)
        try:
            return self._compiled(text, scope, scopes)
        except CompileError:
            scope.variables, scope.functions = variables, functions
            del scopes[count:]
            raise
        finally:
            scope.globals.variables -= scope.new_globals
            scope.children.clear()

    def _compiled(self, text: str, scope: _StatementScope, scopes: list[Scope]) -> Statement:
        block = parse(text)
        own, reached = self._own, self._reached
        earlier = list(scope.functions.values())
        count = len(scopes)
        scope.calls = set()
        analyse_more(block, scope, scopes, self._blocking)
        for caller in (scope, *scopes[count:]):
            if any(caller.find_function(name) is None for name in caller.calls & ENCLOSED):
                raise CompileError(NESTED, 1, 1)
        for name in scope.new_globals:
            raise CompileError(f"{NEW_GLOBAL}: {name}", 1, 1)
        emitter = Emitter(
            text, scope, self._names, self._blocking, self._program.dialect, defined=earlier
        )
        emitter.statements(block, 2)
        made = {f"v{_DEPTH}_{name}" for name in scope.variables}
        made |= {f"f{function.number}" for function in scope.functions.values()}
        # A name that is declared is a free variable, used or not: functions are, where they are used.
        assigned = made | {name for name in reached if name.startswith("v")}
        code = _code(emitter.lines, sorted({*reached, *made}), sorted(assigned), text)
        cells = []
        for name in code.co_freevars:
            if name in made:
                cells.append(own.setdefault(name, CellType()))
            else:
                cells.append(reached[name])
                self._check_defined(name, reached[name])
        start = FunctionType(code, self._namespace, closure=tuple(cells))
        return Statement(start, frozenset(scope.calls))

    def _check_defined(self, name: str, cell: CellType) -> None:
        """Refuse a function of the program whose definition it has not reached."""
        if not name.startswith("f"):
            return
        try:
            _ = cell.cell_contents
        except ValueError:
            function = self._program.scopes[int(name[1:])].function
            raise CompileError.name_not_found(function.name, 1, 1) from None


def _code(body: list[str], names: list[str], assigned: list[str], text: str) -> CodeType:
    """Compile a generator function whose free variables are among `names`; some may be assigned."""
    head = list(_HEAD)
    outer = "def outer():"
    if names:
        outer = f"def outer():\n {' = '.join(names)} = None"
    if assigned:
        head.insert(0, f"nonlocal {', '.join(assigned)}")
    lines = [outer, f" def {_BODY}():", *(f"  {line}" for line in head), *body]
    try:
        module = compile("\n".join(lines), _FILE, "exec", dont_inherit=True)
    except (SyntaxError, RecursionError, MemoryError) as error:
        # What was parsed is well-formed, so only one of Python's limits is left.
        raise CompileError.syntax(text, 1, 1) from error
    return _inner(_inner(module, "outer"), _BODY)


def _inner(code: CodeType, name: str) -> CodeType:
    """The code of a function that is defined in `code`."""
    return next(c for c in code.co_consts if isinstance(c, CodeType) and c.co_name == name)
