"""The values a running script works with, and the built-in functions it may call.

Numbers, booleans and strings are Python's; lists and structs are ours. URScript passes everything
by value, so these are copied when they are assigned or handed to a script function. Arithmetic on
lists is element by element (URScript manual, "Matrix and Array Expressions").
"""

from __future__ import annotations

import inspect
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final, NoReturn, Self

from typing_extensions import override

from crtk_sim_backends.ur.urscript.errors import ScriptRuntimeError

INTEGER_LIMIT: Final = 2**63
NESTING_LIMIT: Final = 4
"""How deep lists and structs can be nested."""

ITEM_LIMIT: Final = 20_000
"""How many items one value can hold, those of nested lists and structs included. Without the two
limits ``a = [a, a]`` in a loop would take the memory of the simulator in no time."""

STRING_LIMIT: Final = 1023
"""Longest string in characters that the controller can hold (manual, str_cat)."""


PRODUCT_LIMIT: Final = 30_000
"""How many products of numbers one operation on matrices can take: some milliseconds."""


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


def arguments_taken(call: Callable[..., Any], own: int = 0) -> str:
    """Return how many arguments a function takes, as the controller words it.

    :param own: how many of its first parameters a script does not give.
    """
    parameters = [
        parameter
        for parameter in list(inspect.signature(call).parameters.values())[own:]
        if parameter.kind is not parameter.KEYWORD_ONLY  # which the compiler gives
    ]
    needed = sum(parameter.default is parameter.empty for parameter in parameters)
    if needed == len(parameters):
        return f"takes exactly {needed} argument{'' if needed == 1 else 's'}"
    return f"takes {needed} to {len(parameters)} arguments"


class Handle(ABC):
    """A value that stands for something outside the program, such as a server; never copied.

    A script reaches into it with a dot: ``handle.name`` reads the attribute ``m_name``.
    """

    @abstractmethod
    def call(
        self, name: str, arguments: Sequence[Any], keywords: dict[str, Any]
    ) -> Generator[None, None, Any]:
        """Run the method ``name``; resumed once per control period until it has its value."""


class _Container:
    """A list or a struct: what is copied on assignment."""

    __slots__ = ()

    def weight(self) -> int:
        """Count the items, those of nested lists and structs included."""
        raise NotImplementedError

    def copy(self, depth: int = NESTING_LIMIT) -> Self:
        """Return a copy that shares nothing with this one, nested to `depth` at most."""
        raise NotImplementedError


def _copied(items: Iterable[Any], depth: int) -> list[Any]:
    if not depth:
        raise ScriptRuntimeError("Type error: lists are nested too deep")
    return [item.copy(depth - 1) if isinstance(item, _Container) else item for item in items]


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


def is_matrix(value: object) -> bool:
    """Tell whether a value is a list of lists."""
    return isinstance(value, list) and bool(value) and all(isinstance(row, list) for row in value)


class List(list[Any], _Container):
    """A URScript list, ``[1, 2]``; a matrix is a list of lists.

    ``most`` is how many items it can hold, once that differs from its first length: a list has a
    capacity, which ``make_list`` gives and which its methods keep to.
    """

    most: int | None = None

    @property
    def capacity(self) -> int:
        """How many items the list can hold."""
        return len(self) if self.most is None else self.most

    @override
    def weight(self) -> int:
        """Count the items, those of nested lists and structs included."""
        return len(self) + sum(item.weight() for item in self if isinstance(item, _Container))

    @override
    def copy(self, depth: int = NESTING_LIMIT) -> Self:
        """Return a copy that shares no nested list with this one, nested to `depth` at most."""
        copy = type(self)(_copied(self, depth))
        if self.most is not None:
            copy.most = self.most
        return copy

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

    @override
    def __mul__(self, other: object) -> List:
        """Matrix product if the left side is a matrix and the right side a list; else per item."""
        if not (is_matrix(self) and isinstance(other, list)):
            return self._times(other)
        if any(len(row) != len(other) for row in self):
            raise ScriptRuntimeError("Type error: matrix dimensions do not match")
        if len(self) * len(other) * (len(other[0]) if is_matrix(other) else 1) > PRODUCT_LIMIT:
            raise ScriptRuntimeError("Value out of range: the matrices are too large")
        if is_matrix(other):
            columns = list(zip(*other, strict=False))
            return List([List([_dot(row, column) for column in columns]) for row in self])
        return List([_dot(row, other) for row in self])


class Pose(List):
    """A pose ``p[x, y, z, rx, ry, rz]`` (m and rotation vector in rad)."""


class Struct(_Container):
    """A struct ``struct(a=1, b="text")``: members with names, which are fixed once it is made.

    A member ``a`` is the attribute ``m_a``, which scripts read; ``s[0]`` is the first member.
    """

    def __init__(self, members: Iterable[tuple[str, Any]]) -> None:
        self.__dict__.update((f"m_{name}", value) for name, value in members)

    def __len__(self) -> int:
        return len(self.__dict__)

    def __getitem__(self, index: int) -> Any:
        return list(self.__dict__.values())[index]

    def __setitem__(self, index: int, value: Any) -> None:
        self.__dict__[list(self.__dict__)[index]] = value

    @override
    def __eq__(self, other: object) -> bool:
        return isinstance(other, Struct) and self.__dict__ == other.__dict__

    __hash__ = None  # type: ignore[assignment]

    def items(self) -> Iterable[tuple[str, Any]]:
        """Names and values of the members, in their order."""
        return ((name[2:], value) for name, value in self.__dict__.items())

    @override
    def weight(self) -> int:
        """Count the members, the items of nested lists and structs included."""
        values = self.__dict__.values()
        return len(values) + sum(item.weight() for item in values if isinstance(item, _Container))

    @override
    def copy(self, depth: int = NESTING_LIMIT) -> Struct:
        """Return a copy that shares nothing with this one, nested to `depth` at most."""
        values = _copied(self.__dict__.values(), depth)
        return Struct(zip((name for name, _ in self.items()), values, strict=True))


def _dot(a: Any, b: Any) -> Any:
    return sum(map(operator.mul, a, b))


def _limit(count: int) -> None:
    if count > ITEM_LIMIT:
        raise ScriptRuntimeError(f"Value out of range: a list of more than {ITEM_LIMIT} items")


def check_weight(*values: Any, count: int = 1) -> None:
    """Refuse values that are, ``count`` times, more than one value can hold."""
    inner = sum(value.weight() for value in values if isinstance(value, _Container))
    _limit(count * (len(values) + inner))


def build(kind: type[List], items: tuple[Any, ...]) -> List:
    """Make a list of copies of ``items``."""
    for item in items:
        if isinstance(item, _Container):
            check_weight(*items)
            return kind(_copied(items, NESTING_LIMIT))
    return kind(items)


def build_struct(**members: Any) -> Struct:
    """Make a struct of copies of ``members``; their names come with ``m_`` before them."""
    check_weight(*members.values())
    return Struct((name[2:], copy_value(value)) for name, value in members.items())


def fitting(whole: Any, part: Any) -> Any:
    """Return a copy of ``part`` that is assigned within ``whole``, which has room for it."""
    if not isinstance(part, _Container):
        return part
    check_weight(whole, part)
    return part.copy()


def same_size(old: Any, new: Any) -> Any:
    """Return what a variable gets that holds ``old``, where a list keeps its size."""
    if isinstance(new, list) and isinstance(old, list) and len(new) != len(old):
        raise ScriptRuntimeError("Resizing of 'List' is not supported")
    return new


def set_member(struct: Any, name: str, value: Any) -> None:
    """Assign to a member that a struct has."""
    if not isinstance(struct, Struct):
        wrong_type(f"only a struct has a member {name}")
    if f"m_{name}" not in struct.__dict__:
        wrong_type(f"the struct has no member {name}")
    struct.__dict__[f"m_{name}"] = value


def copy_value(value: Any) -> Any:
    """Return ``value`` itself, or a copy of a list or struct: URScript assigns by value."""
    return value.copy() if isinstance(value, _Container) else value


def add(a: Any, b: Any) -> Any:
    """Compute ``a + b``; two strings are joined, an integer result fits 64 bits."""
    if a.__class__ is str and b.__class__ is not str:
        raise ScriptRuntimeError("Type error: operator + takes two strings or none")
    total = a + b
    if total.__class__ is int and not -INTEGER_LIMIT <= total < INTEGER_LIMIT:
        raise ScriptRuntimeError("Value out of range: integer overflow")
    return limited(total) if total.__class__ is str else total


def limited(text: str) -> str:
    """Return a joined string that the controller can hold, else raise."""
    if len(text) > STRING_LIMIT:
        raise ScriptRuntimeError(f"Value out of range: string longer than {STRING_LIMIT}")
    return text if text.isascii() else from_bytes(to_bytes(text))


# The manual counts strings in bytes, so that an index may lie within a character: text and bytes go
# back and forth with `surrogateescape`, which keeps what is no character.


def to_bytes(text: str) -> bytes:
    """Return the bytes of a string, UTF-8."""
    return text.encode("utf-8", "surrogateescape")


def from_bytes(data: bytes) -> str:
    """Return the string with these bytes."""
    return data.decode("utf-8", "surrogateescape")


def modulo(a: Any, b: Any) -> Any:
    """Compute ``a % b``."""
    if a.__class__ is str:
        raise ScriptRuntimeError("Type error: operator % does not take strings")
    return a % b


def multiply(a: Any, b: Any) -> Any:
    """Compute ``a * b``; an integer result must fit 64 bits, so that none grows without bound."""
    if a.__class__ is float:
        return a * b
    if a.__class__ is str or b.__class__ is str:
        raise ScriptRuntimeError("Type error: operator * takes numbers and lists")
    product = a * b
    if product.__class__ is int and not -INTEGER_LIMIT <= product < INTEGER_LIMIT:
        raise ScriptRuntimeError("Value out of range: integer overflow")
    return product


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
    if isinstance(value, Struct):
        return f"struct({','.join(f'{name}={to_text(item)}' for name, item in value.items())})"
    return str(value)


def wrong_type(text: str) -> NoReturn:
    """Stop the program with a type error."""
    raise ScriptRuntimeError(f"Type error: {text}")
