"""Shifts the clock of every Python process that has this folder on its path, by `CRTK_TESTS_SHIFT` seconds.

What F18 does to a driver in the same process, for programs and all that they start. Monotonic clocks go on.
"""

import os
import time

_SHIFT = round(float(os.environ.get("CRTK_TESTS_SHIFT", "0")) * 1e9)
_wall_ns = time.time_ns


def _shifted_ns() -> int:
    return _wall_ns() + _SHIFT


def _shifted() -> float:
    return _shifted_ns() * 1e-9


time.time_ns, time.time = _shifted_ns, _shifted
