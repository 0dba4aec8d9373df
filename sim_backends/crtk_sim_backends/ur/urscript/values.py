"""The values a running script works with, and the built-in functions it may call.

Numbers, booleans and strings are Python's; lists are ours. URScript passes everything by value,
so lists are copied when they are assigned or handed to a script function, and arithmetic on
lists is element by element (URScript manual, "Matrix and Array Expressions").
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

from crtk_sim_backends.ur.urscript.errors import ScriptRuntimeError

INTEGER_LIMIT = 2**63
NESTING_LIMIT = 4
"""How deep lists can be nested; without a limit, ``a = [a, a]`` in a loop doubles a list for ever."""


@dataclass(frozen=True)
class Builtin:
    """One function of the controller that scripts can call.

    ``call`` gets the script's arguments; a parameter whose URScript name is a Python keyword is
    spelled with a trailing underscore (``async_``). Lists are handed over as they are: ``call``
    copies what it keeps and never changes them; what it returns is copied by the script, so it may
    return a :class:`List` that it keeps, but no plain list. With ``blocking`` the call returns a generator
    that is resumed once per control period; its return value is the function's value.
    """

    name: str
    call: Callable[..., Any]
    blocking: bool = False


def _elementwise(function: Callable[[Any, Any], Any]) -> Callable[[List, object], List]:
    """Turn an operation on two numbers into one on a list and a number or a list as long."""

    def method(self: List, other: object) -> List:
        if isinstance(other, list):
            if len(other) != len(self):
                raise ScriptRuntimeError(
                    f"Type error: lists of different lengths ({len(self)} and {len(other)})"
                )
            return type(self)(map(function, self, other))
        return type(self)([function(item, other) for item in self])

    return method


def _reflected(function: Callable[[Any, Any], Any]) -> Callable[[List, object], List]:
    """Turn an operation on two numbers into one on a number (left) and a list (right)."""

    def method(self: List, other: object) -> List:
        return type(self)([function(other, item) for item in self])

    return method


def _is_matrix(value: object) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(row, list) for row in value)


class List(list[Any]):
    """A URScript list, ``[1, 2]``; a matrix is a list of lists."""

    __slots__ = ()

    def copy(self, depth: int = NESTING_LIMIT) -> Self:
        """Return a copy that shares no nested list with this one, nested to `depth` at most."""
        if not depth:
            raise ScriptRuntimeError("Type error: lists are nested too deep")
        return type(self)(
            [item.copy(depth - 1) if isinstance(item, List) else item for item in self]
        )

    def __neg__(self) -> Self:
        return type(self)([-item for item in self])

    __add__ = _elementwise(lambda a, b: add(a, b))
    __sub__ = _elementwise(operator.sub)
    __truediv__ = _elementwise(operator.truediv)
    __mod__ = _elementwise(lambda a, b: modulo(a, b))
    __radd__ = _reflected(lambda a, b: add(a, b))
    __rsub__ = _reflected(operator.sub)
    __rtruediv__ = _reflected(operator.truediv)
    __rmod__ = _reflected(lambda a, b: modulo(a, b))
    __rmul__ = _reflected(lambda a, b: multiply(a, b))
    _times = _elementwise(lambda a, b: multiply(a, b))

    def __mul__(self, other: object) -> List:
        """Matrix product if the left side is a matrix and the right side a list; else per item."""
        if not (_is_matrix(self) and isinstance(other, list)):
            return self._times(other)
        if any(len(row) != len(other) for row in self):
            raise ScriptRuntimeError("Type error: matrix dimensions do not match")
        if _is_matrix(other):
            columns = list(zip(*other, strict=False))
            return List([List([_dot(row, column) for column in columns]) for row in self])
        return List([_dot(row, other) for row in self])


class Pose(List):
    """A pose ``p[x, y, z, rx, ry, rz]`` (m and rotation vector in rad)."""

    __slots__ = ()


def _dot(a: Any, b: Any) -> Any:
    return sum(map(operator.mul, a, b))


def copy_value(value: Any) -> Any:
    """Return ``value`` itself, or a copy of a list: URScript assigns by value."""
    return value.copy() if isinstance(value, List) else value


def add(a: Any, b: Any) -> Any:
    """Compute ``a + b``; strings are joined by str_cat alone, an integer result fits 64 bits."""
    if a.__class__ is str:
        raise ScriptRuntimeError("Type error: operator + does not take strings, use str_cat")
    total = a + b
    if total.__class__ is int and not -INTEGER_LIMIT <= total < INTEGER_LIMIT:
        raise ScriptRuntimeError("Value out of range: integer overflow")
    return total


def modulo(a: Any, b: Any) -> Any:
    """Compute ``a % b``."""
    if a.__class__ is str:
        raise ScriptRuntimeError("Type error: operator % does not take strings")
    return a % b


def multiply(a: Any, b: Any) -> Any:
    """Compute ``a * b``; an integer result must fit 64 bits, so that none grows without bound."""
    product = a * b
    if product.__class__ is float:
        return product
    if product.__class__ is int:
        if -INTEGER_LIMIT <= product < INTEGER_LIMIT:
            return product
        raise ScriptRuntimeError("Value out of range: integer overflow")
    if isinstance(product, List):
        return product
    raise ScriptRuntimeError("Type error: operator * takes numbers and lists")


def index(value: Any) -> Any:
    """Return ``value`` if it may index a list: URScript does not count from the end."""
    if value < 0:
        raise ScriptRuntimeError("Index out of range")
    return value


def to_text(value: object) -> str:
    """Write a value as to_str and textmsg do: six significant digits, no blanks in lists."""
    if isinstance(value, list):
        return ("p[" if isinstance(value, Pose) else "[") + ",".join(map(to_text, value)) + "]"
    if isinstance(value, float):
        return f"{value:g}"
    return str(value)
