"""The built-in functions that need no robot (URScript manual, modules "urmath" and "internals").

Each is listed under its URScript name with its URScript parameter names.
"""

from __future__ import annotations

import math
import random as random_numbers
from collections.abc import Callable, Generator
from typing import Any

from crtk_sim_backends.ur.urscript.errors import ScriptRuntimeError
from crtk_sim_backends.ur.urscript.values import Builtin, List, to_text

STRING_LIMIT = 1023
"""Longest string in characters that the controller can hold (manual, str_cat)."""


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


def random() -> float:
    """Random number between 0 and 1."""
    return random_numbers.random()


def norm(a: Any) -> float:
    """Absolute value of a number or Euclidean norm of a list."""
    return math.hypot(*a) if isinstance(a, list) else abs(a)


def normalize(v: List) -> List:
    """Divide a list by its norm; a zero list stays zero."""
    size = norm(v)
    return v / size if size else v.copy()


def point_dist(p_from: List, p_to: List) -> float:
    """Distance in m between the positions of two poses."""
    return math.dist(p_from[:3], p_to[:3])


def length(v: Any) -> int:
    """Count the items of a list or the characters of a string."""
    return len(v)


def transpose(m: List) -> List:
    """Transpose a matrix."""
    return List([List(column) for column in zip(*m, strict=True)])


def inv(m: List) -> List:
    """Invert a square matrix (a pose is inverted by the robot's own functions)."""
    size = len(m)
    if any(len(row) != size for row in m):
        raise ScriptRuntimeError("Type error: inv takes a square matrix")
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


def binary_list_to_integer(value: List) -> int:
    """Integer whose bits are the booleans of a list, least significant first, at most 32."""
    if len(value) > 32:
        raise ScriptRuntimeError("Value out of range: binary_list_to_integer takes 32 bits")
    number = sum(1 << bit for bit, on in enumerate(value) if on)
    return number - (1 << 32) if number >> 31 else number


def to_num(string: str) -> float:
    """Read an integer or floating-point number from a string."""
    try:
        return int(string)
    except ValueError:
        try:
            return float(string)
        except ValueError:
            raise ScriptRuntimeError(f"Type error: to_num cannot read '{string}'") from None


def _string(function: str, value: Any) -> str:
    if isinstance(value, str):
        return value
    raise ScriptRuntimeError(f"Type error: {function} takes a string")


def to_str(val: Any) -> str:
    """Write a value as a string."""
    return _limited(to_text(val))


def _limited(text: str) -> str:
    if len(text) > STRING_LIMIT:
        raise ScriptRuntimeError(f"Value out of range: string longer than {STRING_LIMIT}")
    return text


def str_cat(op1: Any, op2: Any) -> str:
    """Join two values as strings."""
    return _limited(to_text(op1) + to_text(op2))


def str_at(src: str, index: int) -> str:
    """Character of ``src`` at ``index``."""
    if not 0 <= index < len(_string("str_at", src)):
        raise ScriptRuntimeError("Index out of range: str_at")
    return src[index]


def str_empty(str: str) -> bool:
    """Tell whether a string is empty."""
    return not _string("str_empty", str)


def str_find(src: str, target: str, start_from: int = 0) -> int:
    """Index of the first ``target`` in ``src`` from ``start_from`` on, or -1."""
    return _string("str_find", src).find(_string("str_find", target), start_from)


def str_len(str: str) -> int:
    """Count the characters of a string."""
    return len(_string("str_len", str))


def str_sub(src: str, index: int, len: int = -1) -> str:
    """Part of ``src`` of ``len`` characters from ``index`` on, to its end without ``len``."""
    if not 0 <= index <= str_len(src):
        raise ScriptRuntimeError("Index out of range: str_sub")
    return src[index:] if len < 0 else src[index : index + len]


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
    "get_list_length": length,
    "integer_to_binary_list": integer_to_binary_list,
    "inv": inv,
    "length": length,
    "log": log,
    "norm": norm,
    "normalize": normalize,
    "point_dist": point_dist,
    "pow": power,
    "r2d": r2d,
    "random": random,
    "sin": sin,
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
