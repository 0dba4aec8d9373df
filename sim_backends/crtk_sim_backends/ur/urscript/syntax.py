"""The syntax tree of a script. Lines and columns count from 1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["def", "sec", "thread"]
Qualifier = Literal["", "local", "global"]
ThreadWord = Literal["kill", "join"]


@dataclass(frozen=True, slots=True)
class Number:
    """A number: ``1``, ``0x1F``, ``2.5e-3``."""

    value: int | float
    line: int
    column: int


@dataclass(frozen=True, slots=True)
class Text:
    """A string without its quotes."""

    value: str
    line: int
    column: int


@dataclass(frozen=True, slots=True)
class Boolean:
    """``True`` or ``False``."""

    value: bool
    line: int
    column: int


@dataclass(frozen=True, slots=True)
class Name:
    """A variable."""

    name: str
    line: int
    column: int


@dataclass(frozen=True, slots=True)
class ListLiteral:
    """``[a, b, c]``, or a pose ``p[x, y, z, rx, ry, rz]``."""

    items: tuple[Expression, ...]
    pose: bool
    line: int
    column: int


@dataclass(frozen=True, slots=True)
class Unary:
    """``-a`` or ``not a``."""

    operator: str
    operand: Expression
    line: int
    column: int


@dataclass(frozen=True, slots=True)
class Binary:
    """``left operator right`` with an arithmetic operator, a comparison or ``xor``."""

    operator: str
    left: Expression
    right: Expression
    line: int
    column: int


@dataclass(frozen=True, slots=True)
class Logical:
    """A chain of ``and`` or of ``or``: at least two operands."""

    operator: str
    operands: tuple[Expression, ...]
    line: int
    column: int


@dataclass(frozen=True, slots=True)
class Index:
    """``value[i]`` or ``value[i, j]``."""

    value: Expression
    indices: tuple[Expression, ...]
    line: int
    column: int


@dataclass(frozen=True, slots=True)
class Call:
    """``name(a, b, key=c)``."""

    name: str
    arguments: tuple[Expression, ...]
    keywords: tuple[tuple[str, Expression], ...]
    line: int
    column: int


@dataclass(frozen=True, slots=True)
class Member:
    """``value.name``: a member of a struct."""

    value: Expression
    name: str
    line: int
    column: int


@dataclass(frozen=True, slots=True)
class MethodCall:
    """``value.name(a, b)``: a method of a list, or a function of a remote server."""

    value: Expression
    name: str
    arguments: tuple[Expression, ...]
    keywords: tuple[tuple[str, Expression], ...]
    line: int
    column: int


@dataclass(frozen=True, slots=True)
class Run:
    """``run thread(a)``; its value is the handle of the new thread."""

    call: Call
    line: int
    column: int


Expression = (
    Number
    | Text
    | Boolean
    | Name
    | ListLiteral
    | Unary
    | Binary
    | Logical
    | Index
    | Member
    | Call
    | MethodCall
    | Run
)


@dataclass(frozen=True, slots=True)
class Assign:
    """``target = value``; a declaration (``local`` or ``global``) may come without a value."""

    scope: Qualifier
    target: Name | Index | Member
    value: Expression | None
    line: int
    column: int


@dataclass(frozen=True, slots=True)
class Evaluate:
    """An expression as a statement."""

    value: Expression
    line: int
    column: int


@dataclass(frozen=True, slots=True)
class If:
    """``if`` and ``elif`` arms in order, then the ``else`` block (empty if there is none)."""

    arms: tuple[tuple[Expression, Block], ...]
    otherwise: Block
    line: int
    column: int


@dataclass(frozen=True, slots=True)
class While:
    """``while condition: ... end``."""

    condition: Expression
    body: Block
    line: int
    column: int


@dataclass(frozen=True, slots=True)
class Return:
    """``return`` with or without a value."""

    value: Expression | None
    line: int
    column: int


@dataclass(frozen=True, slots=True)
class ThreadControl:
    """``kill handle`` or ``join handle``."""

    word: ThreadWord
    handle: Expression
    line: int
    column: int


@dataclass(frozen=True, slots=True)
class Word:
    """A statement of one word, such as ``break`` or ``enter_critical``, or a program label."""

    word: str
    line: int
    column: int


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of a function, with its default value if it has one."""

    name: str
    default: Expression | None


@dataclass(frozen=True, slots=True)
class Function:
    """``def``, ``sec`` or ``thread``, up to its ``end``."""

    kind: Kind
    name: str
    parameters: tuple[Parameter, ...]
    body: Block
    line: int
    column: int


Statement = Assign | Evaluate | If | While | Return | ThreadControl | Word | Function
Block = tuple[Statement, ...]


def root(expression: Expression) -> Expression:
    """Return what an expression is a part of: ``a`` of ``a[0].b``, itself if it is no part."""
    while isinstance(expression, Index | Member):
        expression = expression.value
    return expression
