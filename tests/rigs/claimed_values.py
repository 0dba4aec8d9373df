"""What a broken device may say on its wire, and whether a driver was surprised by it."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from hypothesis import strategies as st


def numbers(size: int) -> st.SearchStrategy[int]:
    """Whole numbers of `size` bytes, most of them near the ends of signed and unsigned ones."""
    most = 1 << 8 * size
    ends = (0, 1, most - 1, most - 2, most // 2, most // 2 - 1, most // 2 + 1)
    return st.one_of(st.sampled_from(ends), st.integers(0, most - 1))


class _Surprises(logging.Handler):
    def __init__(self) -> None:
        super().__init__()
        self.told: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        if record.exc_info or "unexpected" in record.getMessage():
            self.told.append(self.format(record))


@contextmanager
def no_surprise() -> Iterator[None]:
    """Nothing is to be raised in here that the driver's threads did not expect."""
    handler = _Surprises()
    root = logging.getLogger()
    root.addHandler(handler)
    try:
        yield
    finally:
        root.removeHandler(handler)
    assert not handler.told, handler.told[0]
