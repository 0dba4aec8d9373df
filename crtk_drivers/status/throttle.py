"""What would be told in each cycle is told once in a while."""

from __future__ import annotations

import math
import re
from collections import Counter
from typing import Final

MOST_KINDS: Final = 200
"""Kinds that are remembered beyond their interval at most."""

_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(\.\d*)?(e[-+]?\d+)?(?!\w)")


class Throttle:
    """Lets one event of a kind through in `interval` seconds, the first at once, and counts the others."""

    def __init__(self, interval: float) -> None:
        self._interval = interval
        self._passed: dict[object, float] = {}
        self._left_out: Counter[object] = Counter()

    def passes(self, kind: object, now: float) -> bool:
        """Say whether an event of `kind` may pass at the monotonic time `now`, and remember it if so."""
        if now - self._passed.get(kind, -math.inf) < self._interval:
            self._left_out[kind] += 1
            return False
        if len(self._passed) >= MOST_KINDS:
            self._forget(now)
        self._passed[kind] = now
        return True

    def left_out(self, kind: object) -> int:
        """Return how many of `kind` did not pass since this was asked last."""
        return self._left_out.pop(kind, 0)

    def _forget(self, now: float) -> None:
        for kind, passed in list(self._passed.items()):
            if now - passed >= self._interval:
                del self._passed[kind]
                self._left_out.pop(kind, None)


def kind_of(text: str) -> str:
    """Return `text` without its numbers, which change from cycle to cycle; those in names stay."""
    return _NUMBER.sub("#", text)
