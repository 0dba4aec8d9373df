"""Checks of what scripts hand to built-ins. Errors stop the program."""

from __future__ import annotations

from math import isfinite
from typing import Any

from crtk_sim_backends.ur.urscript.errors import ScriptRuntimeError

LARGEST = 1e6  # of any position, force, mass, ...: what is larger is a mistake and no physics


def vector(name: str, value: Any, length: int) -> tuple[float, ...]:
    """Check that `value` is a list that begins with `length` numbers; the rest is dropped."""
    if (
        not isinstance(value, (list, tuple))
        or len(value) < length
        or not all(isinstance(x, (int, float)) and abs(x) <= LARGEST for x in value)
    ):
        raise ScriptRuntimeError(
            f"{name}: expected {length} numbers of at most {LARGEST:g}, got {value}"
        )
    return tuple(float(x) for x in value[:length])


def six(name: str, value: Any) -> list[float]:
    """Check that `value` is a list of six numbers."""
    if isinstance(value, (list, tuple)) and len(value) != 6:
        raise ScriptRuntimeError(f"{name}: expected six numbers, got {len(value)}")
    return list(vector(name, value, 6))


def positive(name: str, value: Any) -> float:
    """Check that `value` is a finite number above zero."""
    if not isinstance(value, (int, float)) or not isfinite(value) or value <= 0:
        raise ScriptRuntimeError(f"{name}: expected a number above zero, got {value}")
    return float(value)
