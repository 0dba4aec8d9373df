"""Syntax tree to Python source to byte code.

A function that can block (it calls a blocking built-in, joins, or calls such a function) becomes
a generator that yields once per control period; every other one stays a plain function. Variables
become Python locals and closure cells. A table leads from lines of generated Python back to the
script, so that errors carry the script's line and column.
"""

from __future__ import annotations

import functools
import keyword
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import CodeType, TracebackType
from typing import Any, Literal, NoReturn

from crtk_sim_backends.ur.urscript import syntax, values
from crtk_sim_backends.ur.urscript.errors import CompileError, Halt, ScriptRuntimeError
from crtk_sim_backends.ur.urscript.lexer import source_line
from crtk_sim_backends.ur.urscript.manual import ARRAYS, ENCLOSED, OLD_KEYWORDS, Dialect
from crtk_sim_backends.ur.urscript.methods import call_method
from crtk_sim_backends.ur.urscript.parser import parse
from crtk_sim_backends.ur.urscript.scopes import Scope, analyse
from crtk_sim_backends.ur.urscript.values import Builtin

ProgramKind = Literal["def", "sec", "statements"]

CACHED_PROGRAMS = 64
DEPTH_LIMIT = 80
"""How deep an expression may nest, a chain of operators included (Python's own limit is 200)."""

_FILE = "<urscript>"
_HELPERS: dict[str, object] = {
    "add": values.add,
    "modulo": values.modulo,
    "multiply": values.multiply,
    "index": values.index,
    "copy": values.copy_value,
    "build": values.build,
    "struct": values.build_struct,
    "fitting": values.fitting,
    "same_size": values.same_size,
    "set_member": values.set_member,
    "method": call_method,
    "List": values.List,
    "Pose": values.Pose,
    "Halt": Halt,
}
_SHARED = (
    syntax.Name,
    syntax.Index,
    syntax.Member,
    syntax.Logical,
    syntax.Call,
    syntax.MethodCall,
)
"""Expressions whose value somebody else may hold, so that it is copied where it is assigned."""
_PYTHON_WORDS = {"break": "break", "continue": "continue", "halt": "raise Halt"}
_OPERATIONS_PER_STEP = 10
_HELPER_OF_OPERATOR = {"+": "add", "%": "modulo", "*": "multiply"}


def _fail(text: str) -> NoReturn:
    raise ScriptRuntimeError(text)


@dataclass(frozen=True, eq=False)
class Program:
    """A compiled script, ready to be started any number of times.

    ``name`` is that of its top-level function, or "" for loose statements.
    """

    name: str
    kind: ProgramKind
    builtins: Mapping[str, Builtin]
    code: CodeType
    positions: Sequence[tuple[int, int]]
    scopes: Sequence[Scope]
    dialect: Dialect

    def namespace(
        self,
        run: Callable[[Generator[None]], int],
        kill: Callable[[Any], None],
        join: Callable[[Any], Generator[None]],
        budget: list[int],
        overrun: Callable[[], None],
    ) -> dict[str, Any]:
        """Return what the code of one execution finds by name: all but its own variables.

        :param run: starts a thread and returns its handle.
        :param kill: ends the thread with a handle.
        :param join: waits for the end of the thread with a handle.
        :param budget: its only item goes down by one for each call and each turn of a loop.
        :param overrun: called when that is below zero; raises to end the program, or fills it up.
        """
        return {
            **_HELPERS,
            **{f"b_{name}": builtin.call for name, builtin in self.builtins.items()},
            "run": run,
            "kill": kill,
            "join": join,
            "budget": budget,
            "overrun": overrun,
            "fail": _fail,
        }

    def start(self, namespace: dict[str, Any]) -> Generator[None]:
        """Return the main thread of a new execution with variables of its own."""
        exec(self.code, namespace)
        main: Generator[None] = namespace["f0"]()
        return main

    def position(self, traceback: TracebackType | None) -> tuple[int, int]:
        """Return line and column of the innermost script statement of a traceback, else 0, 0."""
        line = 0
        while traceback:
            if traceback.tb_frame.f_code.co_filename == _FILE:
                line = traceback.tb_lineno
            traceback = traceback.tb_next
        return self.positions[line - 1] if line else (0, 0)


def compile_program(
    text: str, builtins: Mapping[str, Builtin], dialect: Dialect | None = None
) -> Program:
    """Compile a script: one ``def`` or ``sec``, or loose statements.

    The result is cached by text and by the names in ``builtins``.

    :param dialect: the language of the controller's software; the plainest by default.
    :raises CompileError: with line, column and the controller's text.
    """
    signature = frozenset((name, builtin.blocking) for name, builtin in builtins.items())
    dialect = dialect or Dialect()
    compiled = _compile(text, signature, dialect)
    if isinstance(compiled, CompileError):
        raise compiled.with_traceback(None)
    name, kind, code, positions, scopes = compiled
    return Program(name, kind, builtins, code, positions, scopes, dialect)


_Compiled = tuple[str, ProgramKind, CodeType, Sequence[tuple[int, int]], Sequence[Scope]]


@functools.lru_cache(CACHED_PROGRAMS)
def _compile(
    text: str, builtins: frozenset[tuple[str, bool]], dialect: Dialect
) -> _Compiled | CompileError:
    """Compile, or return the error: the cache keeps it too."""
    try:
        return _compiled(text, builtins, dialect)
    except CompileError as error:
        return error


def _compiled(text: str, builtins: frozenset[tuple[str, bool]], dialect: Dialect) -> _Compiled:
    main, kind = _main_function(parse(text))
    blocking = frozenset(name for name, blocks in builtins if blocks)
    scopes = analyse(main, blocking)
    root = scopes[0]
    emitter = Emitter(text, root, frozenset(name for name, _ in builtins), blocking, dialect)
    emitter.function(root, 0)
    try:
        code = compile("\n".join(emitter.lines), _FILE, "exec", dont_inherit=True)
    except (SyntaxError, RecursionError, MemoryError) as error:
        # The tree is well-formed, so only one of Python's limits (20 nested loops) is left.
        raise CompileError.syntax(source_line(text, main.line), main.line, main.column) from error
    return main.name, kind, code, emitter.positions, scopes


def _main_function(block: syntax.Block) -> tuple[syntax.Function, ProgramKind]:
    """Return the function that is the program, wrapping loose statements into one."""
    if len(block) == 1 and isinstance(block[0], syntax.Function) and block[0].kind != "thread":
        return block[0], "sec" if block[0].kind == "sec" else "def"
    return syntax.Function("def", "", (), block, 1, 1), "statements"


class Emitter:
    """Writes Python source; ``positions[i]`` is the script position behind ``lines[i]``."""

    def __init__(
        self,
        text: str,
        root: Scope,
        builtins: frozenset[str],
        blocking: frozenset[str],
        dialect: Dialect,
        defined: Iterable[Scope] = (),
    ) -> None:
        self.lines: list[str] = []
        self.positions: list[tuple[int, int]] = []
        self._text = text
        self._builtins = builtins
        self._blocking = blocking
        self._dialect = dialect
        self._scope = root
        self._defined: set[Scope] = set(defined)
        self._assigned: set[str] = set()  # variables that have a value wherever the writing is
        self._operations = 0  # written since the last check of the budget

    def _write(self, indent: int, code: str, node: syntax.Statement | syntax.Expression) -> None:
        self.lines.append(" " * indent + code)
        self.positions.append((node.line, node.column))

    # statements

    def statements(self, block: syntax.Block, indent: int) -> None:
        """Write statements of the scope that it was made for."""
        self._block(block, indent)

    def function(self, scope: Scope, indent: int) -> None:
        """Write one function and everything inside it."""
        function = scope.function
        parameters = []
        for parameter in function.parameters:
            default = parameter.default
            if default is None and scope.parent is None:
                raise CompileError.syntax(
                    source_line(self._text, function.line), function.line, function.column
                )
            name = _variable(scope.depth, parameter.name)
            parameters.append(name if default is None else f"{name}={self._expression(default)}")
        self._write(indent, f"def f{scope.number}({', '.join(parameters)}):", function)
        outer, self._scope = self._scope, scope
        outer_assigned, self._assigned = self._assigned, self._assigned.copy()
        self._assigned.update(_variable(scope.depth, item.name) for item in function.parameters)
        self._defined.add(scope)
        indent += 1
        if scope.bound:
            names = (_variable(0, name) for name in sorted(scope.bound))
            self._write(indent, f"nonlocal {', '.join(names)}", function)
        if scope.parent is None and scope.variables:
            # Names that only inner functions assign must exist here too, without a value.
            names = (f"{_variable(0, name)} = " for name in sorted(scope.variables))
            self._write(indent, f"if False: {''.join(names)}None", function)
        if scope.blocking:
            self._write(indent, "if False: yield", function)
        self._spend(indent, function)
        for parameter in function.parameters:
            if parameter.default is not None and not isinstance(parameter.default, syntax.Number):
                name = _variable(scope.depth, parameter.name)
                self._write(indent, f"{name} = copy({name})", function)
        self._block(function.body, indent)
        self._scope, self._assigned = outer, outer_assigned

    def _spend(self, indent: int, node: syntax.Statement) -> None:
        self._write(indent, "budget[0] -= 1", node)
        self._write(indent, "if budget[0] < 0: overrun()", node)
        self._operations = 0

    def _inner_block(self, block: syntax.Block, indent: int) -> None:
        """Write a block that may be left out: what it assigns may have no value after it."""
        assigned = self._assigned.copy()
        self._block(block, indent)
        self._assigned = assigned

    def _block(self, block: syntax.Block, indent: int) -> None:
        for statement in block:
            self._statement(statement, indent)
            if self._operations >= _OPERATIONS_PER_STEP:
                self._spend(indent, statement)

    def _statement(self, node: syntax.Statement, indent: int) -> None:
        match node:
            case syntax.Assign():
                self._assign(node, indent)
            case syntax.Evaluate(value=value):
                self._write(indent, self._expression(value), node)
            case syntax.If():
                self._if(node, indent)
            case syntax.While(condition=condition, body=body):
                self._write(indent, f"while {self._expression(condition)}:", node)
                self._spend(indent + 1, node)
                self._inner_block(body, indent + 1)
            case syntax.Return(value=value):
                code = "return" if value is None else f"return {self._expression(value)}"
                self._write(indent, code, node)
            case syntax.ThreadControl(word=word, handle=handle):
                wait = "yield from " if word == "join" else ""
                self._write(indent, f"{wait}{word}({self._expression(handle)})", node)
            case syntax.Word(word=word):
                # Threads change only where one blocks, so a critical section needs nothing.
                self._write(indent, _PYTHON_WORDS.get(word, "pass"), node)
            case syntax.Function():
                self.function(self._scope.children[id(node)], indent)

    def _assign(self, node: syntax.Assign, indent: int) -> None:
        call = self._array_call(node)
        if call is not None:
            self._write(indent, self._expression(call), node)
            return
        target = node.target
        if isinstance(target, syntax.Name):
            is_global = node.scope == "global"
            name = _variable(0, target.name) if is_global else self._expression(target)
            if node.value is None:  # a declaration: the name must exist in Python as well
                self._write(indent, f"if False: {name} = None", node)
            else:
                value = self._copied(node.value)
                if self._dialect.fixed_lists and name in self._assigned and _is_list(node.value):
                    value = f"same_size({name}, {value})"
                self._write(indent, f"{name} = {value}", node)
                self._assigned.add(name)
        elif node.value is not None:
            value = self._expression(node.value)
            if not _is_literal(node.value):
                value = f"fitting({self._expression(syntax.root(target))}, {value})"
            if isinstance(target, syntax.Index):
                self._write(indent, f"{self._expression(target)} = {value}", node)
            else:
                struct = self._expression(target.value)
                self._write(indent, f"set_member({struct}, {target.name!r}, {value})", node)

    def _array_call(self, node: syntax.Assign) -> syntax.Call | None:
        """Return the call that an assignment to one of the controller's own arrays stands for."""
        target = node.target
        if not isinstance(target, syntax.Index) or not isinstance(target.value, syntax.Name):
            return None
        name = target.value.name
        function = ARRAYS.get(name, "")
        if node.value is None or function not in self._builtins or self._scope.owner(name):
            return None
        arguments = (*target.indices, node.value)
        return syntax.Call(function, arguments, (), target.line, target.column)

    def _if(self, node: syntax.If, indent: int) -> None:
        word = "if"
        for condition, body in node.arms:
            self._write(indent, f"{word} {self._expression(condition)}:", condition)
            self._arm(body, indent + 1, node)
            word = "elif"
        if node.otherwise:
            self._write(indent, "else:", node)
            self._arm(node.otherwise, indent + 1, node)

    def _arm(self, body: syntax.Block, indent: int, node: syntax.If) -> None:
        if not body:
            self._write(indent, "pass", node)
        self._inner_block(body, indent)

    # expressions

    def _copied(self, node: syntax.Expression, depth: int = 0) -> str:
        """Write an expression whose value nobody else holds."""
        code = self._expression(node, depth)
        return f"copy({code})" if isinstance(node, _SHARED) else code

    def _expression(self, node: syntax.Expression, depth: int = 0) -> str:
        depth += 1
        if depth > DEPTH_LIMIT:
            raise CompileError.syntax(source_line(self._text, node.line), node.line, node.column)
        match node:
            case (
                syntax.Number(value=value) | syntax.Text(value=value) | syntax.Boolean(value=value)
            ):
                return repr(value)
            case syntax.Name(name=name, line=line, column=column):
                owner = self._scope.owner(name)
                if owner is None:
                    raise CompileError.name_not_found(name, line, column)
                return _variable(owner.depth, name)
            case syntax.Index(value=value, indices=indices):
                return self._expression(value, depth) + "".join(
                    f"[{self._index(item, depth)}]" for item in indices
                )
            case syntax.Call():
                self._operations += 1
                return self._call(node, depth)
            case syntax.Binary(operator=operator, left=left, right=right):
                self._operations += 1
                return _binary(
                    operator, self._expression(left, depth), self._expression(right, depth)
                )
            case syntax.Logical(operator=operator, operands=operands):
                codes = [self._expression(operand, depth) for operand in operands]
                return f"({f' {operator} '.join(codes)})"
            case syntax.Unary(operator=operator, operand=operand):
                return f"({operator} {self._expression(operand, depth)})"
            case syntax.Member(value=value, name=name):
                return f"{self._expression(value, depth)}.m_{name}"
            case syntax.MethodCall():
                self._operations += 1
                return self._method_call(node, depth)
            case syntax.ListLiteral(items=items, pose=pose):
                kind = "Pose" if pose else "List"
                codes = [self._expression(item, depth) for item in items]
                if all(map(_is_literal, items)):
                    return f"{kind}([{', '.join(codes)}])"
                return f"build({kind}, ({', '.join(codes)},))"
            case syntax.Run(call=call):
                return self._run(call, depth)

    def _index(self, node: syntax.Expression, depth: int) -> str:
        code = self._expression(node, depth)
        return code if isinstance(node, syntax.Number) else f"index({code})"

    def _call(self, node: syntax.Call, depth: int) -> str:
        function = self._scope.find_function(node.name)
        if function is None and node.name == "struct":
            return self._struct(node, depth)
        if function is None:
            if node.name not in self._builtins:
                known = node.name in self._dialect.known
                refuse = CompileError.not_simulated if known else CompileError.name_not_found
                raise refuse(node.name, node.line, node.column)
            code = f"b_{node.name}({self._arguments(node, depth)}{self._enclosing(node)})"
            return f"(yield from {code})" if node.name in self._blocking else code
        here = self._scope.functions.get(node.name) is function
        if function.function.kind == "thread" or (here and function not in self._defined):
            raise CompileError.name_not_found(node.name, node.line, node.column)
        code = self._script_call(node, function, depth)
        return f"(yield from {code})" if function.blocking else code

    def _arguments(self, node: syntax.Call | syntax.MethodCall, depth: int) -> str:
        """Write the arguments for a function of ours; Python's keywords get an underscore."""
        codes = [self._expression(argument, depth) for argument in node.arguments]
        for given, value in node.keywords:
            name = OLD_KEYWORDS.get((node.name, given), given)
            python_name = f"{name}_" if keyword.iskeyword(name) else name
            codes.append(f"{python_name}={self._expression(value, depth)}")
        return ", ".join(codes)

    def _enclosing(self, node: syntax.Call) -> str:
        """Write by what a built-in reaches names of its caller: a function that only has a closure."""
        if node.name not in ENCLOSED:
            return ""
        variables, functions = self._scope.in_reach()
        names = [_variable(owner.depth, name) for owner, name in variables]
        names += [f"f{function.number}" for function in functions]
        separator = ", " if node.arguments or node.keywords else ""
        cells = "".join(f"{name}, " for name in names)
        return f"{separator}enclosing=({self._scope.number}, lambda: ({cells}))"

    def _struct(self, node: syntax.Call, depth: int) -> str:
        if node.arguments or not node.keywords:
            raise CompileError.syntax(source_line(self._text, node.line), node.line, node.column)
        members = (f"m_{name}={self._expression(value, depth)}" for name, value in node.keywords)
        return f"struct({', '.join(members)})"

    def _method_call(self, node: syntax.MethodCall, depth: int) -> str:
        # A list that a function returns may be one that somebody keeps: not to be changed.
        value = self._copied if isinstance(node.value, syntax.Call) else self._expression
        arguments = self._arguments(node, depth)
        separator = ", " if arguments else ""
        name = repr(node.name)
        return f"(yield from method({value(node.value, depth)}, {name}{separator}{arguments}))"

    def _run(self, call: syntax.Call, depth: int) -> str:
        thread = self._scope.find_function(call.name)
        if thread is None or thread.function.kind != "thread":
            raise CompileError.name_not_found(call.name, call.line, call.column)
        return f"run({self._script_call(call, thread, depth)})"

    def _script_call(self, node: syntax.Call, function: Scope, depth: int) -> str:
        parameters = function.function.parameters
        given = [parameter.name for parameter in parameters[: len(node.arguments)]]
        given += [name for name, _ in node.keywords]
        required = {parameter.name for parameter in parameters if parameter.default is None}
        known = {parameter.name for parameter in parameters}
        fits = len(node.arguments) <= len(parameters) and len(given) == len(set(given))
        if not (fits and required <= set(given) <= known):
            signature = ", ".join(parameter.name for parameter in parameters)
            return f"fail({f'Type error: {node.name} takes ({signature})'!r})"
        codes = [self._copied(argument, depth) for argument in node.arguments]
        codes += [
            f"{_variable(function.depth, name)}={self._copied(value, depth)}"
            for name, value in node.keywords
        ]
        return f"f{function.number}({', '.join(codes)})"


def _is_list(node: syntax.Expression) -> bool:
    """Tell whether the value of an expression may be a list of any size."""
    return isinstance(node, (syntax.ListLiteral, *_SHARED))


def _is_literal(node: syntax.Expression) -> bool:
    """Tell whether an expression is a number, a text or a truth value, perhaps with a sign."""
    while isinstance(node, syntax.Unary):
        node = node.operand
    return isinstance(node, syntax.Number | syntax.Text | syntax.Boolean)


def _variable(depth: int, name: str) -> str:
    """Return the Python name of a variable of a function at ``depth``."""
    return f"v{depth}_{name}"


def _binary(operator: str, left: str, right: str) -> str:
    if operator in _HELPER_OF_OPERATOR:
        return f"{_HELPER_OF_OPERATOR[operator]}({left}, {right})"
    if operator == "xor":
        return f"((not {left}) != (not {right}))"
    return f"({left} {operator} {right})"
