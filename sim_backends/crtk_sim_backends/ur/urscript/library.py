"""The built-in functions that need no robot (URScript manual, modules "urmath" and "internals").

Each is listed under its URScript name with its URScript parameter names.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Generator
from typing import Any, Final

from crtk_sim_backends.ur.urscript.errors import ScriptRuntimeError
from crtk_sim_backends.ur.urscript.values import (
    ITEM_LIMIT,
    Builtin,
    List,
    check_weight,
    copy_value,
    from_bytes,
    is_matrix,
    limited,
    to_bytes,
    to_text,
    wrong_type,
)

MATRIX_LIMIT: Final = 30
"""Rows of the largest matrix that `inv` takes: some milliseconds."""

_NUMBER = re.compile(
    r"\s*(?:(?P<hex>[+-]?0[xX][0-9A-Fa-f]+)|(?P<int>[+-]?\d+)"
    r"|(?P<float>[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|inf(?:inity)?|nan)))",
    re.IGNORECASE | re.ASCII,
)
"""What `to_num` reads (manual, to_num)."""


def sin(f: float) -> float:
    """Sine of ``f`` (rad)."""
    return math.sin(f)


def cos(f: float) -> float:
    """Cosine of ``f`` (rad)."""
    return math.cos(f)


def tan(f: float) -> float:
    """Tangent of ``f`` (rad)."""
    return math.tan(f)


def asin(f: float) -> float:
    """Arc sine of ``f`` in rad."""
    return math.asin(f)


def acos(f: float) -> float:
    """Arc cosine of ``f`` in rad."""
    return math.acos(f)


def atan(f: float) -> float:
    """Arc tangent of ``f`` in rad."""
    return math.atan(f)


def atan2(x: float, y: float) -> float:
    """Arc tangent of ``x / y`` in rad, in the quadrant of both (the manual's order of names)."""
    return math.atan2(x, y)


def sqrt(f: float) -> float:
    """Square root of ``f``."""
    return math.sqrt(f)


def power(base: float, exponent: float) -> float:
    """``base`` to the power ``exponent``."""
    return math.pow(base, exponent)


def log(b: float, f: float) -> float:
    """Logarithm of ``f`` to the base ``b``."""
    return math.log(f, b)


def ceil(f: float) -> int:
    """Smallest integer not below ``f``."""
    return math.ceil(f)


def floor(f: float) -> int:
    """Largest integer not above ``f``."""
    return math.floor(f)


def d2r(d: float) -> float:
    """Degrees to radians."""
    return math.radians(d)


def r2d(r: float) -> float:
    """Radians to degrees."""
    return math.degrees(r)


def norm(a: Any) -> float:
    """Absolute value of a number or Euclidean norm of a list."""
    return math.hypot(*a) if isinstance(a, list) else abs(a)


def normalize(v: List) -> List:
    """Divide a list by its norm, which must not be zero."""
    return v / norm(v)


def point_dist(p_from: List, p_to: List) -> float:
    """Distance in m between the positions of two poses."""
    return math.dist(p_from[:3], p_to[:3])


def length(v: Any) -> int:
    """Count the items of a list or the bytes of a string."""
    return str_len(v) if isinstance(v, str) else len(v)


def get_list_length(v: List) -> int:
    """Count the items of a list."""
    if not isinstance(v, List):
        wrong_type("get_list_length takes a list")
    return len(v)


def size(v: Any) -> Any:
    """Rows and columns of a matrix; the length of a list or string."""
    return List([len(v), len(v[0])]) if is_matrix(v) else length(v)


def make_list(length: int, initial_value: Any, capacity: int | None = None) -> List:
    """Make a list of ``length`` times a value, which can grow up to ``capacity``."""
    most = length if capacity is None else capacity
    if not 0 <= length <= most <= ITEM_LIMIT:
        raise ScriptRuntimeError(f"Value out of range: a list of {length} items out of {most}")
    if isinstance(initial_value, List):
        wrong_type("make_list makes no list of lists")
    check_weight(initial_value, count=int(length))
    made = List([copy_value(initial_value) for _ in range(int(length))])
    made.most = int(most)
    return made


def transpose(m: List) -> List:
    """Transpose a matrix; a list becomes a column."""
    rows = m if is_matrix(m) else [m]
    return List([List(column) for column in zip(*rows, strict=True)])


def inv(m: List) -> List:
    """Invert a square matrix (a pose is inverted by the robot's own functions)."""
    size = len(m)
    if not is_matrix(m) or any(len(row) != size for row in m):
        wrong_type("inv takes a square matrix")
    if size > MATRIX_LIMIT:
        raise ScriptRuntimeError(f"Value out of range: inv of more than {MATRIX_LIMIT} rows")
    rows = [[*map(float, row), *(float(i == j) for j in range(size))] for i, row in enumerate(m)]
    for column in range(size):
        _, pivot = max((abs(rows[row][column]), row) for row in range(column, size))
        rows[column], rows[pivot] = rows[pivot], rows[column]
        scale = rows[column][column]
        if scale == 0:
            raise ScriptRuntimeError("Value out of range: inv of a singular matrix")
        rows[column] = [value / scale for value in rows[column]]
        for row in range(size):
            if row != column:
                factor = rows[row][column]
                rows[row] = [a - factor * b for a, b in zip(rows[row], rows[column], strict=True)]
    return List([List(row[size:]) for row in rows])


def integer_to_binary_list(x: int) -> List:
    """Bits of a 32-bit integer as booleans, least significant first."""
    return List([bool(x >> bit & 1) for bit in range(32)])


def binary_list_to_integer(l: List) -> int:  # noqa: E741
    """Integer whose bits are the first 32 booleans of a list, least significant first."""
    number = sum(1 << bit for bit, on in enumerate(l[:32]) if on)
    return number - (1 << 32) if number >> 31 else number


def to_num(str: str) -> float:
    """Read an integer or floating-point number from a string."""
    match = _NUMBER.fullmatch(_string("to_num", str).rstrip("\0"))
    if match is None:
        wrong_type(f"to_num cannot read '{str}'")
    if match["float"]:
        return float(match["float"])
    number = int(match["hex"], 16) if match["hex"] else int(match["int"])
    if not -(2**31) <= number < 2**32:
        raise ScriptRuntimeError(f"Value out of range: to_num of '{str}'")
    return number


def _string(function: str, value: Any) -> str:
    if not isinstance(value, str):
        wrong_type(f"{function} takes a string")
    return value


def to_str(val: Any) -> str:
    """Write a value as a string."""
    return limited(to_text(val))


def str_cat(op1: Any, op2: Any) -> str:
    """Join two values as strings."""
    return limited(to_text(op1) + to_text(op2))


def str_at(src: str, index: int) -> str:
    """Byte of ``src`` at ``index``."""
    data = to_bytes(_string("str_at", src))
    if not 0 <= index < len(data):
        raise ScriptRuntimeError("Index out of range: str_at")
    return from_bytes(data[index : index + 1])


def str_empty(str: str) -> bool:
    """Tell whether a string is empty."""
    return not _string("str_empty", str)


def str_find(src: str, target: str, start_from: int = 0) -> int:
    """Index of the first ``target`` in ``src`` from ``start_from`` on, or -1."""
    if start_from < 0:
        raise ScriptRuntimeError("Index out of range: str_find")
    data = to_bytes(_string("str_find", src))
    return data.find(to_bytes(_string("str_find", target)), start_from)


def str_len(str: str) -> int:
    """Count the bytes of a string."""
    return len(to_bytes(_string("str_len", str)))


def str_sub(src: str, index: int, len: int | None = None) -> str:
    """Part of ``src`` of at most ``len`` bytes from ``index`` on, to its end without ``len``."""
    data = to_bytes(_string("str_sub", src))
    if not 0 <= index <= str_len(src) or (len is not None and len < 0):
        raise ScriptRuntimeError("Index out of range: str_sub")
    return from_bytes(data[index:] if len is None else data[index : index + len])


_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "acos": acos,
    "asin": asin,
    "atan": atan,
    "atan2": atan2,
    "binary_list_to_integer": binary_list_to_integer,
    "ceil": ceil,
    "cos": cos,
    "d2r": d2r,
    "floor": floor,
    "get_list_length": get_list_length,
    "integer_to_binary_list": integer_to_binary_list,
    "inv": inv,
    "length": length,
    "log": log,
    "make_list": make_list,
    "norm": norm,
    "normalize": normalize,
    "point_dist": point_dist,
    "pow": power,
    "r2d": r2d,
    "sin": sin,
    "size": size,
    "sqrt": sqrt,
    "str_at": str_at,
    "str_cat": str_cat,
    "str_empty": str_empty,
    "str_find": str_find,
    "str_len": str_len,
    "str_sub": str_sub,
    "tan": tan,
    "to_num": to_num,
    "to_str": to_str,
    "transpose": transpose,
}

PURE_BUILTINS = {name: Builtin(name, call) for name, call in _FUNCTIONS.items()}
"""Built-ins that only compute, by name."""


def timing_builtins(tick_seconds: float) -> dict[str, Builtin]:
    """Return the built-ins that only let time pass, for a control period of ``tick_seconds``."""

    def sync() -> Generator[None]:
        yield

    def sleep(t: float) -> Generator[None]:
        for _ in range(max(1, round(t / tick_seconds))):
            yield

    return {"sync": Builtin("sync", sync, blocking=True), "sleep": Builtin("sleep", sleep, True)}
