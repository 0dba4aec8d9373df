"""Which function owns which variable, and which functions can block.

The manual's rule ("Scoping rules"): a name is one of the function's own variables, else a global
one; the variables of a function around it are out of reach. A plain assignment binds a global
variable only if that one was declared earlier in the text, otherwise it makes a local one; ``local``
and ``global`` say which. All variables of the program itself are global.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from crtk_sim_backends.ur.urscript import syntax


@dataclass(eq=False)
class Scope:
    """One function: its variables, the functions defined in it and the calls it makes.

    ``variables`` are its own, parameters included; ``bound`` are the global variables that it
    assigns. ``children`` are by identity of their syntax node. ``waits`` tells that it joins a
    thread or calls a method, which may be that of a server.
    """

    function: syntax.Function
    parent: Scope | None
    depth: int
    number: int
    blocking: bool
    variables: set[str] = field(default_factory=set)
    bound: set[str] = field(default_factory=set)
    children: dict[int, Scope] = field(default_factory=dict)
    functions: dict[str, Scope] = field(default_factory=dict)
    calls: set[str] = field(default_factory=set)
    waits: bool = False

    def owner(self, variable: str) -> Scope | None:
        """Return the function whose variable the name means here: this one or the program."""
        if variable in self.variables:
            return self
        program = self.program
        return program if variable in program.variables else None

    def find_function(self, name: str) -> Scope | None:
        """Return the script function that a call of ``name`` in this function means."""
        scope: Scope | None = self
        while scope and name not in scope.functions:
            scope = scope.parent
        return scope.functions[name] if scope else None

    def in_reach(self) -> tuple[list[tuple[Scope, str]], list[Scope]]:
        """Return every variable, with its owner, and function that names here, or within, can mean."""
        program = self.program
        variables = [(self, name) for name in sorted(self.variables)]
        if program is not self:
            variables += [(program, name) for name in sorted(program.variables)]
        functions: dict[str, Scope] = {}
        scope: Scope | None = self
        while scope:
            functions = {**scope.functions, **functions}
            scope = scope.parent
        return variables, list(functions.values())

    @property
    def program(self) -> Scope:
        """The outermost function."""
        return self.parent.program if self.parent else self


def analyse(program: syntax.Function, blocking_builtins: frozenset[str]) -> list[Scope]:
    """Return the scopes of a program, its own first, then every function in it, by number."""
    scopes: list[Scope] = []
    _declare(program, None, scopes)
    _spread_blocking(scopes, blocking_builtins)
    return scopes


def analyse_more(
    block: syntax.Block, scope: Scope, scopes: list[Scope], blocking_builtins: frozenset[str]
) -> None:
    """Analyse statements that are added to a scope; their functions are appended to `scopes`."""
    known = len(scopes)
    _declare_block(block, scope, scopes)
    _spread_blocking(scopes[known:], blocking_builtins)  # the others are compiled already


def _spread_blocking(scopes: list[Scope], blocking_builtins: frozenset[str]) -> None:
    """Mark the functions that block because of what they call."""
    waiting = True
    while waiting:
        waiting = False
        for scope in scopes:
            if not scope.blocking and _calls_blocking(scope, blocking_builtins):
                scope.blocking = waiting = True


def _calls_blocking(scope: Scope, blocking_builtins: frozenset[str]) -> bool:
    for name in scope.calls:
        function = scope.find_function(name)
        if function.blocking if function else name in blocking_builtins:
            return True
    return scope.waits


def _declare(function: syntax.Function, parent: Scope | None, scopes: list[Scope]) -> Scope:
    scope = Scope(
        function,
        parent,
        depth=parent.depth + 1 if parent else 0,
        number=len(scopes),
        blocking=parent is None or function.kind == "thread",
        variables={parameter.name for parameter in function.parameters},
    )
    scopes.append(scope)
    _declare_block(function.body, scope, scopes)
    return scope


def _declare_block(block: syntax.Block, scope: Scope, scopes: list[Scope]) -> None:
    for statement in block:
        for expression in _expressions_of(statement):
            _collect_calls(expression, scope)
        match statement:
            case syntax.Assign(target=syntax.Name(name=name), scope=kind):
                _bind(name, kind, scope)
            case syntax.If(arms=arms, otherwise=otherwise):
                for _, body in arms:
                    _declare_block(body, scope, scopes)
                _declare_block(otherwise, scope, scopes)
            case syntax.While(body=body):
                _declare_block(body, scope, scopes)
            case syntax.ThreadControl(word="join"):
                scope.waits = True
            case syntax.Function(name=name):
                child = _declare(statement, scope, scopes)
                scope.functions[name] = scope.children[id(statement)] = child


def _bind(variable: str, kind: str, scope: Scope) -> None:
    if kind == "local":
        owner = scope
    elif kind == "global":
        owner = scope.program
    else:
        owner = scope.owner(variable) or scope
    owner.variables.add(variable)
    if owner is not scope:
        scope.bound.add(variable)


def _expressions_of(statement: syntax.Statement) -> Iterator[syntax.Expression]:
    """Yield the expressions that a statement evaluates in its own function."""
    match statement:
        case syntax.Assign(target=target, value=value):
            if not isinstance(target, syntax.Name):
                yield target
            if value is not None:
                yield value
        case syntax.Evaluate(value=value):
            yield value
        case syntax.If(arms=arms):
            for condition, _ in arms:
                yield condition
        case syntax.While(condition=condition):
            yield condition
        case syntax.Return(value=value) if value is not None:
            yield value
        case syntax.ThreadControl(handle=handle):
            yield handle
        case syntax.Function(parameters=parameters):
            for parameter in parameters:
                if parameter.default is not None:
                    yield parameter.default


def _collect_calls(expression: syntax.Expression, scope: Scope) -> None:
    waiting: list[syntax.Expression] = [expression]
    while waiting:
        match waiting.pop():
            case syntax.Call(name=name, arguments=arguments, keywords=keywords):
                scope.calls.add(name)
                waiting.extend(arguments)
                waiting.extend(value for _, value in keywords)
            case syntax.Run(call=call):
                waiting.extend(call.arguments)
                waiting.extend(value for _, value in call.keywords)
            case syntax.ListLiteral(items=items):
                waiting.extend(items)
            case syntax.Unary(operand=operand):
                waiting.append(operand)
            case syntax.Binary(left=left, right=right):
                waiting.extend((left, right))
            case syntax.Logical(operands=operands):
                waiting.extend(operands)
            case syntax.Index(value=value, indices=indices):
                waiting.append(value)
                waiting.extend(indices)
            case syntax.Member(value=value):
                waiting.append(value)
            case syntax.MethodCall(value=value, arguments=arguments, keywords=keywords):
                scope.waits = True
                waiting.append(value)
                waiting.extend(arguments)
                waiting.extend(value for _, value in keywords)
