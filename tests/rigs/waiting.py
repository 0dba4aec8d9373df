"""Waiting for what a device, or a process, comes to by itself."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import pytest

LONG = 60.0
"""Seconds that anything may take to start or to arrive before a test gives up: no promise of a driver."""


def eventually(
    test: Callable[[], Any],
    what: str | Callable[[], str] = "what the test waits for",
    timeout: float = LONG,
) -> Any:
    """Return what `test` returns as soon as that is true; `what` may be asked for when it was never."""
    deadline = time.monotonic() + timeout
    while not (found := test()):
        if time.monotonic() > deadline:
            pytest.fail(f"never: {what() if callable(what) else what}")
        time.sleep(0.005)
    return found


def endless(data: bytes) -> Callable[[float], bytes]:
    """Return a way's `read` that always has data; it fails for who reads for longer than `LONG`."""
    end = time.monotonic() + LONG

    def read(deadline: float) -> bytes:
        assert time.monotonic() < end, "it reads for ever"
        return data

    return read
